"""The agent report: evaluation results for all agents, with charts.

Charts are curves of success, statistics and mixing weights, and bars of score sources.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from wordcraft_kg.agents.explanation import ExplainedSlot, ExplainedStep
from wordcraft_kg.evaluation.agent_metrics import (
    OTHER_BOOK,
    CurvePoint,
    LambdaCurve,
    SeedCurve,
    Slice,
    TrainingMetric,
)
from wordcraft_kg.evaluation.agents import AgentsView, by_success
from wordcraft_kg.evaluation.scores import BECAUSE, main_support, strength
from wordcraft_kg.models.policies.sources import ALPHA, Label, label_of, source_names
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.charts import element
from wordcraft_kg.reports.pages import Report

METRICS: dict[TrainingMetric, str] = {
    "test_success": "greedy success on test tasks",
    "return": "return of the last episodes",
    "loss": "loss",
    "pg_loss": "loss of the policy",
    "baseline_loss": "loss of the state value (V)",
    "entropy": "entropy of the policy, nats",
    "grad_norm": "gradient norm",
}


def source_colours() -> dict[str, int]:
    """Return the colour number for each score source, by name."""
    names = (ALPHA.name, *source_names())
    return {name: number for number, name in enumerate(names)}


def picture_of_success(curves: Mapping[str, Mapping[str, Sequence[CurvePoint]]]) -> charts.Chart:
    """Draw success curves on train and test tasks, from the points by agent and task part."""
    drawn = []
    for number, (agent, parts) in enumerate(curves.items()):
        for part, points in parts.items():
            estimates = [(point.step, point.success, point.low, point.high) for point in points]
            # Both curves of an agent share a colour, so the distance between them is easy to see.
            drawn.append(charts.ChartCurve(f"{agent}, {part}", estimates, number, part == "train"))
    return charts.curves(
        drawn,
        "environment steps",
        "greedy success",
        "Success on train and test tasks over training",
        percent=True,
    )


def picture_of_lambdas(agent: str, lambdas: Sequence[LambdaCurve]) -> charts.Chart:
    """Draw an agent's mixing weights (λ for each score source) over training."""
    colour_of_source = source_colours()
    drawn = []
    for curve in lambdas:
        label = f"{label_of(curve.source).coefficient} {curve.action}"
        colour = colour_of_source[curve.source]
        # Both actions of a source share its colour; dashes tell them apart.
        is_second = curve.action == "second"
        drawn.append(charts.ChartCurve(label, _without_interval(curve.points), colour, is_second))
    return charts.curves(
        drawn,
        "environment steps",
        "mean mixing weight (λ) in the last batch",
        f"Mixing weights of {agent} over training",
    )


def _without_interval(points: Sequence[tuple[int, float]]) -> list[charts.CurvePoint]:
    return [(step, value, None, None) for step, value in points]


def pictures_of_metrics(
    figures: Mapping[str, Mapping[TrainingMetric, Sequence[SeedCurve]]],
) -> dict[TrainingMetric, charts.Chart]:
    """Draw a chart for each logged statistic with a curve for each run.

    ``figures`` has the curves by agent and statistic.
    """
    pictures = {}
    for figure, title in METRICS.items():
        drawn = []
        for number, (agent, by_metric) in enumerate(figures.items()):
            for place, curve in enumerate(by_metric.get(figure, ())):
                # The first seed's curve carries the agent's name.
                label = agent if place == 0 else ""
                drawn.append(charts.ChartCurve(label, _without_interval(curve.points), number))
        if drawn:
            pictures[figure] = charts.curves(
                drawn,
                "environment steps",
                title,
                f"{title} over training, a curve for each seed".capitalize(),
                percent=figure == "test_success",
                width=1.2,
            )
    return pictures


