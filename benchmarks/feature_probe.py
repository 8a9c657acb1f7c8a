"""How much of a book's sense its word vectors carry: a linear probe.

    python benchmarks/feature_probe.py everyday little-alchemy-2

A ridge regression predicts the vector of a recipe's result from the sum and the element-wise absolute difference of its
ingredients' vectors, fitted on the train recipes of a by-recipe split, its weight chosen by 5-fold cross-validation
among them. For each test recipe all entities but its ingredients are ranked by cosine to the prediction; other results
of the pair are left out. The same with the vectors shuffled among the entities says what the recipes give without
meaning, chance what nothing gives. Mean of splits 0, 1, 2.
"""

import argparse

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold

from wordcraft_kg.graphs import RecipeGraph, Split, SplitConfig, make_split, open_book
from wordcraft_kg.models.scorers.features import glove_features

WEIGHTS = np.logspace(-2, 4, 13)


def probe(split: Split, vectors: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the rank of each test recipe's result."""
    graph = split.graph
    scaled = (vectors - vectors.mean(0)) / vectors.std(0)

    def parts(recipes: NDArray[np.int64]) -> NDArray[np.float32]:
        a, b = scaled[recipes[:, 0]], scaled[recipes[:, 1]]
        return np.concatenate([a + b, np.abs(a - b)], axis=1)

    train, test = split.recipes("train"), split.recipes("test")
    model = RidgeCV(WEIGHTS, cv=KFold(5, shuffle=True, random_state=0)).fit(parts(train), scaled[train[:, 2]])
    predicted = model.predict(parts(test))
    unit = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    scores = predicted @ unit.T
    ranks = np.empty(len(test))
    for i, (a, b, result) in enumerate(test.tolist()):
        true = scores[i, result]
        others = np.setdiff1d(np.arange(graph.num_entities), [a, b, *graph.results(a, b)])
        ranks[i] = 1 + np.sum(scores[i, others] > true) + np.sum(scores[i, others] == true) / 2
    return ranks


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("books", nargs="+")
    print(f"{'':18}{'vectors':14}    MRR  hits@1  hits@10  median rank")
    for name in parser.parse_args().books:
        graph = RecipeGraph.from_book(open_book(name))
        vectors = glove_features(graph.entities).vectors
        for kind in ("GloVe", "shuffled"):
            rows = []
            for seed in (0, 1, 2):
                order = np.arange(len(vectors))
                if kind == "shuffled":
                    order = np.random.default_rng(seed).permutation(len(vectors))
                ranks = probe(make_split(graph, SplitConfig(seed=seed)), vectors[order])
                rows.append([np.mean(1 / ranks), np.mean(ranks <= 1), np.mean(ranks <= 10), np.median(ranks)])
            mrr, first, tenth, median = np.mean(rows, axis=0)
            print(f"{graph.name:18}{kind:14} {mrr:6.3f}  {first:6.3f}  {tenth:7.3f}  {median:11.1f}", flush=True)
        n = graph.num_entities
        mrr, first = np.mean(1 / np.arange(1, n + 1)), 1 / n
        print(f"{graph.name:18}{'chance':14} {mrr:6.3f}  {first:6.3f}  {10 * first:7.3f}  {n / 2:11.1f}")


if __name__ == "__main__":
    main()
