"""The agent report: the view of one or several agents with its pictures."""

import re
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from wordcraft_kg.agents.explanation import ExplainedSlot, ExplainedStep
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.policies.sources import ALPHA, SOURCES, Label, label_of
from wordcraft_kg.records import schema_of
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.report import Report
from wordcraft_kg.views.agents import NEVER, AgentEntry, AgentsView, Figure, Groups, Slice, view_agents
from wordcraft_kg.views.glossary import GLOSSARY
from wordcraft_kg.views.recipe_scores import because

MIN_SEEDS = 5
"""With fewer seeds the page warns that another seed may give another figure."""
COLOURS = {name: number for number, name in enumerate((ALPHA.name, *SOURCES))}
"""Number of each source's colour."""
FIGURES: dict[Figure, str] = {
    "test_success": "greedy success on test tasks",
    "return": "return of the last episodes",
    "loss": "loss",
    "pg_loss": "loss of the policy",
    "baseline_loss": "loss of the state value (V)",
    "entropy": "entropy of the policy, nats",
    "grad_norm": "gradient norm",
}
"""Title of the picture of each figure of the training."""
SLICES: dict[Slice, tuple[str, str]] = {
    "train_recipes": ("By train recipes of the goal", "train recipes that make the goal"),
    "layer": ("By crafting layer", "crafting rounds to the goal"),
    "link_rank": ("By the rank of the recipe’s links", "rank of the worse part by the ingredient score (v)"),
}
"""Heading and x-axis of each picture."""


def make_agent_report(
    groups: Groups,
    *,
    part: TaskPart = "test",
    distractors: Sequence[int] | None = None,
    draws: int = 5,
    episodes: int = 2,
) -> Report[AgentsView]:
    """Evaluate agents on all tasks of a part; see :func:`~wordcraft_kg.views.agents.view_agents`."""
    view = view_agents(groups, part=part, distractors=distractors, draws=draws, episodes=episodes)
    return Report(
        view,
        "agent_report.html.j2",
        {
            "success": _success(view),
            "curves": _success_curves(view),
            "training": _pictures_of_training(view),
            "lambdas": {agent.name: _lambda_curves(agent) for agent in view.agents if agent.lambdas},
            "slices": _pictures_of_slices(view),
        },
        shown={
            "min_seeds": MIN_SEEDS,
            "label_of": label_of,
            "because": because,
            "column_labels": column_labels,
            "slot_rows": slot_rows,
            "colours": COLOURS,
            "words": {name: GLOSSARY[name].name for name in COLOURS},
        },
    )


def report_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``report.json``."""
    return schema_of(AgentsView, "urn:wordcraft-kg:agent-report:1", "wordcraft-kg agent report")


def column_labels(step: ExplainedStep) -> list[Label]:
    """Return the labels of the columns of a step's scores."""
    return [label_of(name) for name in step.slots[0].sources]


def slot_rows(step: ExplainedStep) -> list[tuple[ExplainedSlot, Markup]]:
    """Return the slots by descending logit, each with a picture of its contributions, all on one scale."""
    scale = max(
        sum(abs(value) for value in slot.contributions.values() if (value > 0) is to_the_right)
        for slot in step.slots
        for to_the_right in (True, False)
    )
    by_logit = sorted(step.slots, key=lambda slot: slot.logit, reverse=True)
    return [(slot, charts.contribution_bar(slot.contributions, scale, COLOURS)) for slot in by_logit]


def _success(view: AgentsView) -> Markup:
    headline = str(view.headline)
    rows: list[tuple[str, tuple[float, float | None, float | None]]] = [
        (agent.name, (found.mean, *(found.seed_ci or found.task_ci)))
        for agent in view.agents
        if (found := agent.success.get(headline))
    ]
    return charts.intervals(
        rows + [(player.name, (player.success[headline], None, None)) for player in view.baselines],
        f"success on {view.part} tasks, with 95 % intervals",
        "Success of the agents and of scripted players",
        reference=rows[0][1][0] if rows else None,
        percent=True,
    )


def _pictures_of_training(view: AgentsView) -> list[Markup]:
    """Return a picture of each figure of the training, with a curve for each run."""
    pictures = []
    for figure, title in FIGURES.items():
        runs = {
            f"{agent.name}, seed {curve.seed}": (number, agent.name, curve)
            for number, agent in enumerate(view.agents)
            for curve in agent.training.get(figure, ())
        }
        if runs:
            picture = charts.curves(
                {name: [(step, value, None, None) for step, value in run[2].points] for name, run in runs.items()},
                "environment steps",
                title,
                f"{title} over training, a curve for each seed".capitalize(),
                percent=figure == "test_success",
                colours={name: number for name, (number, _, _) in runs.items()},
                # The name of an agent stands at its first seed.
                labels={name: agent for agent, name in {run[1]: name for name, run in reversed(runs.items())}.items()},
            )
            pictures.append(picture)
    return pictures


def _success_curves(view: AgentsView) -> Markup:
    curves = [
        (f"{agent.name}, {part}", part, colour, points)
        for colour, agent in enumerate(view.agents)
        for part, points in agent.curves.items()
    ]
    return charts.curves(
        {name: [(at.step, at.success, at.low, at.high) for at in points] for name, _, _, points in curves},
        "environment steps",
        "greedy success",
        "Success on train and test tasks over training",
        percent=True,
        dashed={name for name, part, _, _ in curves if part == "train"},
        colours={name: colour for name, _, colour, _ in curves},
    )


def _lambda_curves(agent: AgentEntry) -> Markup:
    curves = {f"{label_of(curve.source).coefficient} {curve.pick}": curve for curve in agent.lambdas}
    return charts.curves(
        {name: [(step, value, None, None) for step, value in curve.points] for name, curve in curves.items()},
        "environment steps",
        "mean mixing weight (λ) in the last batch",
        f"Mixing weights of {agent.name} over training",
        dashed={name for name, curve in curves.items() if curve.pick == "second"},
        colours={name: COLOURS[curve.source] for name, curve in curves.items()},
    )


def _pictures_of_slices(view: AgentsView) -> dict[Slice, tuple[str, Markup]]:
    """Return heading and picture of each way to slice the tasks."""
    pictures: dict[Slice, tuple[str, Markup]] = {}
    for key, (heading, axis) in SLICES.items():
        groups = {
            agent.name: {row.slice: (row.success, *row.ci) for row in agent.slices.get(key, ())}
            for agent in view.agents
        }
        if any(groups.values()):
            labels = sorted({label for rows in groups.values() for label in rows}, key=_lower_bound)
            cells: dict[str, Any] = {name: [rows.get(label) for label in labels] for name, rows in groups.items()}
            picture = charts.dots(labels, cells, axis, f"success on {view.part} tasks", f"Success by {axis}")
            pictures[key] = (heading, picture)
    return pictures


def _lower_bound(label: str) -> int:
    return -1 if label == NEVER else int(re.split("[–+]", label)[0])