def contribution_bar(
    contributions: Mapping[str, float],
    scale: float,
    colours: Mapping[str, int],
) -> Markup:
    """Draw terms of a sum as a bar.

    Positive terms are stacked to the right of the middle, negative terms to the left.

    Args:
        contributions: terms by name.
        scale: value for half the width.
        colours: colour number by name.

    Returns:
        The bar as SVG.
    """
    half = 70.0
    height = 12
    # The next term of each sign begins where the last one ended, at first in the middle.
    right = half
    last_left = half
    terms = []
    for name, value in contributions.items():
        # A scale of 0 means that all terms are 0.
        share = min(abs(value) / scale, 1) if scale else 0.0
        width = share * half
        if value >= 0:
            start = right
            right += width
        else:
            last_left -= width
            start = last_left
        term = element(
            "rect",
            element("title", f"{name}: {value:.2f}"),
            x=f"{start:.1f}",
            y=1,
            width=f"{width:.1f}",
            height=height - 2,
            class_=f"series-{colours[name]}",
        )
        terms.append(term)
    # The middle, drawn last and so above the terms.
    middle = element("line", x1=f"{half:g}", x2=f"{half:g}", y1=0, y2=height, class_="grid")
    box = f"0 0 {2 * half:g} {height}"
    return element("svg", *terms, middle, class_="bar", viewBox=box, aria_hidden="true")


def column_labels(step: ExplainedStep) -> list[Label]:
    """Return the labels of the score sources in an explained action, in the columns' order."""
    return [label_of(name) for name in step.slots[0].sources]


def slot_rows(step: ExplainedStep) -> list[tuple[ExplainedSlot, Markup]]:
    """Return an action's slots by descending logit, each with a bar of its sources' shares."""
    # One scale for all slots: the longest side of any bar fills half the width.
    sides = []
    for slot in step.slots:
        values = slot.contributions.values()
        sides.append(sum(value for value in values if value > 0))
        sides.append(sum(-value for value in values if value <= 0))
    scale = max(sides)
    colours = source_colours()
    by_logit = sorted(step.slots, key=lambda slot: slot.logit, reverse=True)
    return [(slot, contribution_bar(slot.contributions, scale, colours)) for slot in by_logit]


ACTIONS: dict[str, Any] = {
    "colours": source_colours,
    "column_labels": column_labels,
    "label_of": label_of,
    "slot_rows": slot_rows,
    "main_support": main_support,
    "strength": strength,
    "because": BECAUSE,
}

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
    success = _success(view)
    return Report(
        view,
        "agent_report.html.j2",
        {
            "success": success,
            "curves": picture_of_success({agent.name: agent.curves for agent in view.agents}),
            "training": pictures_of_metrics({agent.name: agent.training for agent in view.agents}),
            "lambdas": {
                agent.name: picture_of_lambdas(agent.name, agent.lambdas)
                for agent in view.agents
                if agent.lambdas
            },
            "slices": _pictures_of_slices(view),
        },
        shown={
            "min_seeds": _MIN_SEEDS,
            "slice_titles": {key: title for key, (title, _) in _SLICES.items()},
            "ranked": by_success(view, view.headline),
            "colours": source_colours(),
            "actions": ACTIONS,
        },
        files={
            "figure.svg": charts.as_file([("", success)], "Success"),
            "figure.pdf": charts.as_pdf([("", success)]),
        },
    )


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
    for baseline in view.baselines:
        if baseline.distractors == view.headline:
            rows.append((baseline.player, (baseline.success, None, None)))
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
        rows: list[tuple[str, charts.Estimate]] = []
        numbers: list[int] = []
        for number, agent in enumerate(view.agents):
            ending = f", {agent.name}" if len(view.agents) > 1 else ""
            for row in agent.slices.get(key, ()):
                group = row.slice.removeprefix(OTHER_BOOK)
                rows.append((f"{group}{ending}", (row.success, *row.ci)))
                numbers.append(number)
        if rows:
            measure = f"success on {view.part} tasks, by {axis}"
            pictures[key] = charts.intervals(
                rows, measure, f"Success by {axis}", percent=True, numbers=numbers
            )
    return pictures
