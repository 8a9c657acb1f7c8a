"""Measure how well labels get their sense in WordNet, and the size of ConceptNet.

    python benchmarks/general_graphs.py senses everyday /usr/share/wordnet
    python benchmarks/general_graphs.py assertions everyday assertions.csv --lines 3000000

``senses`` compares the chosen senses, and each word's first sense, with the senses in
data/everyday/entities.csv. ``assertions`` writes generated lines in ConceptNet's format; 15 % of
the words are labels of the graph. For seconds and memory: ``/usr/bin/time -v wordcraft-kg
import-knowledge everyday --conceptnet assertions.csv``.
"""

import argparse
import csv
import random
from itertools import pairwise
from pathlib import Path

from wordcraft_kg.graphs import open_graph
from wordcraft_kg.models.knowledge.alignment import align
from wordcraft_kg.models.knowledge.network import plain
from wordcraft_kg.models.knowledge.wordnet import read_wordnet

SENSES = Path(__file__).parents[1] / "data/everyday/entities.csv"
RELATIONS = (
    "RelatedTo",
    "IsA",
    "PartOf",
    "HasA",
    "MadeOf",
    "UsedFor",
    "AtLocation",
    "Synonym",
    "FormOf",
    "CapableOf",
)
BINS = (0, 0.5, 0.7, 0.9, 0.99, 1.01)


def senses(graph: str, wordnet: Path) -> None:
    """Print the share of right senses, and by confidence."""
    with SENSES.open(encoding="utf-8") as file:
        right = {row["entity"]: row["wordnet"] for row in csv.DictReader(file) if row["wordnet"]}
    opened, network = open_graph(graph), read_wordnet(wordnet)
    entities = opened.graph.entities
    alignment = align(network, entities, opened.split.recipes("train"))
    rows = []
    for label, node, confidence in zip(
        entities, alignment.nodes.tolist(), alignment.confidences, strict=True
    ):
        if label in right:
            first = network.spellings.get(plain(label), [node])[0]
            rows.append(
                (
                    confidence,
                    *(one >= 0 and network.nodes[one] == right[label] for one in (node, first)),
                )
            )
    shares = (sum(row[column] for row in rows) / len(rows) for column in (1, 2))
    print(f"{len(rows):,} labels: right {next(shares):.3f}, first sense alone {next(shares):.3f}")
    for low, high in pairwise(BINS):
        inside = [row for row in rows if low <= row[0] < high]
        mean, share = (
            sum(row[column] for row in inside) / max(len(inside), 1) for column in (0, 1)
        )
        print(
            f"confidence {low:.2f}-{high:.2f}: {len(inside):4d} labels, mean {mean:.2f}, right "
            f"{share:.2f}"
        )


def assertions(graph: str, out: Path, lines: int, seed: int = 0) -> None:
    """Write generated assertions; words have skewed frequencies, and one of ten lines is French."""
    rng = random.Random(seed)
    labels = [label.replace(" ", "_") for label in open_graph(graph).graph.entities]
    words = labels + [f"word{number}" for number in range(600_000)]

    def word() -> str:
        pool, power = (labels, 2) if rng.random() < 0.15 else (words, 3)
        return pool[int(len(pool) * rng.random() ** power)]

    with out.open("w", encoding="utf-8") as file:
        for _ in range(lines):
            language = "en" if rng.random() < 0.9 else "fr"
            start, relation, end = (
                f"/c/{language}/{word()}/n",
                f"/r/{rng.choice(RELATIONS)}",
                f"/c/en/{word()}",
            )
            about = (
                f'{{"dataset": "/d/generated", "license": "cc:by/4.0", "weight": '
                f"{1 + 3 * rng.random():.1f}}}"
            )
            file.write(f"/a/[{relation}/,{start}/,{end}/]\t{relation}\t{start}\t{end}\t{about}\n")


def main() -> None:
    """Run a command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("figure", choices=("senses", "assertions"))
    parser.add_argument("graph")
    parser.add_argument("path", type=Path)
    parser.add_argument("--lines", type=int, default=3_000_000)
    given = parser.parse_args()
    if given.figure == "senses":
        senses(given.graph, given.path)
    else:
        assertions(given.graph, given.path, given.lines)


if __name__ == "__main__":
    main()
