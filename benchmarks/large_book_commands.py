"""Run commands on synthetic books of any size, and print time and memory for each command.

python benchmarks/large_book_commands.py --entities 30000 --recipes 250000
python benchmarks/large_book_commands.py --entities 1000 --recipes 5800 --training

Each command runs in a separate process. ``user`` is processor time, which hardly depends on machine
load, ``wall`` the time from start to end, ``peak`` the maximum memory.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from synthetic_book import write_book

COMMANDS = {
    "check-book": ("check-book", "{book}"),
    "build-graph": ("build-graph", "{book}", "--out", "{folder}", "--force"),
    "describe": ("describe", "{folder}"),
    "describe --entity": ("describe", "{folder}", "--entity", "{entity}"),
    "tasks": ("describe", "{folder}", "--tasks"),
    "tasks --depth 2": ("describe", "{folder}", "--tasks", "--depth", "2"),
    "tasks --depth 3": ("describe", "{folder}", "--tasks", "--depth", "3"),
    "play": ("play", "{folder}"),
    "evaluate-agent": ("evaluate-agent", "{folder}"),
    "discover": ("discover", "{folder}", "--runs", "5"),
    "export tsv": ("export", "{folder}", "--format", "tsv", "--out", "{out}", "--force"),
    "export graphml": ("export", "{folder}", "--format", "graphml", "--out", "{out}", "--force"),
    "export parquet": ("export", "{folder}", "--format", "parquet", "--out", "{out}", "--force"),
}
"""What is run by name; the words in braces are filled in."""
TRAINING = {
    "train-complex": ("train-complex", "{folder}", "--out", "{links}", "--force"),
    "train-recipes": ("train-recipes", "{folder}", "--out", "{model}", "--force"),
    "score": ("score", "{model}", "entity 1 + entity 2"),
    "evaluate-links": ("evaluate-links", "{model}"),
    "train-agent": (
        *("train-agent", "{folder}", "--scorer", "{model}", "--use", "combines,component,recipe"),
        *("--steps", "100000", "--out", "{run}", "--force"),
    ),
}
"""With ``--training``: minutes on large books."""


def measure(command: Sequence[str]) -> tuple[float, float, float, int]:
    """Run a command; return wall seconds, processor seconds, peak memory in GiB and exit code."""
    began = time.monotonic()
    running = subprocess.Popen(
        [sys.executable, "-m", "wordcraft_kg", *command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert running.stderr is not None
    last = running.stderr.read().strip().splitlines()[-1:]
    _, status, used = os.wait4(running.pid, 0)
    running.returncode = code = os.waitstatus_to_exitcode(status)
    if code:
        print(*last, file=sys.stderr)
    return time.monotonic() - began, used.ru_utime, used.ru_maxrss / 2**20, code


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--entities", type=int, default=30_000)
    parser.add_argument("--recipes", type=int, default=250_000)
    parser.add_argument("--only", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--training", action="store_true", help="training and models, too")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        book = folder / "book.csv"
        write_book(book, arguments.entities, arguments.recipes)
        filled = {
            "book": str(book),
            "folder": str(folder / "graph"),
            "out": str(folder / "export"),
            "links": str(folder / "links"),
            "model": str(folder / "model"),
            "run": str(folder / "run"),
            "entity": f"entity {arguments.entities - 1}",
        }
        wanted = [name for name in COMMANDS if name in arguments.only or name == "build-graph"]
        commands = {name: COMMANDS[name] for name in wanted}
        if arguments.training:
            commands |= TRAINING
        print(f"{arguments.entities:,} entities, {arguments.recipes:,} recipes\n")
        print("| command | wall, s | user, s | peak, GiB |\n|---|---|---|---|")
        for name, words in commands.items():
            wall, user, peak, code = measure([word.format(**filled) for word in words])
            failed = f" (exit code {code})" if code else ""
            print(f"| `{name}`{failed} | {wall:.1f} | {user:.1f} | {peak:.2f} |", flush=True)


if __name__ == "__main__":
    main()
