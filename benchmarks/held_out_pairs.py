"""How often held-out pairs stand on train tables, and how often they are tried there.

    python benchmarks/held_out_pairs.py little-alchemy-2 --runs runs/no-kg

On 20,000 train tables of depth 1: the share of tables with a pair of any held-out recipe, and with
one that makes the goal in the whole book; and the share of attempts that try such pairs, by random
play (an agent at the start of its training) and by trained agents.
"""

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg import WordCraftConfig, World, open_agent, open_graph
from wordcraft_kg.agents.evaluation import PolicyPlayer
from wordcraft_kg.agents.players import random_entity
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.graphs.arrays import Ids

TABLES = 20_000


def is_pair(graph_size: int, pairs: Ids, one: Ids, other: Ids) -> NDArray[np.bool_]:
    """Return whether ids form one of the pairs, shape (n, 2) with ascending ids."""
    keys = np.minimum(one, other) * (graph_size + 1) + np.maximum(one, other)
    return np.isin(keys, pairs[:, 0] * (graph_size + 1) + pairs[:, 1])


def tried(world: World, choose: Callable[[State], Ids]) -> tuple[State, Ids, Ids]:
    """Return first states, and the pairs that are tried in them: two arrays of ids, (N,)."""
    first = BatchEngine(world, TABLES).reset(3)
    slots = choose(first)
    one = first.table[np.arange(TABLES), slots]
    second, _ = first.engine.step_once(first, slots)
    other = first.table[np.arange(TABLES), choose(second)]
    return first, one, other


def main() -> None:
    """Print a line for each number of distractors and player."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("graph")
    parser.add_argument("--runs", nargs="*", default=[])
    parser.add_argument("--distractors", type=int, nargs="+", default=[8, 1])
    options = parser.parse_args()
    opened = open_graph(options.graph)
    graph = opened.graph
    held_out = graph.recipes[~opened.split.is_in("train")]
    for distractors in options.distractors:
        world = World(opened, WordCraftConfig(num_distractors=distractors))
        players = {"random": lambda state: random_entity(state, np.random.default_rng(0))}
        for run in options.runs:
            player = PolicyPlayer(open_agent(run).policy)
            players[run] = lambda state, player=player: player(state, np.random.default_rng(0))
        for name, choose in players.items():
            state, one, other = tried(world, choose)
            left, right = np.triu_indices(state.table.shape[1])
            on_table = state.table[:, left], state.table[:, right]
            stands = is_pair(graph.num_entities, held_out, *on_table).any(1)
            of_goal = np.zeros(TABLES, dtype=bool)
            tries_goal = np.zeros(TABLES, dtype=bool)
            for goal in np.unique(state.goal):
                rows = state.goal == goal
                pairs = held_out[held_out[:, 2] == goal]
                here = on_table[0][rows], on_table[1][rows]
                of_goal[rows] = is_pair(graph.num_entities, pairs, *here).any(1)
                tries_goal[rows] = is_pair(graph.num_entities, pairs, one[rows], other[rows])
            tries = is_pair(graph.num_entities, held_out, one, other)
            print(
                f"{distractors} distractors, {name}: tables with a held-out pair "
                f"{stands.mean():.3f}, of the goal {of_goal.mean():.4f}; tried "
                f"{tries.mean():.4f}, of the goal {tries_goal.mean():.5f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
