"""Run many cases: ``python -m benchmarks.fuzz --books 10000 --artefacts 5000 --values``, or one:
``--replay books:123``."""

import argparse
import re
import sys
import tempfile
from collections import Counter
from itertools import chain
from pathlib import Path

import torch

from . import artefacts, books, folders, values
from .archives import problems_of_archive
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


def cases_of(given):
    """Return the cases of commands: a part and a number each."""
    cases = [("books", given.first + i) for i in range(given.books)]
    cases += [("artefacts", given.first + i) for i in range(given.artefacts)]
    cases += [
        ("values", i) for i in range(given.first, given.values * len(values.cases()), given.every)
    ]
    return cases


def faults_of_folders(first, number):
    """Yield the faults of models and agents."""
    if number:
        with tempfile.TemporaryDirectory() as folder:
            problems, refused = folders.problems_of(
                folders.make_folders(Path(folder)), first, number
            )
        print(f"{number:,} folders, {refused:,} of them refused", file=sys.stderr)
        yield from problems


def faults_of_commands(cases, *, is_shown):
    """Yield the faults of commands, and tell how far the cases are."""
    if not cases:
        return
    with tempfile.TemporaryDirectory() as folder:
        home = make_home(Path(folder))
        for done, (part, number) in enumerate(cases, 1):
            yield from run_case(part, number, home, is_shown=is_shown)
            if done % 100 == 0 or done == len(cases):
                print(f"{done:,} of {len(cases):,} cases", file=sys.stderr, flush=True)


def main():
    """Run what is asked for and return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__)
    parser.add_argument("--books", type=int, default=0, help="number of books")
    parser.add_argument("--artefacts", type=int, default=0, help="number of artefacts")
    parser.add_argument("--folders", type=int, default=0, help="number of models and agents")
    parser.add_argument("--archives", type=int, default=0, help="number of archives")
    parser.add_argument("--values", action="store_true", help="all options with all values")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--every", type=int, default=1, help="only one value in so many")
    parser.add_argument("--replay", help="a case, such as books:123")
    given = parser.parse_args()
    torch.set_num_threads(1)
    cases = cases_of(given)
    if given.replay:
        part, _, number = given.replay.partition(":")
        given.first = int(number)
        cases = [(part, given.first)] if part in PARTS else []
        given.folders = int(part == "folders")
        given.archives = int(part == "archives")
    archives = range(given.first, given.first + given.archives)
    kinds = Counter()
    for problem in chain(
        chain.from_iterable(map(problems_of_archive, archives)),
        faults_of_folders(given.first, given.folders),
        faults_of_commands(cases, is_shown=bool(given.replay)),
    ):
        place = re.findall(r'File "(.*?)", line (\d+)', problem)
        kind = f"{':'.join(place[-1]) if place else ''} {problem.strip().splitlines()[-1]}"[:200]
        kinds[kind] += 1
        if kinds[kind] <= 3:
            print(f"--- {problem}", flush=True)
    for kind, count in kinds.most_common():
        print(f"{count:>6}  {kind}")
    return bool(kinds)


if __name__ == "__main__":
    sys.exit(main())
