"""Sessions: the answers of one participant, and checks that sessions are comparable."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.apps.people.protocol import Answer, Header, schedule
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import as_values

TableKey = tuple[int, int, str, int]
"""Distractor count, seed, part, task number."""


@dataclass(frozen=True)
class Session:
    """One participant's answers in task order."""

    header: Header
    answers: tuple[Answer, ...]

    @property
    def tasks(self) -> int:
        """Number of tasks per part."""
        return int(self.header.settings["tasks_per_part"])

    @property
    def distractors(self) -> int:
        """Distractors per table."""
        return int(self.header.settings["num_distractors"])

    @property
    def is_finished(self) -> bool:
        """Whether all tasks are answered."""
        return len(self.answers) == len(schedule(self.tasks))

    def table_of(self, answer: Answer) -> TableKey:
        """Return distractor count, seed, part and task number, which determine an answer's table."""
        return self.distractors, self.header.seed, answer.part, answer.number


def check_number(settings: dict[str, int | str], name: str, least: int, most: int, where: str) -> None:
    """Check that a recorded setting is a whole number in the range."""
    value = settings.get(name)
    if not isinstance(value, int) or not least <= value <= most:
        raise ArtefactError(f"{where} is damaged: '{name}' is not a whole number, {least} to {most:,}.")


def check_alike(path: Path, header: Header, other: str, reference: Header) -> None:
    """Check that a header equals the reference, with the errors of :func:`check_equal`."""
    have, want = (as_values(entry) | entry.settings for entry in (header, reference))
    del have["settings"], want["settings"]
    check_equal(f"'{path}' has", have, f"{other} has", want)


def check_equal(subject: str, have: Mapping[str, object], other: str, want: Mapping[str, object]) -> None:
    """Check that settings are equal, except for the graph name; ``subject`` and ``other`` name both in the error.

    A hash that differs is a GraphMismatchError, another setting a ConfigError.
    """
    for name in {**want, **have}:
        if name != "graph" and have.get(name) != want.get(name):
            is_hash = name.endswith("_hash")
            kind = GraphMismatchError if is_hash else ConfigError
            is_, should = (str(values.get(name))[: 12 if is_hash else None] for values in (have, want))
            graph = f" (graph {have['graph']})" if name == "graph_hash" else ""
            raise kind(f"{subject} {name} {is_}{graph}, but {other} {should}. Nothing was changed.")
