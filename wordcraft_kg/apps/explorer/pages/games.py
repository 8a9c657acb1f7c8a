"""The list of tables with recorded games of people, language models and other players."""

from collections.abc import Iterator
from operator import attrgetter
from typing import Any

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, Paging, State, paging
from wordcraft_kg.base.records import Record
from wordcraft_kg.evaluation.result_readers import TableGame

TABLES_A_PAGE = 100


class Games(State):
    """Page settings: the page in the list."""

    page: int = 1


class ListedTable(Record):
    """A table with recorded games; ``settings`` are those of the episode page."""

    solved: tuple[str, ...]
    not_solved: tuple[str, ...]
    settings: dict[str, Any]


class GameTables(Record):
    """A page in the list of tables with recorded games, the tables with most games first."""

    paging: Paging
    tables: tuple[ListedTable, ...]


def list_games(explored: Explored, state: Games) -> GameTables:
    """Return the page's values."""
    tables = sorted(explored.games.values(), key=len, reverse=True)
    shown = paging(len(tables), state.page, TABLES_A_PAGE)
    return GameTables(shown, tuple(_listed(explored, games) for games in tables[shown.rows]))


def _listed(explored: Explored, games: list[TableGame]) -> ListedTable:
    one, graph = games[0], explored.opened.graph
    settings: dict[str, Any] = {
        "goal": one.goal,
        "table": one.table,
        "part": one.part,
        "depth": one.depth,
    }
    config = explored.settings_of(explored.tasks_of(None), settings["part"], settings["depth"])
    tasks, have = (
        explored.plain_world(config).tasks,
        {graph.num_entities, *map(graph.id_of, one.table)},
    )
    for task in np.flatnonzero(tasks.goals == graph.id_of(one.goal)).tolist():
        if have.issuperset(tasks.starts[task].tolist()):
            settings |= {"task": task, "distractors": len(one.table) - len(tasks[task].start)}
    solved, not_solved = (
        tuple(one.player for one in games if one.success == made) for made in (True, False)
    )
    return ListedTable(solved, not_solved, settings)


def _exported(explored: Explored) -> Iterator[Games]:
    yield from (Games(page) for page in range(1, 1 + -(-len(explored.games) // TABLES_A_PAGE)))


PAGE = Page(
    "games", Games, list_games, title="Games", exported=_exported, is_there=attrgetter("games")
)
