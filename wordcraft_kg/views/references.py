"""Figures to compare with: what the reference pack has for a graph, what is measured now, and the user's own beside."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from wordcraft_kg.agents.agent_folder import OpenedAgent, open_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.people.protocol import HUMAN_FORMAT
from wordcraft_kg.agents.people.session_file import Session, read_session
from wordcraft_kg.agents.people.study import STUDY_FILE
from wordcraft_kg.agents.people.study_folder import read_study
from wordcraft_kg.artefacts import what_is
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.envs.world import World
from wordcraft_kg.errors import ConfigError, GraphMismatchError
from wordcraft_kg.experiments.reference import (
    MARKS,
    TRAINED_WITH,
    Estimate,
    Kind,
    Measure,
    OpenPlay,
    Origin,
    ReferenceRow,
    TaskPlay,
    figures_of,
    literature,
    pack_of,
    play_of,
)
from wordcraft_kg.experiments.results import PlayedGraph
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.progress import steps
from wordcraft_kg.records import Record
from wordcraft_kg.runs.record import RUN_FILE
from wordcraft_kg.runs.seeds import run_folders
from wordcraft_kg.statistics import crossed_bootstrap
from wordcraft_kg.views.agents import Groups, can_play, group_agents
from wordcraft_kg.views.baselines import view_baselines
from wordcraft_kg.views.discovery import view_discovery
from wordcraft_kg.views.people import view_people
from wordcraft_kg.wording import counted

DISTRACTORS = (1, 2, 8)
"""Numbers of distractors of the pack: the paper's."""
DRAWS, SEED, RUNS = 5, 0, 100
"""Of scripted players; those of ``baselines`` and ``discover`` by default."""
CHANCE = ("random", "random, distinct", "random-no-repeat")
ORACLES = ("recipe oracle", "greedy", "empowerment")
OPEN_PLAYERS = ("random", "random-no-repeat", "greedy", "empowerment")
SEEN = "knows the recipes of the test tasks"
KINDS: tuple[Kind, ...] = ("chance", "knowledge graph", "oracle", "agent", "people", "language model", "other")
"""In the order of a table."""
NO_RESULT = ("seed", "graph", "scorer", "threads", "device", "log_every", "eval_every", "checkpoint_every")
SAID = ("steps", "distractors")
"""Settings of a training that its figures do not depend on, and those that a row says in other words."""
OVER_SEEDS = "95 %, bootstrap over seeds and tasks"
UNDERSTOOD = (
    "a run folder of `train-agent` or a folder of its seeds, a folder of `study serve`, or a file of "
    "`play --protocol paper`"
).replace("`", "'")


