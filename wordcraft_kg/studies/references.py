"""Figures to compare with: what the reference pack has for a graph, what is measured now, and the user's own beside."""

from collections.abc import Iterator, Sequence
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
    opened: OpenedGraph, play: TaskPlay | OpenPlay, columns: Sequence[int] = DISTRACTORS, beside: Sequence[Path] = ()
) -> ReferenceTable:
    """Return the figures of the pack, of scripted players where it has none, and the user's own.

    Args:
        opened: graph and split, which does not matter for open-ended play.
        play: crafting tasks, or open-ended play.
        columns: numbers of distractors; open-ended play has the attempts of ``discover``.
        beside: folders and files of the user, see :func:`~wordcraft_kg.studies.result_readers.rows_beside`.

    Raises:
        ConfigError: as ``rows_beside``, or for a number out of range.
        GraphMismatchError: as ``rows_beside``.
        TaskError: if there are no such tasks.
    """
    is_open = isinstance(play, OpenPlay)
    columns = MARKS if is_open else columns
    pack = pack_of(opened.graph.hash, None if is_open else opened.split.hash)
    found = pack.rows_of(play, None if is_open else columns) if pack else ()
    own = rows_beside(opened, play, columns, beside)
    there = MARKS if is_open and found else [int(column) for row in found for column in row.figures]
    missing = [column for column in columns if column not in there]
    now = scripted_rows(opened, play, missing) if missing else ()
    return ReferenceTable(
        graph=PlayedGraph.of(opened),
        play=play,
        measure="entities known" if is_open else "success",
        columns=tuple(columns),
        pack=pack.title if pack else None,
        measured=tuple(missing),
        rows=in_order([*(found or now if is_open else _merged(found, now, columns)), *own]),
        literature=literature(["entities known", "new combinations"] if is_open else ["success"]),
    )


def open_play(opened: OpenedGraph, base: Sequence[str] | None = None) -> OpenPlay:
    """Return open-ended play of a graph from a base; None takes the graph's.

    Raises:
        ConfigError: if an entity of the base is unknown, or nothing can be made from the base.
    """
    return OpenPlay(opened.graph.labels(Discovery(opened.graph, base).base))


def scripted_rows(opened: OpenedGraph, play: TaskPlay | OpenPlay, columns: Sequence[int]) -> tuple[ReferenceRow, ...]:
    """Let the scripted players of ``evaluate-agent``, or those of ``discover``, play, and return a row for each."""
    rows = _task_rows(opened, play, columns) if isinstance(play, TaskPlay) else _open_rows(opened, play)
    return tuple(rows)


def _task_rows(opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]) -> Iterator[ReferenceRow]:
    config = WordCraftConfig(
        part=play.part, depth=play.depth, max_attempts=play.attempts, num_distractors=max(columns, default=0)
    )
    view = view_baselines(opened, opened.graph.name, config, columns, draws=DRAWS, seed=SEED)
    options = f"--part {play.part} --depth {play.depth} --distractors {','.join(map(str, columns))}"
    of = {(row.player, row.distractors): (row.success, row.low, row.high) for row in view.rows}
    for player in dict.fromkeys(row.player for row in view.rows):
        yield ReferenceRow(
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


def _open_rows(opened: OpenedGraph, play: OpenPlay) -> Iterator[ReferenceRow]:
    view, _ = view_discovery(opened.graph, _OPEN_PLAYERS, attempts=MARKS[-1], runs=RUNS, seed=SEED, base=play.base)
    for player, known in view.players.items():
        yield ReferenceRow(
            player=player,
            kind=_kind(player),
            measure="entities known",
            figures=figures_of({int(mark): (found.mean, found.low, found.high) for mark, found in known.items()}),
            origin="ours",
            source=f"wordcraft-kg discover {opened.graph.name} --base '{','.join(play.base)}'",
            play=play,
            interval="95 %, over runs",
            runs=RUNS,
            notes="knows the graph" if player in _ORACLES else "",
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
