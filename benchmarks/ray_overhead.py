"""Measure what the Ray engine of studies adds to trainings: 100 workers that only sleep.

    python benchmarks/ray_overhead.py --workers 100 --tasks 500 --seconds 20

The workers are processes of this machine, since a sleeping training needs no core. A first round
of tasks waits until all processes have started; their start is printed apart. Then the study has
``--tasks`` trainings of ``--seconds`` each, and without any overhead it would take
tasks * seconds / workers. The exit code is 1 if it takes more than 5 % longer.
"""

import argparse
import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from wordcraft_kg.runs.parallel import CORES_VARIABLE
from wordcraft_kg.studies.engine import run_plan
from wordcraft_kg.studies.plan import Plan
from wordcraft_kg.studies.ray_workers import RayWorkers
from wordcraft_kg.studies.study import Study
from wordcraft_kg.studies.tasks import Outcome, Task

LIMIT = 0.05
"""Greatest share of the sleeping time that the engine may add."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=100)
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    if options.tasks % options.workers:
        parser.error("--tasks: expected a multiple of --workers, so that no worker is idle")
    # The engine's own cluster takes as many tasks at once as there seem to be cores.
    os.environ[CORES_VARIABLE] = str(options.workers)
    first = [sleeping(number, 0.0) for number in range(options.workers)]
    later = [sleeping(len(first) + number, options.seconds) for number in range(options.tasks)]
    tasks = {task.address: task for task in (*first, *later)}
    plan = Plan("sleeping", Study("Sleeping", {"none": {}}), (), (), tasks, {})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        began = time.time()
        work = partial(sleep, workers=options.workers)
        state = run_plan(plan, root, RayWorkers(plan, root, work))
        if state.failed:
            sys.exit(f"{len(state.failed)} tasks failed: {next(iter(state.failed.values())).error}")
        started = max(path.stat().st_mtime for path in root.glob("runs/*/started"))
        ended = max(path.stat().st_mtime for path in root.glob("runs/*/ended"))
    ideal = options.tasks * options.seconds / options.workers
    overhead = (ended - started) / ideal - 1
    print(f"start of Ray and {options.workers} processes: {started - began:.1f} s")
    print(f"{options.tasks} tasks of {options.seconds:g} s: {ended - started:.2f} s")
    print(f"without overhead {ideal:.2f} s; overhead {overhead:.2%}, limit {LIMIT:.0%}")
    sys.exit(overhead > LIMIT)


def sleeping(number: int, seconds: float) -> Task:
    return Task("runs", {"number": number, "seconds": seconds}, f"sleep {number}")


def sleep(task: Task, root: Path, workers: int) -> Outcome:
    """Sleep as long as the task says, or until all workers have started for 0 seconds."""
    folder = task.folder(root)
    folder.mkdir(parents=True)
    if task.settings["seconds"]:
        time.sleep(task.settings["seconds"])
        (folder / "ended").touch()
        return Outcome(task.address, "done")
    (folder / "started").touch()
    while len(list(root.glob("runs/*/started"))) < workers:
        time.sleep(0.5)
    return Outcome(task.address, "done")


if __name__ == "__main__":
    main()
