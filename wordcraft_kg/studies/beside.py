"""What a user has beside the reference pack: runs of agents, sessions of people, results of players that use words."""

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import get_args

import msgspec

from wordcraft_kg.agents.agent_folder import OpenedAgent, open_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.apps.people.protocol import HUMAN_FORMAT
from wordcraft_kg.apps.people.session_file import Session, read_session
from wordcraft_kg.apps.people.study import STUDY_FILE
from wordcraft_kg.apps.people.study_folder import read_study
from wordcraft_kg.apps.people.summary import view_people
from wordcraft_kg.apps.text_agents.games_result import read_games_result
from wordcraft_kg.apps.text_agents.inspect_log import read_inspect_log
from wordcraft_kg.apps.text_agents.records import (
    RESULT_FILE,
    GamesFormat,
    WordsResult,
    WordsSettings,
    read_words_result,
)
from wordcraft_kg.base.artefacts import what_is
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.statistics import crossed_bootstrap
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.agents import Groups, can_play, group_agents
from wordcraft_kg.evaluation.reference import (
    TRAINED_WITH,
    Estimate,
    Figure,
    OpenPlay,
    Origin,
    ReferenceRow,
    TaskPlay,
    figures_of,
    play_of,
)
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.runs.record import RUN_FILE
from wordcraft_kg.runs.seeds import run_folders

DRAWS = 5
"""Draws of distractors for each task, of scripted players too."""
SEEN = "knows the recipes of the test tasks"
NO_RESULT = ("seed", "graph", "scorer", "threads", "device", "log_every", "eval_every", "checkpoint_every")
SAID = ("steps", "distractors")
"""Settings of a training that its figures do not depend on, and those that a row says in other words."""
OVER_SEEDS = "95 %, bootstrap over seeds and tasks"
OVER_TASKS = "95 %, bootstrap over tasks"
WORDS = "a result of 'evaluate-words', a file of 'mcp --out', or a log of Inspect AI (.eval, .json)"
LOGS = (".eval", ".json")
UNDERSTOOD = (
    "a run folder of 'train-agent' or a folder of its seeds, a folder of 'study serve', a file of "
    f"'play --protocol paper', {WORDS}"
)
"""What can stand beside the pack."""


def rows_beside(
    opened: OpenedGraph, play: TaskPlay, columns: Sequence[int], paths: Sequence[Path]
) -> tuple[ReferenceRow, ...]:
    """Return the rows of what a user has of crafting tasks.

    Args:
        opened: graph and split that it has to be of.
        play: the tasks that it has to be of.
        columns: numbers of distractors.
        paths: folders and files, see :data:`UNDERSTOOD`.

    Raises:
        ConfigError: if one is nothing known, or of other tasks.
        GraphMismatchError: if one is of another graph or split.
        ArtefactError: if one is damaged.
    """
    agents: list[OpenedAgent] = []
    people: list[ReferenceRow] = []
    words: list[tuple[Path, WordsResult]] = []
    for path in paths:
        folders = run_folders(path)
        if (folders[0] / RUN_FILE).is_file():
            agents += [open_agent(folder, opened) for folder in folders]
        elif (path / STUDY_FILE).is_file():
            people.append(_people(path, read_study(path).sessions(), opened, play, columns))
        elif path.is_file() and _begins_with(path, HUMAN_FORMAT):
            people.append(_people(path, (read_session(path),), opened, play, columns))
        elif result := _result_of(path, opened):
            words.append((path, result))
        else:
            raise ConfigError(f"--beside: '{path}' {what_is(path)}; expected {UNDERSTOOD}.")
    own = agent_rows(group_agents(agents), opened, play, columns, "beside") if agents else ()
    return (*own, *people, *_words(words, opened, play, columns))


def open_rows_beside(opened: OpenedGraph, play: OpenPlay, paths: Sequence[Path]) -> tuple[ReferenceRow, ...]:
    """Return the rows of what a user has of open-ended play: results of players that use words.

    Raises:
        ConfigError: if one is nothing else, or of crafting tasks or another base.
        GraphMismatchError: if one is of another graph.
        ArtefactError: if one is damaged.
    """
    rows = []
    for path in paths:
        result = _result_of(path, opened)
        if result is None:
            raise ConfigError(f"--beside: '{path}' {what_is(path)}; expected {WORDS}, of the open-ended world.")
        settings = result.settings
        _check_graph(path, "graph", settings.graph_hash, opened.graph.hash)
        if not settings.is_open_ended or settings.base != play.base:
            its = f"begins with {', '.join(settings.base)}" if settings.is_open_ended else "is of crafting tasks"
            raise ConfigError(f"--beside: '{path}' {its}, and the table is about play from {', '.join(play.base)}.")
        row = _words_row(path, result, play, {})
        known: dict[int, Estimate] = {attempts: (value, None, None) for attempts, value in result.known.items()}
        rows.append(
            msgspec.structs.replace(row, measure="entities known", figures=figures_of(known), runs=result.games)
        )
    return tuple(rows)


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
        interval=OVER_SEEDS if len(members) > 1 else OVER_TASKS,
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
    _check_tasks(agent.name, its, play)


