"""The success of scripted players on all tasks of a part."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.agents.players import PlayerSuccess, knowledge_players, play_all, scorer_players
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.models.links.folder import OpenedModel


class Baselines(Record):
    """Success of scripted players, a row for each number of distractors and player.

    Attributes:
        tasks: number of tasks; every player plays each of them ``draws`` times with each number of distractors.
        intervals: what the intervals of the rows are.
    """

    graph: str
    part: TaskPart
    depth: int
    tasks: Count
    draws: Count
    seed: int
    intervals: str
    rows: tuple[PlayerSuccess, ...]


def view_baselines(
    opened: OpenedGraph,
    graph: str,
    config: WordCraftConfig,
    distractors: Sequence[int],
    model: "tuple[str, OpenedModel] | None" = None,
    *,
    draws: int = 5,
    seed: int = 0,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> Baselines:
    """Let the players of the reference table play, and those of a model if one is given.

    Args:
        opened: graph and split.
        graph: the graph as it was named by the user.
        config: part and depth of the tasks.
        distractors: numbers of distractors.
        model: name of a link predictor, and the predictor.
        draws: draws of distractors for each task.
        seed: seed of the draws and of ties.
        progress: see :func:`~wordcraft_kg.agents.players.play_all`.
    """
    players = knowledge_players(opened.split)
    world = World(opened, config)
    if model is not None:
        name, trained = model
        tasks = world.tasks if config.part in ("train", "all") else None
        named = scorer_players(opened.graph, trained.scorer, trained.observed, tasks)
        oracle = players.pop("recipe oracle")
        players |= {f"{name}, {kind}": player for kind, player in named.items()} | {"recipe oracle": oracle}
    rows = play_all(world, players, distractors, draws=draws, seed=seed, progress=progress)
    return Baselines(
        graph=graph,
        part=config.part,
        depth=config.depth,
        tasks=len(world.tasks),
        draws=draws,
        seed=seed,
        intervals="95 %, bootstrap over tasks",
        rows=rows,
    )
