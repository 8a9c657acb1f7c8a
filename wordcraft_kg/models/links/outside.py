"""Triples from outside the book for joint training, from knowledge folders.

Ids extend the graph's: further nodes follow the E entities, and their relations follow the game's
two. So the first E embeddings are the entities', and the saved model holds these alone.

The page docs/outside-knowledge.md describes joint training to users.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs import RELATIONS, Ids, frozen
from wordcraft_kg.models.knowledge.knowledge_folder import TRIPLES, knowledge_files, read_rows
from wordcraft_kg.models.links.link_records import OutsideSummary


@dataclass(frozen=True, eq=False)
class OutsideTriples:
    """Triples over a graph's E entities and further nodes and relations.

    Attributes:
        nodes: names of the further nodes, with ids from E.
        relations: names of the further relations, with ids from 2.
        triples: ids of shape (T, 3), distinct, sorted.
        summary: numbers for reports, with the share of entities in the triples.
    """

    nodes: tuple[str, ...]
    relations: tuple[str, ...]
    triples: Ids
    summary: OutsideSummary


def outside_hashes(folders: Sequence[str]) -> dict[str, str]:
    """Return the hash of each folder's triples, for the run record.

    Raises:
        ConfigError: if a folder holds no triples.
        ArtefactError: if a folder is incomplete or damaged.
    """
    return {f"outside graph {number}": _hash(folder) for number, folder in enumerate(folders, 1)}


def _hash(folder: str) -> str:
    outputs = knowledge_files(folder).run.outputs
    if TRIPLES not in outputs:
        raise ConfigError(
            f"`with` '{folder}' holds tables and no triples. Expected a folder from "
            "import-knowledge; `train-recipes` uses tables."
        )
    return outputs[TRIPLES]


def read_outside(folders: Sequence[str], entities: Sequence[str]) -> OutsideTriples | None:
    """Read the triples of knowledge folders, with ids for a graph's ``entities``.

    Equal names in several folders are one node or relation.

    Returns:
        the triples; None without folders.

    Raises:
        ConfigError: if a folder has no triples, none with an entity, or a relation with the name of
            a recipe relation.
        ArtefactError: if a folder is incomplete or damaged.
    """
    if not folders:
        return None
    places = {label: place for place, label in enumerate(entities)}
    relations: dict[str, int] = {name: place for place, name in enumerate(RELATIONS)}
    rows = list[tuple[int, int, int]]()
    for folder in folders:
        before = len(rows)
        # Raises ConfigError if the folder has no triples.
        _hash(folder)
        for head, relation, tail in read_rows(knowledge_files(folder), TRIPLES):
            # Such triples would count as recipes, also as those of the test part.
            if relation in RELATIONS:
                raise ConfigError(
                    f"`with` '{folder}': '{relation}' is a relation of recipes. Rename this "
                    "relation, and import the triples again."
                )
            # A new name gets the next id.
            head_id = places.setdefault(head, len(places))
            relation_id = relations.setdefault(relation, len(relations))
            tail_id = places.setdefault(tail, len(places))
            rows.append((head_id, relation_id, tail_id))
        rows_of_folder = rows[before:]
        ends = {head for head, _, _ in rows_of_folder} | {tail for _, _, tail in rows_of_folder}
        if not any(end < len(entities) for end in ends):
            raise ConfigError(
                f"`with` '{folder}': none of the {len(ends):,} nodes in {TRIPLES} is one of the "
                f"{len(entities):,} entities, such as '{entities[0]}'. Make the folder for this "
                "graph."
            )
    triples = frozen(np.unique(np.array(rows, dtype=np.int64), axis=0))
    # Triples of several folders may be equal, so ends are counted after merging.
    endpoints = np.unique(triples[:, [0, 2]])
    summary = OutsideSummary(
        triples=len(triples),
        nodes=len(places) - len(entities),
        relations=len(relations) - len(RELATIONS),
        coverage=int((endpoints < len(entities)).sum()) / len(entities),
    )
    nodes = tuple(places)[len(entities) :]
    return OutsideTriples(nodes, tuple(relations)[len(RELATIONS) :], triples, summary)
