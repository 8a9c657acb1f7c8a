"""``wordcraft-kg tasks``."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.wording import quoted
from wordcraft_kg.cli.console import Output, aligned, lines_of
from wordcraft_kg.cli.options import Graph
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import TaskListing

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
    """Count the tasks of a graph, and show examples with tables and all plans.

    Args:
        depth: recipes in the shortest plan, 1 to 5.
        distractors: distractors on the table.
        part: train (all plans use train recipes only), test (each plan uses a test recipe), valid,
            or all.
        limit: tasks to show; with 0, only count.
        seed: seed for the order and the tables of the examples.
    """
    from wordcraft_kg.envs.wordcraft import WordCraftEnv
    from wordcraft_kg.evaluation.books import view_tasks

    # Before the search for tasks, which takes long at great depths.
    whole("limit", limit, 0, MAX_SIZE)
    whole("seed", seed, 0)
    env = WordCraftEnv(graph, part=part, depth=depth, num_distractors=distractors)
    view = view_tasks(env, limit, seed)
    output.result(view, _text(view))


def _text(view: "TaskListing") -> Iterator[str]:
    # Counts as names and values; the examples follow in a form of their own.
    counts = {name: getattr(view, name) for name in view.__struct_fields__ if name != "shown"}
    yield from lines_of(counts)
    for task in view.shown:
        rows = []
        for name in ("start", "distractors", "table"):
            rows.append((f"  {name}", ", ".join(map(quoted, getattr(task, name))) or "none"))
        for plan in task.plans:
            steps = [f"{first} + {second} -> {result}" for first, second, result in plan]
            rows.append(("  plan", "; ".join(steps)))
        yield from ("", task.goal, *aligned(rows))
