"""What learning adds in a study: success of agents minus the success of their scorers alone, on the same tables.

    wordcraft-kg reproduce splits --seeds 3 --keep figures --out results
    python benchmarks/cells_against_scorers.py results docs/results/splits-little-alchemy-2.json

The scorer of each training, in the folder of ``reproduce``, plays the tables of the training's agent by itself: the
pair with the highest recipe score beside agents with w at depth 1, its plans beside agents with p at more. Intervals
are over seeds and tasks.
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import knowledge_player, scorer_players
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.statistics import crossed_difference
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.sources.registry import make_sources


def recipe_scorers(results: Path) -> dict[tuple[str, int | None], Any]:
    """Return the finished recipe scorers of a results folder, by split and seed."""
    found = {}
    for folder in sorted((results / "scorers").iterdir()):
        try:
            model = open_model(folder)
        except WordCraftKGError:  # not finished
            continue
        if model.run.kind == "train-recipes":
            found[model.opened.split.hash, model.seed] = model
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("study", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    study: dict[str, Any] = json.loads(options.study.read_text(encoding="utf-8"))
    scorers = recipe_scorers(options.results)
    variants, depth = study["study"]["variants"].items(), study["study"]["settings"].get("depth", 1)
    source = "w" if depth == 1 else "p"
    compared = [name for name, settings in variants if source in settings.get("use", "").split(",")]
    points = defaultdict(list)
    for run in study["runs"]:
        if run["variant"] in compared:
            points[study["graphs"][run["graph"]]["split"], run["values"]["distractors"], run["variant"]].append(run)
    alone: dict[tuple[str, int, int], Any] = {}
    for (split, distractors, variant), runs in sorted(points.items()):
        for run in runs:
            model, key = scorers[split, run["seed"]], (split, distractors, run["seed"])
            if key not in alone:
                player = knowledge_player(make_sources(["p"], model.scorer))
                if depth == 1:
                    player = scorer_players(model.opened.graph, model.scorer, model.triples)["w, best pair"]
                world = World(model.opened, WordCraftConfig("test", depth, distractors))
                evaluator = Evaluator(world, distractor_seeds=run["distractor_seeds"])
                alone[key] = evaluator(player).success.mean(axis=1)
        won = np.array([[int(count) / run["distractor_seeds"] for count in run["won"]] for run in runs])
        scores = np.array([alone[split, distractors, run["seed"]] for run in runs])
        (value, low, high), _ = crossed_difference(won - scores)
        kind = scorers[split, runs[0]["seed"]].opened.split.config.kind
        print(
            f"{kind}, {distractors} distractors, {variant}: agent {won.mean():.3f}, scorer {scores.mean():.3f}, "
            f"difference {value:+.3f} [{low:+.3f}, {high:+.3f}], {len(runs)} seeds"
        )


if __name__ == "__main__":
    main()
