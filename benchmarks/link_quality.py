"""How well ComplEx predicts unseen links, and the evidence for its default settings.

    python benchmarks/link_quality.py settings little-alchemy-2     # sweep, judged on validation parts of other splits
    python benchmarks/link_quality.py test little-alchemy-2         # the defaults on the test parts of splits 0, 1, 2

The sweep never ranks a test triple (they are only filtered from the candidates), and its splits (seeds 10, 11, 12) are
not those of the test (0, 1, 2).
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.models import ComplExConfig, FrequencyScorer, load_scorer, rank_triples, ranking_metrics, train_links

WEIGHTS = (0.05, 0.075, 0.1, 0.125, 0.2)
RATES = (0.1, 0.2)
EVERY = 10


def sweep(graph: RecipeGraph, folder: Path, epochs: int) -> None:
    print("validation MRR, mean of 3 splits, after " + " ".join(f"{n:>5}" for n in range(EVERY, epochs + 1, EVERY)))
    for rate in RATES:
        for weight in WEIGHTS:
            config = ComplExConfig(epochs=epochs, eval_every=EVERY, n3=weight, learning_rate=rate)
            curves = []
            for seed in (10, 11, 12):
                split = make_split(graph, SplitConfig(seed=seed, valid_ratio=0.1))
                trained = train_links(OpenedGraph(graph, split, graph.name), config, folder / "model", force=True)
                trace = [json.loads(line) for line in (trained.folder / "trace.jsonl").read_text().splitlines()]
                curves.append([row["valid_mrr"] for row in trace if "valid_mrr" in row])
            means = " ".join(f"{value:.3f}" for value in np.mean(curves, axis=0))
            print(f"rate {rate:<4} N3 weight {weight:<6}                    {means}", flush=True)


def test(graph: RecipeGraph, folder: Path) -> None:
    rows = []
    for seed in (0, 1, 2):
        split = make_split(graph, SplitConfig(seed=seed))
        trained = train_links(OpenedGraph(graph, split, graph.name), ComplExConfig(), folder / "model", force=True)
        queries = split.held_out("test")
        found = ranking_metrics(rank_triples(load_scorer(trained.folder), queries, graph.triples))
        counted = ranking_metrics(rank_triples(FrequencyScorer(graph, split.partial), queries, graph.triples))
        rows.append([found["mrr"], found["hits@1"], found["hits@10"], counted["mrr"], trained.metrics["seconds"]])
        print("split {}  MRR {:.4f}  hits@1 {:.3f}  hits@10 {:.3f}  frequency {:.3f}  {:.1f} s".format(seed, *rows[-1]))
    print(
        "mean     MRR {:.4f}  hits@1 {:.3f}  hits@10 {:.3f}  frequency {:.3f}  {:.1f} s".format(*np.mean(rows, axis=0))
    )
    split = make_split(graph, SplitConfig())
    full = train_links(OpenedGraph(graph, split, graph.name), ComplExConfig(kg="full"), folder / "model", force=True)
    print(f"full graph, on its own triples: MRR {full.metrics['train_mrr']:.4f}  {full.metrics['seconds']:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["settings", "test"])
    parser.add_argument("book", nargs="?", default="little-alchemy-2")
    parser.add_argument("--epochs", type=int, default=100, help="of the sweep")
    arguments = parser.parse_args()
    graph = RecipeGraph.from_book(open_book(arguments.book))
    with tempfile.TemporaryDirectory() as folder:
        if arguments.what == "settings":
            sweep(graph, Path(folder), arguments.epochs)
        else:
            test(graph, Path(folder))


if __name__ == "__main__":
    main()
