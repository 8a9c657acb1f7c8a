"""Run many cases: ``python -m tests.fuzz --books 10000 --artefacts 5000 --values``, or one: ``--replay books:123``."""

import argparse
import re
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import torch

from . import artefacts, books, values
from .harness import call, problems_of
from .home import make_home

PARTS = {"books": books.trial, "artefacts": artefacts.trial, "values": values.trial}


def run_case(part: str, number: int, home: Path) -> list[str]:
    """Run a case in a sandbox of its own and return its faults."""
    with tempfile.TemporaryDirectory() as folder:
        trial = PARTS[part](number, home, Path(folder))
        return [f"{part}:{number}: {problem}" for problem in problems_of(trial, Path(folder))]


def replay(part: str, number: int, home: Path) -> list[str]:
    """Run a case and show the answers of its commands."""
    with tempfile.TemporaryDirectory() as folder:
        trial = PARTS[part](number, home, Path(folder))
        for outcome in (call(command, Path(folder), trial.typed) for command in trial.commands):
            print(f"{outcome.out[:2000]}{outcome.err[:4000]}[exit code {outcome.code}, {outcome.seconds:.2f} s]")
    return run_case(part, number, home)


def main() -> int:
    """Run what is asked for and return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--books", type=int, default=0, help="number of books")
    parser.add_argument("--artefacts", type=int, default=0, help="number of artefacts")
    parser.add_argument("--values", action="store_true", help="all options with all values")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--every", type=int, default=1, help="only one value in so many")
    parser.add_argument("--replay", help="a case, such as books:123")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        home = make_home(Path(folder))
        if arguments.replay:
            part, _, number = arguments.replay.partition(":")
            found = replay(part, int(number), home)
            print(*found, sep="\n")
            return bool(found)
        cases = [("books", arguments.first + i) for i in range(arguments.books)]
        cases += [("artefacts", arguments.first + i) for i in range(arguments.artefacts)]
        if arguments.values:
            cases += [("values", i) for i in range(arguments.first, len(values.cases()), arguments.every)]
        return _run(cases, home)


def _run(cases: list[tuple[str, int]], home: Path) -> int:
    found: Counter[str] = Counter()
    slowest: list[tuple[float, str]] = []
    for done, (part, number) in enumerate(cases, 1):
        began = time.process_time()
        for problem in run_case(part, number, home):
            place = re.findall(r'File "(.*?)", line (\d+)', problem)
            kind = f"{':'.join(place[-1])} {problem.strip().splitlines()[-1]}" if place else problem.splitlines()[-1]
            found[kind[:200]] += 1
            if found[kind[:200]] <= 3:
                print(f"--- {problem}", flush=True)
        slowest = sorted([*slowest, (time.process_time() - began, f"{part}:{number}")])[-5:]
        if done % 100 == 0 or done == len(cases):
            print(f"{done:,} of {len(cases):,} cases, {found.total():,} problems", file=sys.stderr, flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"\n{len(cases):,} cases, {found.total():,} problems of {len(found):,} kinds; peak memory {peak:.2f} GiB")
    print("slowest:", ", ".join(f"{name} {seconds:.1f} s" for seconds, name in reversed(slowest)))
    for kind, count in found.most_common():
        print(f"{count:>6}  {kind}")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
