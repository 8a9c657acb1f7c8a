"""Weights of plans learned from play beside the planner, on the same tables, with an ablation.

    wordcraft-kg build-graph everyday --seed 10 --out graphs/everyday
    wordcraft-kg train-recipes graphs/everyday --features glove --out models/everyday
    python benchmarks/plan_weights.py graphs/everyday models/everyday

    wordcraft-kg train-agent graphs/everyday --scorer models/everyday --depth 2 --distractors 4 \\
        --use combines,component,recipe,plan --out runs/weighed
    python benchmarks/plan_weights.py graphs/everyday models/everyday --runs runs/weighed

Plays an evenly spaced sample of tasks, a table each, with as many attempts as the depth. ``--parts-of``
learns only some weights: those of probabilities, those of a plan's form, or those of the planner's own
value and of using an ingredient again. ``--runs`` plays trained agents of the same graph on the same
tables: what does training add to planner and weights? Prints a JSON line each. With unseen goals, the
line has the success on tasks whose final goal is unseen, and on those with an unseen intermediate.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from wordcraft_kg.agents.agent_config import TaskConfig
from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.plan_weights import TASKS, fit_plan_weights
from wordcraft_kg.agents.players import knowledge_player
from wordcraft_kg.base.statistics import paired_difference
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.graph_folder import open_graph
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.sources.source import ScoreView
from wordcraft_kg.models.scorers.scorer_folder import load_scorer
from wordcraft_kg.planning.search import FEATURES
from wordcraft_kg.planning.source import BestPlan

FORM = ("itself", "reused", "twice")
"""Features of a plan's form; all others are probabilities."""
PARTS = {
    "all": FEATURES,
    "probabilities": tuple(name for name in FEATURES if name not in FORM),
    "form": FORM,
    "value and reused": ("value", "reused"),
}


def by_goal(world: World, planner: Evaluation, weighed: Evaluation) -> dict[str, Any]:
    """Return both players' success on tasks whose final goal is unseen, and on the other tasks."""
    made_in_train = world.split.recipes("train")[:, 2]
    is_seen = np.isin(world.tasks.goals[planner.tasks], made_in_train)
    rows = {}
    for name, chosen in (("unseen", ~is_seen), ("seen", is_seen)):
        before = planner.success[chosen]
        after = weighed.success[chosen]
        difference = paired_difference(after, before, planner.groups[chosen])
        rows[name] = {
            "tasks": int(chosen.sum()),
            "planner": round(float(before.mean()), 4),
            "weighed": round(float(after.mean()), 4),
            "difference": [round(value, 4) for value in difference],
        }
    return rows


def main() -> None:
    """Print the planner's success, and that with weights learned from play."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("graph")
    parser.add_argument("model", type=Path)
    parser.add_argument("--part", default="test")
    parser.add_argument("--depths", default="2")
    parser.add_argument("--distractors", type=int, default=4)
    parser.add_argument("--tasks", type=int, default=2_000, help="tasks to play")
    parser.add_argument("--train-tasks", type=int, default=TASKS)
    parser.add_argument("--seeds", default="0", help="seeds of the train tasks' sample")
    parser.add_argument("--parts-of", action="store_true", help="learn some weights only, too")
    parser.add_argument("--runs", nargs="*", default=[], help="trained agents, at one depth")
    options = parser.parse_args()
    torch.set_num_threads(1)
    opened = open_graph(options.graph)
    scorer = load_scorer(options.model, graph=opened.graph)
    for depth in map(int, options.depths.split(",")):
        config = TaskConfig(depth=depth, distractors=options.distractors)
        train = World(opened, config.environment("train"))
        view = ScoreView(tasks=train.tasks)
        (source,) = make_sources(["plan"], scorer, view)
        assert isinstance(source, BestPlan)
        world = train.variant(part=options.part)
        evaluator = Evaluator(world, distractor_seeds=1, limit=options.tasks)
        planner = evaluator(knowledge_player([source]))
        for seed in map(int, options.seeds.split(",")):
            for name in PARTS if options.parts_of else ("all",):
                (weighed,) = make_sources(["plan"], scorer, view)
                assert isinstance(weighed, BestPlan)
                began = time.process_time()
                weights = fit_plan_weights(
                    weighed,
                    train,
                    seed=seed,
                    tasks=options.train_tasks,
                    features=PARTS[name],
                )
                seconds = time.process_time() - began
                weighed.weigh(weights)
                result = evaluator(knowledge_player([weighed]))
                difference = paired_difference(result.success, planner.success, result.groups)
                row = {
                    "depth": depth,
                    "seed": seed,
                    "weights": name,
                    "tasks": len(result.tasks),
                    "planner": round(planner.metrics().mean, 4),
                    "weighed": round(result.metrics().mean, 4),
                    "difference": [round(value, 4) for value in difference],
                    "other_decisions": round(
                        float((result.decisions != planner.decisions).mean()), 4
                    ),
                    "cpu_seconds_to_learn": round(seconds, 1),
                }
                if opened.split.config.kind == "by-goal":
                    row["by_goal"] = by_goal(world, planner, result)
                print(json.dumps(row), flush=True)
        # Beside the weights of the last seed, which are all weights unless parts are asked for.
        for run in options.runs:
            agent = open_agent(run)
            played = evaluator(PolicyPlayer(agent.policy))
            row = {"run": Path(run).name, "seed": agent.config.trainer.seed, "depth": depth}
            row |= {"tasks": len(played.tasks), "agent": round(played.metrics().mean, 4)}
            for name, other in (("planner", planner), ("weighed", result)):
                difference = paired_difference(played.success, other.success, played.groups)
                row[f"against_{name}"] = [round(value, 4) for value in difference]
                is_other = played.decisions != other.decisions
                row[f"other_decisions_than_{name}"] = round(float(is_other.mean()), 4)
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
