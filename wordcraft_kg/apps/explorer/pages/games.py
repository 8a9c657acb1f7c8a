"""The list of tables with recorded games of people, language models and other players."""

from collections.abc import Iterator
from operator import attrgetter
from typing import Any

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState, Paging, num_pages, paging
from wordcraft_kg.base.records import Record
from wordcraft_kg.evaluation.reference import TableGame

TABLES_A_PAGE = 100


class GamesState(PageState):
    """Page settings: the page in the list.

    Attributes:
        page: page number.
    """

    page: int = 1


class ListedTable(Record):
    """A table with recorded games.

    Attributes:
        solved: names of the players that made the goal.
        not_solved: names of the other players.
        settings: settings of the episode page that show the table, with the task if the graph has
            it.
    """

    solved: tuple[str, ...]
    not_solved: tuple[str, ...]
    settings: dict[str, Any]


class GameTables(Record):
    """A page in the list of tables with recorded games.

    Attributes:
        paging: which tables are on this page.
        tables: the tables on this page, those with most games first.
    """

    paging: Paging
    tables: tuple[ListedTable, ...]


def list_games(explored: Explored, state: GamesState) -> GameTables:
    """Return the page's values.

    Raises:
        ConfigError: if the list has no such page.
    """
    tables = sorted(explored.games.values(), key=len, reverse=True)
    shown = paging(len(tables), state.page, TABLES_A_PAGE)
    return GameTables(shown, tuple(_listed(explored, games) for games in tables[shown.rows]))


def _listed(explored: Explored, games: list[TableGame]) -> ListedTable:
    graph = explored.opened.graph
    # All games of a group have the same goal and table.
    first_game = games[0]
    settings: dict[str, Any] = {
        "goal": first_game.goal,
        "table": first_game.table,
        "part": first_game.part,
        "depth": first_game.depth,
    }
    config = explored.settings_of(explored.tasks_of(None), settings["part"], settings["depth"])
    tasks = explored.plain_world(config).tasks
    # Starting ingredients are padded with num_entities.
    have = {graph.num_entities, *map(graph.id_of, first_game.table)}
    for task in np.flatnonzero(tasks.goals == graph.id_of(first_game.goal)).tolist():
        # Of several tasks that the table allows, the last one: the table does not tell which was
        # played.
        if have.issuperset(tasks.starts[task].tolist()):
            settings["task"] = task
            settings["distractors"] = len(first_game.table) - len(tasks[task].start)
    return ListedTable(
        solved=tuple(game.player for game in games if game.success),
        not_solved=tuple(game.player for game in games if not game.success),
        settings=settings,
    )


def _exported(explored: Explored) -> Iterator[GamesState]:
    pages = num_pages(len(explored.games), TABLES_A_PAGE)
    yield from (GamesState(page) for page in range(1, pages + 1))


PAGE = Page(
    "games", GamesState, list_games, title="Games", exported=_exported, is_there=attrgetter("games")
)
