"""Running the studies of ``reproduce``: the engine's options, a board of the running tasks, and the outcome."""

import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.studies.study import Study

if TYPE_CHECKING:
    from rich.console import Group

    from wordcraft_kg.studies.engine import State, Watch
    from wordcraft_kg.studies.plan import Plan
    from wordcraft_kg.studies.tasks import Workers

LISTED = 10
"""Tasks that a dry run and a message of failures list."""


@Parameter(name="*", group="Engine")
@dataclass(frozen=True)
class EngineOptions:
    """Where and how a study runs.

    Attributes:
        out: results folder; what it holds already is not made again, so the same command goes on after Ctrl-C.
        engine: local (processes of this machine) or ray (a cluster; needs the extra ray).
        jobs: trainings at once, of the local engine. Default: the number of cores.
        address: of the Ray cluster: auto, or host:port. Default: one of its own, on this machine.
        keep: all files of a run, or figures alone: without weights and episodes, which take tens of megabytes each.
        dry_run: list what would be done and how long it takes, and do nothing.
    """

    out: Path = Path("results")
    engine: Literal["local", "ray"] = "local"
    jobs: int | None = None
    address: str | None = None
    keep: Literal["all", "figures"] = "all"
    dry_run: Flag = False

    def make_workers(self, plan: "Plan") -> "Callable[[], Workers]":
        """Return what starts those who perform the tasks.

        Raises:
            ConfigError: for options of the other engine.
        """
        from wordcraft_kg.studies.perform import perform

        work = partial(perform, keep_all=self.keep == "all")
        if self.engine == "ray":
            if self.jobs is not None:
                raise ConfigError("`jobs` is of the local engine; a cluster takes as many as it has cores.")
            from wordcraft_kg.studies.ray_workers import RayWorkers

            return lambda: RayWorkers(self.out, self.address, work)
        if self.address is not None:
            raise ConfigError("`address` is that of a Ray cluster; give `engine` ray too.")
        plan.jobs(self.jobs)  # refused now, if it has to be
        return lambda: self._local(plan, work)

    def _local(self, plan: "Plan", work: Any) -> "Workers":
        from wordcraft_kg.studies.local_workers import LocalWorkers

        return LocalWorkers(self.out, plan.jobs(self.jobs), work, plan.threads)


def run_studies(studies: dict[str, Study], options: EngineOptions, output: Output) -> int:
    """Run studies one after the other, write their reports, print the outcome and return the exit code.

    Args:
        studies: by name.
        options: where and how.
        output: where it is printed.
    """
    from wordcraft_kg.studies.plan import make_plan

    plans = [make_plan(study, name) for name, study in studies.items()]
    if options.dry_run:
        return _dry(plans, options, output)
    from wordcraft_kg.runs.interruption import sigterm_as_interrupt
    from wordcraft_kg.studies.engine import run_plan

    found, text, failed = {}, [], 0
    for plan in plans:
        with _board(plan, options, output) as watch, sigterm_as_interrupt():
            state = run_plan(plan, options.out, options.make_workers(plan), command=_command(), watch=watch)
        values, lines = _reported(plan, state, options)
        found[plan.name] = values
        text += lines
        failed += len(state.failed) + (values["report"] is None)
    output.result({"out": str(options.out), "studies": found}, text)
    return 1 if failed else 0


def _command() -> str:
    return shlex.join(["wordcraft-kg", *sys.argv[1:]])


