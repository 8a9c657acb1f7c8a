"""What the engine of studies costs beside the trainings: planning, starting and keeping thousands of tasks.

    python benchmarks/study_engine.py                  # planning 10,000 trainings; overhead of tasks that do nothing
    python benchmarks/study_engine.py --side-by-side   # trainings two at a time against one at a time

The second one trains agents of the book everyday, for a minute or two; let the machine do nothing else.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from wordcraft_kg.studies.engine import run_plan
from wordcraft_kg.studies.local_workers import LocalWorkers
from wordcraft_kg.studies.perform import is_done, perform
from wordcraft_kg.studies.plan import Plan, make_plan
from wordcraft_kg.studies.results import PlayedGraph, RunFigures, write_figures
from wordcraft_kg.studies.study import parse_study
from wordcraft_kg.studies.tasks import Outcome, Task

STUDY = """
title = "Speed"
seeds = {seeds}
[settings]
book = "everyday"
steps = {steps}
[grid]
distractors = {distractors}
{grid}
[variants.none]
"""
GRID = "learning_rate = [0.001, 0.002, 0.003, 0.004, 0.005]\nentropy_cost = [0.01, 0.02, 0.03, 0.04, 0.05]"


def planned(seeds: int, steps: int, distractors: list[int], grid: str = "") -> Plan:
    text = STUDY.format(seeds=seeds, steps=steps, distractors=distractors, grid=grid)
    return make_plan(parse_study(text, "benchmark"), "benchmark")


def nothing(task: Task, root: Path) -> Outcome:
    """Look for the task's figures and write some, as a training would."""
    is_done(task, root)
    task.folder(root).mkdir(parents=True)
    hash_of_nothing = "0" * 64
    figures = RunFigures(
        seconds=0.0,
        versions={},
        graph=PlayedGraph("nowhere", hash_of_nothing, "none", 0, hash_of_nothing),
        success={},
        by_plan={},
        endings={},
        won="5" * 700,
        draws=5,
        curve=tuple((step, 0.5) for step in range(20)),
        steps=0,
        steps_per_second=0,
    )
    write_figures(task.folder(root), figures)
    return Outcome(task.address, "done")


def timed(what: Callable[[], object]) -> tuple[float, object]:
    began = time.perf_counter()
    result = what()
    return time.perf_counter() - began, result


def engine_costs(tasks: int) -> None:
    seconds, plan = timed(lambda: planned(20, 1_000, list(range(1, 21)), GRID))
    assert isinstance(plan, Plan)
    print(f"planning {len(plan.cells):,} trainings: {seconds:.2f} s")
    small = planned(tasks // 20, 1_000, list(range(1, 21)))
    from study_engine import nothing as work  # processes import this file by its name

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)

        def run() -> object:
            return run_plan(small, root, lambda: LocalWorkers(root, 2, work))

        seconds, _ = timed(run)
        print(
            f"{tasks:,} tasks that do nothing, processes started and graph built included: {seconds / tasks:.4f} s each"
        )
        seconds, _ = timed(run)
        print(f"finding that all of them are done: {seconds / tasks * 1000:.2f} ms each")


def side_by_side(steps: int, trainings: int) -> None:
    plan = planned(trainings, steps, [8])
    seconds = {}
    for jobs in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            seconds[jobs], _ = timed(lambda: run_plan(plan, root, lambda: LocalWorkers(root, jobs, partial(perform))))  # noqa: B023
            print(f"{trainings} trainings of {steps:,} steps, {jobs} at once: {seconds[jobs]:.1f} s")
    print(f"ratio {seconds[1] / seconds[2]:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side-by-side", action="store_true")
    parser.add_argument("--tasks", type=int, default=2_000)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--trainings", type=int, default=4)
    options = parser.parse_args()
    if options.side_by_side:
        side_by_side(options.steps, options.trainings)
    else:
        engine_costs(options.tasks)


if __name__ == "__main__":
    main()
