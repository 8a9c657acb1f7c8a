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
from wordcraft_kg.views.agents import NEVER, AgentEntry, AgentsView, Groups, Slice, view_agents

MIN_SEEDS = 5
"""With fewer seeds the page warns that a difference may be luck."""
SLICES: dict[Slice, tuple[str, str]] = {
    "train_recipes": ("By train recipes of the goal", "train recipes that make the goal"),
    "layer": ("By crafting layer", "crafting rounds to the goal"),
    "link_rank": ("By the rank of the recipe’s links", "rank of the worse part by v"),
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
            "curves": _success_curves(view),
            "lambdas": {agent.name: _lambda_curves(agent) for agent in view.agents if agent.lambdas},
            "slices": _pictures_of_slices(view),
        },
        shown={
            "min_seeds": MIN_SEEDS,
            "label_of": label_of,
            "column_labels": column_labels,
            "slot_rows": slot_rows,
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
    largest = max(abs(value) for slot in step.slots for value in slot.contributions.values())
    scale = largest * len(step.slots[0].sources)
    by_logit = sorted(step.slots, key=lambda slot: slot.logit, reverse=True)
    return [(slot, charts.contribution_bar(slot.contributions, scale)) for slot in by_logit]


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
        "mean λ in the last batch",
        f"Mixing coefficients of {agent.name} over training",
        dashed={name for name, curve in curves.items() if curve.pick == "second"},
        colours={name: [ALPHA.name, *SOURCES].index(curve.source) for name, curve in curves.items()},
    )


def _pictures_of_slices(view: AgentsView) -> dict[Slice, tuple[str, Markup]]:
    """Return heading and picture of each way to slice the tasks."""
    pictures: dict[Slice, tuple[str, Markup]] = {}
    for key, (heading, axis) in SLICES.items():
        groups = {
            agent.name: {row.slice: (row.success, *row.ci) for row in agent.slices[key]}
            for agent in view.agents
            if key in agent.slices
        }
        if groups:
            labels = sorted({label for rows in groups.values() for label in rows}, key=_lower_bound)
            cells: dict[str, Any] = {name: [rows.get(label) for label in labels] for name, rows in groups.items()}
            picture = charts.dots(labels, cells, axis, f"success on {view.part} tasks", f"Success by {axis}")
            pictures[key] = (heading, picture)
    return pictures


def _lower_bound(label: str) -> int:
    return -1 if label == NEVER else int(re.split("[–+]", label)[0])
