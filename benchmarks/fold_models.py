"""Do models without a fold know of it? Success of their best pairs on the fold, and on test tasks.

    python benchmarks/fold_models.py everyday little-alchemy-2 kitchen --seeds 10 --json fold-models.json

A recipe scorer's model without fold k learns from the other folds' queries, whose features count recipes of fold k as
known (docs/explanation/cross-fitting.md, "A scorer in two steps"); here in small books, too. Its strict twin is a main
model of the other folds alone, in which nothing comes from fold k. Where the first model gains more on the fold's train
tasks than on test tasks, which neither has seen, it knows of the fold. Where folds have more than 800 recipes, as those
of `everyday`, the model learns from queries about 3,200 recipes and its twin from 4,000, on the fold as on the test.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from wordcraft_kg import RecipeGraph, WordCraftConfig, World, open_graph
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.graphs import OpenedGraph, fold_of_tasks, make_folds, recipe_keys
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.splits import Split, SplitConfig, make_split
from wordcraft_kg.graphs.train_samples import Folds
from wordcraft_kg.models.knowledge.books import Words, word_features
from wordcraft_kg.models.recipes import fitting
from wordcraft_kg.models.recipes.fitting import fit_recipe_scorers
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge

FOLDS = 5
DRAWS = 4
"""Tables of each task, with other distractors."""
TRAIN, NOT_TRAIN = 0, 2
"""Numbers of parts in a split."""


def strict(folds: Folds, words: Words, fold: int) -> RecipeKnowledge:
    """Fit a main model on all folds but one, as if there were no other train recipes."""
    # Folds after the one that is gone move up.
    of_recipe = folds.of_recipe - (folds.of_recipe > fold)
    of_recipe[folds.of_recipe == fold] = -1
    parts = np.where(of_recipe < 0, NOT_TRAIN, TRAIN).astype(np.int8)
    split = Split(folds.split.graph, folds.split.config, parts)
    others = Folds(split, FOLDS - 1, folds.seed, of_recipe)
    ((_, knowledge),) = fit_recipe_scorers(others, words, [()])
    return knowledge


def success(knowledge: RecipeKnowledge, world: World, tasks: Ids, known: Ids) -> float:
    """Return the share of tables on which the best pair makes the goal.

    Args:
        knowledge: the model.
        world: poses the tasks.
        tasks: numbers of tasks, shape (B,).
        known: keys of all recipes of the graph, shape (n,).
    """
    engine = BatchEngine(world, len(tasks))
    shares = []
    for draw in range(DRAWS):
        state = engine.pose(tasks, draw)
        goal = torch.from_numpy(state.goal.astype(np.int64))
        table = torch.from_numpy(state.table.astype(np.int64))
        scores = knowledge(goal, table, torch.zeros_like(goal))
        # Places in the flattened (A, A) scores to slots.
        first, second = np.divmod(scores.flatten(1).argmax(1).numpy(), table.shape[1])
        rows = np.arange(len(tasks))
        pairs = (
            state.table[rows, first].astype(np.int64),
            state.table[rows, second].astype(np.int64),
        )
        keys = recipe_keys(*pairs, goal.numpy(), num_entities=knowledge.num_entities)
        shares.append(np.isin(keys, known).mean())
    return float(np.mean(shares))


def measured(graph: RecipeGraph, kind: str, seed: int) -> Iterator[dict[str, float]]:
    """Yield the success of both models without each fold, with 8 distractors."""
    split = make_split(graph, SplitConfig(kind=kind, seed=seed))
    folds = make_folds(split, FOLDS)
    words = Words.of(word_features("auto", graph.entities))
    every = [(fold,) for fold in range(FOLDS)]
    shared = fit_recipe_scorers(folds, words, every)
    known = recipe_keys(*graph.recipes.T, num_entities=graph.num_entities)
    opened = OpenedGraph(graph, split, graph.name)
    train, test = (
        World(opened, WordCraftConfig(part=part, num_distractors=8)) for part in ("train", "test")
    )
    of_tasks = fold_of_tasks(folds.of_recipe, train.tasks)
    for (fold,), knowledge in shared:
        twin = strict(folds, words, fold)
        own = np.flatnonzero(of_tasks == fold)
        every_test = np.arange(len(test.tasks))
        yield {
            "on the fold": success(knowledge, train, own, known),
            "on the fold, strict": success(twin, train, own, known),
            "on test": success(knowledge, test, every_test, known),
            "on test, strict": success(twin, test, every_test, known),
        }


def main() -> None:
    """Print the means over folds for each book and split."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("books", nargs="+")
    parser.add_argument("--seeds", type=int, nargs="+", default=[10])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    # Otherwise both models of a small book would be the same.
    fitting.STRICT = 0
    results = []
    for book in options.books:
        graph = open_graph(book).graph
        for kind in ("by-recipe", "by-goal"):
            for seed in options.seeds:
                models = list(measured(graph, kind, seed))
                means = {
                    name: float(np.mean([model[name] for model in models])) for name in models[0]
                }
                gain = means["on the fold"] - means["on the fold, strict"]
                gain -= means["on test"] - means["on test, strict"]
                results.append(
                    {"book": book, "split": kind, "seed": seed, **means, "difference": gain}
                )
                print(
                    *(
                        f"{value:.4f}" if isinstance(value, float) else value
                        for value in results[-1].values()
                    ),
                    flush=True,
                )
    if options.json:
        write_atomically(options.json, json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
