"""A study report: tables, page and pictures from a study's summarised results."""

from collections.abc import Callable
from itertools import chain, groupby
from operator import attrgetter
from statistics import fmean

from wordcraft_kg.base.wording import counted
from wordcraft_kg.evaluation.agent_metrics import Interval
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.charts import Chart
from wordcraft_kg.reports.pages import Report
from wordcraft_kg.studies.claims import REACHED, Measured
from wordcraft_kg.studies.study import Claim, title_of
from wordcraft_kg.studies.view import (
    PointMetrics,
    StudyView,
    VariantMetrics,
)


def tables_of(view: StudyView) -> list[list[dict[str, str]]]:
    """Return the tables of a study report: for each grid point a row per variant, by heading.

    A column without text at all points is left out of all tables, so that tables stay comparable.
    """
    entries = _entries(view)
    over = "splits" if view.study.vary_split else _RESAMPLED
    columns = [
        (heading.replace(_RESAMPLED, over), text)
        for heading, text in _COLUMNS
        if any(map(text, entries))
    ]

    def row(entry: VariantMetrics) -> dict[str, str]:
        return {heading: text(entry) for heading, text in columns}

    return [list(map(row, point.variants)) for point in view.points]


def _entries(view: StudyView) -> list[VariantMetrics]:
    return list(chain.from_iterable(point.variants for point in view.points))


def with_bounds(value: float, interval: Interval, form: str = "z.3f") -> str:
    """Format a value with its interval bounds, such as ``0.500 [0.400, 0.610]``.

    Args:
        value: the value.
        interval: lower and upper end.
        form: format specification of all three numbers.
    """
    low, high = interval
    return f"{signed(value, form)} [{signed(low, form)}, {signed(high, form)}]"


def signed(value: float, form: str) -> str:
    """Format a number with a true minus sign; with z in the form, a rounded 0 has none."""
    return format(value, form).replace("-", "−")


def p_value_of(at: VariantMetrics) -> str:
    """Format the corrected p-value of the difference to the reference; empty without one."""
    if at.comparison is None:
        return ""
    p = at.comparison.p_corrected
    if p is None:
        return "–"
    return "<.001" if p < 0.001 else f"{p:.2g}"


def _mrr(at: VariantMetrics) -> str:
    if not at.mrr:
        return ""
    low, high = (f"{end:.3f}" for end in (min(at.mrr), max(at.mrr)))
    # Variants often share one scorer: then there is no range to show.
    shown_range = "" if low == high else f" ({low}–{high})"
    return f"{fmean(at.mrr):.3f}{shown_range}"


def difference_of(at: VariantMetrics) -> str:
    """Format the difference to the reference with its interval; empty without one."""
    if at.comparison is None:
        return ""
    return with_bounds(at.comparison.difference, at.comparison.interval, "+z.3f")


_MEASURES = {
    "success": "",
    "early": "after a tenth of the steps: ",
    "steps": f"steps to {REACHED:.0%} of the other's end, as a share of all: ",
    "same_twice": "ends with one entity twice: ",
}


def in_words(claim: Claim, measured: Measured) -> str:
    """Format a claim's measured values at a grid point as a sentence.

    Returns:
        Both sides, the difference with its interval, and the numbers of seeds, tasks and groups.
    """
    right = claim.right or f"{claim.than:g}"
    if claim.right_at:
        right += f" with {title_of(claim.right_at)}"
    # A value that the claim names has no measurement of its own beside it.
    if claim.right:
        right += f" {measured.right:.3f}"
    difference = signed(measured.difference, "+z.3f")
    # A single seed has no interval.
    if measured.low is not None and measured.high is not None:
        difference = with_bounds(measured.difference, (measured.low, measured.high), "+z.3f")
    size = counted(measured.seeds, "split" if measured.splits > 1 else "seed")
    # 0 tasks: the measure has one value for each training.
    if measured.tasks:
        size += f", {counted(measured.tasks, 'task')}"
    # The number of groups says something only where a group holds several tasks.
    if measured.groups < measured.tasks:
        size += f" in {counted(measured.groups, 'group')}"
    sides = f"{claim.left} {measured.left:.3f} against {right}"
    return f"{_MEASURES[claim.measure]}{sides}: {difference} ({size})"


