"""Picks of scripted players for text agents that play like them, and the evaluation that these must
have."""

from collections.abc import Callable

import numpy as np

from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import (
    Player,
    knowledge_player,
    random_distinct,
    random_entity,
    recipe_oracle,
)
from wordcraft_kg.graphs.graph_folder import OpenedGraph
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.scorers.baselines import SymbolicScorer

PLAYERS: dict[str, Callable[[OpenedGraph], Player]] = {
    "oracle": lambda opened: recipe_oracle,
    "random": lambda opened: random_entity,
    "random distinct": lambda opened: random_distinct,
    "full graph": lambda opened: knowledge_player(
        make_sources(["u", "v"], SymbolicScorer(opened.graph, opened.graph.triples))
    ),
}


def picks_of(player, world, distractor_seeds):
    """Return the slots that a scripted player picks, by task and draw, as an
    evaluation has them."""
    found = {}
    evaluator = Evaluator(world, distractor_seeds=distractor_seeds)
    episode = -1

    def recording(engine, rng):
        nonlocal episode
        slots = player(engine, rng)
        if (engine.selection == engine.nothing).all() and (
            engine.attempts_left == world.config.attempts
        ).all():
            episode += 1
        for row in np.flatnonzero(engine.attempts_left > 0):
            found.setdefault((int(evaluator.tasks[row]), episode), []).append(int(slots[row]))
        return slots

    evaluator(recording)
    return found


def assert_same(found, expected):
    for name in ("tasks", "success", "by_plan", "actions"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name
    assert found.metrics() == expected.metrics()


def plan_pairs(game):
    """Return the label pairs of a plan of a game's task, in order."""
    rows = game.tasks.plans[game.task][0]
    pairs = (game.graph.labels(pair) for pair in game.graph.recipes[rows, :2].tolist())
    # A pair with two results stands twice in a plan that needs both.
    return [*dict.fromkeys(pairs)]
