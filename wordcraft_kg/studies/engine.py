"""The engine: performs a study's missing tasks with joblib: graphs, then scorers, then runs."""

import logging
import os
import shutil
import sys
import threading
import uuid
from _thread import interrupt_main
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.base.errors import (
    ConfigError,
    TrainingError,
    reason,
)
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.registry import Plugin, load_again, loaded_plugins
from wordcraft_kg.base.settings import CORES_VARIABLE, MAX_THREADS, cores, whole
from wordcraft_kg.runs.run_folder import first_interrupt, sigterm_as_interrupt
from wordcraft_kg.studies.perform import is_done, make_graph, perform
from wordcraft_kg.studies.plan import Kind, Outcome, Plan, Task, make_plan
from wordcraft_kg.studies.results import (
    METRICS_FILE,
    StudyResults,
    collect_study,
    own_results,
    stop_file,
    write_plan,
)
from wordcraft_kg.studies.study import Study, check_study


@contextmanager
def ray_cluster(address: str | None) -> Iterator[int]:
    """Connect to a Ray cluster, so that joblib has a backend ``ray``; leave it at the end.

    Args:
        address: host:port of the head node, or auto for the cluster of this machine; None starts a
            cluster on this machine.

    Yields:
        The number of cores of the cluster.

    Raises:
        MissingExtraError: without Ray.
        ConfigError: if there is no such cluster.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray itself tries for minutes to reach an address.
    os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "1")
    settings: dict[str, Any] = {}
    if address is None:
        settings = {"num_cpus": cores(), "include_dashboard": False}
        if "RAY_AUTH_MODE" not in os.environ and "ray" not in sys.modules:
            # Its own cluster opens ports for nobody else. Ray reads these when it is imported.
            os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex}
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError:
        raise missing_extra("ray", ["Ray"]) from None
    # Stdout is for the result, not for Ray's messages about lost nodes.
    with redirect_stdout(sys.stderr):
        try:
            ray.init(
                address=address or "local", log_to_driver=False, logging_level="ERROR", **settings
            )
        except Exception as error:
            raise ConfigError(
                f"no Ray cluster at '{address or 'this machine'}' ({reason(error)}); expected auto "
                "or host:port. Run `ray start --head --port=6379` on one machine and `ray start "
                "--address=HOST:6379` on the others, this one included; then repeat the command."
            ) from None
        register_ray()
        try:
            # Ray has set a handler of its own.
            with sigterm_as_interrupt():
                yield int(ray.cluster_resources().get("CPU", 1))
        finally:
            ray.shutdown()


Engine = Literal["processes", "ray"]
"""Processes of this machine, or the nodes of a Ray cluster; both by joblib."""
_WAVES: tuple[Kind, ...] = ("graphs", "scorers", "runs")
"""A task's inputs are made in an earlier wave."""
_TICK = 0.5
"""Seconds between a worker's looks at the stop file."""


@dataclass
class StudyProgress:
    """The progress of a running study, in numbers of tasks.

    Attributes:
        total: tasks of the study.
        kept: tasks that were finished before the start.
        done: tasks finished since the start.
        failed: outcomes by task address, also for tasks whose inputs failed.
    """

    total: int
    kept: int = 0
    done: int = 0
    failed: dict[str, Outcome] = field(default_factory=dict)


Perform = Callable[[Task, Path], Outcome]
"""Performs a task in a results folder; returns errors as an outcome, and can be pickled."""
Watch = Callable[[Plan, StudyProgress], None]


@dataclass(frozen=True)
class Pool:
    """The workers of a study.

    Attributes:
        jobs: parallel trainings; a single one runs in this process. Default: the number of cores,
            of the cluster with ray.
        engine: processes of this machine, or ray: a Ray cluster whose nodes see the results folder
            under the same path (needs the extra ray).
        address: with ray, host:port of the head node, or auto for this machine's cluster. Default:
            a cluster on this machine that ends with the study.
    """

    jobs: int | None = None
    engine: Engine = "processes"
    address: str | None = None