def _reported(plan: "Plan", state: "State", options: EngineOptions) -> tuple[dict[str, Any], list[str]]:
    """Write the report of a study; return its values and text."""
    from wordcraft_kg.base.artefacts import write_atomically
    from wordcraft_kg.studies.collect import collect_study
    from wordcraft_kg.studies.report import write_study_report
    from wordcraft_kg.studies.results import results_text
    from wordcraft_kg.studies.tables import lines_of
    from wordcraft_kg.studies.view import view_study

    results = collect_study(options.out, plan.name)
    folder = options.out / "reports" / plan.name
    failures = [f"  {plan.tasks[address].title}: {outcome.error}" for address, outcome in state.failed.items()]
    text = [f"{state.done:,} tasks done, {state.kept:,} were there, {len(state.failed):,} failed", *failures[:LISTED]]
    if len(failures) > LISTED:
        text.append(f"  and {len(failures) - LISTED:,} more, in {options.out / 'failed'}/")
    page = None
    try:
        if results.runs:
            view = view_study(results)
            page, *_ = write_study_report(view, folder, force=True)
            # After the report, which replaces the folder; small enough to be kept with a page that shows it.
            write_atomically(folder / "results.json", results_text(results))
            text = [*lines_of(view, "success"), *text, f"wrote {folder}/   open {page}"]
    except ConfigError as error:  # of figures that cannot be averaged; the other studies go on
        text.append(f"no report: {error}")
    values = {
        "done": state.done,
        "kept": state.kept,
        "failed": {plan.tasks[address].title: outcome.error for address, outcome in state.failed.items()},
        "report": None if page is None else str(folder),
    }
    return values, text


def _dry(plans: "list[Plan]", options: EngineOptions, output: Output) -> int:
    """List what studies consist of."""
    from wordcraft_kg.studies.engine import estimated_hours

    found, text = {}, []
    for plan in plans:
        hours = estimated_hours(plan, options.out)
        kinds = Counter(task.kind for task in plan.tasks.values())
        counts = ", ".join(f"{number:,} {kind if number > 1 else kind[:-1]}" for kind, number in kinds.items())
        found[plan.name] = {
            "core_hours": round(hours, 3),
            "tasks": [{"address": address, "title": task.title} for address, task in plan.tasks.items()],
        }
        jobs = plan.jobs(options.jobs)
        text += [
            f"{plan.study.title}: {counts}; about {hours:.1f} hours of one core, {hours / jobs:.1f} with {jobs} jobs",
            *(f"  {task.address}  {task.title}" for task in list(plan.tasks.values())[:LISTED]),
        ]
        if len(plan.tasks) > LISTED:
            text.append(f"  and {len(plan.tasks) - LISTED:,} more; --json lists all")
    output.result({"out": str(options.out), "studies": found}, text)
    return 0


@contextmanager
def _board(plan: "Plan", options: EngineOptions, output: Output) -> "Iterator[Watch | None]":
    """Show how far a study is: a table on a terminal, or else a line now and then."""
    from rich.console import Console

    console = Console(stderr=True)
    if output.quiet:
        yield None
    elif not console.is_interactive:
        progress = output.progress(plan.name, unit="task")

        def line(plan: "Plan", state: "State") -> None:
            figures = {"running": len(state.running), "failed": len(state.failed)}
            progress(state.kept + state.done + len(state.failed), state.total, figures)

        yield line
    else:
        from rich.live import Live

        began = time.monotonic()
        with Live(console=console, refresh_per_second=2, transient=True) as live:
            yield lambda plan, state: live.update(_table(plan, state, began))


def _table(plan: "Plan", state: "State", began: float) -> "Group":
    """Return lines that say what runs."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    ended = state.done + len(state.failed)
    notes = [f"{plan.study.title}: {state.kept + ended:,} of {state.total:,} tasks"]
    if state.failed:
        notes.append(f"{len(state.failed):,} failed")
    if ended:
        left = (time.monotonic() - began) / ended * (state.left + len(state.running))
        notes.append(f"about {_duration(left)} left")
    table = Table.grid(padding=(0, 2))
    for address, since in state.running.items():
        table.add_row(" ", _duration(time.monotonic() - since), Text(plan.tasks[address].title, overflow="ellipsis"))
    return Group(Text(", ".join(notes)), table, Text("Ctrl-C stops; the same command goes on", style="dim"))


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}"