class ReferenceTable(Record, frozen=True):
    """Figures of players under one condition, and those of the literature.

    Attributes:
        graph: graph and split that ``rows`` are of.
        play: what was played.
        measure: what the figures of ``rows`` are.
        columns: numbers of distractors, or of attempts in open-ended play.
        pack: title of the file of the pack that has this graph and split; None if there is none.
        measured: columns that the pack does not have, so that scripted players were measured now.
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


def played_graph(opened: OpenedGraph) -> PlayedGraph:
    """Return which graph and split these are."""
    graph, split = opened.graph, opened.split
    return PlayedGraph(graph.name, graph.hash, split.config.kind, split.config.seed, split.hash)


def view_references(
    opened: OpenedGraph, play: TaskPlay, columns: Sequence[int] = DISTRACTORS, beside: Sequence[Path] = ()
) -> ReferenceTable:
    """Return success on crafting tasks: the pack's, scripted players' where it has none, and the user's own.

    Args:
        opened: graph and split.
        play: the tasks.
        columns: numbers of distractors.
        beside: folders and files of the user: see :data:`UNDERSTOOD`.

    Raises:
        ConfigError: if a folder or file is nothing known, or of other tasks; or for a number out of range.
        GraphMismatchError: if it is of another graph or split.
        TaskError: if there are no such tasks.
    """
    pack = pack_of(opened.graph.hash, opened.split.hash)
    found = pack.rows_of(play, columns) if pack else ()
    own = _beside(opened, play, columns, beside)
    missing = [column for column in columns if not any(str(column) in row.figures for row in found)]
    now = scripted_rows(opened, play, missing) if missing else ()
    return ReferenceTable(
        graph=played_graph(opened),
        play=play,
        measure="success",
        columns=tuple(columns),
        pack=pack.title if pack else None,
        measured=tuple(missing),
        rows=in_order([*_merged(found, now, columns), *own]),
        literature=literature(["success"]),
    )


def view_open_references(opened: OpenedGraph, base: Sequence[str] | None = None) -> ReferenceTable:
    """Return entities known after n attempts of open-ended play: the pack's, or scripted players'.

    Args:
        opened: graph and split; the split does not matter here.
        base: entities known at the start; None takes the graph's.

    Raises:
        ConfigError: if an entity of the base is unknown, or nothing can be made from the base.
    """
    play = open_play(opened, base)
    pack = pack_of(opened.graph.hash, None)
    found = pack.rows_of(play) if pack else ()
    return ReferenceTable(
        graph=played_graph(opened),
        play=play,
        measure="entities known",
        columns=MARKS,
        pack=pack.title if pack else None,
        measured=() if found else MARKS,
        rows=in_order(found or open_rows(opened, play)),
        literature=literature(["entities known", "new combinations"]),
    )


def open_play(opened: OpenedGraph, base: Sequence[str] | None = None) -> OpenPlay:
    """Return open-ended play of a graph from a base; None takes the graph's.

    Raises:
        ConfigError: if an entity of the base is unknown, or nothing can be made from the base.
    """
    return OpenPlay(opened.graph.labels(Discovery(opened.graph, base).base))


def scripted_rows(opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]) -> tuple[ReferenceRow, ...]:
    """Let the players of ``baselines`` play, and return a row for each."""
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
            source=f"wordcraft-kg baselines {opened.graph.name} {options}",
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
    view, _ = view_discovery(opened.graph, OPEN_PLAYERS, attempts=MARKS[-1], runs=RUNS, seed=SEED, base=play.base)
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
            notes="knows the graph" if player in ORACLES else "",
        )
        for player, by_mark in view.players.items()
        for known in [{int(mark): found for mark, found in by_mark.items()}]
    )


def agent_rows(
    groups: Groups, opened: OpenedGraph, play: TaskPlay, columns: Sequence[int], origin: Origin
) -> tuple[ReferenceRow, ...]:
    """Let agents play greedily, as ``compare-agents`` does, and return a row for each agent.

    Args:
        groups: runs by agent, on this graph and split.
        opened: the graph and split.
        play: the tasks.
        columns: numbers of distractors; those that a policy cannot play with are left out.
        origin: of the rows.

    Raises:
        ConfigError: if an agent plays other tasks, or with none of these numbers of distractors.
    """
    for agent in (agent for members in groups.values() for agent in members):
        _check_play(agent, play)
    world = World(opened, next(iter(groups.values()))[0].config.tasks.environment(play.part, columns[0]))
    found: dict[str, dict[int, Estimate]] = {name: {} for name in groups}
    for column in columns:
        evaluator = Evaluator(world.variant(num_distractors=column), draws=DRAWS)
        for name, members in steps("evaluating agents", groups.items()):
            if can_play(members[0], column):
                rates = [evaluator(PolicyPlayer(agent.policy)).success.mean(axis=1) for agent in members]
                found[name][column] = (
                    float(sum(map(float, (r.mean() for r in rates))) / len(rates)),
                    *crossed_bootstrap(rates),
                )
    rows = []
    for name, members in groups.items():
        if not found[name]:
            raise ConfigError(
                f"--beside: '{name}' plays with {members[0].config.tasks.distractors} distractors only; "
                f"add them to --distractors {','.join(map(str, columns))}."
            )
        rows.append(_agent_row(name, members, found[name], play, origin, len(evaluator.tasks)))
    return tuple(rows)


def in_order(rows: Sequence[ReferenceRow]) -> tuple[ReferenceRow, ...]:
    """Return rows by kind of player, those of a kind in the order in which they come, the user's own last."""
    return tuple(sorted(rows, key=lambda row: (KINDS.index(row.kind), row.origin == "beside")))


def _agent_row(
    name: str,
    members: Sequence[OpenedAgent],
    found: dict[int, Estimate],
    play: TaskPlay,
    origin: Origin,
    tasks: int,
) -> ReferenceRow:
    config = members[0].config
    settings = {key: str(value) for key, value in config.differing().items() if key not in NO_RESULT + SAID}
    steps_done = sorted({agent.metrics[-1].step if agent.metrics else 0 for agent in members})
    trained = {
        "steps": ", ".join(f"{number:,}" for number in steps_done),
        TRAINED_WITH: counted(config.tasks.distractors, "distractor"),
    }
    return ReferenceRow(
        player=name,
        kind="agent",
        measure="success",
        figures=figures_of(found),
        origin=origin,
        source=" ".join(("wordcraft-kg", *members[0].run.argv[1:])),
        play=play,
        interval=OVER_SEEDS if len(members) > 1 else "95 %, bootstrap over tasks",
        tasks=tasks,
        draws=DRAWS,
        seeds=len(members),
        settings=settings | trained,
        notes=f"its scorer {SEEN}" if members[0].run.kg == "full" else "",
    )


