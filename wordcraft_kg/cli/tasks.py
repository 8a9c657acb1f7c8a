"""``wordcraft-kg tasks``."""

from typing import TYPE_CHECKING

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.options import Graph
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.tasks import TaskListing

EXAMPLES = (
    "wordcraft-kg tasks everyday --depth 2 --distractors 4 --part test --limit 5",
    "wordcraft-kg tasks graphs/everyday --part train --seed 1 --json",
)


def tasks(
    graph: Graph = "everyday",
    *,
    depth: int = WordCraftConfig.depth,
    distractors: int = WordCraftConfig.num_distractors,
    part: TaskPart = WordCraftConfig.part,
    limit: int = 20,
    seed: int = 0,
    output: Output = Output(),
) -> None:
    """Count the tasks of a graph, and show some as an agent sees them, with all their plans.

    Args:
        depth: fewest attempts that solve a task, 1 to 5.
        distractors: entities on the table that no plan needs.
        part: train (all plans use train recipes only), test (each uses a test recipe), valid, or all.
        limit: number of tasks to show; 0 only counts them.
        seed: seed of the order in which tasks are shown, and of their tables.
    """
    from wordcraft_kg.envs.wordcraft import WordCraftEnv
    from wordcraft_kg.evaluation.tasks import view_tasks

    whole("limit", limit, 0, MAX_SIZE)
    whole("seed", seed, 0)
    env = WordCraftEnv(graph, part=part, depth=depth, num_distractors=distractors)
    view = view_tasks(env, limit, seed)
    output.result(view, _text(view))


def _text(view: "TaskListing") -> list[str]:
    of_part = "" if view.part == "all" else f" in the {view.part} part"
    known = "which is all" if view.complete else "drawn; there may be more"
    head = [("graph", view.graph), ("tasks", f"{view.tasks:,} of depth {view.depth}{of_part}, {known}")]
    if view.part != "all":
        drawn = "" if view.complete else " of those drawn"
        reason = "their plans belong to different parts"
        head.append(("mixed", f"{view.mixed:,}{drawn} belong to no part: {reason}"))
    text = [*aligned(head), *([] if view.shown else [f"none shown of {view.tasks:,}"])]
    for task in view.shown:
        plans = ["; ".join(f"{a} + {b} -> {result}" for a, b, result in plan) for plan in task.plans]
        rows = [
            ("  start", ", ".join(task.start)),
            ("  distractors", ", ".join(task.distractors) or "none"),
            ("  table", ", ".join(task.table)),
            *(("  plan", plan) for plan in plans),
        ]
        text += ["", task.goal, *aligned(rows)]
    return text
