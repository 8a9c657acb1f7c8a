"""Success rates of people in the protocol of the paper, and of agents at the same tables."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.people.protocol import (
    HUMAN_PARTS,
    AgentGame,
    Answer,
    Session,
    TableKey,
    check_alike,
)
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import bootstrap, interval, wilson_interval


class AgentRate(Record):
    """An agent's results on people's tables, once per answer.

    The 95 % interval is a bootstrap over groups of tasks, Wilson's for equal results.
    """

    successes: Count
    rate: Share
    tables: Count
    interval: tuple[Share, Share] | None


class AnswerRate(Record):
    """Number and share of correct answers; None without answers.

    The 95 % Wilson interval is for independent answers of these people; ``people_interval`` is a
    bootstrap over people, Wilson's for equal results, and None for a single person. ``agents``
    played at the same tables."""

    answered: Count
    successes: Count
    rate: Share | None
    interval: tuple[Share, Share] | None
    people: Count
    people_interval: tuple[Share, Share] | None
    agents: dict[str, AgentRate]


class PeopleCondition(Record):
    """People in one distractor condition, and correct answers by part."""

    distractors: Count
    sessions: Count
    finished: Count
    parts: dict[str, AnswerRate]


class HumanSummary(Record):
    """Sessions with equal graph, split and settings, by distractor condition."""

    graph: str
    graph_hash: str
    settings: dict[str, int | str]
    sessions: Count
    finished: Count
    conditions: tuple[PeopleCondition, ...]


class ExportedAnswers(Record):
    """An exported file, with numbers of people and answers."""

    out: str
    people: Count
    answers: Count


def view_people(
    sources: Mapping[Path, Sequence[Session]],
    agents: Mapping[str, Mapping[TableKey, AgentGame]] | None = None,
) -> HumanSummary:
    """Return success rates over sessions; ``agents`` holds the games of each agent by name and table.

    Two studies with the same answers are an ArtefactError, other graphs or splits a
    GraphMismatchError, and other settings than the number of distractors, or no session, a
    ConfigError."""
    _check_sources(sources)
    sessions = [session for group in sources.values() for session in group]
    header = sessions[0].header
    by_amount: dict[int, list[Session]] = {}
    for session in sessions:
        by_amount.setdefault(session.distractors, []).append(session)
    conditions = tuple(
        PeopleCondition(
            distractors=amount,
            sessions=len(group),
            finished=sum(session.is_finished for session in group),
            parts={part: _rate(part, group, agents or {}) for part in HUMAN_PARTS},
        )
        for amount, group in sorted(by_amount.items())
    )
    return HumanSummary(
        graph=header.graph,
        graph_hash=header.graph_hash,
        settings={
            name: value for name, value in header.settings.items() if name != "num_distractors"
        },
        sessions=len(sessions),
        finished=sum(session.is_finished for session in sessions),
        conditions=conditions,
    )


def _check_sources(sources: Mapping[Path, Sequence[Session]]) -> None:
    reference: tuple[Path, Session] | None = None
    seen: dict[tuple[tuple[Answer, ...], ...], Path] = {}
    for path, sessions in sources.items():
        for session in sessions:
            reference = reference or (path, session)
            settings = reference[1].header.settings | {"num_distractors": session.distractors}
            like = msgspec.structs.replace(
                reference[1].header, seed=session.header.seed, settings=settings
            )
            check_alike(path, session.header, f"'{reference[0]}'", like)
        answers = tuple(session.answers for session in sessions)
        if answers in seen:
            raise ArtefactError(
                f"{path} has the same answers as {seen[answers]}; give each study once."
            )
        if any(answers):
            seen[answers] = path
    if reference is None:
        raise ConfigError("no session: expected a study with participants.")


def _rate(
    part: str, sessions: Sequence[Session], agents: Mapping[str, Mapping[TableKey, AgentGame]]
) -> AnswerRate:
    given = [
        (person, answer)
        for person, session in enumerate(sessions)
        for answer in session.answers
        if answer.part == part
    ]
    keys = [sessions[person].table_of(answer) for person, answer in given]
    right = np.array([answer.success for _, answer in given], dtype=float)
    people = np.array([person for person, _ in given], dtype=np.int64)
    n, successes = len(given), int(right.sum())
    return AnswerRate(
        answered=n,
        successes=successes,
        rate=successes / n if n else None,
        interval=wilson_interval(successes, n) if n else None,
        people=len(set(people.tolist())),
        people_interval=_over(right, people),
        agents={
            name: _agent_rate([made[key] for key in keys], keys)
            for name, made in agents.items()
            if keys
        },
    )


def _agent_rate(made: Sequence[AgentGame], keys: Sequence[TableKey]) -> AgentRate:
    won = np.array([game.success for game in made], dtype=float)
    groups = np.array([game.group for game in made], dtype=np.int64)
    return AgentRate(int(won.sum()), float(won.mean()), len(set(keys)), _over(won, groups))


def _over(right: NDArray[np.float64], clusters: NDArray[np.int64]) -> tuple[float, float] | None:
    amount = len(np.unique(clusters))
    if amount < 2:
        return None
    if right.min() == right.max():
        return wilson_interval(
            int(right[0]) * amount, amount
        )  # the bootstrap interval would be a point
    return interval(bootstrap(right, clusters))
