"""Evaluate predictions from words alone: for entities without recipes, and for goals that no train recipe makes.

    python benchmarks/inductive.py removed everyday-1 little-alchemy-2 \
        --json new-entities.json                    # entities taken out of the graph
    python benchmarks/inductive.py splits everyday little-alchemy-2    # with words, without words, with shuffled words

`removed` samples 30 entities with at least three recipes, fits a recipe scorer's link rankers on the remaining recipes
(without entities that only occur with removed entities), and then scores the removed entities' links by words. Two
filtered queries per link: rank all entities given the removed entity ("of it"), and rank the removed entities given the
known entity ("it"). Columns: link rankers, kernel alone, rankers with words permuted among removed entities, frequency
in the remaining recipes, and chance.

`splits` fits the rankers on train recipes and ranks unseen validation triples.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.train_samples import Folds, make_folds
from wordcraft_kg.graphs.triples import COMPONENT_OF, RELATIONS, recipe_triples
from wordcraft_kg.models.knowledge.books import Words, word_features
from wordcraft_kg.models.recipes.fitting import fit_recipe_scorers
from wordcraft_kg.models.recipes.inductive import extended
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import (
    mean_reciprocal_rank,
    random_reciprocal_ranks,
    rank_triples,
    slice_masks,
)
from wordcraft_kg.models.scorers.recipes import RecipeScorer

FOLDS = 5
MIN_RECIPES = 3
COLUMNS = ("rankers", "kernel", "words of others", "frequency", "chance")
FEATURES = ("glove", "one-hot", "shuffled:glove")


def fitted(graph: RecipeGraph, folds: Folds, spec: str) -> RecipeScorer:
    """Fit a recipe scorer on all recipes of the folds."""
    words = Words.of(word_features(spec, graph.entities))
    ((_, knowledge),) = fit_recipe_scorers(folds, words, [()])
    return RecipeScorer(knowledge.constants(), graph.entities, graph.hash)


# --- entities taken out ---------------------------------------------------------------------------


def without(graph: RecipeGraph, amount: int, seed: int) -> tuple[RecipeGraph, NDArray[np.bool_]]:
    """Return the graph without some entities, and the remaining recipes' indices in the whole
    graph."""
    recipes = graph.recipes
    uses = np.bincount(
        np.concatenate([np.unique(row) for row in recipes]), minlength=graph.num_entities
    )
    taken = np.random.default_rng(seed).permutation(np.flatnonzero(uses >= MIN_RECIPES))[:amount]
    left = ~np.isin(recipes, taken).any(axis=1)
    rows = graph.recipe_labels(recipes[left])
    return RecipeGraph.from_recipes(rows, name=f"{graph.name} without {amount}"), left


def scored_by_words(graph: RecipeGraph, rest: RecipeGraph, seed: int) -> list[TripleScorer]:
    """Return whole-graph scorers trained on the remaining recipes: rankers, kernel, rankers with
    permuted words."""
    new = [label for label in graph.entities if label not in rest]
    order = np.array([graph.id_of(label) for label in (*rest.entities, *new)])
    vectors = make_features("glove", graph.entities).unit_vectors
    scorer = fitted(rest, make_folds(make_split(rest, SplitConfig("none")), FOLDS), "glove")
    of_new = order[rest.num_entities :]
    exchanged = np.random.default_rng(seed).permutation(of_new)
    back = np.argsort(order)

    def scorer_of(rows: Ids, by_kernel: bool = False) -> TripleScorer:
        """Score all links with the new entities described by the vectors of ``rows``."""
        wider = extended(scorer, new, vectors[rows])
        tables = []
        for relation in range(len(RELATIONS)):
            left, right = wider.factors(relation)
            table = left @ right.T if by_kernel else wider.table(relation)
            tables.append(table[back][:, back])
        return TableScorer(torch.stack(tables), graph.entities, graph.hash)

    return [scorer_of(of_new), scorer_of(of_new, by_kernel=True), scorer_of(exchanged)]


def removed(graph: RecipeGraph, amount: int, seed: int) -> Iterator[tuple[str, int, list[float]]]:
    """Yield query kinds, the number of queries, and MRR by scorer."""
    rest, left = without(graph, amount, seed)
    is_new = np.array([label not in rest for label in graph.entities])
    triples = recipe_triples(graph.recipes[~left])
    triples = triples[is_new[triples[:, 0]] != is_new[triples[:, 2]]]
    scorers = [
        *scored_by_words(graph, rest, seed),
        FrequencyScorer(graph, recipe_triples(graph.recipes[left])),
    ]
    # Links between entities of the rest are no candidates: "it" is one of the new ones.
    old = np.flatnonzero(~is_new)
    among_old = np.stack(
        np.meshgrid(old, range(len(RELATIONS)), old, indexing="ij"), axis=-1
    ).reshape(-1, 3)
    known = np.concatenate([graph.triples, among_old])
    ranks = [rank_triples(scorer, triples, known) for scorer in scorers]
    asked = ranks[0]
    is_tail = (asked["side"] == "tail").to_numpy()
    asks_new = is_new[np.where(is_tail, asked["tail"], asked["head"])]
    parts = (asked["relation"] == COMPONENT_OF).to_numpy()
    questions = {
        "of it: goes with": ~asks_new & ~parts,
        "of it: goes into": ~asks_new & parts & is_tail,
        "of it: is made of": ~asks_new & parts & ~is_tail,
        "of it": ~asks_new,
        "it": asks_new,
    }
    for name, mask in questions.items():
        found = [mean_reciprocal_rank(each[mask]) for each in ranks]
        yield name, int(mask.sum()), [*found, float(random_reciprocal_ranks(asked[mask]).mean())]


def test_removed(
    graph: RecipeGraph, amount: int, seeds: Sequence[int]
) -> Iterator[dict[str, str | int | float]]:
    """Yield the figures of each sample of removed entities and question."""
    for seed in seeds:
        for name, queries, figures in removed(graph, amount, seed):
            about = {"book": graph.name, "question": name, "seed": seed, "queries": queries}
            yield about | {
                column: round(float(figure), 4)
                for column, figure in zip(COLUMNS, figures, strict=True)
            }


# --- splits ---------------------------------------------------------------------------------------


def test_splits(graph: RecipeGraph, kinds: Sequence[str], seeds: Sequence[int]) -> None:
    for kind in kinds:
        for spec in FEATURES:
            rows = []
            for seed in seeds:
                split = make_split(graph, SplitConfig(kind, seed=seed, valid_ratio=0.1))
                scorer = fitted(graph, make_folds(split, FOLDS), spec)
                ranks = rank_triples(scorer, split.held_out("valid"), graph.triples)
                masks = slice_masks(ranks)
                rows.append(
                    [mean_reciprocal_rank(ranks[masks[name]]) for name in ("all", *RELATIONS)]
                )
            means = np.mean(rows, axis=0)
            each = " ".join(f"{row[0]:.3f}" for row in rows)
            print(
                f"{graph.name}, {kind}, {spec}: validation MRR {means[0]:.3f} ({each}), "
                + ", ".join(
                    f"{name} {mean:.3f}" for name, mean in zip(RELATIONS, means[1:], strict=True)
                ),
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["removed", "splits"])
    parser.add_argument("books", nargs="+")
    parser.add_argument("--amount", type=int, default=30)
    parser.add_argument("--seeds", type=int, nargs="+", default=[10, 11])
    parser.add_argument("--kinds", nargs="+", default=["by-recipe", "by-slot", "by-goal"])
    parser.add_argument("--json", type=Path, help="file to write the figures of `removed` to")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for book in arguments.books:
        graph = RecipeGraph.from_book(open_book(book))
        if arguments.what == "removed":
            for row in test_removed(graph, arguments.amount, arguments.seeds):
                print(row, flush=True)
                rows.append(row)
        else:
            test_splits(graph, arguments.kinds, arguments.seeds)
    if arguments.json:
        write_atomically(arguments.json, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