def run_plan(
    plan: Plan,
    root: Path,
    pool: Pool = Pool(),
    *,
    work: Perform = perform,
    command: str = "",
    watch: Watch | None = None,
) -> StudyProgress:
    """Perform the tasks in a study without results in the folder ``root``; return the final state.

    A failed task stops only the tasks that need its result; the next call repeats failed tasks.

    Args:
        plan: the study.
        root: results folder.
        pool: the workers.
        work: performs a task.
        command: command line, for the study's record.
        watch: called with the plan and its progress after each task.

    Raises:
        ArtefactError: if a different study runs in the folder.
        ConfigError: if the number of jobs is out of range, or there is no such cluster.
        MissingExtraError: for a Ray cluster without Ray.
        TrainingError: if a worker process or node was lost; finished tasks are safe.
        KeyboardInterrupt: after Ctrl-C; running trainings keep a checkpoint.
    """
    root = root.resolve()
    if pool.jobs is not None:
        whole("jobs", pool.jobs, 1, MAX_THREADS)  # refused before the folder is touched
    with own_results(root):
        write_plan(root, plan, command)
        state = StudyProgress(len(plan.tasks))
        missing = missing_tasks(plan, root)
        state.kept = len(plan.tasks) - len(missing)
        # One that an interrupted study has left.
        stop_file(root).unlink(missing_ok=True)
        for task in missing:
            # Damaged results: the task begins anew.
            if (task.folder(root) / METRICS_FILE).exists():
                shutil.rmtree(task.folder(root))
        cluster = ray_cluster(pool.address) if pool.engine == "ray" else nullcontext()
        with cluster as cluster_cores:
            places = max((cluster_cores or cores()) // plan.threads, 1)
            jobs = pool.jobs or places
            # Ray refuses more workers than fit its cores.
            if pool.engine == "ray":
                jobs = min(jobs, places)
            for kind in _WAVES:
                wave = [task for task in missing if task.kind == kind]
                ready = _ready(wave, plan, state)
                outcomes = _outcomes(plan, root, ready, replace(pool, jobs=jobs), work)
                _receive(outcomes, plan, root, state, watch)
    return state


def missing_tasks(plan: Plan, root: Path) -> list[Task]:
    """Return the tasks without results, in the order of the plan: first seeds come first.

    Args:
        plan: the study.
        root: results folder, which may be missing.
    """
    return [task for task in plan.tasks.values() if not is_done(task, root)]


def _ready(wave: Sequence[Task], plan: Plan, state: StudyProgress) -> list[Task]:
    """Return the tasks whose inputs are there, and note the others as failed."""
    for task in wave:
        for address in task.needs:
            if address in state.failed:
                # Named as failed, too: otherwise the study would seem to wait for them.
                reason = f"{plan.tasks[address].title} failed: {state.failed[address].error}"
                state.failed[task.address] = Outcome(task.address, "failed", reason)
    return [task for task in wave if task.address not in state.failed]


def _outcomes(
    plan: Plan, root: Path, tasks: list[Task], pool: Pool, work: Perform
) -> Iterator[Outcome]:
    """Perform tasks of one wave; yield their outcomes as they come."""
    if tasks and tasks[0].kind == "graphs":
        # Made quickly, so no process has to start for them.
        for task in tasks:
            make_graph(task, root)
            yield Outcome(task.address, "done")
        return
    if pool.jobs == 1:
        for task in tasks:
            yield _performed(task, root, work)
        return
    from joblib import Parallel, delayed, parallel_config

    # Ray's backend returns results only together, and shows progress itself.
    settings: dict[str, Any] = {"inner_max_num_threads": plan.threads}
    form: dict[str, Any] = {"return_as": "generator_unordered"}
    if pool.engine == "ray":
        gpus = int(any(task.device.startswith("cuda") for task in tasks))
        settings = {"ray_remote_args": {"num_cpus": plan.threads, "num_gpus": gpus}}
        form = {"return_as": "list", "verbose": 10}
    backend = "ray" if pool.engine == "ray" else "loky"
    plugins = loaded_plugins()
    calls = [delayed(_performed_by_worker)(task, root, work, sys.argv, plugins) for task in tasks]
    ask = partial(stop_file(root).touch, exist_ok=True)
    with parallel_config(backend=backend, n_jobs=pool.jobs, **settings), first_interrupt(ask):
        try:
            # One by one: joblib would group tasks that end quickly.
            yield from Parallel(batch_size=1, **form)(calls)
        except Exception as error:
            if stop_file(root).exists():
                # A worker had not begun to listen when Ctrl-C reached it.
                yield Outcome(tasks[0].address, "interrupted")
                return
            raise TrainingError(
                f"a process of the study in '{root}' was lost ({reason(error)}). All finished "
                "tasks are safe, and trainings have kept their last checkpoint; repeat the "
                "command, perhaps with fewer `jobs`, if memory is too small for so many."
            ) from error


def _performed(task: Task, root: Path, work: Perform) -> Outcome:
    """Perform a task, unless the study stops."""
    if stop_file(root).exists():
        return Outcome(task.address, "interrupted")
    # A study's settings are meant as they are, and hundreds of trainings would repeat warnings.
    logger = logging.getLogger("wordcraft_kg")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        return work(task, root)
    finally:
        logger.setLevel(level)


def _performed_by_worker(
    task: Task, root: Path, work: Perform, command: list[str], plugins: Sequence[Plugin]
) -> Outcome:
    # Out of reach of Ctrl-C on a terminal: the study asks by its stop file, also on other machines.
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    # The record of the run has the command of the study, not that of the worker.
    sys.argv = command
    # So that a training starts no processes of its own beside the other workers.
    os.environ[CORES_VARIABLE] = str(task.threads)
    load_again(plugins)
    with _stopping(stop_file(root)):
        return _performed(task, root, work)


@contextmanager
def _stopping(stop: Path) -> Iterator[None]:
    """Interrupt this worker when the study stops, and end it with its parent."""
    ended = threading.Event()
    parent = os.getppid()

    def look() -> None:
        while not ended.wait(_TICK):
            if os.getppid() != parent:
                # At once: an orderly exit would wait for the training, and keep its folder locked.
                os._exit(1)
            if stop.exists():
                interrupt_main()
                return

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _receive(
    outcomes: Iterator[Outcome],
    plan: Plan,
    root: Path,
    state: StudyProgress,
    watch: Watch | None,
) -> None:
    """Note how the tasks of a wave ended.

    Raises:
        KeyboardInterrupt: see :func:`run_plan`.
    """
    is_interrupted = False
    try:
        for outcome in outcomes:
            if outcome.termination == "done":
                state.done += 1
            elif outcome.termination == "failed":
                state.failed[outcome.address] = outcome
            else:
                is_interrupted = True
                # Running trainings write a checkpoint, and no other task begins.
                stop_file(root).touch()
            if watch:
                watch(plan, state)
    except KeyboardInterrupt:  # a second Ctrl-C skips the checkpoints
        is_interrupted = True
    if is_interrupted:
        raise KeyboardInterrupt(
            f"interrupted; {state.kept + state.done:,} of {state.total:,} tasks are done, repeat "
            "the command to perform the rest"
        )


def run_study(
    study: Study,
    out: str | Path,
    *,
    name: str = "study",
    jobs: int | None = None,
    keep_all: bool = True,
    watch: Watch | None = None,
) -> StudyResults:
    """Perform the missing tasks in a study and return its results.

    Failed trainings are listed as missing.

    Args:
        study: from :func:`~wordcraft_kg.studies.study.read_study`, or made in Python.
        out: results folder; studies in the same folder share equal tasks.
        name: study name.
        jobs: number of parallel trainings. Default: as many as the cores allow.
        keep_all: keep run weights and episodes, tens of megabytes each.
        watch: called with the plan and its state after each training.

    Raises:
        ConfigError: for a study fault, or ``jobs`` out of range.
        RecipeFileError: if a recipe book is missing.
        ArtefactError: if another study runs in the folder.
        TrainingError: if a worker process was lost; finished trainings are safe.
        KeyboardInterrupt: after Ctrl-C; the same call resumes.

    Example:
        >>> settings = {"book": "kitchen", "steps": 256}
        >>> study = Study("A look", {"none": {}}, seeds=1, settings=settings)
        >>> results = run_study(study, "results", jobs=1)
        >>> [(run.variant, run.seed, run.steps) for run in results.runs]
        [('none', 0, 256)]
    """
    check_study(study)
    root = Path(out)
    plan = make_plan(study, name)
    run_plan(plan, root, Pool(jobs), work=partial(perform, keep_all=keep_all), watch=watch)
    return collect_study(root, name)