def _check_play(agent: OpenedAgent, play: TaskPlay) -> None:
    """Refuse an agent that plays other tasks."""
    its = play_of(agent.config.tasks, play.part)
    if its is None:
        raise ConfigError(f"--beside: '{agent.name}' plays by other rules than the table: {agent.config.tasks}.")
    if its != play:
        raise ConfigError(
            f"--beside: '{agent.name}' plays tasks of depth {its.depth} with {counted(its.attempts, 'attempt')}, and "
            f"the table is about depth {play.depth} with {play.attempts}; give --depth {its.depth}, or leave it out."
        )


def _beside(
    opened: OpenedGraph, play: TaskPlay, columns: Sequence[int], paths: Sequence[Path]
) -> tuple[ReferenceRow, ...]:
    """Return the rows of what the user gave."""
    agents: list[OpenedAgent] = []
    rows: list[ReferenceRow] = []
    for path in paths:
        folders = run_folders(path)
        if (folders[0] / RUN_FILE).is_file():
            agents += [open_agent(folder, opened) for folder in folders]
        elif (path / STUDY_FILE).is_file():
            rows.append(_people(path, read_study(path).sessions(), opened, play, columns))
        elif path.is_file() and _is_session(path):
            rows.append(_people(path, (read_session(path),), opened, play, columns))
        else:
            raise ConfigError(f"--beside: '{path}' {what_is(path)}; expected {UNDERSTOOD}.")
    own = agent_rows(group_agents(agents), opened, play, columns, "beside") if agents else ()
    return (*own, *rows)


def _is_session(path: Path) -> bool:
    with path.open("rb") as file:
        return HUMAN_FORMAT.encode() in file.readline(10_000)


def _people(
    path: Path, sessions: Sequence[Session], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> ReferenceRow:
    """Return the row of people who took the paper's test."""
    view = view_people({path: sessions})
    header = sessions[0].header
    for name, has, wanted in (
        ("graph", header["graph_hash"], opened.graph.hash),
        ("split", header["split_hash"], opened.split.hash),
    ):
        if has != wanted:
            raise GraphMismatchError(
                f"--beside: '{path}' is of {name} {has[:12]}, and the table of {wanted[:12]}. Give the graph that "
                "people played on."
            )
    settings = view.settings
    its = TaskPlay(play.part, int(settings.get("depth", 1)), int(settings.get("attempts", 1)))
    if its != play:
        raise ConfigError(
            f"--beside: '{path}' has tasks of depth {its.depth} with {counted(its.attempts, 'attempt')}, and the "
            f"table is about depth {play.depth} with {play.attempts}."
        )
    found: dict[int, Estimate] = {}
    people, over = 0, set()
    for condition in view.conditions:
        rate = condition.parts.get(play.part)
        if rate is None or rate.rate is None or condition.distractors not in columns:
            continue
        bounds = rate.people_interval or rate.interval or (None, None)
        over.add("people" if rate.people_interval else "the answers of one person")
        people += rate.people
        found[condition.distractors] = (rate.rate, *bounds)
    if not found:
        has = ", ".join(str(condition.distractors) for condition in view.conditions)
        raise ConfigError(
            f"--beside: '{path}' has no answers to {play.part} tasks with {', '.join(map(str, columns))} distractors; "
            f"it is of {has} distractors, and of train and test tasks."
        )
    return ReferenceRow(
        player=path.name,
        kind="people",
        measure="success",
        figures=figures_of(found),
        origin="beside",
        source=str(path),
        play=play,
        interval=f"95 %, over {' or '.join(sorted(over))}",
        people=people,
    )


def _merged(found: Sequence[ReferenceRow], now: Sequence[ReferenceRow], columns: Sequence[int]) -> list[ReferenceRow]:
    """Return the pack's rows with the figures that were measured now, in the order of the columns."""
    more = {row.player: row for row in now}
    rows = []
    for row in found:
        figures = row.figures | (more.pop(row.player).figures if row.player in more else {})
        rows.append(msgspec.structs.replace(row, figures=figures).at(columns))
    return rows + list(more.values())


def _kind(player: str) -> Kind:
    return "chance" if player in CHANCE else "oracle" if player in ORACLES else "knowledge graph"
