"""The success of scripted players on all tasks of a part."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.agents.players import PlayerSuccess, knowledge_players, play_all, scorer_players
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.records import Record

if TYPE_CHECKING:
    from wordcraft_kg.models.links.folder import OpenedModel


class Baselines(Record):
    """Success of scripted players, a row for each number of distractors and player."""

    graph: str
    part: TaskPart
    depth: int
    draws: int
    seed: int
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
    """
    players = knowledge_players(opened.graph, opened.split.partial)
    if model is not None:
        name, trained = model
        named = scorer_players(opened.graph, trained.scorer, opened.triples(trained.kg))
        oracle = players.pop("recipe oracle")
        players |= {f"{name}, {kind}": player for kind, player in named.items()} | {"recipe oracle": oracle}
    rows = play_all(World(opened, config), players, distractors, draws=draws, seed=seed)
    return Baselines(graph, config.part, config.depth, draws, seed, rows)
