"""People at the task: how their input is read, the paper's protocol, the file of their answers, and its summary."""

import json
import logging
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from wordcraft_kg.artefacts import read_small_file, write_atomically
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.errors import ActionError, ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.records import Count, Record, Share
from wordcraft_kg.settings import nearest, whole
from wordcraft_kg.statistics import wilson_interval

HUMAN_FORMAT = "wordcraft-kg human protocol 1"
TASKS_PER_PART = 40
"""The paper's number."""
HUMAN_PARTS = ("train", "test")
"""Parts in their order. The answer is shown after each train task, and after no test task."""
SCHEDULE = tuple((part, number) for part in HUMAN_PARTS for number in range(1, TASKS_PER_PART + 1))
"""Part and number of each task of a session."""
MOST_CHOICES = 8
"""How many of the things that a beginning could mean are named."""
_SEED_KEYS = ("all", "train", "valid", "test")  # a part's place goes into the seeds, so it must never change


def episode_seed(seed: int, part: str, number: int) -> int:
    """Return the seed of an episode, independent of those played before it.

    Raises:
        ConfigError: if the seed is negative.
    """
    whole("seed", seed, 0)
    return int(np.random.SeedSequence(seed, spawn_key=(_SEED_KEYS.index(part), number)).generate_state(1)[0])


def table_labels(env: WordCraftEnv, observation: Observation) -> tuple[str, ...]:
    """Return what is on the table, slot by slot."""
    return env.world.graph.labels(observation["table"][observation["action_mask"] == 1])


def results_of(env: WordCraftEnv, one: str, other: str) -> tuple[str, ...]:
    """Return the results of a pair in an environment; most pairs have none."""
    a, b = sorted(map(env.world.graph.id_of, (one, other)))
    return env.world.graph.labels(env.world.outcomes.get((a, b), ()))


def read_pick(typed: str, table: Sequence[str]) -> int:
    """Return the slot that a player means: by its number from 1, by its entity's word, or by the word's beginning.

    A number takes precedence over a word, a whole word over a beginning, and equal case over different case.

    Raises:
        ActionError: if the input means no slot or several.
    """
    typed = " ".join(typed.split())
    expected = f"expected 1 to {len(table)}, a word on the table, or its beginning"
    if not typed:
        raise ActionError(f"nothing typed: {expected}.")
    numbers = {str(slot + 1): slot for slot in range(len(table))}
    if typed in numbers:
        return numbers[typed]
    folded = [label.casefold() for label in table]
    for found in (
        [slot for slot, label in enumerate(table) if label == typed],
        [slot for slot, label in enumerate(folded) if label == typed.casefold()],
        [slot for slot, label in enumerate(folded) if label.startswith(typed.casefold())],
    ):
        if len(found) == 1:
            return found[0]
        if found:
            choices = ", ".join(f"{table[slot]} ({slot + 1})" for slot in found[:MOST_CHOICES])
            more = f" and {len(found) - MOST_CHOICES} more" if len(found) > MOST_CHOICES else ""
            raise ActionError(f"'{typed}' could be {choices}{more}; type more of the word, or the number.")
    shown = typed if len(typed) <= 40 else f"{typed[:40]}..."
    raise ActionError(f"{shown!r}: {expected}.{nearest(typed, table)}")


