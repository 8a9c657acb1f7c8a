"""Play the test tasks of the studies without agents: chance, nearest words, a recipe scorer alone,
and a planner.

    python benchmarks/study_players.py SCORER --distractors 8,2,1
    python benchmarks/study_players.py SCORER --depth 2 --distractors 4,0

SCORER is a folder of `train-recipes` on the graph of a study, such as those below scorers/ in a
folder of `reproduce`. The rows go to docs/study-players.json, where docs/make_results.py finds them
for studies on the same graph, split and tasks; each has the hash of the scorer's weights and its
seed. All play all test tasks with as many distractor seeds as the agents of the studies: five, or
one above 6,000 tasks.
"""

import argparse
import json
from pathlib import Path

import torch

from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import (
    Player,
    knowledge_player,
    nearest_words,
    random_distinct,
    scorer_players,
)
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import rate_interval
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.folder import WEIGHTS

TARGET = Path(__file__).parents[1] / "docs" / "study-players.json"
KEY = ("graph", "split", "depth", "distractors", "distractor_seeds", "player")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scorer", type=Path)
    parser.add_argument("--depth", type=int, default=1)
    parser.add_argument("--distractors", default="8,1")
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = open_model(options.scorer)
    opened = model.opened
    alone = scorer_players(opened.graph, model.scorer, model.triples)
    players: dict[str, Player] = {
        "random pairs": random_distinct,
        "nearest words": nearest_words(glove_features(opened.graph.entities).unit_vectors),
    }
    players |= {"recipe scorer alone, u v": alone["u+v, self edges dropped"]}
    players["recipe scorer alone, w"] = alone["w, best pair"]
    players["planner, p"] = knowledge_player(make_sources(["plan"], model.scorer))
    rows = json.loads(TARGET.read_text(encoding="utf-8")) if TARGET.exists() else []
    for distractors in map(int, options.distractors.split(",")):
        world = World(opened, WordCraftConfig("test", options.depth, distractors))
        evaluator = Evaluator(world)
        for name, player in players.items():
            result = evaluator(player)
            rates = result.success.mean(axis=1)
            row = {"graph": opened.graph.hash, "split": opened.split.hash, "depth": options.depth}
            row |= {
                "distractors": distractors,
                "distractor_seeds": evaluator.distractor_seeds,
                "player": name,
            }
            row |= {"tasks": len(rates), "groups": len(set(result.groups.tolist()))}
            row |= {"success": float(rates.mean())}
            low, high = rate_interval(rates[None], result.groups)
            row |= {"low": low, "high": high, "by_plan": float(result.by_plan.mean())}
            row |= {"weights": model.run.outputs[WEIGHTS], "seed": model.seed}
            row = {
                key: round(value, 4) if isinstance(value, float) else value
                for key, value in row.items()
            }
            rows = [*(other for other in rows if any(other[key] != row[key] for key in KEY)), row]
            print(
                f"depth {options.depth}, {distractors} distractors, {name}: {row['success']} "
                f"[{low:.3f}, {high:.3f}]"
            )
    rows.sort(key=lambda row: [str(row[key]) for key in KEY[:5]])
    write_atomically(TARGET, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


if __name__ == "__main__":
    main()
