"""A study report: page, tables and pictures from a study's summarised results."""

from collections.abc import Iterator
from itertools import groupby
from operator import attrgetter
from pathlib import Path

from markupsafe import Markup

from wordcraft_kg.reports import charts
from wordcraft_kg.reports.charts.scales import Estimate
from wordcraft_kg.reports.pages import Report, chart_style, write_report
from wordcraft_kg.studies.claims import in_words
from wordcraft_kg.studies.tables import as_csv, notes, origin_in_words, tables_of, with_bounds
from wordcraft_kg.studies.variants import PointFigures, ScorerScatter
from wordcraft_kg.studies.view import StudyView, title_of

_SUCCESS = "greedy success on test tasks"


def write_study_report(view: StudyView, folder: Path, *, force: bool = False) -> list[Path]:
    """Write page, report.json, table and picture; return the paths."""
    report = make_study_report(view)
    write_report(report, folder, force=force)
    return [folder / name for name in ("index.html", "report.json", *report.files)]


def make_study_report(view: StudyView) -> Report[StudyView]:
    """Return a study report, ready to write."""
    return Report(
        view,
        "wordcraft_kg.studies/study_report.html.j2",
        {"panels": list(panels_of(view))},
        shown={
            "tables": tables_of(view),
            "notes": notes(view),
            "origin_in_words": origin_in_words,
            "correlation": lambda of: (
                with_bounds(of.value, (of.low, of.high), ".2f") if of else "–"
            ),
            "title": title_of,
            "words": in_words,
            "claims": [list(same) for _, same in groupby(view.claims, key=attrgetter("text"))],
        },
        files={"table.csv": as_csv(view), "figure.svg": study_figure(view)},
    )


def study_figure(view: StudyView) -> str:
    """Return a study's picture as the text of an SVG file, with a chart for each grid point."""
    return charts.figure(view.title, list(panels_of(view)), chart_style())


def panels_of(view: StudyView) -> Iterator[tuple[str, Markup]]:
    """Yield a caption and a chart for each grid point; a "scatter" study has a single chart for all scorer settings."""
    if view.drawing == "scatter" and view.scatters:
        for title in dict.fromkeys(title_of(scatter.values) for scatter in view.scatters):
            yield (
                title,
                _scatter(view, [one for one in view.scatters if title_of(one.values) == title]),
            )
        return
    for point in view.points:
        is_curve = view.drawing == "curves" and any(
            len(entry.curve) > 1 for entry in point.variants
        )
        yield point.title, (_curves if is_curve else _bars)(view, point)


def _curves(view: StudyView, point: PointFigures) -> Markup:
    # A variant keeps its colour at all points.
    names = list(dict.fromkeys(entry.variant for at in view.points for entry in at.variants))
    series = {
        entry.variant: [(at.step, at.success, at.low, at.high) for at in entry.curve]
        for entry in sorted(point.variants, key=lambda entry: names.index(entry.variant))
    }
    return charts.curves(
        series,
        "environment steps",
        _SUCCESS,
        f"Success of each variant over training, {point.title}",
        percent=True,
        colours={name: names.index(name) for name in series},
    )


def _bars(view: StudyView, point: PointFigures) -> Markup:
    reference = [entry.mean for entry in point.variants if entry.variant == view.reference]
    return charts.intervals(
        [(entry.variant, (entry.mean, *entry.interval)) for entry in point.variants],
        "success on test tasks, 95 % over seeds and tasks",
        f"Success of each variant, {point.title}",
        reference=reference[0] if reference else None,
        percent=True,
    )


def _scatter(view: StudyView, scatters: list[ScorerScatter]) -> Markup:
    several = any(len({at.variant for at in scatter.points}) > 1 for scatter in scatters)
    series: dict[str, list[tuple[str, Estimate, Estimate]]] = {}
    for scatter in scatters:
        for at in scatter.points:
            name = at.variant if several else "in-sample" if scatter.in_sample else "cross-fitted"
            series.setdefault(name, []).append(
                (at.label, (at.mrr, *at.mrr_range), (at.success, *at.interval))
            )
    without = next((scatter.without for scatter in scatters if scatter.without is not None), None)
    return charts.scatter(
        series,
        "leak-free MRR of the scorer on test triples",
        _SUCCESS,
        "Success by the MRR of the scorer",
        level=None if without is None else (view.reference, without),
    )
