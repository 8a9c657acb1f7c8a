"""Measure environment speed, compared with plain Python in the same run.

    python benchmarks/env_speed.py little-alchemy-2 --json environments.json

Depth 1 and 8 distractors unless said otherwise; random legal actions, resets included (plain Python gets drawn tables). *Plain
Python* is a loop over the tests' reference environments, the rules as one would write them without
the engine, whose observations are stacked into arrays. Steps are counted for each CPU second of the process, so other jobs on
the machine count little; ``--wall`` counts by the clock, for an idle machine.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from datetime import date
from itertools import cycle
from pathlib import Path

import numpy as np

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.envs.batch import BatchEngine, State
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import make_split, open_graph
from wordcraft_kg.graphs.graph_folder import OpenedGraph
from wordcraft_kg.graphs.tasks import make_tasks

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "envs"))
from reference_env import ReferenceEnv

SECONDS = 2.0


def rate(step: Callable[[], int], clock: Callable[[], float]) -> float:
    """Return units per second of a clock, given the units per call; best run out of three."""
    best = 0.0
    for _ in range(3):
        done, start = 0, clock()
        while (spent := clock() - start) < SECONDS / 3:
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


def plain(opened: OpenedGraph, num_envs: int) -> Callable[[], int]:
    world = World(opened, WordCraftConfig(num_distractors=8))
    # Drawn before, so that the time is that of the rules.
    drawn = BatchEngine(world, 8_192).reset()
    starts = cycle(zip(drawn.task.tolist(), drawn.table.tolist(), strict=True))
    rng = np.random.default_rng(0)

    def begun() -> ReferenceEnv:
        task, table = next(starts)
        return ReferenceEnv(world, task, world.without_nothing(table))

    envs = [begun() for _ in range(num_envs)]

    def run() -> int:
        for i, number in enumerate(rng.random(num_envs).tolist()):
            envs[i].step(int(number * len(envs[i].table)))
            if envs[i].outcome != "in_progress":
                envs[i] = begun()
        observations = [env.seen() for env in envs]
        for name in observations[0]:
            np.array([seen[name] for seen in observations])
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


def stored(book: str, rates: dict[str, float], path: Path) -> None:
    """Write steps per CPU second, with the day and the load at the end."""
    rows = [
        {
            "book": book,
            "row": name,
            "steps_per_cpu_second": round(value),
            "date": date.today().isoformat(),
            "load": round(os.getloadavg()[0], 1),
            "cores": os.cpu_count(),
        }
        for name, value in rates.items()
    ]
    write_atomically(path, "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", nargs="?", default="everyday")
    parser.add_argument("--wall", action="store_true", help="steps a second by the clock")
    parser.add_argument("--json", type=Path, help="file to write steps per CPU second to")
    given = parser.parse_args()
    if given.wall and given.json:
        parser.error("--json stores steps per CPU second; leave --wall out")
    clock = time.perf_counter if given.wall else time.process_time
    unit = "steps/s" if given.wall else "steps per CPU second"
    opened = open_graph(given.graph)

    start = clock()
    WordCraftEnv(opened, num_distractors=8)
    print(f"construction at depth 1   {1e3 * (clock() - start):6.1f} ms")
    start = clock()
    drawn = make_tasks(
        opened.graph, 4, make_split(opened.graph, opened.split.config), "train", limit=200, seed=1
    )
    print(f"a task of depth 4         {1e3 * (clock() - start) / len(drawn):6.2f} ms")

    rates = {"one": rate(single(opened), clock), "plain 1024": rate(plain(opened, 1_024), clock)}
    print(f"one environment           {rates['one']:12,.0f} {unit}")
    print(f"plain Python, 1,024       {rates['plain 1024']:12,.0f} {unit}")
    for num_envs in (128, 1_024, 8_192):
        run, state = batched(opened, num_envs)
        speed = rates[f"batched {num_envs}"] = rate(run, clock)
        print(
            f"batched, {num_envs:5,}            {speed:12,.0f} {unit}, {memory(state):.0f} bytes "
            f"each, {speed / rates['plain 1024']:.0f} times plain Python"
        )
    run, _ = batched(opened, 1_024, depth=3)
    rates["depth 3, batched 1024"] = rate(run, clock)
    print(f"batched, 1,024, depth 3   {rates['depth 3, batched 1024']:12,.0f} {unit}")
    if given.json:
        stored(opened.graph.name, rates, given.json)


if __name__ == "__main__":
    main()
