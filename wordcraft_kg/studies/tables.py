"""Tables with a study's results: for the report page, as lines of text, and as CSV."""

import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from wordcraft_kg.base.wording import counted
from wordcraft_kg.studies.claims import in_words
from wordcraft_kg.studies.results import Origin
from wordcraft_kg.studies.study import Metric
from wordcraft_kg.studies.variants import Interval, PointFigures, VariantFigures
from wordcraft_kg.studies.view import StudyView, title_of


@dataclass(frozen=True)
class Table:
    """A table of texts with a title, column headings and rows; the first column names the variants."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


_Column = tuple[str, Callable[[VariantFigures], str]]


def tables_of(view: StudyView) -> list[Table]:
    """Return the tables of a study report, one per grid point with a row per agent; empty columns are left out."""
    columns = [
        (heading, text)
        for heading, text in _COLUMNS
        if any(text(at) for p in view.points for at in p.variants)
    ]
    headings = tuple(heading for heading, _ in columns)
    return [
        Table(
            point.title,
            headings,
            tuple(tuple(text(entry) for _, text in columns) for entry in point.variants),
        )
        for point in view.points
    ]


def with_bounds(value: float, interval: Interval | None, form: str = ".3f") -> str:
    """Format a value with its interval bounds, such as ``0.500 [0.400, 0.610]``."""
    return " ".join(part for part in (signed(value, form), bounds(interval, form)) if part)


def bounds(interval: Interval | None, form: str = ".3f") -> str:
    """Format interval bounds by a format specification such as ".3f"; empty for None."""
    return f"[{signed(interval[0], form)}, {signed(interval[1], form)}]" if interval else ""


def signed(value: float, form: str) -> str:
    """Format a number with a true minus sign, and a rounded 0 without sign."""
    text = format(value, form)
    if not re.search("[1-9]", text):
        text = text.replace("-", "+" if "+" in form else "")
    return text.replace("-", "−")


def _mrr(at: VariantFigures) -> str:
    if at.mrr is None or at.mrr_range is None:
        return ""
    low, high = at.mrr_range
    return f"{at.mrr:.3f}" + (f" ({low:.3f}–{high:.3f})" if f"{low:.3f}" != f"{high:.3f}" else "")


def _reached(at: VariantFigures) -> str:
    if not at.curve:
        return ""
    ends = at.reached_interval
    return _amount(at.reached) + (
        f" [{_amount(ends[0])}, {_amount(ends[1])}]" if ends and ends[0] != ends[1] else ""
    )


def _amount(steps: int | None) -> str:
    return "never" if steps is None else f"{steps:,}"


_COLUMNS: tuple[_Column, ...] = (
    ("variant", lambda at: at.variant),
    ("seeds", lambda at: str(len(at.seeds))),
    ("success [seeds, tasks]", lambda at: with_bounds(at.mean, at.interval)),
    ("success [seeds]", lambda at: bounds(at.seed_interval)),
    (
        "difference [seeds, tasks]",
        lambda at: (
            with_bounds(at.comparison.difference, at.comparison.interval, "+.3f")
            if at.comparison
            else ""
        ),
    ),
    ("train", lambda at: "" if at.train is None else f"{at.train:.3f}"),
    ("MRR", _mrr),
    ("p", lambda at: _p_value(at.comparison.p_corrected) if at.comparison else ""),
    ("reached after", _reached),
)


def notes(view: StudyView) -> list[str]:
    """Return sentences that explain the columns of :func:`tables_of`."""
    sentences = [
        "Success: share of episodes on test tasks in which the greedy agent makes the goal, with 95 % intervals: "
        "over seeds and tasks, that is, for other such tasks too, and over seeds alone (Student's t), for "
        "these tasks."
    ]
    if any(entry.comparison for point in view.points for entry in point.variants):
        sentences += [
            f"Differences are to {view.reference}, paired by seed and task, with intervals over both.",
            "Reached after: environment steps until the mean learning curve reaches where that of "
            f"{view.reference} ends, with the interval over seeds.",
            "p: of no difference, the level at which the interval of the difference reaches 0, none below three seeds"
            + (
                f"; corrected by Holm for {counted(view.comparisons, 'comparison')}."
                if view.comparisons
                else "."
            ),
        ]
    return sentences


def as_csv(view: StudyView) -> str:
    """Return all results but durations as CSV, a row per variant and grid point; equal results give equal bytes."""
    grid = list(dict.fromkeys(name for point in view.points for name in point.values))
    rows = [_values(point, entry, grid) for point in view.points for entry in point.variants]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return text.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else value


def _values(point: PointFigures, at: VariantFigures, grid: Sequence[str]) -> dict[str, object]:
    comparison = at.comparison

    def ends(name: str, interval: Sequence[float | int | None] | None) -> dict[str, object]:
        low, high = interval or ("", "")
        return {f"{name}_low": low, f"{name}_high": high}

    def steps(value: int | None) -> object:
        return ("" if not at.curve else "never") if value is None else value

    reached = at.reached_interval and [steps(end) for end in at.reached_interval]
    return {
        **{name: point.values.get(name, "") for name in grid},
        "variant": at.variant,
        "seeds": len(at.seeds),
        "tasks": point.tasks,
        "success": at.mean,
        **ends("success", at.interval),
        **ends("success_seeds", at.seed_interval),
        "by_plan": at.by_plan,
        "train": at.train,
        "mrr": at.mrr,
        **ends("mrr", at.mrr_range),
        "difference": comparison and comparison.difference,
        **ends("difference", comparison.interval if comparison else None),
        "p_value": comparison and comparison.p_value,
        "p_holm": comparison and comparison.p_corrected,
        "steps_to_reference": steps(at.reached),
        "steps_to_reference_low": reached[0] if reached else "",
        "steps_to_reference_high": reached[1] if reached else "",
        "steps": at.steps,
    }


def lines_of(view: StudyView, metric: Metric) -> Iterator[str]:
    """Yield a study's results as lines of text: ``metric`` of each agent at each grid point, and verdicts on claims."""
    yield f"{view.title}: {_TITLES[metric]}"
    for point in view.points:
        graphs = (
            dict.fromkeys(f"{graph.name}, {graph.kind}; " for graph in point.graphs)
            if point.values
            else ()
        )
        yield f"{point.title} ({''.join(graphs)}{counted(point.tasks, 'test task')})"
        width = max(len(entry.variant) for entry in point.variants)
        shown = {entry.variant: _SHOWN[metric](entry) for entry in point.variants}
        longest = max(map(len, shown.values()))
        for entry in point.variants:
            line = f"  {entry.variant:<{width}}  {shown[entry.variant]:<{longest}}  {counted(len(entry.seeds), 'seed')}"
            yield (line + (_comparison(entry) if metric == "success" else "")).rstrip()
    if metric == "success":
        of = (
            f"of {view.comparisons} comparisons, corrected by Holm"
            if view.comparisons > 1
            else "of the comparison"
        )
        compared = f"; differences to {view.reference}; p {of}" if view.comparisons else ""
        yield f"intervals: 95 % over seeds and tasks{compared}"
    if metric == "success" and view.claims:
        yield "claims"
        width = max(len(claim.verdict) for claim in view.claims)
        for claim in view.claims:
            yield f"  {claim.verdict:<{width}}  {claim.text}"
            for measured in claim.measured:
                yield f"  {'':<{width}}  {title_of(measured.values)}: {in_words(claim, measured)}"
    for origin in (origin for origin in view.origins if origin.stored):
        versions = ", ".join(f"{name} {version}" for name, version in origin.versions.items())
        yield f"{origin_in_words(origin)}: {origin.platform}; {versions}"
    if view.missing:
        first = view.missing[0]
        number = counted(len(view.missing), "training")
        yield f"{number} without figures; the first, {first.variant}, seed {first.seed}: {first.why}"


