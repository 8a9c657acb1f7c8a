"""Scripted players: chance, knowledge graphs without any learning, and an oracle; how often each makes the goal.

A player is a function ``(engine, rng) -> slots`` that picks for all environments of a batch at once.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.scales import SelfEdges, scaled_scorer
from wordcraft_kg.settings import whole
from wordcraft_kg.statistics import wilson_interval

Player = Callable[[BatchEngine, np.random.Generator], Ids]
Tables = NDArray[np.float64]
"""Scores of all pairs, shape (2, E + 1, E + 1), by relation, head and tail; 0 for nothing."""


def random_entity(engine: BatchEngine, rng: np.random.Generator) -> Ids:
    """Pick any entity on the table."""
    return np.asarray(engine.random_actions(rng.random(engine.num_envs)))


def random_distinct(engine: BatchEngine, rng: np.random.Generator) -> Ids:
    """Pick any entity on the table, the second time another one."""
    others = engine.action_masks() & (engine.table != engine.selection[:, None])
    # Where there is no other one, the same again.
    return _best(np.where(others, 1.0, np.where(engine.action_masks(), 0.0, -np.inf)), rng)


def recipe_oracle(engine: BatchEngine, rng: np.random.Generator) -> Ids:
    """Follow a plan of the task."""
    recipes = engine.world.graph.recipes
    slots = np.zeros(engine.num_envs, dtype=np.int64)
    for i in range(engine.num_envs):
        if not engine.attempts_left[i]:
            continue
        table = engine.table[i].tolist()
        plan = recipes[list(engine.world.tasks.plans[engine.task[i]][0])].tolist()
        a, b, _ = next((row for row in plan if row[2] not in table), plan[-1])
        slots[i] = table.index(b if engine.selection[i] == a else a)
    return slots


def knowledge_player(tables: Tables, *, u: bool = True, v: bool = True) -> Player:
    """Return a player that picks the best score ``u + v`` of the paper, ties at random.

    ``u_i = L(e_i, combinesWith, held)``, 0 with nothing held; ``v_i = L(e_i, componentOf, goal)``.
    """

    def pick(engine: BatchEngine, rng: np.random.Generator) -> Ids:
        scores = np.zeros(engine.table.shape)
        if u:
            scores += tables[COMBINES_WITH, engine.table, engine.selection[:, None]]
        if v:
            scores += tables[COMPONENT_OF, engine.table, engine.goal[:, None]]
        return _best(np.where(engine.action_masks(), scores, -np.inf), rng)

    return pick


def pair_player(tables: Tables) -> Player:
    """Return a player that picks the pair of the best ``u + v_a + v_b``, of two different entities if it can."""

    def pick(engine: BatchEngine, rng: np.random.Generator) -> Ids:
        table, there = engine.table, engine.action_masks()
        parts = tables[COMPONENT_OF, table, engine.goal[:, None]]
        pairs = tables[COMBINES_WITH, table[:, :, None], table[:, None, :]] + parts[:, :, None] + parts[:, None, :]
        pairs = np.where(there[:, :, None] & there[:, None, :], pairs, -np.inf)
        pairs -= 1e-6 * np.eye(table.shape[1])
        held = (table == engine.selection[:, None]).argmax(1)
        is_second = engine.selection != engine.nothing
        first = pairs.max(axis=2)
        return _best(np.where(is_second[:, None], pairs[np.arange(len(table)), held], first), rng)

    return pick


def fact_tables(graph: RecipeGraph, triples: Ids, *, self_edges: SelfEdges = "keep") -> Tables:
    """Return the 0/1 tables of a set of triples."""
    tables = np.zeros((len(RELATIONS), graph.num_entities + 1, graph.num_entities + 1))
    tables[triples[:, 1], triples[:, 0], triples[:, 2]] = 1
    if self_edges == "drop":
        np.fill_diagonal(tables[COMBINES_WITH], 0)
    return tables


def scorer_tables(
    graph: RecipeGraph, scorer: TripleScorer, *, self_edges: SelfEdges = "keep", observed: Ids | None = None
) -> Tables:
    """Return a scorer's tables on a common scale: each relation standardised over all pairs of different entities.

    Args:
        graph: of the environment.
        scorer: of the same graph.
        self_edges: what happens to an entity's combinesWith score with itself: ``keep``; ``observed`` keeps those of
            ``observed``; ``drop`` none. A score that is dropped is 0, the mean.
        observed: triples that the scorer was trained on, shape (T, 3).

    Raises:
        GraphMismatchError: if the scorer belongs to another graph.
        ConfigError: for ``observed`` without triples.
    """
    check_scorer(scorer, graph)
    scaled = scaled_scorer(scorer, self_edges=self_edges, observed=observed)
    return np.pad(scaled.scores.numpy().astype(np.float64), ((0, 0), (0, 1), (0, 1)))


def knowledge_players(graph: RecipeGraph, partial: Ids) -> dict[str, Player]:
    """Return the players of the reference table: chance, symbolic partial and full knowledge graphs, and the oracle."""
    some, everything = fact_tables(graph, partial), fact_tables(graph, graph.triples)
    no_self = fact_tables(graph, graph.triples, self_edges="drop")
    return {
        "random": random_entity,
        "random, distinct": random_distinct,
        "partial KG, v": knowledge_player(some, u=False),
        "partial KG, u+v": knowledge_player(some),
        "full KG, v": knowledge_player(everything, u=False),
        "full KG, u": knowledge_player(everything, v=False),
        "full KG, u+v": knowledge_player(everything),
        "full KG, u+v, no self edges": knowledge_player(no_self),
        "full KG, best pair": pair_player(everything),
        "recipe oracle": recipe_oracle,
    }


def scorer_players(graph: RecipeGraph, scorer: TripleScorer, observed: Ids) -> dict[str, Player]:
    """Return the players that a scorer makes: v, u, and u+v with self edges kept, observed and dropped."""
    kept = scorer_tables(graph, scorer)
    return {
        "v": knowledge_player(kept, u=False),
        "u": knowledge_player(kept, v=False),
        "u+v, self edges kept": knowledge_player(kept),
        "u+v, self edges observed": knowledge_player(
            scorer_tables(graph, scorer, self_edges="observed", observed=observed)
        ),
        "u+v, self edges dropped": knowledge_player(scorer_tables(graph, scorer, self_edges="drop")),
    }


def play_all(
    world: World,
    players: dict[str, Player],
    distractors: Iterable[int] = (1, 2, 8),
    *,
    draws: int = 5,
    seed: int = 0,
) -> pd.DataFrame:
    """Let players play every task of a part, each with several draws of distractors.

    Success is the sparse one, whatever the reward settings: the goal was made within the attempts.

    Args:
        world: the tasks; its number of distractors is replaced.
        players: by name.
        distractors: numbers of distractors.
        draws: of distractors for each task; all players see the same ones.
        seed: of distractors and players.

    Returns:
        a row for each player and number of distractors: ``player``, ``distractors``, ``episodes``, ``success``, its
        95 % Wilson interval ``low`` and ``high``, and ``by_plan``, the share won with a plan's last pair.
    """
    rows: list[dict[str, Any]] = []
    whole("seed", seed, 0)
    for amount in dict.fromkeys(distractors):
        tasks = np.arange(len(world.tasks))
        engine = BatchEngine(world.variant(num_distractors=amount), len(tasks), seed=seed)
        for name, player in players.items():
            won = by_plan = 0
            rng = np.random.default_rng([seed, amount])
            for draw in range(draws):
                engine.pose(tasks, draw)
                while (engine.attempts_left > 0).any():
                    step = engine.step_once(player(engine, rng))
                    won += int(np.sum(step.outcome == GOAL))
                    by_plan += int(np.sum(step.by_plan))
            episodes = len(tasks) * draws
            low, high = wilson_interval(won, episodes)
            rows.append(
                {
                    "player": name,
                    "distractors": amount,
                    "episodes": episodes,
                    "success": won / episodes,
                    "low": low,
                    "high": high,
                    "by_plan": by_plan / episodes,
                }
            )
    return pd.DataFrame(rows)


def _best(scores: NDArray[np.float64], rng: np.random.Generator) -> Ids:
    """Return the column of each row's largest score, ties at random."""
    is_best = scores == scores.max(axis=1, keepdims=True)
    return np.asarray(np.where(is_best, rng.random(scores.shape), -1.0).argmax(axis=1))
