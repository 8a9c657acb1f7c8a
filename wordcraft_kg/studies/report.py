"""A study report: page, tables and pictures from a study's summarised results."""

from itertools import groupby
from operator import attrgetter
from pathlib import Path

from wordcraft_kg.base.wording import counted
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.charts import Chart, Estimate
from wordcraft_kg.reports.pages import Report, write_report
from wordcraft_kg.studies.claims import in_words
from wordcraft_kg.studies.tables import as_csv, notes, tables_of, with_bounds
from wordcraft_kg.studies.variants import Correlation, PointMetrics, ScorerScatter
from wordcraft_kg.studies.view import StudyView, title_of

_SUCCESS = "greedy success on test tasks"


def write_study_report(view: StudyView, folder: Path, *, force: bool = False) -> list[Path]:
    """Write a study's report.

    Args:
        view: the summarised results.
        folder: folder to write, which appears when it is complete.
        force: replace an existing report.

    Returns:
        The paths of page, ``report.json``, table and picture.

    Raises:
        OutputExistsError: if ``folder`` exists and ``force`` is False.
        ValueError: if a number is not finite or out of bounds; nothing is written.
    """
    report = make_study_report(view)
    write_report(report, folder, force=force)
    return [folder / name for name in ("index.html", "report.json", *report.files)]


def make_study_report(view: StudyView) -> Report[StudyView]:
    """Return a study report, ready to write.

    Returns:
        The page with its charts, and the files ``table.csv`` and ``figure.svg``.
    """
    # A claim has one verdict for each grid point, all in a row: the page prints its text once.
    claims = [list(same) for _, same in groupby(view.claims, key=attrgetter("text"))]
    return Report(
        view,
        "wordcraft_kg.studies/study_report.html.j2",
        {"panels": panels_of(view)},
        # Functions too: the template formats a value where it is printed.
        shown={
            "tables": tables_of(view),
            "notes": notes(view),
            "counted": counted,
            "correlation": _correlation,
            "title": title_of,
            "words": in_words,
            "claims": claims,
        },
        files={"table.csv": as_csv(view), "figure.svg": study_figure(view)},
    )


def _correlation(of: Correlation | None) -> str:
    """Format a correlation with its interval; a dash without one."""
    return with_bounds(of.value, (of.low, of.high), ".2f") if of else "–"


def study_figure(view: StudyView) -> str:
    """Return a study's picture as the text of an SVG file, with a chart for each grid point."""
    return charts.as_file(list(panels_of(view).items()), view.title)


def panels_of(view: StudyView) -> dict[str, Chart]:
    """Return a chart for each grid point, by caption.

    A "scatter" study has a single chart for all scorer settings.
    """
    if view.drawing == "scatter" and view.scatters:
        by_title: dict[str, list[ScorerScatter]] = {}
        for scatter in view.scatters:
            by_title.setdefault(title_of(scatter.values), []).append(scatter)
        return {title: _scatter(view, scatters) for title, scatters in by_title.items()}
    panels = {}
    for point in view.points:
        has_curves = any(len(entry.curve) > 1 for entry in point.variants)
        draw = _curves if view.drawing == "curves" and has_curves else _bars
        panels[point.title] = draw(view, point)
    return panels


def _curves(view: StudyView, point: PointMetrics) -> Chart:
    """Draw the success of each variant over training."""
    # A variant keeps its colour at all points.
    colours: dict[str, int] = {}
    for at in view.points:
        for entry in at.variants:
            colours.setdefault(entry.variant, len(colours))
    series = {}
    for entry in sorted(point.variants, key=lambda entry: colours[entry.variant]):
        series[entry.variant] = [(at.step, at.success, at.low, at.high) for at in entry.curve]
    return charts.curves(
        series,
        "environment steps",
        _SUCCESS,
        f"Success of each variant over training, {point.title}",
        percent=True,
        colours={name: colours[name] for name in series},
    )


def _bars(view: StudyView, point: PointMetrics) -> Chart:
    """Draw the final success of each variant, with its interval and a line for the reference."""
    # A point where the reference has no runs has no line.
    reference = None
    rows = []
    for entry in point.variants:
        rows.append((entry.variant, (entry.mean, *entry.interval)))
        if entry.variant == view.reference:
            reference = entry.mean
    return charts.intervals(
        rows,
        "success on test tasks, 95 % over seeds and tasks",
        f"Success of each variant, {point.title}",
        reference=reference,
        percent=True,
    )


def _scatter(view: StudyView, scatters: list[ScorerScatter]) -> Chart:
    """Draw the success of agents by the MRR of their scorers, and that of one without a scorer."""
    # Labels name the variants only if a chart has agents of several.
    has_several = False
    for scatter in scatters:
        agents = {at.variant for at in scatter.points}
        has_several = has_several or len(agents) > 1
    series: dict[str, list[tuple[str, Estimate, Estimate]]] = {}
    for scatter in scatters:
        how = "in-sample" if scatter.in_sample else "cross-fitted"
        for at in scatter.points:
            # One agent alone needs no name: what then tells points apart is how train tasks are
            # scored.
            name = at.variant if has_several else how
            mrr: Estimate = (at.mrr, *at.mrr_range)
            success: Estimate = (at.success, *at.interval)
            series.setdefault(name, []).append((at.label, mrr, success))
    without = next((scatter.without for scatter in scatters if scatter.without is not None), None)
    return charts.scatter(
        series,
        "leak-free MRR of the scorer on test triples",
        _SUCCESS,
        "Success by the MRR of the scorer",
        level=None if without is None else (view.reference, without),
    )
