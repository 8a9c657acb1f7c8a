"""Knowledge folders: what a source outside the book says about pairs of entities, as tables and triples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import safetensors.torch
import torch
from torch import Tensor

from wordcraft_kg.base.artefacts import dump_json, staged_folder, with_a_name, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.records import Count, Record, as_values
from wordcraft_kg.base.tensors import copied
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import end_run, read_finished_run, start_run

KNOWLEDGE, TABLES, TRIPLES = "knowledge.json", "tables.safetensors", "triples.tsv"
FACTS = "facts.tsv"
"""Optional file for explanations, with a header: entity, relation phrase such as ``is a``, and entity or class."""
EXPECTED = "a knowledge folder from elicit or import-knowledge"
Role = Literal["part", "pair"]
"""``part``: a cell is (ingredient, result); ``pair``: a cell is (ingredient, ingredient), symmetric."""


class TableInfo(Record, frozen=True, kw_only=True):
    """A table's name, role and phrase, such as ``{result} needs {ingredient}``, or with ``{a}`` and ``{b}``."""

    name: str
    role: Role
    phrase: str


class KnowledgeRecord(Record, frozen=True, kw_only=True):
    """The file ``knowledge.json``: source, labels in row order, table descriptions, number of triples."""

    format: Literal["wordcraft-kg knowledge 1"] = "wordcraft-kg knowledge 1"
    source: str
    entities: tuple[str, ...]
    tables: tuple[TableInfo, ...]
    triples: Count = 0


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Tables (E, E) of one source of knowledge outside the book, float16; 0 where the source says nothing."""

    record: KnowledgeRecord
    tables: tuple[Tensor, ...]

    def of_entities(self, entities: Sequence[str]) -> "Knowledge":
        """Return the tables for other labels in another order; rows and columns of missing labels are 0."""
        if tuple(entities) == self.record.entities:
            return self
        place = {label: row for row, label in enumerate(self.record.entities)}
        known = [row for row, label in enumerate(entities) if label in place]
        rows, columns = (
            torch.tensor(known, dtype=torch.int64),
            torch.tensor([place[entities[row]] for row in known]),
        )

        def moved(table: Tensor) -> Tensor:
            result = torch.zeros(len(entities), len(entities), dtype=torch.half)
            if known:
                result[rows[:, None], rows] = table[columns[:, None], columns]
            return result

        record = msgspec.structs.replace(self.record, entities=tuple(entities))
        return Knowledge(record, tuple(map(moved, self.tables)))

    def coverage(self, entities: Sequence[str]) -> float:
        """Return the share of labels that the source describes: labels with a cell other than 0."""
        has_cell = (
            torch.stack([(table != 0).any(0) | (table != 0).any(1) for table in self.tables])
            .any(0)
            .tolist()
        )
        known = {
            label
            for label, is_known in zip(self.record.entities, has_cell, strict=True)
            if is_known
        }
        return sum(label in known for label in entities) / max(len(entities), 1)


def write_knowledge(
    out: str | Path,
    command: str,
    knowledge: Knowledge,
    *,
    inputs: Mapping[str, str],
    files: Mapping[str, str | bytes],
    force: bool = False,
) -> Path:
    """Write a knowledge folder, complete or not at all; OutputExistsError if it exists and ``force`` is False.

    ``command`` is the name of the writing command. ``inputs`` are SHA-256 hashes of what the tables were made from,
    such as graph, weights and prompts; ``files`` are further files by name, such as ``README.md``.
    """
    folder = with_a_name(Path(out))
    tensors = {
        info.name: table
        for info, table in zip(knowledge.record.tables, knowledge.tables, strict=True)
    }
    with staged_folder(folder, force=force) as staging:
        write_atomically(staging / KNOWLEDGE, dump_json(as_values(knowledge.record)))
        write_atomically(staging / TABLES, safetensors.torch.save(copied(tensors)))
        for name, content in files.items():
            write_atomically(staging / name, content)
        end_run(
            staging, start_run(staging, command, inputs=inputs), "done", (KNOWLEDGE, TABLES, *files)
        )
    return folder


def read_knowledge(folder: str | Path) -> Knowledge:
    """Read a knowledge folder; ArtefactError if unfinished, incomplete, damaged or of another kind."""
    files = knowledge_files(folder)
    record, tensors = files.record(KNOWLEDGE, KnowledgeRecord), files.tensors(TABLES)
    size, names = len(record.entities), [info.name for info in record.tables]
    if {*names} != {*tensors} or any(tensor.shape != (size, size) for tensor in tensors.values()):
        raise ArtefactError(
            f"{files.folder / TABLES} does not hold the tables in {KNOWLEDGE}, with {size} rows and columns. Make the "
            "folder again."
        )
    return Knowledge(record, tuple(tensors[name].half() for name in names))


def knowledge_files(folder: str | Path) -> RunFiles:
    """Return verified access to the files of a knowledge folder; errors as :func:`read_knowledge`."""
    return RunFiles(Path(folder), read_finished_run(Path(folder), EXPECTED, KNOWLEDGE))


def check_same_split(spec: str, opened: OpenedGraph) -> None:
    """Raise ConfigError if a knowledge folder was made with the train recipes of another split of the same graph."""
    inputs = knowledge_files(spec).run.inputs
    if (
        inputs.get("graph") == opened.graph.hash
        and inputs.get("split", opened.split.hash) != opened.split.hash
    ):
        raise ConfigError(
            f"`with` '{spec}' was made with the train recipes of another split, which may be test recipes here. Make "
            "the folder again from this graph folder."
        )
