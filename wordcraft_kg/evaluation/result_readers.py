"""Readers for external results (results from the user), and the reader for agent runs.

An app registers a :class:`ResultReader` by an entry point in the group
``wordcraft_kg.result_readers``.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from wordcraft_kg.agents.agent_folder import OpenedAgent, open_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.base.artefacts import what_is
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.base.statistics import rate_interval
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.agents import Groups, can_play, group_agents
from wordcraft_kg.evaluation.reference import (
    TRAINED_WITH,
    Estimate,
    MeasuredValue,
    OpenPlay,
    Origin,
    ReferenceRow,
    TaskPlay,
    metrics_of,
    play_of,
)
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.scorers.folder import WEIGHTS
from wordcraft_kg.runs.record import RUN_FILE, run_folders


def over(unit: str, *, seeds: int = 1) -> str:
    """Return how the interval of success is made; ``unit`` names the groups of tasks, as goals."""
    return f"95 %, over seeds and {unit}" if seeds > 1 else f"95 %, bootstrap over {unit}"


class TableGame(Record):
    """A player's recorded game on a crafting task, by labels.

    Attributes:
        player: the player's name.
        kind: kind of the player, such as people or language model.
        part: split part with the task.
        depth: fewest attempts that solve the task.
        goal: label of the goal.
        table: entities on the table at the start.
        pairs: combined pairs in turn; None for a lost attempt.
        success: whether the player made the goal.
    """

    player: str
    kind: str
    part: TaskPart
    depth: Count
    goal: str
    table: tuple[str, ...]
    pairs: tuple[tuple[str, str] | None, ...]
    success: bool


SEEN = "knows the recipes of the test tasks"
_NO_RESULT = (
    "seed",
    "graph",
    "scorer",
    "threads",
    "device",
    "log_every",
    "eval_every",
    "checkpoint_every",
)
_SHOWN = ("steps", "distractors")
"""Settings with a column or remark of their own; those before do not change the results."""


@dataclass(frozen=True)
class ResultReader:
    """Functions that read external results in a certain file format.

    The functions raise ConfigError for results on different tasks, GraphMismatchError for results
    on a different graph or split, and ArtefactError for a damaged file.

    Attributes:
        expected: description of the format, for the error about an unknown path.
        knows: return whether a path, which need not exist, has this format.
        task_rows: return success on crafting tasks from paths, graph and split, tasks, and
            distractor counts.
        open_rows: return known entities in open-ended play; None if not supported.
        games: return the games on tasks from a path; None if not supported.
    """

    expected: str
    knows: Callable[[Path], bool]
    task_rows: Callable[
        [Sequence[Path], OpenedGraph, TaskPlay, Sequence[int]], Sequence[ReferenceRow]
    ]
    open_rows: Callable[[Sequence[Path], OpenedGraph, OpenPlay], Sequence[ReferenceRow]] | None = (
        None
    )
    games: Callable[[Path, OpenedGraph], Iterable[TableGame]] | None = None


def external_rows(
    opened: OpenedGraph, play: TaskPlay | OpenPlay, columns: Sequence[int], paths: Sequence[Path]
) -> tuple[ReferenceRow, ...]:
    """Return table rows for the user's results.

    Args:
        opened: graph and split.
        play: crafting tasks or open-ended play.
        columns: distractor counts.
        paths: folders and files, each in the format of a registered reader.

    Returns:
        The rows, reader by reader.

    Raises:
        ConfigError: if a path has no known format, or results on other tasks.
        GraphMismatchError: if a result is of another graph or split.
        ArtefactError: if a result is damaged.
    """
    readers = list(READERS.values())
    # Without the others, the error for an unknown path lists formats that would be read.
    if isinstance(play, OpenPlay):
        readers = [reader for reader in readers if reader.open_rows]
    # A reader gets all its paths at once, because several runs may be seeds of one agent. All
    # formats are recognised before anything is read.
    of: dict[ResultReader, list[Path]] = {reader: [] for reader in readers}
    for path in paths:
        of[_reader_of(path, readers)].append(path)
    rows: list[ReferenceRow] = []
    for reader, own in of.items():
        if not own:
            continue
        if isinstance(play, TaskPlay):
            rows += reader.task_rows(own, opened, play, columns)
        elif reader.open_rows:
            rows += reader.open_rows(own, opened, play)
    return tuple(rows)


def read_table_games(opened: OpenedGraph, path: Path) -> tuple[TableGame, ...]:
    """Return recorded games on a graph's tasks.

    Args:
        opened: the graph and its split.
        path: file or folder with the games, of any kind that a reader knows.

    Raises:
        ConfigError: if no reader knows the path, or it has no games on tasks.
        ArtefactError: if it is damaged, or names entities that the graph does not have.
        GraphMismatchError: if the games are of another graph or split.
    """
    reader = _reader_of(path, [reader for reader in READERS.values() if reader.games])
    assert reader.games is not None
    games = tuple(reader.games(path, opened))
    if not games:
        raise ConfigError(f"'{path}' has no games on tasks.")
    # The hash in the file may be right and a label still wrong, if the file was edited.
    labels: set[str] = set()
    for game in games:
        labels.update((game.goal, *game.table))
    unknown = labels.difference(opened.graph.entities)
    if unknown:
        raise ArtefactError(
            f"'{path}' is damaged: {opened.graph.name} has no entity '{min(unknown)}'."
        )
    return games


def _reader_of(path: Path, readers: Sequence[ResultReader]) -> ResultReader:
    for reader in readers:
        if reader.knows(path):
            return reader
    raise ConfigError(
        f"'{path}' {what_is(path)}; expected {', '.join(reader.expected for reader in readers)}."
    )


def begins_with(path: Path, form: str) -> bool:
    """Return whether a path is a file that names the format ``form`` in the first line."""
    if not path.is_file():
        return False
    # Bounded: a file of another kind may be a single line of many gigabytes.
    with path.open("rb") as file:
        return form.encode() in file.readline(10_000)


def check_hash(path: Path, name: str, has: str, wanted: str) -> None:
    """Check that results are of the expected graph or split.

    Args:
        path: the results' path, for the error.
        name: graph or split, in words.
        has: hash in the results.
        wanted: hash of the graph or split that the user gave.

    Raises:
        GraphMismatchError: if the hashes differ.
    """
    if has != wanted:
        raise GraphMismatchError(
            f"'{path}' was played on {name} {has[:12]}, but GRAPH has {wanted[:12]}. Use the graph "
            "of the result."
        )


def check_tasks(name: Path | str, its: TaskPlay, play: TaskPlay) -> None:
    """Check that results are on the tasks of a table.

    Args:
        name: the results' path or name, for the error.
        its: the results' tasks.
        play: the table's tasks.

    Raises:
        ConfigError: if the tasks differ; the message tells the options for the results' tasks.
    """
    if its != play:
        attempts = f" --attempts {its.attempts}" if its.attempts != its.depth else ""
        raise ConfigError(
            f"--external-results: '{name}' has {_in_words(its)}, but the table has "
            f"{_in_words(play)}; add --part {its.part} --depth {its.depth}{attempts}, "
            f"or remove '{name}'."
        )


def agent_rows(
    groups: Groups, opened: OpenedGraph, play: TaskPlay, columns: Sequence[int], origin: Origin
) -> tuple[ReferenceRow, ...]:
    """Evaluate agents greedily, as ``compare`` does.

    Args:
        groups: runs by agent, on this graph and split.
        opened: graph and split.
        play: the tasks.
        columns: distractor counts; an agent skips those that its policy cannot play with.
        origin: origin of the rows.

    Returns:
        A row for each agent.

    Raises:
        ConfigError: if an agent plays other tasks, or with none of these distractor counts, or if
            the graph has too few entities for one of them.
        TaskError: if the split has no such tasks.
    """
    everyone = list(chain.from_iterable(groups.values()))
    # All agents are checked before the first is evaluated, which may take minutes.
    for agent in everyone:
        its = play_of(agent.config.tasks, play.part)
        if its is None:
            raise ConfigError(
                f"--external-results: '{agent.name}' has different task settings than the table: "
                f"{agent.config.tasks}."
            )
        check_tasks(agent.name, its, play)
    # All agents have the table's tasks, so the first one's settings make the world for all.
    world = World(opened, everyone[0].config.tasks.environment(play.part, columns[0]))
    estimates: dict[str, dict[int, Estimate]] = {name: {} for name in groups}
    own: dict[str, dict[int, float]] = {name: {} for name in groups}
    for column in columns:
        evaluator = Evaluator(world.variant(num_distractors=column))
        for name, members in steps("evaluating agents", groups.items()):
            # Members differ in the seed alone, so that one stands for all.
            if not can_play(members[0], column):
                continue
            played = [evaluator(PolicyPlayer(agent.policy)) for agent in members]
            # Rates by task: the interval resamples seeds and groups of tasks.
            rates = [result.success.mean(axis=1) for result in played]
            means = [float(rate.mean()) for rate in rates]
            mean = sum(means) / len(means)
            low, high = rate_interval(rates, played[0].groups)
            estimates[name][column] = (mean, low, high)
            by_plan = [float(result.by_plan.mean()) for result in played]
            own[name][column] = sum(by_plan) / len(by_plan)
    rows = []
    for name, members in groups.items():
        if not estimates[name]:
            distractors = members[0].config.tasks.distractors
            asked = ",".join(map(str, columns))
            raise ConfigError(
                f"--external-results: '{name}' plays with {distractors} distractors only; add this "
                f"number to --distractors {asked}."
            )
        figures = metrics_of(estimates[name], own[name])
        rows.append(_agent_row(name, members, figures, play, origin, evaluator))
    return tuple(rows)


def _agent_row(
    name: str,
    members: Sequence[OpenedAgent],
    figures: dict[str, MeasuredValue],
    play: TaskPlay,
    origin: Origin,
    evaluator: Evaluator,
) -> ReferenceRow:
    config = members[0].config
    hidden = (*_NO_RESULT, *_SHOWN)
    settings = {key: str(value) for key, value in config.differing().items() if key not in hidden}
    # Seeds of an agent may have been stopped at different steps.
    steps_done = sorted({agent.metrics[-1].step if agent.metrics else 0 for agent in members})
    trained = {
        "steps": ", ".join(f"{number:,}" for number in steps_done),
        TRAINED_WITH: counted(config.tasks.distractors, "distractor"),
    }
    return ReferenceRow(
        player=name,
        kind="agent",
        measure="success",
        figures=figures,
        origin=origin,
        source=" ".join(("wordcraft-kg", *members[0].run.argv[1:])),
        play=play,
        interval=over(members[0].opened.split.unit, seeds=len(members)),
        tasks=len(evaluator.tasks),
        distractor_seeds=evaluator.distractor_seeds,
        seeds=len(members),
        settings=settings | trained,
        notes=f"its scorer {SEEN}" if members[0].run.kg == "full" else "",
    )


def _in_words(play: TaskPlay) -> str:
    return f"{play.part} tasks of depth {play.depth} with {counted(play.attempts, 'attempt')}"


def is_model(path: Path) -> bool:
    """Return whether a path is a model folder."""
    # A model folder has a run record, too: the weights tell it from a run of an agent.
    return (path / WEIGHTS).is_file()


def _is_run(path: Path) -> bool:
    return (run_folders(path)[0] / RUN_FILE).is_file() and not is_model(path)


def _own_agents(
    paths: Sequence[Path], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> Sequence[ReferenceRow]:
    # A path may be a run, or a folder with a run for each seed.
    folders = chain.from_iterable(run_folders(path) for path in paths)
    agents = [open_agent(folder, opened) for folder in folders]
    return agent_rows(group_agents(agents), opened, play, columns, "external")


AGENTS = ResultReader(
    "a run folder of 'train-agent' or a folder of its seeds", _is_run, _own_agents
)
READERS: Registry[ResultReader] = Registry("wordcraft_kg.result_readers", {"agents": AGENTS})
