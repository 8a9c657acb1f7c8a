"""What learning adds in the studies: success of agents minus the success of their scorers alone, on the same tables.

    wordcraft-kg train-recipes GRAPH --seed 0 --out scorers/any-name    (each graph of the studies, each seed)
    python benchmarks/cells_against_scorers.py scorers splits-little-alchemy-2.json ...

The scorer of each training, below the folder ``scorers`` by graph, split and seed, plays the tables of the training's
agent by itself: the pair with the highest recipe score beside agents with w at depth 1, its plans beside agents with p
at more. Intervals are over seeds and tasks. The rows go to
agents-against-scorers.json; a variant that several studies share has one row. Points without their scorers are left
out, and keep earlier rows. Files of studies lie in docs/results.zip.
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
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.errors import WordCraftKGError
from wordcraft_kg.base.statistics import crossed_difference
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.splits import SplitConfig
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.scorers.folder import WEIGHTS

TARGET = Path("agents-against-scorers.json")
KEY = ("graph", "split", "depth", "distractors", "variant")


def recipe_scorers(folder: Path) -> dict[tuple[str, int | None], Any]:
    """Return the finished recipe scorers of a folder, by split and seed."""
    found = {}
    for path in sorted(folder.iterdir()):
        try:
            model = open_model(path)
        except WordCraftKGError:  # not finished
            continue
        if model.run.kind == "train-recipes":
            found[model.opened.split.hash, model.seed] = model
    return found


def rates_alone(model: Any, depth: int, distractors: int, distractor_seeds: int) -> np.ndarray:
    """Return the success of a recipe scorer alone on each test task: by w at depth 1, by its plans at more."""
    player = knowledge_player(make_sources(["plan"], model.scorer))
    if depth == 1:
        player = scorer_players(model.opened.graph, model.scorer, model.triples)["w, best pair"]
    world = World(model.opened, WordCraftConfig("test", depth, distractors))
    return Evaluator(world, distractor_seeds=distractor_seeds)(player).success.mean(axis=1)


def groups_of(study: dict[str, Any], run: dict[str, Any]) -> list[int] | None:
    """Return the resampling groups of a run's tasks, if the study has them."""
    number = run.get("groups")
    return None if number is None else study["groups"][number]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scorers", type=Path)
    parser.add_argument("studies", type=Path, nargs="+")
    options = parser.parse_args()
    torch.set_num_threads(1)
    scorers = recipe_scorers(options.scorers)
    rows = json.loads(TARGET.read_text(encoding="utf-8")) if TARGET.exists() else []
    done = set()
    alone: dict[tuple[str, int, int, int], Any] = {}
    for path in options.studies:
        study: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        depth = study["study"]["settings"].get("depth", 1)
        source = "w" if depth == 1 else "p"
        variants = study["study"]["variants"].items()
        compared = [
            name for name, settings in variants if source in settings.get("use", "").split(",")
        ]
        points = defaultdict(list)
        for run in study["runs"]:
            if run["variant"] in compared:
                points[run["graph"], run["values"]["distractors"], run["variant"]].append(run)
        for (number, distractors, variant), runs in sorted(points.items()):
            graph = study["graphs"][number]
            key = dict(
                zip(KEY, (graph["hash"], graph["split"], depth, distractors, variant), strict=True)
            )
            if tuple(key.values()) in done or any(
                (graph["split"], run["seed"]) not in scorers for run in runs
            ):
                continue
            done.add(tuple(key.values()))
            for run in runs:
                played = (graph["split"], depth, distractors, run["seed"])
                if played not in alone:
                    alone[played] = rates_alone(
                        scorers[played[0], played[3]], *played[1:3], run["distractor_seeds"]
                    )
            won = np.array(
                [[int(count) / run["distractor_seeds"] for count in run["won"]] for run in runs]
            )
            own = np.array([alone[graph["split"], depth, distractors, run["seed"]] for run in runs])
            groups = groups_of(study, runs[0])
            (value, low, high), p_value = crossed_difference(won - own, groups)
            figures = {
                "agent": won.mean(),
                "scorer": own.mean(),
                "difference": value,
                "low": low,
                "high": high,
            }
            ratio = runs[0]["values"].get("train_ratio", SplitConfig().train_ratio)
            row = key | {
                "book": graph["name"],
                "kind": graph["kind"],
                "train_ratio": ratio,
                "seeds": len(runs),
                "tasks": won.shape[1],
            }
            row |= {name: round(float(figure), 6) for name, figure in figures.items()} | {
                "p": float(f"{p_value:.3g}")
            }
            if groups is not None:
                row["groups"] = len(set(groups))
            row["weights"] = [
                scorers[graph["split"], run["seed"]].run.outputs[WEIGHTS] for run in runs
            ]
            rows = [
                *(other for other in rows if any(other[name] != row[name] for name in KEY)),
                row,
            ]
            print(
                f"{row['book']} {row['kind']}, depth {depth}, {distractors} distractors, "
                f"{variant}: agent {row['agent']:.3f}, scorer {row['scorer']:.3f}, difference "
                f"{value:+.3f} [{low:+.3f}, {high:+.3f}], p {p_value:.2g}, {len(runs)} seeds",
                flush=True,
            )
            rows.sort(key=lambda row: [str(row[name]) for name in KEY])
            write_atomically(TARGET, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


if __name__ == "__main__":
    main()
