"""What each part adds: chance, words, PPO, the learner, its scorers and plans on the same test tables.

    python benchmarks/parts.py little-alchemy-2 everyday --out parts --csv docs/evidence/data/parts.csv
    python benchmarks/parts.py little-alchemy-2 everyday --out parts --depth 2 --distractors 4 \\
        --seeds 0 --csv docs/evidence/data/parts.csv

For each book, kind of split and split seed the script runs the product's commands in a folder below
``--out`` (build-graph, train-complex, train-recipes, train-agent; a finished folder is kept), plays
all test tasks and keeps each task's success beside the run. The table has the mean over splits with
intervals for other splits of the same book; differences are paired by split, task and table.
"""

import argparse
import csv
import importlib.util
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg import WordCraftConfig, World, open_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.players import (
    BEST_PAIR,
    PLANNER,
    Player,
    knowledge_of,
    nearest_words,
    random_distinct,
    scorer_players,
    words_player,
)
from wordcraft_kg.base.statistics import crossed_difference, rate_interval
from wordcraft_kg.models.model_folder import open_model
from wordcraft_kg.models.scorers.features import glove_features

STEPS = 350_000
"""Environment steps of an agent; curves of agents without a graph are flat by then."""
PLAN_STEPS = 50_000
"""Environment steps of an agent with plans: its weights are learned from play before, and a step costs
milliseconds of planning."""
PLANNED_TASKS = 2_000
"""Tasks that are played where plans have two steps, evenly spaced, on one table each."""
PPO_STEPS = 1_000_000
"""Environment steps of ``examples/ppo.py``, its default: it needs more."""
LEARNERS = {
    "learner alone": (None, ""),
    "learner with ComplEx": ("complex", "combines,component"),
    "learner with the recipe scorer": ("recipes", "combines,component,recipe"),
    "learner with the recipe scorer and plans": ("recipes", "combines,component,recipe,plan"),
}
"""The scorer's folder and sources of each agent; the last one only where plans have two steps."""
PAIRS = [
    ("learner alone", "nearest words (glove)"),
    ("learner alone", "PPO"),
    ("learner with ComplEx", "learner alone"),
    ("learner with the recipe scorer", "learner alone"),
    ("learner with the recipe scorer", "recipe scorer alone"),
    ("recipe scorer alone", "nearest words (its vectors)"),
    ("planner", "recipe scorer alone"),
    ("learner with the recipe scorer and plans", "planner"),
]
"""Rows that are compared on the same splits, tasks and tables."""


@dataclass(frozen=True)
class Cell:
    """A book with a split, and the tasks that are played on it.

    Attributes:
        folder: where graph, models and runs lie.
        book: name of the book.
        kind: kind of the split.
        split_seed: seed of the split.
        depth: attempts that a task needs.
        distractors: entities on the table that no plan needs.
        seeds: seeds of the agents, as ``train-agent --seeds`` takes them.
    """

    folder: Path
    book: str
    kind: str
    split_seed: int
    depth: int
    distractors: int
    seeds: str

    def run(self, name: str, *arguments: str) -> Path:
        """Return the folder that a command writes, after running it where it has not finished."""
        target = self.folder / name
        if not (target.parent / f"{target.name}.done").exists():
            print(f"{target}", file=sys.stderr, flush=True)
            command = [sys.executable, "-m", "wordcraft_kg", *arguments, "--quiet"]
            target.parent.mkdir(parents=True, exist_ok=True)
            subprocess.run([*command, "--out", str(target)], check=True, stdout=subprocess.DEVNULL)
            (target.parent / f"{target.name}.done").touch()
        return target

    @cached_property
    def graph(self) -> Path:
        """Folder of the graph."""
        split = ("--split", self.kind, "--seed", str(self.split_seed))
        return self.run("graph", "build-graph", self.book, *split)

    def scorer(self, name: str) -> Path:
        """Return the folder of ``complex`` or ``recipes``."""
        return self.run(name, f"train-{name}", str(self.graph))

    def agents(self, row: str) -> list[Path]:
        """Return the folders of an agent's trainings."""
        scorer, sources = LEARNERS[row]
        steps = PLAN_STEPS if "plan" in sources else STEPS
        options = ["--steps", str(steps), "--seeds", self.seeds]
        options += ["--depth", str(self.depth), "--distractors", str(self.distractors)]
        if scorer:
            options += ["--scorer", str(self.scorer(scorer)), "--use", sources]
        name = f"{row.replace(' ', '-')}-depth-{self.depth}-{self.distractors}-seeds-{self.seeds}"
        return sorted(self.run(name, "train-agent", str(self.graph), *options).glob("seed-*"))


