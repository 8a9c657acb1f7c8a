"""Does ComplEx gain from a general graph's triples? MRR on validation triples, by their weight.

    wordcraft-kg build-graph little-alchemy-2 --split by-goal --train-ratio 0.7 --valid-ratio 0.2 --seed 10 --out graphs/by-goal
    wordcraft-kg import-knowledge graphs/by-goal --wordnet /usr/share/wordnet --out knowledge/wn
    python benchmarks/joint_training.py graphs/by-goal knowledge/wn --json joint-training.json

A row is one training of `train-complex` without folds. Weight 0 means: without the general graph.
Rows that the file has of this graph are kept and not measured again.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.cli import main as run_command
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.models.links.link_config import ComplExConfig
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.scorer_folder import load_scorer

WEIGHTS = (0.0, ComplExConfig().outside_weight)


def trained(graph: str, knowledge: str, weight: float, seed: int, folder: Path) -> dict[str, Any]:
    """Return the metrics of a training with a weight; without the general graph if it is 0."""
    options = ["--folds", "0", "--seed", str(seed), "--quiet"]
    if weight:
        options += ["--with", knowledge, "--outside-weight", str(weight)]
    if run_command(["train-complex", graph, *options, "--out", str(folder)]):
        sys.exit(f"train-complex failed at weight {weight:g}")
    metrics: dict[str, Any] = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    split = open_graph(graph).split
    known = np.concatenate([split.partial, split.triples_of("valid")])
    ranks = rank_triples(load_scorer(folder), split.held_out("valid"), known)
    return metrics | {"valid_mrr": mean_reciprocal_rank(ranks)}


def main() -> None:
    """Measure the missing rows, and write each at once."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", help="graph folder with validation recipes")
    parser.add_argument("knowledge", help="knowledge folder for this graph")
    parser.add_argument("--weights", type=float, nargs="+", default=WEIGHTS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--json", type=Path, required=True, help="file of all rows")
    given = parser.parse_args()
    opened = open_graph(given.graph)
    rows = json.loads(given.json.read_text(encoding="utf-8")) if given.json.exists() else []
    for seed in given.seeds:
        for weight in given.weights:
            key = {
                "book": opened.graph.name,
                "split": opened.split.config.kind,
                "split_seed": opened.split.config.seed,
                "weight": weight,
                "seed": seed,
            }
            if any(key.items() <= row.items() for row in rows):
                continue
            with tempfile.TemporaryDirectory() as folder:
                began = time.process_time()
                found = trained(given.graph, given.knowledge, weight, seed, Path(folder, "model"))
                used = time.process_time() - began
            outside = (found.get("outside") or {}).get("triples", 0)
            row = {
                **key,
                "mrr": round(found["valid_mrr"], 4),
                "outside_triples": outside,
                "cpu_seconds": round(used),
            }
            rows.append(row)
            print(row, flush=True)
            write_atomically(given.json, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


if __name__ == "__main__":
    main()
