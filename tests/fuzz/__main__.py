"""Run many cases: ``python -m tests.fuzz --books 10000 --artefacts 5000 --values``, or one:
``--replay books:123``."""

import argparse
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path

import torch

from . import artefacts, books, values
from .harness import call, problems_of
from .home import make_home

PARTS = {"books": books.trial, "artefacts": artefacts.trial, "values": values.trial}


def run_case(part, number, home, *, is_shown=False):
    """Run a case in a sandbox of its own and return its faults; show the answers of its commands
    before, if asked."""
    if is_shown:
        with tempfile.TemporaryDirectory() as folder:
            trial = PARTS[part](number, home, Path(folder))
            for outcome in (call(command, Path(folder), trial.typed) for command in trial.commands):
                print(f"{outcome.out[:2000]}{outcome.err[:4000]}[exit code {outcome.code}]")
    with tempfile.TemporaryDirectory() as folder:
        trial = PARTS[part](number, home, Path(folder))
        return [f"{part}:{number}: {problem}" for problem in problems_of(trial, Path(folder))]


def main():
    """Run what is asked for and return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--books", type=int, default=0, help="number of books")
    parser.add_argument("--artefacts", type=int, default=0, help="number of artefacts")
    parser.add_argument("--values", action="store_true", help="all options with all values")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--every", type=int, default=1, help="only one value in so many")
    parser.add_argument("--replay", help="a case, such as books:123")
    given = parser.parse_args()
    torch.set_num_threads(1)
    cases = [("books", given.first + i) for i in range(given.books)]
    cases += [("artefacts", given.first + i) for i in range(given.artefacts)]
    cases += [
        ("values", i) for i in range(given.first, given.values * len(values.cases()), given.every)
    ]
    if given.replay:
        part, _, number = given.replay.partition(":")
        cases = [(part, int(number))]
    kinds = Counter()
    with tempfile.TemporaryDirectory() as folder:
        home = make_home(Path(folder))
        for done, (part, number) in enumerate(cases, 1):
            for problem in run_case(part, number, home, is_shown=bool(given.replay)):
                place = re.findall(r'File "(.*?)", line (\d+)', problem)
                kind = f"{':'.join(place[-1]) if place else ''} {problem.strip().splitlines()[-1]}"[
                    :200
                ]
                kinds[kind] += 1
                if kinds[kind] <= 3:
                    print(f"--- {problem}", flush=True)
            if done % 100 == 0 or done == len(cases):
                print(
                    f"{done:,} of {len(cases):,} cases, {kinds.total():,} problems",
                    file=sys.stderr,
                    flush=True,
                )
    for kind, count in kinds.most_common():
        print(f"{count:>6}  {kind}")
    return bool(kinds)


if __name__ == "__main__":
    sys.exit(main())