def origin_in_words(origin: Origin) -> str:
    """Format the number of trainings of an origin, and their place: here, or a store (folder of shared results)."""
    return f"{counted(origin.runs, 'training')} {'from the store' if origin.stored else 'in this folder'}"


def _p_value(p: float | None) -> str:
    if p is None:
        return "–"
    return "<.001" if p < 0.001 else f"{p:.2g}"


def _comparison(entry: VariantFigures) -> str:
    comparison = entry.comparison
    if comparison is None:
        return ""
    low, high = comparison.interval
    difference = f"{comparison.difference:+.3f} [{low:+.3f}, {high:+.3f}]"
    return f"  {difference}  p {_p_value(comparison.p_corrected)}"


_TITLES: dict[Metric, str] = {
    "success": "success on test tasks",
    "by-plan": "success on test tasks by the last pair of a plan",
    "train": "success on train tasks",
    "mrr": "leak-free MRR of the scorer, with the least and the greatest",
    "steps": "environment steps until the mean curve reaches where the reference's ends",
}
_SHOWN: dict[Metric, Callable[[VariantFigures], str]] = {
    "success": lambda at: with_bounds(at.mean, at.interval),
    "by-plan": lambda at: with_bounds(at.by_plan, None),
    "train": lambda at: "–" if at.train is None else with_bounds(at.train, None),
    "mrr": lambda at: "–" if at.mrr is None else with_bounds(at.mrr, at.mrr_range),
    "steps": lambda at: _reached(at) or "–",
}
