"""ComplEx on small books: the fixed N3 weight, the regularisation chosen on train recipes, and
counting.

    python benchmarks/small_books.py                       # all sizes and seeds
    python benchmarks/small_books.py --sizes 100 --seeds 0 --each
    python benchmarks/small_books.py --json small-books.json

Filtered MRR on unseen test triples, which neither training nor choice uses. Books: random recipes
from `everyday-1` and `kitchen`, the first recipes by crafting round in `everyday-1`, and synthetic
books, where only entity frequencies can be learned. "below" counts books with a lower figure than
counting, "worst" is the largest difference; the last column is choice time divided by training
time, in CPU seconds. Books with fewer than 30 unseen triples are left out, as in reports.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from synthetic_book import synthetic_rows

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs import RecipeGraph, Split, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.graph_folder import OpenedGraph
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.fitting import choose, fit
from wordcraft_kg.models.links.link_config import ComplExConfig
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.scorer_folder import make_scorer

SIZES = (100, 200, 500, 900)


class Row(NamedTuple):
    book: str
    split: str
    frequency: float
    fixed: float
    chosen: float
    n3: float
    popularity: float
    seconds: float
    seconds_of_choice: float


def synthetic(size: int, seed: int) -> RecipeGraph:
    return _graph(synthetic_rows(size // 6, size, 5, seed).astype(str).tolist())


def drawn(book: str) -> Callable[[int, int], RecipeGraph]:
    def distractor_seed(size: int, seed: int) -> RecipeGraph:
        rows = RecipeGraph.from_book(open_book(book)).recipe_labels()
        return _graph(
            [tuple(rows[i]) for i in np.random.default_rng(seed).permutation(len(rows))[:size]]
        )

    return distractor_seed


def reached_first(size: int, seed: int) -> RecipeGraph:
    graph = RecipeGraph.from_book(open_book("everyday-1"))
    rounds = layers(graph)
    when = np.where(rounds < 0, np.inf, rounds) + 3 * np.random.default_rng(seed).random(
        len(rounds)
    )
    order = np.argsort(when[graph.recipes].max(axis=1), kind="stable")[:size]
    return _graph([tuple(graph.recipe_labels()[i]) for i in order])


def _graph(rows: list) -> RecipeGraph:
    return RecipeGraph.from_recipes([tuple(row) for row in rows], name="book")


BOOKS = {
    "everyday-1, drawn": drawn("everyday-1"),
    "everyday-1, first": reached_first,
    "kitchen, drawn": drawn("kitchen"),
    "synthetic": synthetic,
}


def measure(book: str, size: int, kind: str, seed: int) -> Row | None:
    split = make_split(BOOKS[book](size, seed), SplitConfig(kind, seed=seed))
    if len(split.held_out("test")) < MIN_TRIPLES:
        return None
    settings = ComplExConfig(seed=seed)
    began = time.process_time()
    choice = choose(OpenedGraph(split.graph, split, book), settings, lambda done, total: None)
    chose = time.process_time()
    before = trained(split, settings.fixed())
    ended = time.process_time()
    if choice is None:
        n3, popularity, after = before[1].n3, 0.0, before
    else:
        n3, popularity = choice.n3, choice.popularity
        after = trained(split, replace(settings, n3=n3, popularity=popularity))
    figures = (
        mrr(split, scorer)
        for scorer in (FrequencyScorer(split.graph, split.partial), before[0], after[0])
    )
    return Row(f"{book} {size}", kind, *figures, n3, popularity, ended - chose, chose - began)


def trained(split: Split, settings: ComplExConfig) -> tuple[TripleScorer, ComplExConfig]:
    model = fit(settings, triples_factory(split.graph, split.partial), lambda epoch: None)
    tensors = scorer_tensors(settings, model, split.partial)
    return make_scorer(*tensors, split.graph.entities, split.graph.hash), settings


def mrr(split: Split, scorer: TripleScorer) -> float:
    return mean_reciprocal_rank(rank_triples(scorer, split.held_out("test"), split.graph.triples))


def measured(sizes: list[int], seeds: list[int]) -> Iterator[Row]:
    for size, book, kind, seed in product(sizes, BOOKS, ("by-recipe", "by-goal"), seeds):
        if book.startswith("kitchen") and size > 300:
            continue
        if row := measure(book, size, kind, seed):
            yield row


def summary(name: str, rows: list[Row]) -> str:
    frequency, fixed, chosen = (np.array([row[i] for row in rows]) for i in (2, 3, 4))
    ratio = sum(row.seconds_of_choice for row in rows) / sum(row.seconds for row in rows)
    return (
        f"{name:<28}{len(rows):>5}{frequency.mean():>8.3f}{fixed.mean():>8.3f}{chosen.mean():>8.3f}"
        f"{np.sum(fixed < frequency):>7}{np.min(fixed - frequency):>+8.3f}"
        f"{np.sum(chosen < frequency):>7}{np.min(chosen - frequency):>+8.3f}{ratio:>7.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--each", action="store_true", help="print each book, too")
    parser.add_argument("--json", type=Path, help="file to write each book's figures to")
    arguments = parser.parse_args()
    measure("kitchen, drawn", 100, "by-recipe", 0)  # the first training of a process is slower
    rows = []
    for row in measured(arguments.sizes, arguments.seeds):
        rows.append(row)
        if arguments.each:
            print(
                f"{row.book:<20} {row.split:<10}",
                " ".join(f"{value:.3f}" for value in row[2:]),
                flush=True,
            )
    print(
        f"{'recipes, split':<28}{'books':>5}{'counting':>9}{'fixed':>7}{'chosen':>8}"
        f"{'fixed: below, worst':>20}{'chosen: below, worst':>21}{'time':>6}"
    )
    for kind, size in product(("by-recipe", "by-goal"), arguments.sizes):
        of_size = [row for row in rows if row.split == kind and row.book.endswith(f" {size}")]
        if of_size:
            print(summary(f"{size}, {kind}", of_size))
    print(summary("all", rows))
    if arguments.json:
        stored = [
            {key: round(v, 4) if isinstance(v, float) else v for key, v in row._asdict().items()}
            for row in rows
        ]
        write_atomically(arguments.json, "[\n" + ",\n".join(map(json.dumps, stored)) + "\n]\n")


if __name__ == "__main__":
    main()
