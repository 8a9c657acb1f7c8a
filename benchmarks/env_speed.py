"""Measure environment speed, compared with a naive loop in the same run.

    python benchmarks/env_speed.py little-alchemy-2

Depth 1 and 8 distractors unless said otherwise; random legal actions, resets included. *Naive* is
gymnasium's SyncVectorEnv over the single environment: a Python loop over environments, as one would
write it without the engine.
"""

import argparse
import time
from collections.abc import Callable

import gymnasium as gym
import numpy as np

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import make_split, open_graph
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.task_search import make_tasks

SECONDS = 2.0


def rate(step: Callable[[], int]) -> float:
    """Return units per second, given the units per call; best run out of three."""
    best = 0.0
    for _ in range(3):
        done, start = 0, time.perf_counter()
        while (spent := time.perf_counter() - start) < SECONDS / 3:
            done += step()
        best = max(best, done / spent)
    return best


def single(opened: OpenedGraph) -> Callable[[], int]:
    env = WordCraftEnv(opened, num_distractors=8)
    rng = np.random.default_rng(0)

    def run() -> int:
        env.reset()
        numbers = rng.random(2_000).tolist()
        for number in numbers:
            _, _, over, _, _ = env.step(int(number * len(env.state.table)))
            if over:
                env.reset()
        return len(numbers)

    env.reset(seed=0)
    return run


def batched(opened: OpenedGraph, num_envs: int, depth: int = 1) -> tuple[Callable[[], int], State]:
    engine = BatchEngine(World(opened, WordCraftConfig(num_distractors=8, depth=depth)), num_envs)
    rng, state = np.random.default_rng(0), engine.reset()

    def run() -> int:
        nonlocal state
        for _ in range(16):
            state, _ = engine.step(
                state, state.random_actions(rng.random(num_envs, dtype=np.float32))
            )
        return 16 * num_envs

    run()
    return run, state


def naive(opened: OpenedGraph, num_envs: int) -> Callable[[], int]:
    world = World(opened, WordCraftConfig(num_distractors=8))
    envs = gym.make_vec("WordCraft-v0", num_envs=num_envs, vectorization_mode="sync", graph=world)
    rng = np.random.default_rng(0)
    seen, _ = envs.reset(seed=0)

    def run() -> int:
        nonlocal seen
        actions = (rng.random(num_envs) * seen["action_mask"].sum(1)).astype(np.int64)
        seen, *_ = envs.step(actions)
        return num_envs

    return run


def memory(state: State) -> float:
    """Return the bytes that are kept for each environment."""
    values = [*state, *vars(state.engine).values(), *vars(state.ahead).values()]
    arrays = {id(value): value for value in values if isinstance(value, np.ndarray)}
    own = [
        array
        for array in arrays.values()
        if array.shape[0] == state.num_envs and array.base is None
    ]
    return sum(array.nbytes for array in own) / state.num_envs


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", nargs="?", default="everyday")
    opened = open_graph(parser.parse_args().graph)

    start = time.perf_counter()
    WordCraftEnv(opened, num_distractors=8)
    print(f"construction at depth 1   {1e3 * (time.perf_counter() - start):6.1f} ms")
    start = time.perf_counter()
    drawn = make_tasks(
        opened.graph, 4, make_split(opened.graph, opened.split.config), "train", limit=200, seed=1
    )
    print(f"a task of depth 4         {1e3 * (time.perf_counter() - start) / len(drawn):6.2f} ms")

    print(f"one environment           {rate(single(opened)):12,.0f} steps/s")
    loop = rate(naive(opened, 1_024))
    print(f"naive, 1,024              {loop:12,.0f} steps/s")
    for num_envs in (128, 1_024, 8_192):
        run, state = batched(opened, num_envs)
        speed = rate(run)
        ratio = f", {speed / loop:.0f} times the naive loop" if num_envs == 1_024 else ""
        print(
            f"batched, {num_envs:5,}            {speed:12,.0f} steps/s, {memory(state):.0f} bytes "
            f"each{ratio}"
        )
    run, _ = batched(opened, 1_024, depth=3)
    print(f"batched, 1,024, depth 3   {rate(run):12,.0f} steps/s")


if __name__ == "__main__":
    main()
