"""``wordcraft-kg reproduce``."""

import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.base import (
    ConfigError,
    TrainingError,
    check_output,
    counted,
    read_record,
    write_atomically,
)
from wordcraft_kg.cli.console import (
    Flag,
    Output,
    aligned,
    check_table,
    refuse_given,
    split_labels,
    text_table,
    write_table,
)
from wordcraft_kg.cli.options import Force, Table, Words
from wordcraft_kg.runs.run_folder import sigterm_as_interrupt
from wordcraft_kg.studies.claims import ClaimVerdict
from wordcraft_kg.studies.engine import Pool, StudyProgress, missing_tasks, run_plan
from wordcraft_kg.studies.perform import perform
from wordcraft_kg.studies.plan import Plan, make_plan
from wordcraft_kg.studies.results import StudyResults, collect_study, results_text, studies_of
from wordcraft_kg.studies.search import search as search_settings, validation_success
from wordcraft_kg.studies.study import (
    PLAYER,
    Study,
    adapted,
    built_in,
    cells_of,
    read_study,
    title_of,
)

if TYPE_CHECKING:
    from wordcraft_kg.studies.view import StudyView

EXAMPLES = (
    "wordcraft-kg reproduce --list",
    "wordcraft-kg reproduce embeddings --out results",
    "wordcraft-kg reproduce all --book everyday --steps 300000 --seeds 3 --jobs 2",
    "wordcraft-kg reproduce study.toml --engine ray --address auto",
    "wordcraft-kg reproduce --search study.toml --table best.tex",
    "wordcraft-kg reproduce knowledge-everyday --show",
    "wordcraft-kg reproduce --show --plot",
)
ALL = "all"


@dataclass(frozen=True)
class Changes:
    """Changes to a study.

    Attributes:
        book: comma-separated recipe books for a built-in study. Default: little-alchemy-2.
        seeds: number of seeds for each cell. Default: the study's.
        steps: environment steps for each training; variants with fewer of their own keep these.
            Default: the study's; 3,000,000 for the paper's agents.
    """

    book: Words = None
    seeds: int | None = None
    steps: int | None = None


@Parameter(name="*", group="Engine")
@dataclass(frozen=True)
class EngineOptions:
    """Where and how a study runs.

    Attributes:
        out: results folder; finished tasks are kept. After Ctrl-C, repeat the command to continue.
        pool: where trainings run.
        keep: all run files, or metrics: without weights and episodes (tens of megabytes).
        dry_run: list the tasks without running anything.
    """

    out: Path = Path("results")
    pool: Annotated[Pool, Parameter(name="*")] = field(default_factory=Pool)
    keep: Literal["all", "metrics"] = "all"
    dry_run: Flag = False


@dataclass(frozen=True)
class ShowOptions:
    """Options for existing results.

    Attributes:
        plot: write a page with all results, and plots (SVG, PDF) into reports/<the study's
            name>, in the results folder or beside the results file.
        force: replace an existing output.
    """

    plot: Flag = False
    force: Force = False


def reproduce(  # noqa: PLR0913 - parameters are the command's options
    study: str | None = None,
    *,
    all_studies: Annotated[Flag, Parameter(name="--list")] = False,
    show: Flag = False,
    search: Flag = False,
    changes: Annotated[Changes, Parameter(name="*", group="Changes to the study")] = Changes(),
    engine: EngineOptions = EngineOptions(),
    shown: Annotated[ShowOptions, Parameter(name="*", group="Options of --show")] = ShowOptions(),
    table: Table = None,
    output: Output = Output(),
) -> int:
    """Run a study and write the report (build, train, evaluate, plot), or show existing results.

    Each combination of settings is trained with several seeds. To continue an interrupted study,
    repeat the command.

    Args:
        study: name of a built-in study, all, or a TOML file (see docs/studies.md). With --show, a
            study in the results folder (default: the only study), or a results file.
        all_studies: list the built-in studies.
        show: show existing results without training.
        search: search for the settings below [search] in the study file: the best on validation
            tasks are reported on test tasks.
    """
    check_table(table, force=shown.force)
    # Options of the other mode would silently do nothing.
    if show:
        refuse_given(changes, "running a study, not for --show")
        return _show(study, engine.out, shown, table, output)
    refuse_given(shown, "existing results, with --show")
    if all_studies:
        refuse_given(changes, "running a study, not for --list")
        return _list(output)
    if study is None:
        raise ConfigError(
            "reproduce needs a study; `wordcraft-kg reproduce --list` lists the built-in studies."
        )
    if engine.pool.address is not None and engine.pool.engine != "ray":
        raise ConfigError(
            f"`address` '{engine.pool.address}' is for a Ray cluster; add --engine ray, or leave "
            "it out."
        )
    studies = _chosen(study, changes)
    if table is not None and len(studies) > 1:
        raise ConfigError(f"`table` is for one study; '{study}' is {len(studies)}.")
    if search:
        studies = {
            name: _searched(declared, name, engine, output) for name, declared in studies.items()
        }
    for declared in studies.values():
        if declared.search:
            raise ConfigError(f"'{study}' has settings to search over: add --search.")
    return _run(studies, engine, table, output)


