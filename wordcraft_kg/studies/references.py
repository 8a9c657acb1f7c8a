"""Figures to compare with: what the reference pack has for a graph, what is measured now, and the user's own beside."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from wordcraft_kg.agents.discovery import MARKS
from wordcraft_kg.base.records import Record
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.evaluation.discovery import view_discovery
from wordcraft_kg.evaluation.players import view_baselines
from wordcraft_kg.evaluation.reference import (
    Kind,
    Measure,
    OpenPlay,
    PlayedGraph,
    ReferenceRow,
    TaskPlay,
    figures_of,
    literature,
    pack_of,
)
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.reports.pages import render_page
from wordcraft_kg.studies.result_readers import DRAWS, SEEN, rows_beside

DISTRACTORS = (1, 2, 8)
"""Numbers of distractors of the pack: the paper's."""
SEED, RUNS = 0, 100
"""Of scripted players; those of ``evaluate-agent`` and ``discover`` by default."""
_CHANCE = ("random", "random, distinct", "random-no-repeat")
_ORACLES = ("recipe oracle", "greedy", "empowerment")
_OPEN_PLAYERS = ("random", "random-no-repeat", "greedy", "empowerment")
KINDS: tuple[Kind, ...] = ("chance", "knowledge graph", "oracle", "agent", "people", "language model", "other")
"""In the order of a table."""


class ReferenceTable(Record, frozen=True):
    """Figures of players under one condition, and those of the literature.

    Attributes:
        measure: kind of the figures of ``rows``.
        columns: numbers of distractors, or of attempts in open-ended play.
        pack: title of the file of the pack that has this graph and split; None if there is none.
        measured: columns that the pack does not have, for which scripted players were measured now.
        rows: measured with this package on this graph and split, by kind of player.
        literature: of others, in other environments: to be compared with care, or not at all.
        out: file of the page, if it was written.
    """

    graph: PlayedGraph
    play: TaskPlay | OpenPlay
    measure: Measure
    columns: tuple[int, ...]
    pack: str | None
    measured: tuple[int, ...]
    rows: tuple[ReferenceRow, ...]
    literature: tuple[ReferenceRow, ...]
    out: str | None = None


def view_references(
    opened: OpenedGraph, play: TaskPlay, columns: Sequence[int] = DISTRACTORS, beside: Sequence[Path] = ()
) -> ReferenceTable:
    """Return success on crafting tasks: the pack's, scripted players' where it has none, and the user's own.

    Args:
        opened: graph and split.
        play: the tasks.
        columns: numbers of distractors.
        beside: folders and files of the user, see :func:`~wordcraft_kg.studies.result_readers.rows_beside`.

    Raises:
        ConfigError: as ``rows_beside``, or for a number out of range.
        GraphMismatchError: as ``rows_beside``.
        TaskError: if there are no such tasks.
    """
    pack = pack_of(opened.graph.hash, opened.split.hash)
    found = pack.rows_of(play, columns) if pack else ()
    own = rows_beside(opened, play, columns, beside)
    missing = [column for column in columns if not any(str(column) in row.figures for row in found)]
    now = scripted_rows(opened, play, missing) if missing else ()
    return ReferenceTable(
        graph=PlayedGraph.of(opened),
        play=play,
        measure="success",
        columns=tuple(columns),
        pack=pack.title if pack else None,
        measured=tuple(missing),
        rows=in_order([*_merged(found, now, columns), *own]),
        literature=literature(["success"]),
    )


def view_open_references(
    opened: OpenedGraph, base: Sequence[str] | None = None, beside: Sequence[Path] = ()
) -> ReferenceTable:
    """Return entities known after n attempts of open-ended play: the pack's, or scripted players', and the user's own.

    Args:
        opened: graph and split, which does not matter here.
        base: entities known at the start; None takes the graph's.
        beside: folders and files of the user.

    Raises:
        ConfigError: for an unknown entity of the base, or one from which nothing can be made; else as ``rows_beside``.
    """
    play = open_play(opened, base)
    own = rows_beside(opened, play, (), beside)
    pack = pack_of(opened.graph.hash, None)
    found = pack.rows_of(play) if pack else ()
    return ReferenceTable(
        graph=PlayedGraph.of(opened),
        play=play,
        measure="entities known",
        columns=MARKS,
        pack=pack.title if pack else None,
        measured=() if found else MARKS,
        rows=in_order([*(found or open_rows(opened, play)), *own]),
        literature=literature(["entities known", "new combinations"]),
    )


