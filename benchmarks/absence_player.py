"""What train tables tell about the test by what is never on them: the absence player.

    python benchmarks/absence_player.py little-alchemy-2 everyday --json absence.json

The player reads train tables alone, goal and items of each: no recipe, no word, no result. On a
test table it picks the pair of items whose absence from the tables of the goal is least likely to be
chance, or any pair where no absence is surprising. Where training keeps held-out pairs off its
tables, this finds them. Beside it, on the same test tables, a random pair of different items.

How often a pair should be there follows from how often each item is a distractor (its share of all
tables) and how much more often it is there with this goal (then it is an ingredient). Two
ingredients of different recipes are together only if one of them is a distractor. A player that
forgets this takes rival ingredients for absent pairs, and so counts ingredients, as train recipes
allow: that is no leak.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from wordcraft_kg import SplitConfig, WordCraftConfig, World, make_split, open_graph
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import task_bootstrap
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.graphs import OpenedGraph
from wordcraft_kg.graphs.arrays import Ids

AT_ONCE = 20_000
"""Tables drawn at a time."""
CHANCE = 0.01
"""Probability below which an absence is surprising."""


def pairs_of_tables(goals: Ids, tables: Ids, size: int) -> Ids:
    """Return a number for the goal and each pair of different items, shape (B, pairs).

    Args:
        goals: shape (B,), ids.
        tables: shape (B, A), ids; all tables are full.
        size: number of entities.
    """
    one, other = np.triu_indices(tables.shape[1], 1)
    ordered = np.sort(tables, axis=1)
    return (goals[:, None] * size + ordered[:, one]) * size + ordered[:, other]


def absence_player(train: World, test: World, num_tables: int, seed: int = 0) -> dict[str, Any]:
    """Return the success of the absence player, and of a random pair, on test tasks.

    Args:
        train: the training's world, with as many distractors as ``test``.
        test: the test tasks; each is played on one table.
        num_tables: train tables that are read.
        seed: seed of the train tables.
    """
    size = train.nothing
    width = train.config.depth + 1 + train.config.num_distractors
    asked = BatchEngine(test, len(test.tasks)).pose(np.arange(len(test.tasks)), seed=seed)
    # Self pairs leave a slot of the table empty; such tables are left out.
    is_full = (asked.table[:, width - 1] < size).nonzero()[0]
    tables = np.sort(asked.table[is_full, :width], axis=1)
    goals = asked.goal[is_full]
    queries = pairs_of_tables(goals, tables, size)
    known, place = np.unique(queries, return_inverse=True)
    together = np.zeros(len(known) + 1, dtype=np.int64)
    alone = np.zeros((size, size), dtype=np.int64)
    state = BatchEngine(train, AT_ONCE).reset(seed + 1)
    for _ in range(-(-num_tables // AT_ONCE)):
        full = (state.table[:, width - 1] < size).nonzero()[0]
        seen = state.table[full, :width]
        numbers = pairs_of_tables(state.goal[full], seen, size).ravel()
        places = np.searchsorted(known, numbers)
        is_asked = known[np.minimum(places, len(known) - 1)] == numbers
        together += np.bincount(places[is_asked], minlength=len(known) + 1)
        np.add.at(alone, (state.goal[full][:, None], seen), 1)
        state = state.engine.begin_where(state, np.ones(AT_ONCE, dtype=bool))
    one, other = np.triu_indices(width, 1)
    of_goal = alone.sum(1, keepdims=True) / width
    share = alone / np.maximum(of_goal, 1)
    # Items are distractors of most goals, and ingredients of few: the median goal has none.
    as_distractor = np.median(share[of_goal[:, 0] > 0], axis=0)
    as_ingredient = np.maximum(share - as_distractor, 0)
    first = as_distractor[tables[:, one]]
    second = as_distractor[tables[:, other]]
    made_of_first = as_ingredient[goals[:, None], tables[:, one]]
    made_of_second = as_ingredient[goals[:, None], tables[:, other]]
    expected = first * second + made_of_first * second + first * made_of_second
    expected = expected * of_goal[goals]
    sightings = together[place.reshape(queries.shape)]
    # A pair is never seen by chance with probability exp(-expected).
    is_absent = (sightings == 0) & (expected > -np.log(CHANCE))
    lots = np.random.default_rng(seed).random(queries.shape) * 1e-9
    chosen = (np.where(is_absent, expected, 0) + lots).argmax(1)
    makes = np.zeros(queries.shape, dtype=bool)
    for row, (goal, table) in enumerate(zip(goals.tolist(), tables.tolist(), strict=True)):
        for column, (i, j) in enumerate(zip(one.tolist(), other.tolist(), strict=True)):
            makes[row, column] = goal in test.outcomes.get((table[i], table[j]), ())
    success = makes[np.arange(len(makes)), chosen]
    low, high = task_bootstrap(success[:, None].astype(float), test.groups[is_full])
    return {
        "tasks": len(makes),
        "tables": num_tables,
        "absence": round(float(success.mean()), 4),
        "interval": [round(low, 4), round(high, 4)],
        "random pair": round(float(makes.mean()), 4),
    }


def main() -> None:
    """Print and write a row for each book, split and number of distractors."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("books", nargs="+")
    parser.add_argument("--splits", default="by-recipe,by-goal")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--distractors", type=int, nargs="+", default=[8, 1])
    parser.add_argument("--tables", type=int, default=1_400_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for book in options.books:
        graph = open_graph(book).graph
        for kind in options.splits.split(","):
            for seed in options.seeds:
                opened = OpenedGraph(graph, make_split(graph, SplitConfig(kind, seed=seed)), book)
                for distractors in options.distractors:
                    train = World(opened, WordCraftConfig(num_distractors=distractors))
                    measured = absence_player(train, train.variant(part="test"), options.tables)
                    row = {"book": graph.name, "split": kind, "seed": seed}
                    rows.append({**row, "distractors": distractors, **measured})
                    print(json.dumps(rows[-1]), flush=True)
    if options.json:
        write_atomically(options.json, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
