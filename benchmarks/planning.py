"""Goals that need several attempts: success of the planner and of other players, by depth and unseen recipes.

    wordcraft-kg build-graph little-alchemy-2 --out graphs/la2
    wordcraft-kg train-recipes graphs/la2 --out models/la2
    python benchmarks/planning.py graphs/la2 models/la2 --depths 1,2,3,4 --distractors 0,4,8 --json figures.json

Plays an evenly spaced sample of test tasks on the evaluation's tables, with as many attempts as the depth, or as many
as ``--attempts``: then *within* is the share of the tasks that were solved within n attempts, and shows who uses failures.
*unseen* counts tasks by the least number of unseen recipes in a plan, *twice* those whose plans use an entity twice.
*minus_planner* is the paired difference to the planner, with an interval over what is held out. The planner has two
trivial twins: one does not know that plans seldom use an ingredient again, the other forgets it after the first attempt
and searches again. ``--run`` adds a trained agent, ``--widths`` planners with
other numbers of candidates, with milliseconds per decision, ``--odds`` plays the planner with other log-odds for
intermediates instead. ``--time`` times decisions, alone and in a batch of 256.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.players import Player, knowledge_player, random_distinct, recipe_oracle
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import paired_difference, task_bootstrap
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.graph_folder import OpenedGraph, open_graph
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.sources.source import ScoreView
from wordcraft_kg.models.scorers.scorer_folder import load_scorer
from wordcraft_kg.planning import search
from wordcraft_kg.planning.source import BestPlan


def players(opened: OpenedGraph, options: argparse.Namespace) -> Iterator[tuple[str, Player]]:
    """Yield the players of the table."""
    scorer, graph = load_scorer(options.model), opened.graph
    for odds in map(float, options.odds.split(",") if options.odds else ()):
        # The search reads this constant at each call: a player plays before the next one comes.
        search.INTERMEDIATE = odds
        yield f"planner, log-odds {odds:g}", knowledge_player(make_sources(["plan"], scorer))
    if options.odds:
        return
    yield "chance", random_distinct
    for name in ("u,v", "w"):
        yield (
            name,
            knowledge_player(make_sources(name.split(","), scorer, ScoreView("standardise"))),
        )
    planner = knowledge_player(make_sources(["plan"], scorer))
    yield "planner", planner
    (source,) = make_sources(["plan"], scorer)
    assert isinstance(source, BestPlan)
    # The log-odds of two forms of plans.
    source.curve[-2:] = 0.0
    any_form = knowledge_player([source])
    yield "planner, any form", any_form
    yield "planner, searches again", by_attempt(planner, any_form)
    for width in map(int, options.widths.split(",") if options.widths else ()):
        yield (
            f"planner, {width} candidates",
            knowledge_player(make_sources(["plan"], scorer, ScoreView(width=width))),
        )
    known = BestPlan.of_recipes(graph.num_entities, opened.split.recipes("train"))
    yield "planner, train recipes", knowledge_player([known])
    for run in options.run:
        yield run.name, PolicyPlayer(open_agent(run).policy)
    yield "oracle", recipe_oracle


def by_attempt(first: Player, later: Player) -> Player:
    """Return a player that plays its first attempt like one player, all others like another."""

    def choose(state: State, rng: np.random.Generator) -> Ids:
        is_first = state.attempts_left.max() == state.world.config.attempts
        return first(state, rng) if is_first else later(state, rng)

    return choose


def cell(world: World, result: Evaluation, seconds: float) -> dict[str, Any]:
    """Return a player's success on a sample of the tasks, also by the fewest unseen recipes in a
    plan, and by whether a plan uses an entity twice.

    Args:
        world: graph, tasks and settings.
        result: the player's outcomes.
        seconds: CPU time of its play.
    """
    decisions = result.actions.sum() / 2
    is_train = world.split.is_in("train")
    unseen = np.array(
        [
            min((~is_train[list(plan)]).sum() for plan in world.tasks.plans[task])
            for task in result.tasks
        ]
    )
    figures = result.metrics()
    # An attempt has two actions. A solved task ends its episode, so that its length tells when.
    solved_after = np.where(result.success, result.actions // 2, np.inf)
    uses_twice = world.tasks.uses_twice[result.tasks]
    within = {
        number: float((solved_after <= number).mean())
        for number in range(1, world.config.attempts + 1)
    }
    return {
        "success": figures.mean,
        "within": within,
        "interval": list(task_bootstrap(result.success, result.groups)),
        "by_plan": figures.by_plan,
        "tasks": len(result.tasks),
        "attempts": float(decisions / len(result.tasks)),
        "ms": 1000 * seconds / float(decisions),
        "twice": [float(result.success[uses_twice].mean()), int(uses_twice.sum())],
        "unseen": {
            int(number): [
                float(result.success[unseen == number].mean()),
                int((unseen == number).sum()),
            ]
            for number in np.unique(unseen)
        },
    }


def milliseconds(world: World, source: Any, batch: int) -> float:
    """Return the CPU time of a first decision, per state, for a batch of states."""
    states = states_of(BatchEngine(world, batch).reset())
    rounds = []
    for _ in range(9):
        source.kept.forget()
        began = time.process_time()
        source(states)
        rounds.append(time.process_time() - began)
    return 1000 * float(np.median(rounds)) / batch


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph")
    parser.add_argument("model", type=Path)
    parser.add_argument("--depths", default="1,2,3,4")
    parser.add_argument("--distractors", default="0,4,8")
    parser.add_argument("--attempts", type=int, help="attempts in an episode; default: the depth")
    parser.add_argument("--part", default="test")
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--only", help="names of players, separated by semicolons")
    parser.add_argument("--widths", default="")
    parser.add_argument("--odds", default="", help="log-odds added for intermediates")
    parser.add_argument("--run", type=Path, action="append", default=[])
    parser.add_argument("--time", action="store_true")
    parser.add_argument("--json", type=Path, help="file to add the figures to")
    options = parser.parse_args()
    torch.set_num_threads(1)
    opened = open_graph(options.graph)
    rows = json.loads(options.json.read_text()) if options.json and options.json.exists() else []
    with threadpool_limits(1):
        for depth in map(int, options.depths.split(",")):
            for distractors in map(int, options.distractors.split(",")):
                config = WordCraftConfig(
                    options.part, depth, distractors, max_attempts=options.attempts
                )
                world = World(opened, config)
                if options.time:
                    (source,) = make_sources(["plan"], load_scorer(options.model))
                    alone, many = (milliseconds(world, source, batch) for batch in (1, 256))
                    print(
                        f"first decision at depth {depth}: {alone:.2f} ms alone, {many:.3f} ms in "
                        "a batch of 256"
                    )
                    continue
                evaluator = Evaluator(world, distractor_seeds=1, limit=options.tasks)
                planner = None
                for name, player in players(opened, options):
                    if options.only and name not in options.only.split(";"):
                        continue
                    began = time.process_time()
                    result = evaluator(player)
                    figures = cell(world, result, time.process_time() - began)
                    planner = result if name == "planner" else planner
                    if planner is not None:
                        figures["minus_planner"] = list(
                            paired_difference(result.success, planner.success, result.groups)
                        )
                    split = opened.split.config
                    about = {
                        "book": opened.graph.name,
                        "split": split.kind,
                        "seed": split.seed,
                        "part": options.part,
                    }
                    about |= {
                        "depth": depth,
                        "distractors": distractors,
                        "max_attempts": world.config.attempts,
                        "player": name,
                    }
                    rows.append({**about, "model": options.model.name, **figures})
                    unseen = ", ".join(
                        f"{key}: {share:.3f} of {n}"
                        for key, (share, n) in figures["unseen"].items()
                    )
                    within = ", ".join(f"{share:.3f}" for share in figures["within"].values())
                    print(
                        f"depth {depth}, {distractors} distractors, {name}: "
                        f"{figures['success']:.3f} (own plan {figures['by_plan']:.3f}), "
                        f"{figures['ms']:.2f} ms; unseen {unseen}; "
                        f"within 1, 2, ... attempts {within}",
                        flush=True,
                    )
                    if options.json:
                        write_atomically(options.json, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