# --- protocol --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """A line of a session's file; it holds nothing about the person or the machine.

    Attributes:
        part: ``train`` or ``test``.
        number: number of the task in its part, from 1.
        goal: entity to make.
        table: entities on the table, slot by slot.
        picks: the two entities picked.
        made: their results.
        success: whether the goal is among them.
        seconds: time from showing the task to the second pick.
    """

    part: str
    number: int
    goal: str
    table: tuple[str, ...]
    picks: tuple[str, ...]
    made: tuple[str, ...]
    success: bool
    seconds: float


class HumanProtocol:
    """The paper's protocol: 40 train tasks with their answers, then 40 test tasks; depth 1, one attempt each.

    The tasks and tables are drawn as for agents, and depend on graph, split, number of distractors and seed only.

    Attributes:
        header: what comparable sessions share; the first line of a session's file.

    Source: Jiang et al. 2020, human evaluation (one person with 1 distractor, another with 8).
    """

    def __init__(self, graph: GraphLike, num_distractors: int = 8, seed: int = 0):
        """Prepare the environments of both parts.

        Raises:
            ConfigError: for a setting out of range.
            TaskError: if a part has no task.
        """
        episode_seed(seed, "train", 1)  # refuses a negative one
        self.seed = seed
        world = World(graph, WordCraftConfig(num_distractors=num_distractors))
        self._envs = {part: WordCraftEnv(world.variant(part=part)) for part in HUMAN_PARTS}
        self.header = {
            "format": HUMAN_FORMAT,
            "graph": world.graph.name,
            "graph_hash": world.graph.hash,
            "split_hash": world.split.hash,
            "settings": _settings(world.config),
            "seed": seed,
        }

    def pose(self, part: str, number: int) -> tuple[WordCraftEnv, Observation]:
        """Begin the episode of a task; return its environment and observation."""
        env = self._envs[part]
        observation, _ = env.reset(seed=episode_seed(self.seed, part, number))
        return env, observation


def _settings(config: WordCraftConfig) -> dict[str, Any]:
    kept = ("depth", "num_distractors", "attempts", "distractor_weighting", "distractor_policy", "task_weighting")
    return {"tasks_per_part": TASKS_PER_PART} | {name: getattr(config, name) for name in (*kept, "ambiguity")}


# --- file ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Session:
    """Content of a session's file.

    Attributes:
        header: see :class:`HumanProtocol`.
        answers: the answers so far, in the order of :data:`SCHEDULE`.
        torn: number of bytes after the last whole line, which a crash left.
    """

    header: dict[str, Any]
    answers: tuple[Answer, ...]
    torn: int = 0

    @property
    def is_finished(self) -> bool:
        """Whether all tasks are answered."""
        return len(self.answers) == len(SCHEDULE)


def open_session(path: Path, protocol: HumanProtocol) -> Session:
    """Begin a session's file, or read the existing one to continue it; a torn last line is dropped.

    Raises:
        ArtefactError: if the file is not of this kind, is damaged, or has other tasks than the protocol.
        GraphMismatchError: if it belongs to another graph or split.
        ConfigError: if it was begun with other settings. The file is unchanged in all these cases.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, _line(protocol.header))
        return Session(protocol.header, ())
    session = read_session(path)
    _check_alike(path, session.header, "this command", protocol.header)
    for line, answer in enumerate(session.answers, start=2):
        env, observation = protocol.pose(answer.part, answer.number)
        if (answer.goal, answer.table) != (env.task.goal, table_labels(env, observation)):
            raise ArtefactError(f"{path}, line {line}: this version poses another task there. Nothing was changed.")
    if session.torn:
        logging.getLogger(__name__).warning("%s ended in a torn line, which was dropped; its task is asked again", path)
        os.truncate(path, path.stat().st_size - session.torn)
    return replace(session, torn=0)


def append_answer(path: Path, session: Session, answer: Answer) -> Session:
    """Add an answer to a session and its file; it is on disk when this returns."""
    with path.open("ab") as file:
        file.write(_line(asdict(answer)).encode())
        file.flush()
        os.fsync(file.fileno())
    return replace(session, answers=(*session.answers, answer))


def read_session(path: Path) -> Session:
    """Read a session's file.

    Raises:
        ArtefactError: naming the line, if the file is not of this kind or damaged; a torn last line is not an error.
    """
    if not path.is_file():
        raise ArtefactError(f"'{path}' is not a file; expected one that `wordcraft-kg play --protocol paper` wrote.")
    *lines, rest = read_small_file(path).split(b"\n")
    header = _json(lines[0]) if lines else None
    if not isinstance(header, dict) or header.get("format") != HUMAN_FORMAT:
        raise ArtefactError(
            f"'{path}' is not a file of the human protocol of this version ({HUMAN_FORMAT}). Nothing was changed."
        )
    kinds = {"graph": str, "graph_hash": str, "split_hash": str, "settings": dict, "seed": int}
    wrong = [name for name, kind in kinds.items() if not isinstance(header.get(name), kind)]
    if wrong:
        raise ArtefactError(f"{path}, line 1 is damaged: '{wrong[0]}' is missing or has another type.")
    if len(lines) - 1 > len(SCHEDULE):
        raise ArtefactError(f"{path} is damaged: it has {len(lines) - 1} answers, but a session has {len(SCHEDULE)}.")
    answers = []
    for line, (text, turn) in enumerate(zip(lines[1:], SCHEDULE, strict=False), start=2):
        answer = _answer(_json(text))
        if answer is None or (answer.part, answer.number) != turn:
            raise ArtefactError(f"{path}, line {line} is damaged: it is not an answer to {turn[0]} task {turn[1]}.")
        answers.append(answer)
    return Session(header, tuple(answers), len(rest))


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n"


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


