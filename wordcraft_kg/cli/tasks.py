"""``wordcraft-kg tasks``."""

from typing import TYPE_CHECKING, Any

from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.errors import ConfigError
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.envs.wordcraft import WordCraftEnv

EXAMPLES = (
    "wordcraft-kg tasks everyday --depth 2 --distractors 4 --part test --limit 5",
    "wordcraft-kg tasks graphs/everyday --part train --seed 1 --json",
)


def tasks(
    graph: str = "everyday",
    *,
    depth: int = WordCraftConfig.depth,
    distractors: int = WordCraftConfig.num_distractors,
    part: TaskPart = WordCraftConfig.part,
    limit: int = 20,
    seed: int = 0,
    output: Output = Output(),
) -> None:
    """Count the tasks of a graph, and show some as an agent would see them, with all their plans.

    Args:
        graph: graph folder, recipe book or known book's name.
        depth: attempts that a task takes at least, 1 to 5.
        distractors: entities on the table that no plan needs.
        part: train (all plans use train recipes only), test (each uses a test recipe), valid, or all.
        limit: how many tasks to show; 0 only counts them.
        seed: of the order in which tasks are shown, and of their tables.
    """
    from wordcraft_kg.envs.wordcraft import WordCraftEnv

    for name, value in (("limit", limit), ("seed", seed)):
        if value < 0:
            raise ConfigError(f"--{name} {value}: expected 0 or more.")
    env = WordCraftEnv(graph, part=part, depth=depth, num_distractors=distractors)
    values = {
        "graph": env.world.graph.name,
        "depth": depth,
        "part": part,
        "tasks": len(env.tasks),
        "complete": env.tasks.is_complete,
        "mixed": env.tasks.mixed,
        "shown": _shown(env, limit, seed),
    }
    output.result(values, _text(values))


def _shown(env: "WordCraftEnv", limit: int, seed: int) -> list[dict[str, Any]]:
    import numpy as np

    names, nothing = env.world.graph.entities, env.world.nothing
    # One seed for the first episode only, as in training: with one for each, all tables would have like distractors.
    env.reset(seed=seed)
    shown = []
    for index in np.random.default_rng(seed).permutation(len(env.tasks))[:limit].tolist():
        observation, _ = env.reset(options={"task": index})
        task = env.task
        table = [names[entity] for entity in observation["table"].tolist() if entity != nothing]
        shown.append(
            {
                "goal": task.goal,
                "start": list(task.start),
                "distractors": sorted(set(table) - set(task.start)),
                "table": table,
                "plans": [[list(recipe) for recipe in plan] for plan in task.plans],
            }
        )
    return shown


def _text(values: dict[str, Any]) -> list[str]:
    part, count = values["part"], values["tasks"]
    of_part = "" if part == "all" else f" in the {part} part"
    known = "all there are" if values["complete"] else "drawn; there may be more"
    head = [
        ("graph", values["graph"]),
        ("tasks", f"{count:,} of depth {values['depth']}{of_part}, {known}"),
    ]
    if part != "all":
        came_up = "" if values["complete"] else " of those that came up"
        reason = "some of their plans belong to one, some to another"
        head.append(("mixed", f"{values['mixed']:,}{came_up} belong to no part: {reason}"))
    text = [*aligned(head), *([] if values["shown"] else [f"none shown of {count:,}"])]
    for task in values["shown"]:
        plans = ["; ".join(f"{a} + {b} -> {result}" for a, b, result in plan) for plan in task["plans"]]
        rows = [
            ("  start", ", ".join(task["start"])),
            ("  distractors", ", ".join(task["distractors"]) or "none"),
            ("  table", ", ".join(task["table"])),
            *(("  plan", plan) for plan in plans),
        ]
        text += ["", task["goal"], *aligned(rows)]
    return text
