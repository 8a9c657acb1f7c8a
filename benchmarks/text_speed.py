"""Episodes a second of the environment for TRL, on one core.

    python benchmarks/text_speed.py everyday

A game of each row is played to its end: by the pairs of a plan, or by the first two items (*idle*).
Best of seven runs; CPU seconds, and wall seconds, which other processes lengthen.
"""

import argparse
import time

from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment, crafting_rows


def games(graph, depth, by_plan):
    """Return rows, each with the pairs to combine."""
    played = []
    environment = CraftingEnvironment()
    for row in crafting_rows(graph, part="train", depth=depth, distractors=8, tasks=1_000):
        pairs = [("1", "2")] * row["attempts"]
        if by_plan:
            environment.reset(**row)
            game = environment.talk.game
            plan = game.tasks.plans[game.task][0]
            pairs = [game.graph.labels(pair) for pair in game.graph.recipes[plan, :2].tolist()]
        played.append((row, pairs))
    return played


def rates(played):
    """Return games a second of CPU time and of wall time."""
    wall, cpu = time.perf_counter(), time.process_time()
    for row, pairs in played:
        environment = CraftingEnvironment()
        environment.reset(**row)
        for pair in pairs:
            environment.combine(*pair)
        environment.get_reward()
    return len(played) / (time.process_time() - cpu), len(played) / (time.perf_counter() - wall)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("graph", nargs="?", default="everyday")
    graph = parser.parse_args().graph
    for by_plan in (False, True):
        for depth in (1, 2):
            played = games(graph, depth, by_plan)
            cpu, wall = map(max, zip(*(rates(played) for _ in range(7)), strict=True))
            kind = "plan" if by_plan else "idle"
            print(f"depth {depth}, {kind}: {cpu:,.0f} by CPU time, {wall:,.0f} by wall time")