_KINDS = dict(
    zip((entry.name for entry in fields(Answer)), (str, int, str, list, list, list, bool, float), strict=True)
)


def _answer(value: Any) -> Answer | None:
    """Return the answer that a line holds, or None if it is not one."""
    if not isinstance(value, dict) or {name: type(entry) for name, entry in value.items()} != _KINDS:
        return None
    lists = {name: tuple(entry) for name, entry in value.items() if isinstance(entry, list)}
    answer = Answer(**(value | lists))
    sound = (
        all(isinstance(label, str) for labels in lists.values() for label in labels)
        and len(answer.picks) == 2
        and set(answer.picks) <= set(answer.table)
        and answer.success == (answer.goal in answer.made)
        and 0 <= answer.seconds < math.inf
    )
    return answer if sound else None


def _check_alike(path: Path, header: dict[str, Any], other: str, reference: dict[str, Any]) -> None:
    """Refuse a header that differs from the reference in anything but the graph's name."""
    have, want = ({**entry, **entry["settings"]} for entry in (header, reference))
    for name in want | have:
        if name in ("graph", "settings") or have.get(name) == want.get(name):
            continue
        kind = GraphMismatchError if name.endswith("_hash") else ConfigError
        is_, should = (str(entry.get(name))[:12] for entry in (have, want))
        raise kind(f"'{path}' has {name} {is_}, but {other} has {should}. Nothing was changed.")


# --- summary ---------------------------------------------------------------------------------------------------------


class AnswerRate(Record):
    """Number and share of right answers, with its 95 % Wilson interval; the share is None without answers."""

    answered: Count
    successes: Count
    rate: Share | None
    interval: tuple[Share, Share] | None


class HumanSummary(Record):
    """Sessions of one graph, split and settings, and the rate of right answers by part."""

    graph: str
    graph_hash: str
    settings: dict[str, int | str]
    sessions: Count
    finished: Count
    parts: dict[str, AnswerRate]


def summarise(paths: Sequence[Path]) -> HumanSummary:
    """Return the rate of right answers of each part over sessions with equal graph, split and settings.

    Raises:
        ArtefactError: if a file is damaged, ends in a torn line, or has the same answers as another.
        GraphMismatchError: if the graphs or splits differ.
        ConfigError: if the settings differ, or there is no file.
    """
    if not paths:
        raise ConfigError("no session file: expected at least one.")
    sessions = [read_session(path) for path in paths]
    reference = sessions[0].header
    seen: dict[tuple[Answer, ...], Path] = {}
    for path, session in zip(paths, sessions, strict=True):
        if session.torn:
            raise ArtefactError(f"{path} ends in a torn line; continue its session, which asks that task again.")
        _check_alike(path, session.header | {"seed": reference["seed"]}, f"'{paths[0]}'", reference)
        if session.answers in seen:
            raise ArtefactError(f"{path} has the same answers as {seen[session.answers]}; give each session once.")
        if session.answers:
            seen[session.answers] = path
    return HumanSummary(
        graph=reference["graph"],
        graph_hash=reference["graph_hash"],
        settings=reference["settings"],
        sessions=len(sessions),
        finished=sum(session.is_finished for session in sessions),
        parts={
            part: _rate([answer for session in sessions for answer in session.answers if answer.part == part])
            for part in HUMAN_PARTS
        },
    )


def _rate(answers: list[Answer]) -> AnswerRate:
    n, successes = len(answers), sum(answer.success for answer in answers)
    return AnswerRate(n, successes, successes / n if n else None, wilson_interval(successes, n) if n else None)