def players(cell: Cell) -> Iterator[tuple[str, Callable[[], list[Player]]]]:
    """Yield the rows of the table, each with a function that makes a player for each training."""

    def words() -> list[Player]:
        graph = open_model(cell.scorer("recipes")).opened.graph
        return [nearest_words(glove_features(graph.entities).unit_vectors)]

    def alone(name: str) -> Callable[[], list[Player]]:
        def make() -> list[Player]:
            model = open_model(cell.scorer("recipes"))
            graph = model.opened.graph
            return [scorer_players(graph, model.scorer, model.triples, plans=True)[name]]

        return make

    def words_of_scorer() -> list[Player]:
        model = open_model(cell.scorer("recipes"))
        return list(words_player(model.opened.graph, knowledge_of(model.scorer)).values())

    def trained(row: str) -> Callable[[], list[Player]]:
        return lambda: [PolicyPlayer(open_agent(run).policy) for run in cell.agents(row)]

    yield "random pair", lambda: [random_distinct]
    yield "nearest words (glove)", words
    yield "nearest words (its vectors)", words_of_scorer
    if cell.depth == 1:
        yield "PPO", lambda: [ppo(cell)]
    for row in LEARNERS:
        if cell.depth > 1 or "plans" not in row:
            yield row, trained(row)
    yield "recipe scorer alone", alone(BEST_PAIR)
    if cell.depth > 1:
        yield "planner", alone(PLANNER)


def ppo(cell: Cell) -> Player:
    """Return the player that ``examples/ppo.py`` trains."""
    path = Path(__file__).parents[1] / "examples" / "ppo.py"
    spec = importlib.util.spec_from_file_location("ppo", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    network = module.train(str(cell.graph), PPO_STEPS, distractors=cell.distractors)
    player: Player = module.player_of(network)
    return player


def successes(cell: Cell) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64]]:
    """Return each row's success by training and task, shape (S, N), and the tasks' groups."""
    opened = open_model(cell.scorer("recipes")).opened
    world = World(opened, WordCraftConfig("test", cell.depth, cell.distractors))
    planned = {"distractor_seeds": 1, "limit": PLANNED_TASKS} if cell.depth > 1 else {}
    evaluator = Evaluator(world, **planned)
    table = {}
    for row, make in players(cell):
        suffix = f"-seeds-{cell.seeds}" if row in LEARNERS else ""
        setting = f"depth-{cell.depth}-{cell.distractors}{suffix}"
        file = cell.folder / "success" / setting / f"{row.replace(' ', '-')}.npy"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            rates = [evaluator(player).success.mean(axis=1) for player in make()]
            np.save(file, np.stack(rates))
        table[row] = np.load(file)
        print(cell.folder, setting, row, table[row].mean(axis=1).round(4), flush=True)
    return table, world.groups[evaluator.tasks]


def summary(cells: list[Cell]) -> Iterator[dict[str, object]]:
    """Yield the table's rows for cells that differ by the split seed alone."""
    tables, groups = zip(*map(successes, cells), strict=True)
    joined = np.concatenate(groups)
    splits = np.repeat(np.arange(len(cells)), [len(part) for part in groups])
    first = cells[0]
    base = {"book": first.book, "split": first.kind, "splits": len(cells), "depth": first.depth}
    base |= {"distractors": first.distractors, "tasks": len(joined)}
    rates = {row: np.concatenate([table[row] for table in tables], axis=1) for row in tables[0]}
    for row, values in rates.items():
        mean = np.mean([table[row].mean() for table in tables])
        low, high = rate_interval(values, joined, splits)
        figures = {"value": mean, "low": low, "high": high}
        yield {**base, "row": row, "minus": "", "trainings": len(values), **rounded(figures)}
    for row, reference in PAIRS:
        if row in rates and reference in rates:
            difference = rates[row] - rates[reference]
            (value, low, high), _ = crossed_difference(difference, joined, splits)
            figures = {"value": value, "low": low, "high": high}
            trainings = {"minus": reference, "trainings": len(difference)}
            yield {**base, "row": row, **trainings, **rounded(figures)}


def rounded(figures: dict[str, float]) -> dict[str, float]:
    """Return figures with four decimals."""
    return {name: round(float(value), 4) for name, value in figures.items()}


def main() -> None:
    """Train, play, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("books", nargs="+")
    parser.add_argument("--out", type=Path, default=Path("parts"))
    parser.add_argument("--csv", type=Path, help="table to add the figures to")
    parser.add_argument("--splits", default="by-recipe,by-goal")
    parser.add_argument("--split-seeds", default="0,1,2")
    parser.add_argument("--depth", type=int, default=1)
    parser.add_argument("--distractors", default="8")
    parser.add_argument("--seeds", default="0-2", help="trainings of each agent")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows: list[dict[str, object]] = []
    if options.csv and options.csv.exists():
        with options.csv.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    for book in options.books:
        for kind in options.splits.split(","):
            for distractors in map(int, options.distractors.split(",")):
                cells = [
                    Cell(
                        options.out / book / kind / seed,
                        book,
                        kind,
                        int(seed),
                        options.depth,
                        distractors,
                        options.seeds,
                    )
                    for seed in options.split_seeds.split(",")
                ]
                for new in summary(cells):
                    print(new, flush=True)
                    rows = [row for row in rows if not is_same(row, new)] + [new]
                if options.csv:
                    with options.csv.open("w", encoding="utf-8", newline="") as file:
                        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
                        writer.writeheader()
                        writer.writerows(rows)


def is_same(row: dict[str, object], new: dict[str, object]) -> bool:
    """Return whether two rows of the table are of the same setting and players."""
    keys = ("book", "split", "depth", "distractors", "row", "minus")
    return all(str(row[key]) == str(new[key]) for key in keys)


if __name__ == "__main__":
    main()
