"""Success of plain PPO (``examples/ppo.py``), the baseline of an outsider, on the splits of a study.

    python benchmarks/plain_ppo.py results/graphs/* --json plain-ppo.json

Each folder is a graph of the study ``parts``; others are left out. Test tables are those of the
study, and each training has the example's 1,000,000 steps. The JSON file has the number of
successes on each test task, a digit each, and the task's group; a finished training is not repeated.
``docs/make_results.py`` compares the file with the study.
"""

import argparse
import json
import runpy
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch

from wordcraft_kg import evaluate, open_graph
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.graphs import OpenedGraph

EXAMPLE = Path(__file__).parents[1] / "examples" / "ppo.py"
STEPS = 1_000_000
"""Environment steps of a training, the example's default."""
KINDS = ("by-recipe", "by-goal")
"""Kinds of split of the study."""
SPLITS = range(3)
"""Seeds of its splits."""


def play(
    example: SimpleNamespace, folder: Path, opened: OpenedGraph, distractors: int
) -> dict[str, Any]:
    """Train on a graph's train tasks, and return the successes on its test tasks."""
    seed = opened.split.config.seed
    network = example.train(str(folder), STEPS, seed=seed, distractors=distractors)
    player = example.player_of(network)
    played = evaluate(player, opened, part="test", num_distractors=distractors)
    return {
        "book": opened.graph.name,
        "split": opened.split.config.kind,
        "seed": seed,
        "distractors": distractors,
        "success": round(float(played.success.mean()), 6),
        "tables": played.success.shape[1],
        "won": "".join(map(str, played.success.sum(axis=1))),
        "groups": played.groups.tolist(),
    }


def main() -> None:
    """Train, play, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--distractors", default="8,1")
    parser.add_argument("--json", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    example = SimpleNamespace(**runpy.run_path(str(EXAMPLE)))
    trainings = json.loads(options.json.read_text()) if options.json.exists() else {}
    numbers = map(int, options.distractors.split(","))
    for folder, distractors in product(options.folders, numbers):
        opened = open_graph(folder)
        split = opened.split.config
        name = f"{folder.name}, {distractors} distractors"
        if split.kind not in KINDS or split.seed not in SPLITS or name in trainings:
            continue
        trainings[name] = play(example, folder, opened, distractors)
        write_atomically(options.json, json.dumps(trainings))
        print(*list(trainings[name].values())[:5], flush=True)


if __name__ == "__main__":
    main()
