"""``wordcraft-kg results``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.studies.study import Metric

if TYPE_CHECKING:
    from wordcraft_kg.studies.results import StudyResults

EXAMPLES = (
    "wordcraft-kg results results --study knowledge-everyday",
    "wordcraft-kg results results --by scorer,use --plot",
    "wordcraft-kg results results --by scorer --metric steps --json",
    "wordcraft-kg results knowledge-everyday.json --plot --out reports/knowledge",
)


def results(
    folder: Path,
    *,
    study: str | None = None,
    by: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    metric: Metric = "success",
    plot: Flag = False,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Show what came out of studies, any selection at any time: means, intervals, comparisons, tables and figures.

    Args:
        folder: results folder of reproduce or sweep, or a file of results.
        study: name of one of its studies. Default: the only one.
        by: comma-separated settings whose values are compared over all runs of the folder, whatever study they are of;
            other settings that differ, except the seed, divide the runs into groups.
        metric: what is printed: success, iqm, by-plan (success by the last pair of a plan), train (success on train
            tasks), mrr (of the scorer), or steps (until the reference's final success is reached).
        plot: write a page with all figures, tables (CSV, Markdown, LaTeX) and pictures (SVG; PNG and PDF with the extra
            figures).
        out: folder to write them to, which implies --plot. Default: reports/<the study's name> in the results folder.
        force: replace the report if it exists.
    """
    from wordcraft_kg.base.artefacts import check_output
    from wordcraft_kg.studies.report import write_study_report
    from wordcraft_kg.studies.tables import lines_of
    from wordcraft_kg.studies.view import view_study

    found = _collect(folder, study, split_labels(by) if by else None)
    target = None
    if plot or out is not None:
        parent = folder.parent if folder.is_file() else folder
        target = out or parent / "reports" / found.name
        check_output(target, force=force)
    view = view_study(found)
    text = [*lines_of(view, metric)]
    if target is not None:
        page, *_ = write_study_report(view, target, force=force)
        text.append(f"wrote {target}/   open {page}")
    output.result({"report": None if target is None else str(target), "study": view}, text)


def _collect(folder: Path, study: str | None, by: list[str] | None) -> "StudyResults":
    """Return the selected results, of a results folder or of a file."""
    from wordcraft_kg.base.errors import ConfigError
    from wordcraft_kg.base.records import read_record
    from wordcraft_kg.studies.collect import collect_runs, collect_study
    from wordcraft_kg.studies.results import StudyResults
    from wordcraft_kg.studies.store import studies_of

    if study is not None and by is not None:
        raise ConfigError("`study` and `by` cannot be combined: `by` compares all runs of the folder.")
    if folder.is_file():
        if study is not None or by is not None:
            raise ConfigError(f"{folder} is a file of one study; `study` and `by` are for results folders.")
        return read_record(folder, StudyResults)
    if by is not None:
        return collect_runs(folder, by)
    names = studies_of(folder)
    if study is None and len(names) != 1:
        there = f"has the studies {', '.join(names)}" if names else "has no study yet"
        raise ConfigError(f"{folder} {there}; name one with `study`, or compare all runs with `by`, such as scorer.")
    return collect_study(folder, names[0] if study is None else study)
