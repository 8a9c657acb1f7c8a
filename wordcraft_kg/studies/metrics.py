"""A study's figures as lines of text, one metric at a time."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Literal

from wordcraft_kg.base.wording import counted

if TYPE_CHECKING:
    from wordcraft_kg.studies.view import Interval, PointFigures, StudyView, VariantFigures

Metric = Literal["success", "iqm", "by-plan", "train", "mrr", "steps"]


def lines_of(view: "StudyView", metric: Metric) -> Iterator[str]:
    """Yield a study's title, and for each point of the grid a line for each variant."""
    from wordcraft_kg.studies.claims import in_words
    from wordcraft_kg.studies.view import title_of

    yield f"{view.title}: {TITLES[metric]}"
    for point in view.points:
        yield f"{point.title} ({_where(point)})"
        width = max(len(entry.variant) for entry in point.variants)
        shown = {entry.variant: SHOWN[metric](entry) for entry in point.variants}
        longest = max(map(len, shown.values()))
        for entry in point.variants:
            line = f"  {entry.variant:<{width}}  {shown[entry.variant]:<{longest}}  {counted(len(entry.seeds), 'seed')}"
            yield (line + (_comparison(entry) if metric == "success" else "")).rstrip()
    if metric == "success":
        of = f"of {view.comparisons} comparisons, corrected by Holm" if view.comparisons > 1 else "of the comparison"
        compared = f"; differences to {view.reference}; p {of}" if view.comparisons else ""
        yield f"intervals: 95 % over seeds and tasks{compared}"
    if metric == "success" and view.claims:
        yield "claims"
        width = max(len(claim.verdict) for claim in view.claims)
        for claim in view.claims:
            yield f"  {claim.verdict:<{width}}  {claim.text}"
            for measured in claim.measured:
                yield f"  {'':<{width}}  {title_of(measured.values)}: {in_words(claim, measured)}"
    if view.missing:
        first = view.missing[0]
        number = counted(len(view.missing), "training")
        yield f"{number} without figures; the first, {first.variant}, seed {first.seed}: {first.why}"


def p_in_words(p: float) -> str:
    """Return a p-value; below a thousandth its size says nothing that the data could tell."""
    return "<.001" if p < 0.001 else f"{p:.2g}"


def _where(point: "PointFigures") -> str:
    graphs = dict.fromkeys(f"{graph.name}, {graph.kind}; " for graph in point.graphs) if point.values else ()
    return "".join(graphs) + counted(point.tasks, "test task")


def _comparison(entry: "VariantFigures") -> str:
    found = entry.comparison
    if found is None:
        return ""
    low, high = found.interval
    difference = f"{found.difference:+.3f} [{low:+.3f}, {high:+.3f}]"
    return f"  {difference}  P(better) {found.p_better:.2f}  p {p_in_words(found.p_corrected)}"


def _bounds(value: float | None, interval: "Interval | None") -> str:
    if value is None:
        return "–"
    return f"{value:.3f}" + (f" [{interval[0]:.3f}, {interval[1]:.3f}]" if interval else "")


def _reached(entry: "VariantFigures") -> str:
    def steps(value: int | None) -> str:
        return "never" if value is None else f"{value:,}"

    if not entry.curve:
        return "–"
    ends = entry.reached_interval
    return steps(entry.reached) + (f" [{steps(ends[0])}, {steps(ends[1])}]" if ends else "")


TITLES: dict[Metric, str] = {
    "success": "success on test tasks",
    "iqm": "success on test tasks, mean of the middle half of the seeds",
    "by-plan": "success on test tasks by the last pair of a plan",
    "train": "success on train tasks",
    "mrr": "leak-free MRR of the scorer, with the least and the greatest",
    "steps": "environment steps until the mean curve reaches where the reference's ends",
}
SHOWN: dict[Metric, Callable[["VariantFigures"], str]] = {
    "success": lambda entry: _bounds(entry.mean, entry.interval),
    "iqm": lambda entry: _bounds(entry.iqm, entry.iqm_interval),
    "by-plan": lambda entry: _bounds(entry.by_plan, None),
    "train": lambda entry: _bounds(entry.train, None),
    "mrr": lambda entry: _bounds(entry.mrr, entry.mrr_range),
    "steps": _reached,
}
