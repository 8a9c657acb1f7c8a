"""The true results of unseen pairs among those that a recipe scorer proposes, and the time of a pair.

    wordcraft-kg build-graph infinite-craft --out graphs/ic
    wordcraft-kg train-recipes graphs/ic --features vectors/ic --out models/ic
    python benchmarks/pair_results.py graphs/ic models/ic --json results.json

Asks for test pairs that no train recipe has, a sample of them. A pair with several test results
counts by its best one. The rank of a result that is not proposed counts as infinite. Times are CPU
milliseconds of one thread: pairs in one batch, and pairs one by one. Prints the JSON object.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.graphs.graph_folder import open_graph
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

FIRST = (1, 5, 32)
"""Ranks up to which the share of pairs is counted."""
ALONE = 50
"""Pairs that are asked one by one for their time."""


def main() -> None:
    """Rank the true results, print the figures, and write them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph")
    parser.add_argument("model", type=Path)
    parser.add_argument("--pairs", type=int, default=2_000, help="most pairs to ask for")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--json", type=Path, help="file to write")
    options = parser.parse_args()
    torch.set_num_threads(1)
    opened = open_graph(options.graph)
    scorer = whole_of(load_scorer(options.model, graph=opened.graph))
    if not isinstance(scorer, RecipeScorer) or not scorer.proposes_results:
        parser.error(f"{options.model} proposes no results: its book is small.")
    size = opened.graph.num_entities
    seen = {tuple(pair) for pair in opened.split.recipes("train")[:, :2].tolist()}
    results_of: dict[tuple[int, int], list[int]] = {}
    for a, b, result in opened.split.recipes("test").tolist():
        if (a, b) not in seen:
            results_of.setdefault((a, b), []).append(result)
    every = np.array(sorted(results_of))
    rng = np.random.default_rng(options.seed)
    pairs = torch.from_numpy(every[np.sort(rng.permutation(len(every))[: options.pairs])])
    scorer.candidate_results(*pairs[:1].T)  # makes lists, and compiles loops
    began = time.process_time()
    proposed, _ = scorer.candidate_results(*pairs.T)
    in_batch = time.process_time() - began
    began = time.process_time()
    for pair in pairs[:ALONE]:
        scorer.candidate_results(*pair[:, None])
    one_by_one = time.process_time() - began
    ranks = np.full(len(pairs), np.inf)
    for row, pair in enumerate(pairs.tolist()):
        is_right = np.isin(proposed[row].numpy(), results_of[pair[0], pair[1]])
        if is_right.any():
            ranks[row] = 1 + int(is_right.argmax())
    found = {
        "graph": opened.graph.name,
        "split": opened.split.config.kind,
        "entities": size,
        "pairs": len(pairs),
        "mrr": round(float(np.mean(1 / ranks)), 4),
        **{f"first {place}": round(float(np.mean(ranks <= place)), 4) for place in FIRST},
        "milliseconds in a batch": round(1e3 * in_batch / len(pairs), 2),
        "milliseconds alone": round(1e3 * one_by_one / min(ALONE, len(pairs)), 2),
    }
    print(json.dumps(found))
    if options.json:
        write_atomically(options.json, dump_json(found))


if __name__ == "__main__":
    main()
