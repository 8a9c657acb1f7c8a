"""The agent report: evaluation results for all agents, with charts."""

import re

from wordcraft_kg.agents.players import advice_on_words
from wordcraft_kg.evaluation.agent_metrics import NEVER, Slice
from wordcraft_kg.evaluation.agents import AgentsView, by_success
from wordcraft_kg.evaluation.goal_groups import MADE, NOT_MADE
from wordcraft_kg.reports import agent_pictures, charts
from wordcraft_kg.reports.pages import Report

# With fewer seeds, Student's interval over seeds is so wide that the page says so.
_MIN_SEEDS = 5
_SLICES: dict[Slice, tuple[str, str]] = {
    "train_recipes": ("By train recipes of the goal", "train recipes that make the goal"),
    "layer": ("By crafting layer", "crafting rounds to the goal"),
    "other_book": ("By the other book", "goals by whether the other book makes them"),
}


def make_agent_report(view: AgentsView) -> Report[AgentsView]:
    """Return the report on agents, ready to write.

    ``view`` has the results, by :func:`~wordcraft_kg.evaluation.agents.view_agents`.
    """
    return Report(
        view,
        "agent_report.html.j2",
        {
            "success": _success(view),
            "curves": agent_pictures.picture_of_success(
                {agent.name: agent.curves for agent in view.agents}
            ),
            "training": agent_pictures.pictures_of_metrics(
                {agent.name: agent.training for agent in view.agents}
            ),
            "lambdas": {
                agent.name: agent_pictures.picture_of_lambdas(agent.name, agent.lambdas)
                for agent in view.agents
                if agent.lambdas
            },
            "slices": _pictures_of_slices(view),
        },
        shown={
            "min_seeds": _MIN_SEEDS,
            "slice_titles": {key: title for key, (title, _) in _SLICES.items()},
            "ranked": by_success(view, view.headline),
            "colours": agent_pictures.source_colours(),
            "actions": agent_pictures.ACTIONS,
            "advice": advice_on_words(row.name for row in view.baselines),
        },
    )


def _place(label: str) -> int:
    """Return the place of a group of tasks in a chart: named groups, then groups by number."""
    named = (NEVER, MADE, NOT_MADE)
    # Negative places come before all numbers, which begin at 0.
    if label in named:
        return named.index(label) - len(named)
    return int(re.split("[–+]", label)[0])


def _success(view: AgentsView) -> charts.Chart:
    headline = str(view.headline)
    rows: list[tuple[str, charts.Estimate]] = []
    for agent in by_success(view, view.headline):
        # An MLP may be unable to play with this number of distractors.
        success = agent.success.get(headline)
        if success:
            low, high = success.widest_ci
            rows.append((agent.name, (success.mean, low, high)))
    reference = None
    first = view.agents[0].success.get(headline)
    if first:
        # The first agent's success is the line that all others are compared with.
        reference = first.mean
    for player in view.baselines:
        success_of_player = player.success[headline]
        rows.append((player.name, (success_of_player, None, None)))
    return charts.intervals(
        rows,
        f"success on {view.part} tasks, with 95 % intervals",
        "Success of the agents and of scripted players",
        reference=reference,
        percent=True,
    )


def _pictures_of_slices(view: AgentsView) -> dict[Slice, charts.Chart]:
    pictures: dict[Slice, charts.Chart] = {}
    for key, (_, axis) in _SLICES.items():
        groups: dict[str, dict[str, charts.Estimate]] = {}
        found: set[str] = set()
        for agent in view.agents:
            rows: dict[str, charts.Estimate] = {}
            for row in agent.slices.get(key, ()):
                low, high = row.ci
                rows[row.slice] = (row.success, low, high)
            groups[agent.name] = rows
            found.update(rows)
        if not found:
            continue
        labels = sorted(found, key=_place)
        cells = {}
        for name, rows in groups.items():
            # An agent has None for a group in which it played no task.
            cells[name] = [rows.get(label) for label in labels]
        measure = f"success on {view.part} tasks"
        pictures[key] = charts.dots(labels, cells, axis, measure, f"Success by {axis}")
    return pictures
