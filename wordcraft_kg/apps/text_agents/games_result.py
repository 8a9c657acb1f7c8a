"""The result of games that a server has kept, where players chose themselves what they played."""

from itertools import product
from pathlib import Path

import msgspec

from wordcraft_kg.apps.text_agents.evaluation import chosen_tasks, result_of_tasks, result_of_worlds
from wordcraft_kg.apps.text_agents.games_file import read_games
from wordcraft_kg.apps.text_agents.records import PlayedTask, PlayedWorld, WordsResult
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph


def read_games_result(path: Path, opened: OpenedGraph) -> WordsResult:
    """Read the games of ``wordcraft-kg mcp --out`` as a result.

    A task that was played again counts as it was played first. Every task has to be there: a figure over tasks that a
    player has chosen says nothing.

    Args:
        path: the file.
        opened: graph and split of its games.

    Raises:
        ArtefactError: if the file is not of this kind or damaged.
        GraphMismatchError: if its games are of another graph or split.
        ConfigError: if a task is missing.
    """
    header, played = read_games(path)
    settings, player = header.settings, header.player
    for what, its, own in (
        ("graph", settings.graph_hash, opened.graph.hash),
        ("split", settings.split_hash, opened.split.hash),
    ):
        if its != own:
            raise GraphMismatchError(f"'{path}' holds games on the {what} {its[:12]}, and this is {own[:12]}.")
    worlds = [one for one in played if isinstance(one, PlayedWorld)]
    if settings.part is None or settings.depth is None or settings.distractors is None:
        if not worlds:
            raise ConfigError(f"'{path}' holds no game that is over.")
        return result_of_worlds(player, msgspec.structs.replace(settings, draws=len(worlds)), worlds)
    first: dict[tuple[int, int], PlayedTask] = {}
    for one in played:
        if isinstance(one, PlayedTask):
            first.setdefault((one.task, one.draw), one)
    config = WordCraftConfig(
        part=settings.part,
        depth=settings.depth,
        num_distractors=settings.distractors,
        max_attempts=settings.attempts,
    )
    world = World(opened, config)
    tasks = chosen_tasks(world, settings.tasks).tolist()
    draws = 1 + max((draw for _, draw in first), default=0)
    needed = set(product(tasks, range(draws)))
    if set(first) != needed:
        there = len(needed & set(first))
        raise ConfigError(
            f"'{path}' holds {there:,} of the {len(needed):,} games of its {settings.part} tasks: expected each task "
            "with each draw. A player that chooses its tasks has no figure."
        )
    return result_of_tasks(player, msgspec.structs.replace(settings, draws=draws), world, [*first.values()])