def _check_tasks(name: Path | str, its: TaskPlay, play: TaskPlay) -> None:
    """Refuse other tasks than those of the table."""
    if its != play:
        attempts = f" --attempts {its.attempts}" if its.attempts != its.depth else ""
        raise ConfigError(
            f"--beside: '{name}' is of {_in_words(its)}, and the table of {_in_words(play)}; give --part {its.part} "
            f"--depth {its.depth}{attempts}, or leave it out."
        )


def _in_words(play: TaskPlay) -> str:
    return f"{play.part} tasks of depth {play.depth} with {counted(play.attempts, 'attempt')}"


def _begins_with(path: Path, form: str) -> bool:
    """Return whether the first line of a file names a format."""
    with path.open("rb") as file:
        return form.encode() in file.readline(10_000)


def _people(
    path: Path, sessions: Sequence[Session], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> ReferenceRow:
    """Return the row of people who took the paper's test."""
    view = view_people({path: sessions})
    header = sessions[0].header
    _check_graph(path, "graph", header["graph_hash"], opened.graph.hash)
    _check_graph(path, "split", header["split_hash"], opened.split.hash)
    settings = view.settings
    its = TaskPlay(play.part, int(settings.get("depth", 1)), int(settings.get("attempts", 1)))
    _check_tasks(path, its, play)
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


def _result_of(path: Path, opened: OpenedGraph) -> WordsResult | None:
    """Return the result of a player that uses words, None if a path is nothing of the kind."""
    if (path / RESULT_FILE).is_file():
        return read_words_result(path)
    if path.is_file() and path.suffix in LOGS:
        return read_inspect_log(path)
    if path.is_file() and _begins_with(path, *get_args(GamesFormat)):
        return read_games_result(path, opened)
    return None


def _words(
    results: Sequence[tuple[Path, WordsResult]], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> list[ReferenceRow]:
    """Return a row for each player that uses words; results that differ in the distractors alone are one player's."""
    rows: dict[tuple[str, WordsSettings, int], ReferenceRow] = {}
    for path, result in results:
        settings = result.settings
        _check_graph(path, "graph", settings.graph_hash, opened.graph.hash)
        _check_graph(path, "split", settings.split_hash, opened.split.hash)
        success, amount = result.success, settings.distractors
        if settings.part is None or settings.depth is None or amount is None or success is None:
            raise ConfigError(f"--beside: '{path}' is of the open-ended world; add --open-ended, or leave it out.")
        _check_tasks(path, TaskPlay(settings.part, settings.depth, settings.attempts), play)
        if amount not in columns:
            raise ConfigError(
                f"--beside: '{path}' has {counted(amount, 'distractor')}, which are no column of the table; "
                f"add them to --distractors {','.join(map(str, columns))}."
            )
        figures = figures_of({amount: (success.mean, success.ci_low, success.ci_high)})
        row = _words_row(path, result, play, figures)
        row = msgspec.structs.replace(row, interval=OVER_TASKS, tasks=success.tasks, draws=success.draws)
        # A player that has played the same twice, such as one that draws at random, has a row for each time.
        same = result.player, msgspec.structs.replace(settings, distractors=None)
        times = ((*same, time) for time in count())
        key = next(key for key in times if key not in rows or str(amount) not in rows[key].figures)
        if key in rows:
            figures = rows[key].figures | figures
            notes = ", ".join(dict.fromkeys(said for said in (rows[key].notes, row.notes) if said))
            row = msgspec.structs.replace(row, figures=figures, source=f"{rows[key].source}, {row.source}", notes=notes)
        rows[key] = row
    return list(rows.values())


def _words_row(path: Path, result: WordsResult, play: TaskPlay | OpenPlay, figures: dict[str, Figure]) -> ReferenceRow:
    """Return what a row says of a result, whatever was played."""
    settings = result.settings
    said = {"knowledge": settings.knowledge, "look-ups a game": str(settings.look_ups)}
    lost = f"{counted(result.lost, 'attempt')} lost by messages that were not understood"
    sample = f"an even sample of {counted(result.success.tasks, 'task')}" if result.success else ""
    notes = (
        sample if settings.tasks is not None else "",
        lost if result.lost else "",
        f"its scorer {SEEN}" if settings.kg == "full" else "",
    )
    return ReferenceRow(
        player=result.player,
        kind="language model" if path.suffix in LOGS else "other",
        measure="success",
        figures=figures,
        origin="beside",
        source=str(path),
        play=play,
        settings={} if settings.knowledge == "none" else said,
        notes=", ".join(note for note in notes if note),
    )


def _check_graph(path: Path, name: str, has: str, wanted: str) -> None:
    """Refuse another graph or split."""
    if has != wanted:
        raise GraphMismatchError(
            f"--beside: '{path}' is of {name} {has[:12]}, and the table of {wanted[:12]}. Give as GRAPH what was "
            "played on."
        )
