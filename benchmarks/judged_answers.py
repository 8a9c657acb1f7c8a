"""Count how often models' likeliest results for test pairs are in the book `everyday`, or accepted
by a reader.

    wordcraft-kg build-graph everyday --out graphs/everyday
    wordcraft-kg train-recipes graphs/everyday --features glove --out models/recipes
    wordcraft-kg train-complex graphs/everyday --out models/complex
    python benchmarks/judged_answers.py graphs/everyday models/recipes models/complex

The verdicts are those of data/everyday/judged.csv, on the two likeliest results by these models for
300 test pairs.
"""

import argparse
import csv
import random
from pathlib import Path

import torch

from wordcraft_kg.cli.console import aligned
from wordcraft_kg.graphs.graph_folder import open_graph
from wordcraft_kg.graphs.triples import COMPONENT_OF
from wordcraft_kg.models.scorers.baselines import VoteScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

JUDGED = Path(__file__).parents[1] / "data/everyday/judged.csv"
PAIRS, SEED = 300, 20261124


def main() -> None:
    """Print the table of the datasheet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in ("graph", "recipes", "complex"):
        parser.add_argument(name)
    given = parser.parse_args()
    opened = open_graph(given.graph)
    graph, names = opened.graph, opened.graph.entities
    recipes, links = (load_scorer(path, graph=graph) for path in (given.recipes, given.complex))
    votes = VoteScorer(graph, opened.split.recipes("train"))
    words = torch.tensor(glove_features(names).unit_vectors)
    with JUDGED.open(newline="") as file:
        verdicts = {
            (row["ingredient_a"], row["ingredient_b"], row["answer"]): row["accepted"] == "1"
            for row in csv.DictReader(file)
        }
    test = sorted({(a, b) for a, b, _ in opened.split.recipes("test").tolist()})
    everything = torch.arange(len(names))
    counts = {name: [0, 0, 0] for name in ("recipe-scorer", "ComplEx", "votes", "nearest-words")}
    for a, b in random.Random(SEED).sample(test, PAIRS):
        one, other = torch.full_like(everything, a), torch.full_like(everything, b)
        scores = {
            "recipe-scorer": recipes.score_recipes(one, other, everything),
            "votes": votes.score_recipes(one, other, everything),
            "ComplEx": links.score(one, COMPONENT_OF, everything)
            + links.score(other, COMPONENT_OF, everything),
            "nearest-words": words @ (words[a] + words[b]),
        }
        for name, of_all in scores.items():
            best = int(of_all.index_fill(0, torch.tensor([a, b]), -torch.inf).argmax())
            if best in graph.results(a, b):
                counts[name][0] += 1
            else:
                verdict = verdicts.get((names[a], names[b], names[best]))
                counts[name][2 if verdict is None else 1] += verdict is not False
    rows = [("model", "in the book", "accepted", "not judged", "in the book or accepted")]
    for name, (right, accepted, unknown) in counts.items():
        rows.append(
            (name, str(right), str(accepted), str(unknown), f"{(right + accepted) / PAIRS:.3f}")
        )
    print("\n".join(aligned(rows)))


if __name__ == "__main__":
    main()
