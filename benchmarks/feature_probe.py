"""How much of a book's sense its word vectors carry: a linear probe, and what counting finds without them.

    python benchmarks/feature_probe.py everyday little-alchemy-2

A ridge regression predicts the vector of a recipe's result from the sum and the element-wise absolute difference of its
ingredients' vectors, fitted on the train recipes of a by-recipe split, its weight chosen by 5-fold cross-validation
among them. For each test recipe all entities but its ingredients are ranked by cosine to the prediction; other results
of the pair are left out. Mean of splits 0, 1, 2.

Two controls have no meaning to go by. *Shuffled*: the same regression on the vectors assigned to other entities. These
still tell the entities apart, so it is no zero, and a ridge of 100 inputs learns little from that. *Votes*: who has
been in recipes of which result, counted in the train recipes. This is how far their structure alone goes, and the
floor for whatever claims to know what words mean. *Chance* is what nothing gives.
"""

import argparse

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold

from wordcraft_kg.graphs import RecipeGraph, Split, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.baselines import VoteScorer
from wordcraft_kg.models.scorers.features import glove_features

WEIGHTS = np.logspace(-2, 4, 13)


def probe(split: Split, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the score of every entity as the result of each test recipe, shape (num_test, E)."""
    scaled = (vectors - vectors.mean(0)) / vectors.std(0)

    def parts(recipes: Ids) -> NDArray[np.float32]:
        a, b = scaled[recipes[:, 0]], scaled[recipes[:, 1]]
        return np.concatenate([a + b, np.abs(a - b)], axis=1)

    train, test = split.recipes("train"), split.recipes("test")
    model = RidgeCV(WEIGHTS, cv=KFold(5, shuffle=True, random_state=0)).fit(parts(train), scaled[train[:, 2]])
    unit = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    return model.predict(parts(test)) @ unit.T


def count_votes(scorer: VoteScorer, recipes: Ids) -> NDArray[np.float32]:
    """Return the score of every entity as the result of each recipe, shape (n, E)."""
    a, b, _ = torch.tensor(recipes).T
    everything = torch.arange(len(scorer.entities))
    return scorer.score_recipes(a[:, None], b[:, None], everything).numpy()


def result_ranks(graph: RecipeGraph, recipes: Ids, scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the rank of each recipe's result among the entities, ties counting half."""
    ranks = np.empty(len(recipes))
    for i, (a, b, result) in enumerate(recipes.tolist()):
        true = scores[i, result]
        others = np.setdiff1d(np.arange(graph.num_entities), [a, b, *graph.results(a, b)])
        ranks[i] = 1 + np.sum(scores[i, others] > true) + np.sum(scores[i, others] == true) / 2
    return ranks


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("books", nargs="+")
    parser.add_argument("--split", default="by-recipe", help="what is held out")
    arguments = parser.parse_args()
    print(f"{'':18}{'knows':14}    MRR  hits@1  hits@10  median rank")
    for name in arguments.books:
        graph = RecipeGraph.from_book(open_book(name))
        vectors = glove_features(graph.entities).vectors
        for kind in ("GloVe", "shuffled", "votes"):
            rows = []
            for seed in (0, 1, 2):
                split = make_split(graph, SplitConfig(arguments.split, seed=seed))
                test, order = split.recipes("test"), np.arange(len(vectors))
                if kind == "shuffled":
                    order = np.random.default_rng(seed).permutation(len(vectors))
                if kind == "votes":
                    scores = count_votes(VoteScorer(graph, split.recipes("train")), test)
                else:
                    scores = probe(split, vectors[order])
                ranks = result_ranks(graph, test, scores)
                rows.append([np.mean(1 / ranks), np.mean(ranks <= 1), np.mean(ranks <= 10), np.median(ranks)])
            mrr, first, tenth, median = np.mean(rows, axis=0)
            print(f"{graph.name:18}{kind:14} {mrr:6.3f}  {first:6.3f}  {tenth:7.3f}  {median:11.1f}", flush=True)
        n = graph.num_entities
        mrr, first = np.mean(1 / np.arange(1, n + 1)), 1 / n
        print(f"{graph.name:18}{'chance':14} {mrr:6.3f}  {first:6.3f}  {10 * first:7.3f}  {n / 2:11.1f}")


if __name__ == "__main__":
    main()
