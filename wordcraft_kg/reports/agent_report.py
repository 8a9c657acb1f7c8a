"""The agent report: evaluation results for all agents, with charts.

Charts are curves of success, statistics and mixing weights, and success by kind of task.
"""

from collections.abc import Mapping, Sequence

from wordcraft_kg.evaluation.agent_metrics import (
    OTHER_BOOK,
    CurvePoint,
    LambdaCurve,
    SeedCurve,
    Slice,
    TrainingMetric,
)
from wordcraft_kg.evaluation.agents import AgentsView, by_success
from wordcraft_kg.models.policies.sources import ALPHA, label_of, source_names
from wordcraft_kg.reports import charts
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
    names = (ALPHA.name, *source_names())
    drawn = []
    for curve in lambdas:
        label = f"{label_of(curve.source).coefficient} {curve.action}"
        colour = names.index(curve.source)
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
            "sources": source_names(),
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
    # The first agent's success is the line that all others are compared with.
    first = view.agents[0].success.get(headline)
    for baseline in view.baselines:
        if baseline.distractors == view.headline:
            rows.append((baseline.player, (baseline.success, None, None)))
    return charts.intervals(
        rows,
        f"success on {view.part} tasks, with 95 % intervals",
        "Success of the agents and of scripted players",
        reference=first.mean if first else None,
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
