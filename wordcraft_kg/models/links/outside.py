"""Triples from outside the book for joint training, from knowledge folders.

Ids extend the graph's: further nodes follow the E entities, and their relations follow the game's two. So
the first E embeddings are the entities', and the saved model holds these alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.graphs.arrays import Ids, frozen
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.knowledge.folder import (
    KNOWLEDGE,
    TRIPLES,
    KnowledgeRecord,
    knowledge_files,
)
from wordcraft_kg.models.links.records import OutsideSummary

_COLUMNS = ("head", "relation", "tail")


@dataclass(frozen=True, eq=False)
class OutsideTriples:
    """Triples over a graph's E entities and further nodes (ids from E) and relations (ids from 2), with coverage."""

    nodes: tuple[str, ...]
    relations: tuple[str, ...]
    triples: Ids
    summary: OutsideSummary


def outside_hashes(folders: Sequence[str]) -> dict[str, str]:
    """Return the hash of each folder's triples; ConfigError without any, ArtefactError if incomplete."""
    return {f"outside graph {number}": _hash(folder) for number, folder in enumerate(folders, 1)}


def _hash(folder: str) -> str:
    outputs = knowledge_files(folder).run.outputs
    if TRIPLES not in outputs:
        raise ConfigError(
            f"`with` '{folder}' holds tables and no triples. Expected a folder from import-knowledge; `train-recipes` "
            "uses tables."
        )
    return outputs[TRIPLES]


def read_outside(folders: Sequence[str], entities: Sequence[str]) -> OutsideTriples | None:
    """Read the triples of knowledge folders, with ids for a graph's ``entities``; None without folders.

    Equal nodes and relations of several folders are one. ConfigError if a folder has no triples or none with an entity,
    or names a relation of the game, ArtefactError if a folder is incomplete or damaged.
    """
    if not folders:
        return None
    places = {label: place for place, label in enumerate(entities)}
    relations: dict[str, int] = {name: place for place, name in enumerate(RELATIONS)}
    rows = list[tuple[int, int, int]]()
    for folder in folders:
        before = len(rows)
        for head, relation, tail in _lines(folder):
            if relation in RELATIONS:
                raise ConfigError(
                    f"`with` '{folder}': '{relation}' is a relation of recipes. Rename this relation, and "
                    "import the triples again."
                )
            place = relations.setdefault(relation, len(relations))
            rows.append(
                (places.setdefault(head, len(places)), place, places.setdefault(tail, len(places)))
            )
        ends = {row[side] for row in rows[before:] for side in (0, 2)}
        if not any(end < len(entities) for end in ends):
            raise ConfigError(
                f"`with` '{folder}': none of the {len(ends):,} nodes in {TRIPLES} is one of the {len(entities):,} "
                f"entities, such as '{entities[0]}'. Make the folder for this graph."
            )
    triples = frozen(np.unique(np.array(rows, dtype=np.int64), axis=0))
    known = np.unique(triples[:, [0, 2]])
    summary = OutsideSummary(
        triples=len(triples),
        nodes=len(places) - len(entities),
        relations=len(relations) - len(RELATIONS),
        coverage=int((known < len(entities)).sum()) / len(entities),
    )
    return OutsideTriples(
        tuple(places)[len(entities) :], tuple(relations)[len(RELATIONS) :], triples, summary
    )


def _lines(folder: str) -> list[list[str]]:
    """Return head, relation and tail of each line."""
    _hash(folder)
    files = knowledge_files(folder)
    number = files.record(KNOWLEDGE, KnowledgeRecord).triples
    header, *lines = [
        line.split("\t")
        for line in files.bytes(TRIPLES).decode(errors="replace").removesuffix("\n").split("\n")
    ]
    if (
        tuple(header) != _COLUMNS
        or len(lines) != number
        or any(len(line) != len(_COLUMNS) for line in lines)
    ):
        raise ArtefactError(
            f"{files.folder / TRIPLES} is damaged: expected the header {' '.join(_COLUMNS)} and {number:,} lines of "
            "three columns, separated by tabs. Make the folder again."
        )
    return lines