def open_play(opened: OpenedGraph, base: Sequence[str] | None = None) -> OpenPlay:
    """Return open-ended play of a graph from a base; None takes the graph's.

    Raises:
        ConfigError: if an entity of the base is unknown, or nothing can be made from the base.
    """
    return OpenPlay(opened.graph.labels(Discovery(opened.graph, base).base))


def scripted_rows(opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]) -> tuple[ReferenceRow, ...]:
    """Let the players of ``evaluate-agent`` play, and return a row for each."""
    config = WordCraftConfig(
        part=play.part, depth=play.depth, max_attempts=play.attempts, num_distractors=max(columns, default=0)
    )
    view = view_baselines(opened, opened.graph.name, config, columns, draws=DRAWS, seed=SEED)
    options = f"--part {play.part} --depth {play.depth} --distractors {','.join(map(str, columns))}"
    players = dict.fromkeys(row.player for row in view.rows)
    of = {(row.player, row.distractors): (row.success, row.low, row.high) for row in view.rows}
    return tuple(
        ReferenceRow(
            player=player,
            kind=_kind(player),
            measure="success",
            figures=figures_of({column: of[player, column] for column in columns}),
            origin="ours",
            source=f"wordcraft-kg evaluate-agent {opened.graph.name} {options}",
            play=play,
            interval=view.intervals,
            tasks=view.tasks,
            draws=view.draws,
            notes=SEEN if player.startswith("full KG") else "",
        )
        for player in players
    )


def open_rows(opened: OpenedGraph, play: OpenPlay) -> tuple[ReferenceRow, ...]:
    """Let the players of ``discover`` play, and return a row for each."""
    view, _ = view_discovery(opened.graph, _OPEN_PLAYERS, attempts=MARKS[-1], runs=RUNS, seed=SEED, base=play.base)
    return tuple(
        ReferenceRow(
            player=player,
            kind=_kind(player),
            measure="entities known",
            figures=figures_of({mark: (found.mean, found.low, found.high) for mark, found in known.items()}),
            origin="ours",
            source=f"wordcraft-kg discover {opened.graph.name} --base '{','.join(play.base)}'",
            play=play,
            interval="95 %, over runs",
            runs=RUNS,
            notes="knows the graph" if player in _ORACLES else "",
        )
        for player, by_mark in view.players.items()
        for known in [{int(mark): found for mark, found in by_mark.items()}]
    )


def in_order(rows: Sequence[ReferenceRow]) -> tuple[ReferenceRow, ...]:
    """Return rows by kind of player, those of a kind in the order in which they come, the user's own last."""
    return tuple(sorted(rows, key=lambda row: (KINDS.index(row.kind), row.origin == "beside")))


def _merged(found: Sequence[ReferenceRow], now: Sequence[ReferenceRow], columns: Sequence[int]) -> list[ReferenceRow]:
    """Return the pack's rows with the figures that were measured now, in the order of the columns."""
    more = {row.player: row for row in now}
    rows = []
    for row in found:
        figures = row.figures | (more.pop(row.player).figures if row.player in more else {})
        rows.append(msgspec.structs.replace(row, figures=figures).at(columns))
    return rows + list(more.values())


def _kind(player: str) -> Kind:
    return "chance" if player in _CHANCE else "oracle" if player in _ORACLES else "knowledge graph"


def reference_page(view: ReferenceTable) -> str:
    """Return the page of a table."""
    return render_page("wordcraft_kg.studies/reference_page.html.j2", report=view)
