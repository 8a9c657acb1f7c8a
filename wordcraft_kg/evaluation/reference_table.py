"""Tables of results: published ones, scripted players measured now, and the user's own."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import get_args

import msgspec

from wordcraft_kg.agents.discovery import MARKS
from wordcraft_kg.agents.players import FEWEST_USES, is_words_player
from wordcraft_kg.base.records import Record
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.evaluation.discovery import view_discovery
from wordcraft_kg.evaluation.players import view_baselines
from wordcraft_kg.evaluation.reference import (
    Estimate,
    Kind,
    Measure,
    OpenPlay,
    PlayedGraph,
    ReferenceRow,
    TaskPlay,
    literature,
    metrics_of,
    pack_of,
)
from wordcraft_kg.evaluation.result_readers import (
    READERS,
    SEEN,
    ResultReader,
    external_rows,
    is_model,
)
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.scorers.folder import MODEL

DISTRACTORS = (1, 2, 8)
"""Distractor counts in the published results, as in the paper."""
_SEED = 0
RUNS = 100
"""Seed and run count for scripted players, the defaults in ``evaluate-agent`` and ``discover``."""
_CHANCE = ("random", "random, distinct", "random-no-repeat", FEWEST_USES)
# Players that know all recipes, those of the test tasks too.
_ORACLES = ("recipe oracle", "greedy", "empowerment")
# Players that need no model.
_OPEN_PLAYERS = ("random", "random-no-repeat", "greedy", "empowerment")
# The order of the rows: from chance to agents and people.
_KINDS: tuple[Kind, ...] = get_args(Kind)
_ALONE = ("u+v, self edges dropped", "w, best pair")
"""A scorer's players in the table, see :func:`~wordcraft_kg.agents.players.scorer_players`."""


