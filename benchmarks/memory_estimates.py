"""Compare the memory that commands expect with the memory that they take, on synthetic books of
several sizes.

python benchmarks/memory_estimates.py --entities 1000 10000 30000

Each command runs in a process of its own, with all fits of the folds. A row shows what the command
expects, its largest resident memory, and the ratio; the difference should be within 25 %.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from synthetic_book import write_book

from wordcraft_kg.graphs.folder import open_graph
from wordcraft_kg.models.scorers.config import lists_bytes

MIB = 2**20


def peak_bytes(*arguments: str) -> int:
    """Return the largest resident memory of a command of wordcraft-kg that must succeed."""
    process = subprocess.Popen([sys.executable, "-m", "wordcraft_kg", *arguments, "--quiet"])
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"wordcraft-kg {' '.join(arguments)} failed.")
    unit = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss
    return usage.ru_maxrss * unit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--entities", type=int, nargs="+", default=[1_000, 10_000, 30_000])
    parser.add_argument("--recipes-per-entity", type=int, default=5)
    parser.add_argument("--folds", type=int, default=5)
    arguments = parser.parse_args()
    print("entities  recipes  folds  expected MiB  peak MiB  expected / peak")
    for entities in arguments.entities:
        recipes = entities * arguments.recipes_per_entity
        with tempfile.TemporaryDirectory() as folder:
            book, out = Path(folder, "book.csv"), Path(folder, "model")
            write_book(book, entities, recipes)
            options = ["--features", "one-hot", "--folds", str(arguments.folds)]
            peak = peak_bytes("train-recipes", str(book), *options, "--out", str(out))
            graph = open_graph(book).graph
        # One-hot: vectors of length 0. As many sets of lists are made at once as there are cores.
        expected = lists_bytes(graph.num_entities, graph.num_recipes, 0, os.cpu_count() or 1)
        print(
            f"{entities:8,}  {recipes:7,}  {arguments.folds:5}  {expected / MIB:12,.0f}  "
            f"{peak / MIB:8,.0f}  {expected / peak:15.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