def _chosen(study: str, changes: Changes) -> dict[str, Study]:
    if study not in (ALL, *built_in()):
        if changes.book:
            raise ConfigError("`book` is for built-in studies; in a study file, set the book.")
        adapted_study = adapted(read_study(study), steps=changes.steps, seeds=changes.seeds)
        return {Path(study).stem: adapted_study}
    studies: dict[str, Study] = {}
    for name in built_in() if study == ALL else [study]:
        declared = read_study(name)
        own_book = str(declared.settings.get("book", "everyday"))
        for book in split_labels(changes.book or ()) or [own_book]:
            # Names of studies are names of report folders, so they must differ.
            full = f"{name}-{Path(book).stem}"
            if full in studies:
                raise ConfigError(
                    f"`book`: two books are called '{Path(book).stem}'; rename one file."
                )
            studies[full] = adapted(declared, book=book, steps=changes.steps, seeds=changes.seeds)
    return studies


def _list(output: Output) -> int:
    listed: dict[str, dict[str, object]] = {}
    rows: list[tuple[str, str]] = []
    for name in built_in():
        study = read_study(name)
        trainings = sum(PLAYER not in cell.settings for cell in cells_of(study))
        listed[name] = {"title": study.title, "source": study.source, "trainings": trainings}
        rows += [(name, f"{study.title}: {trainings} trainings"), ("", study.source)]
    rows.append((ALL, "all of them: shared trainings run once"))
    following = "run one: wordcraft-kg reproduce NAME; for a quick look: --steps 300000 --seeds 3"
    output.result({"studies": listed}, [*aligned(rows), following])
    return 0


def _show(
    study: str | None, root: Path, options: ShowOptions, table: Path | None, output: Output
) -> int:
    from wordcraft_kg.reports.pages import write_report
    from wordcraft_kg.studies.report import make_study_report
    from wordcraft_kg.studies.view import view_study

    results, folder = _collect(study, root)
    target = folder / "reports" / results.name if options.plot else None
    if target is not None:
        # Refused before the tables and plots are made.
        check_output(target, force=options.force)
    view = view_study(results)
    text = list(_lines_of(view, table, force=options.force))
    if target is not None:
        write_report(make_study_report(view), target, force=options.force)
        text.append(f"wrote {target}/   open {target / 'index.html'}")
    output.result({"report": None if target is None else str(target), "study": view}, text)
    return 0


def _collect(study: str | None, root: Path) -> tuple[StudyResults, Path]:
    """Return existing results, and the folder that they are in.

    Args:
        study: name of a study in the results folder, or a results file; None for the only study.
        root: the results folder.
    """
    if study is not None and study.endswith(".json"):
        return read_record(Path(study), StudyResults), Path(study).parent
    if study is None:
        names = studies_of(root)
        if len(names) != 1:
            raise ConfigError(
                f"'{root}' has results of {', '.join(names) or 'no study yet'}; name a study, or "
                "run one first (`wordcraft-kg reproduce --list` names them)."
            )
        # With one study in the folder, its name says nothing new.
        (study,) = names
    return collect_study(root, study), root


def _run(
    studies: dict[str, Study], options: EngineOptions, table: Path | None, output: Output
) -> int:
    """Run studies, write the reports, print the outcome and return the exit code.

    Args:
        studies: studies by name.
        options: where and how they run.
        table: file for a table of the results; None for none.
        output: the command's common options.
    """
    values: dict[str, Any] = {}
    text: list[str] = []
    failed = False
    # All plans first: a fault in the last study must not show after days of the others.
    for plan in [make_plan(study, name) for name, study in studies.items()]:
        if options.dry_run:
            values[plan.name], lines = _planned(plan, options)
        else:
            state = _run_plan(plan, options, output)
            values[plan.name], lines = _reported(plan, state, options.out, table)
            failed |= bool(state.failed) or values[plan.name]["report"] is None
        text += lines
    output.result({"out": str(options.out), "studies": values}, text)
    return 1 if failed else 0


def _searched(study: Study, name: str, options: EngineOptions, output: Output) -> Study:
    """Return a study with the settings that are best on validation tasks, all trained."""
    if options.keep != "all" or options.dry_run:
        raise ConfigError("a search reads the trained agents: leave out `keep` and `dry_run`.")

    def score(trial: Study) -> float:
        plan = make_plan(trial, name)
        for outcome in _run_plan(plan, options, output).failed.values():
            raise TrainingError(f"a trial of '{name}' failed: {outcome.error}")
        return validation_success(plan, options.out)

    return search_settings(study, score)