_RESAMPLED = "seeds, tasks"
"""What the intervals of a column are over, in its heading; over splits, another."""
# Headings, and texts of a variant's cells.
_COLUMNS: tuple[tuple[str, Callable[[VariantMetrics], str]], ...] = (
    ("variant", lambda at: at.variant),
    ("seeds", lambda at: str(len(at.seeds))),
    (f"success [{_RESAMPLED}]", lambda at: with_bounds(at.mean, at.interval)),
    (f"difference [{_RESAMPLED}]", difference_of),
    ("train", lambda at: "" if at.train is None else f"{at.train:.3f}"),
    ("MRR", _mrr),
    ("p", p_value_of),
)


def notes(view: StudyView) -> list[str]:
    """Return sentences that explain the columns of :func:`tables_of`."""
    sentences = [
        "Success: share of episodes on test tasks in which the greedy agent makes the goal, with "
        f"95 % intervals over {view.resampled}."
    ]
    entries = _entries(view)
    if any(len(entry.seeds) == 1 for entry in entries):
        sentences.append("The interval of a single seed is over its tasks alone.")
    if any(entry.comparison for entry in entries):
        sentences.append(
            f"Differences are to {view.reference}, paired by seed and task, with intervals over "
            f"{view.resampled}."
        )
    if view.comparisons:
        comparisons = counted(view.comparisons, "comparison")
        sentences.append(
            "p: of no difference, the level at which the interval of the difference reaches 0, "
            f"none below three seeds; corrected by Holm for {comparisons}."
        )
    return sentences


def make_study_report(view: StudyView) -> Report[StudyView]:
    """Return a study report, ready to write.

    Returns:
        The page with its charts, and the files ``figure.svg`` and ``figure.pdf``.
    """
    # A claim has one verdict for each grid point, all in a row: the page prints its text once.
    by_claim = groupby(view.claims, key=attrgetter("claim"))
    claims = [(claim, list(verdicts)) for claim, verdicts in by_claim]
    panels = panels_of(view)
    return Report(
        view,
        "wordcraft_kg.studies/study_report.html.j2",
        {"panels": panels},
        # Functions too: the template formats a value where it is printed.
        shown={
            "tables": tables_of(view),
            "notes": notes(view),
            "counted": counted,
            "words_of": title_of,
            "words": in_words,
            "claims": claims,
        },
        files={
            "figure.svg": charts.as_file(list(panels.items()), view.study.title),
            "figure.pdf": charts.as_pdf(list(panels.items()), view.study.title),
        },
    )


def panels_of(view: StudyView) -> dict[str, Chart]:
    """Return a chart for each grid point, by caption."""
    panels = {}
    for point in view.points:
        has_curves = any(len(entry.curve) > 1 for entry in point.variants)
        draw = _curves if view.study.drawing == "curves" and has_curves else _bars
        panels[point.title] = draw(view, point)
    return panels


def _curves(view: StudyView, point: PointMetrics) -> Chart:
    """Draw the success of each variant over training."""
    # A variant keeps its colour at all points.
    colours = {name: number for number, name in enumerate(view.study.variants)}
    last_step = max(at.step for entry in point.variants for at in entry.curve)
    drawn = []
    for entry in point.variants:
        points: list[charts.CurvePoint] = [
            (at.step, at.success, at.low, at.high) for at in entry.curve
        ]
        is_level = not entry.curve
        # A player without training is a level from the first step to the last.
        if is_level:
            points = [(step, entry.mean, None, None) for step in (0, last_step)]
        drawn.append(charts.ChartCurve(entry.variant, points, colours[entry.variant], is_level))
    return charts.curves(
        drawn,
        "environment steps",
        "greedy success on test tasks",
        f"Success of each variant over training, {point.title}",
        percent=True,
    )


def _bars(view: StudyView, point: PointMetrics) -> Chart:
    """Draw the final success of each variant, with its interval and a line for the reference."""
    means = {entry.variant: entry.mean for entry in point.variants}
    return charts.intervals(
        [(entry.variant, (entry.mean, *entry.interval)) for entry in point.variants],
        f"success on test tasks, 95 % over {view.resampled}",
        f"Success of each variant, {point.title}",
        # A point where the reference has no runs has no line.
        reference=means.get(view.reference),
        percent=True,
    )