class ReferenceTable(Record, frozen=True):
    """A table that compares players under one condition, with results from the literature.

    Attributes:
        graph: graph and split of `rows`.
        play: crafting tasks or open-ended play.
        measure: unit of the results in `rows`.
        columns: distractor counts, or attempt counts in open-ended play.
        pack: title of the reference pack with this graph and split; None without one.
        measured: columns without published results, for which scripted players were measured now.
        rows: results on this graph and split, by player kind.
        literature: results from different environments, not directly comparable.
        out: the written page; None without a page.
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
    opened: OpenedGraph,
    play: TaskPlay | OpenPlay,
    columns: Sequence[int] = DISTRACTORS,
    external: Sequence[Path] = (),
) -> ReferenceTable:
    """Return a table of published results, the user's results, and scripted players.

    Scripted players are measured now for columns without published results.

    Args:
        opened: graph and split; open-ended play ignores the split.
        play: crafting tasks or open-ended play.
        columns: distractor counts; open-ended play has the attempt counts of ``discover`` instead.
        external: folders and files with the user's results.

    Returns:
        The table.

    Raises:
        ConfigError: if a path has no known format or results on other tasks, or the graph has too
            few entities for so many distractors.
        GraphMismatchError: if a result is of another graph or split.
        TaskError: if the split has no such tasks.
        ArtefactError: if a result is damaged.
    """
    measures: list[Measure] = ["success"]
    split: str | None = opened.split.hash
    if isinstance(play, OpenPlay):
        # All recipes take part, so results do not depend on the split.
        split = None
        columns = MARKS
        measures = ["entities known", "new combinations"]
    pack = pack_of(opened.graph.hash, split)
    known = pack.rows_of(play, columns) if pack else ()
    # The user's paths come first, because a wrong one should fail before minutes of play.
    own = external_rows(opened, play, columns, external)
    published: set[str] = set()
    for row in known:
        published |= row.figures.keys()
    missing = [column for column in columns if str(column) not in published]
    now = scripted_rows(opened, play, missing) if missing else ()
    return ReferenceTable(
        graph=PlayedGraph.of(opened),
        play=play,
        measure=measures[0],
        columns=tuple(columns),
        pack=pack.title if pack else None,
        measured=tuple(missing),
        rows=in_order([*_merged(known, now, columns), *own]),
        literature=literature(measures),
    )


def open_play(opened: OpenedGraph, base: Sequence[str] | None = None) -> OpenPlay:
    """Return open-ended play from base entities.

    Args:
        opened: the graph.
        base: labels known at the start; None for the graph's base.

    Raises:
        ConfigError: if the base makes nothing.
    """
    return OpenPlay(opened.graph.labels(Discovery(opened.graph, base).base))


def scripted_rows(
    opened: OpenedGraph, play: TaskPlay | OpenPlay, columns: Sequence[int]
) -> tuple[ReferenceRow, ...]:
    """Evaluate scripted players now.

    Args:
        opened: graph and split.
        play: crafting tasks or open-ended play.
        columns: distractor counts; open-ended play always has the attempt counts of ``discover``.

    Returns:
        A row for each player.

    Raises:
        TaskError: if the split has no such tasks.
        ConfigError: if the graph has too few entities for so many distractors, or nothing can be
            made from the base.
    """
    if isinstance(play, TaskPlay):
        return tuple(_task_rows(opened, play, columns))
    return tuple(_open_rows(opened, play))


def scorer_rows(
    opened: OpenedGraph, play: TaskPlay, columns: Sequence[int], name: str, model: Model
) -> tuple[ReferenceRow, ...]:
    """Evaluate a scorer alone, by u + v and, if the scorer has recipe scores, by w.

    Args:
        opened: graph and split.
        play: the tasks.
        columns: distractor counts.
        name: the model's name, with which the rows' names begin, such as ``name, w, best pair``.
        model: the model with the scorer.

    Returns:
        A row for each way to play.

    Raises:
        TaskError: if the split has no such tasks.
        ConfigError: if the graph has too few entities for so many distractors, or the model needs
            score tables that would be too large.
        GraphMismatchError: if the model belongs to another graph.
        LeakError: if a cross-fitted model has seen all recipes of a task's plan.
    """
    rows = _task_rows(opened, play, columns, (name, model))
    notes = {"full": SEEN, "none": "learned no recipe of this graph"}.get(model.kg, "")
    players = [f"{name}, {player}" for player in _ALONE]
    return tuple(msgspec.structs.replace(row, notes=notes) for row in rows if row.player in players)


def _own_scorers(
    paths: Sequence[Path], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> Sequence[ReferenceRow]:
    models = [(path.name, open_model(path, opened.source)) for path in paths]
    rows: list[ReferenceRow] = []
    for name, model in models:
        rows += scorer_rows(opened, play, columns, name, model)
    return [msgspec.structs.replace(row, origin="external") for row in rows]


# Here and not beside the reader of agents, because scripted players measure a scorer.
READERS["scorers"] = ResultReader(MODEL, is_model, _own_scorers)


def _task_rows(
    opened: OpenedGraph,
    play: TaskPlay,
    columns: Sequence[int],
    model: tuple[str, Model] | None = None,
) -> Iterator[ReferenceRow]:
    config = WordCraftConfig(
        part=play.part,
        depth=play.depth,
        max_attempts=play.attempts,
        # The largest table: a graph that is too small for it fails before anything is played.
        num_distractors=max(columns, default=0),
    )
    view = view_baselines(opened, opened.graph.name, config, columns, model, seed=_SEED)
    listed = ",".join(map(str, columns))
    options = f"--part {play.part} --depth {play.depth} --distractors {listed}"
    if model:
        options += f" --scorer {model[0]}"
    # Rows of a group of goals have no place in a table with one result for each count.
    estimates: dict[str, dict[int, Estimate]] = {}
    by_plan: dict[str, dict[int, float]] = {}
    for row in view.rows:
        if not row.goals:
            estimate = (row.success, row.low, row.high)
            estimates.setdefault(row.player, {})[row.distractors] = estimate
            by_plan.setdefault(row.player, {})[row.distractors] = row.by_plan
    for player, values in estimates.items():
        yield ReferenceRow(
            player=player,
            kind=_kind(player),
            measure="success",
            figures=metrics_of(values, by_plan[player]),
            origin="ours",
            source=f"wordcraft-kg evaluate-agent {opened.graph.name} {options}",
            play=play,
            interval=view.intervals,
            tasks=view.tasks,
            distractor_seeds=view.distractor_seeds,
            notes=SEEN if player.startswith("full KG") else "",
        )


def _open_rows(opened: OpenedGraph, play: OpenPlay) -> Iterator[ReferenceRow]:
    view, _ = view_discovery(
        opened.graph, _OPEN_PLAYERS, attempts=MARKS[-1], runs=RUNS, seed=_SEED, base=play.base
    )
    for player, known in view.players.items():
        values: dict[int, Estimate] = {
            int(mark): (at.mean, at.low, at.high) for mark, at in known.items()
        }
        yield ReferenceRow(
            player=player,
            kind=_kind(player),
            measure="entities known",
            figures=metrics_of(values),
            origin="ours",
            source=f"wordcraft-kg discover {opened.graph.name} --base '{','.join(play.base)}'",
            play=play,
            interval="95 %, over runs",
            runs=RUNS,
            notes="knows the graph" if player in _ORACLES else "",
        )


def in_order(rows: Sequence[ReferenceRow]) -> tuple[ReferenceRow, ...]:
    """Sort table rows by player kind, with the user's results last in each kind."""
    return tuple(sorted(rows, key=lambda row: (_KINDS.index(row.kind), row.origin == "external")))


def _merged(
    known: Sequence[ReferenceRow], now: Sequence[ReferenceRow], columns: Sequence[int]
) -> list[ReferenceRow]:
    more = {row.player: row for row in now}
    rows = []
    for row in known:
        # A player with published results keeps its row, and gets the columns measured now.
        measured = more.pop(row.player).figures if row.player in more else {}
        figures = row.figures | measured
        rows.append(msgspec.structs.replace(row, figures=figures).at(columns))
    return rows + list(more.values())


def _kind(player: str) -> Kind:
    kinds: dict[str, Kind] = dict.fromkeys(_CHANCE, "chance")
    if is_words_player(player):
        return "words"
    if player.endswith(_ALONE):
        return "scorer"
    return kinds.get(player, "oracle" if player in _ORACLES else "knowledge graph")