def _run_plan(plan: Plan, options: EngineOptions, output: Output) -> StudyProgress:
    """Run a study's tasks in processes on this machine or on a Ray cluster."""
    work = partial(perform, keep_all=options.keep == "all")
    # Results name the command that made them, so that others can repeat it.
    command = shlex.join(["wordcraft-kg", *sys.argv[1:]])
    progress = output.progress(plan.name, unit="done")

    def watch(plan: Plan, state: StudyProgress) -> None:
        failed = len(state.failed)
        # A failed task is over, too: the bar counts what needs no more time.
        progress(state.kept + state.done + failed, state.total, {"failed": failed})

    # A cluster ends jobs by SIGTERM; finished tasks are kept as after Ctrl-C.
    with sigterm_as_interrupt():
        return run_plan(
            plan,
            options.out,
            options.pool,
            work=work,
            command=command,
            watch=watch,
        )


def _planned(plan: Plan, options: EngineOptions) -> tuple[dict[str, Any], list[str]]:
    """Return what a study would do, as JSON values and as lines of text."""
    missing = len(missing_tasks(plan, options.out))
    title = f"{plan.study.title}: {counted(len(plan.tasks), 'task')}; {missing:,} to perform"
    tasks = [{"address": task.address, "title": task.title} for task in plan.tasks.values()]
    lines = [f"  {task.address}  {task.title}" for task in plan.tasks.values()]
    return {"missing": missing, "tasks": tasks}, [title, *lines]


def _reported(
    plan: Plan, state: StudyProgress, root: Path, table: Path | None
) -> tuple[dict[str, Any], list[str]]:
    """Write the report of a study; return the outcome as JSON values and as lines of text.

    Args:
        plan: the study's plan.
        state: how its tasks have ended.
        root: the results folder.
        table: file for a table of the results; None for none.
    """
    from wordcraft_kg.reports.pages import write_report
    from wordcraft_kg.studies.report import make_study_report
    from wordcraft_kg.studies.view import view_study

    results = collect_study(root, plan.name)
    folder = root / "reports" / plan.name
    failures = {
        plan.tasks[address].title: outcome.error for address, outcome in state.failed.items()
    }
    values = {"done": state.done, "kept": state.kept, "failed": failures, "report": None}
    counts = f"{counted(state.done, 'task')} done, {state.kept:,} already done"
    text = [f"{counts}, {len(failures):,} failed"]
    text += [f"  {title}: {error}" for title, error in failures.items()]
    if not results.runs:
        # Failures say why already; results may be there, but not their graph.
        reasons = [f"no report: {gap.why}" for gap in results.missing if not failures]
        return values, [*text, *reasons[:1]]
    view = view_study(results)
    write_report(make_study_report(view), folder, force=True)
    # After the report, which replaces the folder; small enough to keep with the page.
    write_atomically(folder / "results.json", results_text(results))
    text = [*_lines_of(view, table), *text, f"wrote {folder}/   open {folder / 'index.html'}"]
    return {**values, "report": str(folder)}, text


def _lines_of(view: "StudyView", table: Path | None, *, force: bool = False) -> Iterator[str]:
    """Yield success at each grid point and verdicts on claims; write the table to a file."""
    from wordcraft_kg.studies.report import tables_of

    rows = []
    yield f"{view.study.title}: success on test tasks"
    for point, cells in zip(view.points, tables_of(view), strict=True):
        rows += [{"at": point.title, **row, "tasks": point.tasks} for row in cells]
        yield f"{point.title} ({counted(point.tasks, 'test task')})"
        # A terminal is narrow: what says more about the trainings is in the report.
        yield from text_table(
            [{name: row[name] for name in row if name not in _OF_TRAININGS} for row in cells]
        )
    compared = f"; differences to {view.reference}, p corrected by Holm" if view.comparisons else ""
    yield f"intervals: 95 % over {view.resampled}{compared}"
    if view.claims:
        yield "claims"
        yield from aligned(_rows_of_claims(view.claims))
    if view.missing:
        first = view.missing[0]
        number = counted(len(view.missing), "training")
        training = f"{first.variant}, seed {first.seed}"
        yield f"{number} without results; the first, {training}: {first.why}"
    yield from write_table(table, rows, force=force)


_OF_TRAININGS = ("train", "MRR")
"""Columns of the report, on trainings and their spread, that the text leaves out."""


def _rows_of_claims(claims: Sequence[ClaimVerdict]) -> Iterator[tuple[str, str]]:
    from wordcraft_kg.studies.report import in_words

    for checked in claims:
        yield f"  {checked.verdict}", checked.claim.text
        for measured in checked.measured:
            yield "", f"{title_of(measured.values)}: {in_words(checked.claim, measured)}"
