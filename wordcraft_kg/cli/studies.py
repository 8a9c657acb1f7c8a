"""Studies run by ``reproduce``: options of the engine, progress and outcome."""

import shlex
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.wording import counted, duration
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.studies.study import Study

if TYPE_CHECKING:
    from wordcraft_kg.studies.engine import State, Watch
    from wordcraft_kg.studies.plan import Plan
    from wordcraft_kg.studies.tasks import Workers

LISTED = 10
"""Maximum number of tasks to list in a dry run or a failure message."""


@Parameter(name="*", group="Engine")
@dataclass(frozen=True)
class EngineOptions:
    """Where and how a study runs.

    Attributes:
        out: results folder; finished tasks are kept. After Ctrl-C, repeat the command to continue.
        engine: local (processes on this machine) or ray (a cluster; needs the extra ray).
        jobs: parallel trainings of the local engine. Default: the number of cores.
        address: Ray cluster: auto, or host:port. Default: a new cluster on this machine.
        keep: all run files, or figures: without weights and episodes (tens of megabytes).
        store: folder of finished cells (docs/results/cells in the repository): its results are taken, missing cells are
            trained and added.
        dry_run: list the tasks and the run time without running anything.
    """

    out: Path = Path("results")
    engine: Literal["local", "ray"] = "local"
    jobs: int | None = None
    address: str | None = None
    keep: Literal["all", "figures"] = "all"
    store: Path | None = None
    dry_run: Flag = False

    def make_workers(self, plan: "Plan") -> "Callable[[], Workers]":
        """Return a function that starts the processes for a plan's tasks; a ConfigError for options without effect."""
        from wordcraft_kg.studies.perform import perform

        work = partial(perform, keep_all=self.keep == "all")
        if self.engine == "ray":
            if self.jobs is not None:
                raise ConfigError("`jobs` is for the local engine; a cluster uses all cores. Leave `jobs` out.")
            from wordcraft_kg.studies.ray_workers import RayWorkers

            return lambda: RayWorkers(self.out, self.address, work)
        if self.address is not None:
            raise ConfigError("`address` is for a Ray cluster; add `engine` ray.")
        from wordcraft_kg.studies.local_workers import LocalWorkers

        jobs = plan.jobs(self.jobs)  # an error is raised before the workers start
        return lambda: LocalWorkers(self.out, jobs, work, plan.threads)


def run_studies(studies: dict[str, Study], options: EngineOptions, output: Output) -> int:
    """Run studies, write the reports, print the outcome and return the exit code; ``studies`` maps names to studies."""
    from wordcraft_kg.runs.interruption import sigterm_as_interrupt
    from wordcraft_kg.studies.engine import run_plan
    from wordcraft_kg.studies.plan import make_plan

    values: dict[str, Any] = {}
    text: list[str] = []
    failed = False
    for plan in [make_plan(study, name) for name, study in studies.items()]:
        if options.dry_run:
            values[plan.name], lines = _planned(plan, options)
        else:
            command = shlex.join(["wordcraft-kg", *sys.argv[1:]])
            with sigterm_as_interrupt():
                workers = options.make_workers(plan)
                watch = _watch(plan, output)
                state = run_plan(plan, options.out, workers, command=command, watch=watch, store=options.store)
            values[plan.name], lines = _reported(plan, state, options)
            failed |= bool(state.failed) or values[plan.name]["report"] is None
        text += lines
    output.result({"out": str(options.out), "studies": values}, text)
    return 1 if failed else 0


def _planned(plan: "Plan", options: EngineOptions) -> tuple[dict[str, Any], list[str]]:
    from wordcraft_kg.studies.engine import estimated_hours

    hours, jobs = estimated_hours(plan, options.out, options.store), plan.jobs(options.jobs)
    kinds = Counter(task.kind for task in plan.tasks.values())
    counts = ", ".join(f"{number:,} {kind if number > 1 else kind[:-1]}" for kind, number in kinds.items())
    about = f"{counts}; about {duration(hours)} of one core, {duration(hours / jobs)} with {counted(jobs, 'job')}"
    tasks = [{"address": address, "title": task.title} for address, task in plan.tasks.items()]
    listed = _first([f"  {task['address']}  {task['title']}" for task in tasks], "--json lists all")
    return {"core_hours": round(hours, 3), "tasks": tasks}, [f"{plan.study.title}: {about}", *listed]


def _reported(plan: "Plan", state: "State", options: EngineOptions) -> tuple[dict[str, Any], list[str]]:
    from wordcraft_kg.base.artefacts import write_atomically
    from wordcraft_kg.studies.report import write_study_report
    from wordcraft_kg.studies.results import results_text
    from wordcraft_kg.studies.store import collect_study
    from wordcraft_kg.studies.tables import lines_of
    from wordcraft_kg.studies.view import view_study

    results = collect_study(options.out, plan.name)
    folder, page = options.out / "reports" / plan.name, None
    failures = {plan.tasks[address].title: outcome.error for address, outcome in state.failed.items()}
    from_store = f" ({state.taken:,} of them in '{options.store}')" if state.taken else ""
    text = [f"{counted(state.done, 'task')} done, {state.kept:,} already done{from_store}, {len(failures):,} failed"]
    text += _first([f"  {title}: {error}" for title, error in failures.items()], f"in {options.out / 'failed'}/")
    try:
        if results.runs:
            view = view_study(results)
            page, *_ = write_study_report(view, folder, force=True)
            # Written after the report, which replaces the folder; small enough to keep with the page.
            write_atomically(folder / "results.json", results_text(results))
            text = [*lines_of(view, "success"), *text, f"wrote {folder}/   open {page}"]
    except ConfigError as error:  # figures cannot be averaged; continue with the next study
        text.append(f"no report: {error}")
    report = None if page is None else str(folder)
    return {
        "done": state.done,
        "kept": state.kept,
        "from_store": state.taken,
        "failed": failures,
        "report": report,
    }, text


def _first(lines: list[str], rest: str) -> list[str]:
    more = [f"  and {len(lines) - LISTED:,} more; {rest}"] if len(lines) > LISTED else []
    return [*lines[:LISTED], *more]


def _watch(plan: "Plan", output: Output) -> "Watch":
    progress = output.progress(plan.name, unit="done")

    def watch(plan: "Plan", state: "State") -> None:
        failed = len(state.failed)
        progress(state.kept + state.done + failed, state.total, {"running": len(state.running), "failed": failed})

    return watch
