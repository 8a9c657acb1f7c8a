"""Knowledge folders: tables and triples from a source outside the book.

The page docs/architecture.md, *On disk*, lists the files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import safetensors.torch
import torch
from torch import Tensor

from wordcraft_kg.base import (
    ArtefactError,
    Count,
    Record,
    as_values,
    dump_json,
)
from wordcraft_kg.base.tensors import copied
from wordcraft_kg.runs.record import RunFiles, read_finished_run, write_run

KNOWLEDGE = "knowledge.json"
TABLES = "tables.safetensors"
TRIPLES = "triples.tsv"
"""Optional file of triples for joint training, from general graphs."""
EXPECTED = "a knowledge folder from elicit or import-knowledge"
Role = Literal["part", "pair"]
"""Cells of ``part`` are (ingredient, result), of ``pair`` (ingredient, ingredient), symmetric."""
PLACES = {"part": ("{ingredient}", "{result}"), "pair": ("{a}", "{b}")}
"""Places for the labels of a cell's row and column in a table's phrase, by role."""


class TableInfo(Record, frozen=True, kw_only=True):
    """The description of a table.

    Attributes:
        name: the tensor's name in ``tables.safetensors``.
        role: what a cell is about, see :data:`Role`.
        phrase: words for explanations, such as ``{result} needs {ingredient}``, or with ``{a}`` and
            ``{b}``.
    """

    name: str
    role: Role
    phrase: str

    def words(self, row: str, column: str) -> str:
        """Return the phrase with the labels of a cell's row and column."""
        row_place, column_place = PLACES[self.role]
        return self.phrase.replace(row_place, row).replace(column_place, column)


class KnowledgeRecord(Record, frozen=True, kw_only=True):
    """The file ``knowledge.json``.

    Attributes:
        format: name and version of the file format.
        source: display name of the source, such as a language model or WordNet.
        entities: labels of the tables' rows and columns, in order.
        tables: descriptions of the tables.
        triples: number of lines in ``triples.tsv`` without the header; 0 without this file.
    """

    format: Literal["wordcraft-kg knowledge 1"] = "wordcraft-kg knowledge 1"
    source: str
    entities: tuple[str, ...]
    tables: tuple[TableInfo, ...]
    triples: Count = 0


@dataclass(frozen=True, eq=False)
class KnowledgeTables:
    """Tables of one source of knowledge outside the book.

    Attributes:
        record: source, labels and descriptions.
        tables: shape (E, E) each, float16, in the record's order; 0 where the source says nothing.
    """

    record: KnowledgeRecord
    tables: tuple[Tensor, ...]

    def of_entities(self, entities: Sequence[str]) -> "KnowledgeTables":
        """Return the tables for other labels or another order; missing labels have zeros."""
        if tuple(entities) == self.record.entities:
            return self
        row_of = {label: row for row, label in enumerate(self.record.entities)}
        # Missing labels have the row and the column behind the last, of zeros.
        ids = [row_of.get(label, len(row_of)) for label in entities]
        rows = torch.tensor(ids, dtype=torch.int64)
        with_zeros = (torch.nn.functional.pad(table, (0, 1, 0, 1)) for table in self.tables)
        tables = [table[rows[:, None], rows] for table in with_zeros]
        record = msgspec.structs.replace(self.record, entities=tuple(entities))
        return KnowledgeTables(record, tuple(tables))

    def coverage(self) -> float:
        """Return the share of labels that the source describes: labels with a cell other than 0."""
        is_described = torch.zeros(len(self.record.entities), dtype=torch.bool)
        for table in self.tables:
            has_value = table != 0
            # By row and by column: an entity may be an ingredient only, or a result only.
            is_described |= has_value.any(1) | has_value.any(0)
        return int(is_described.sum()) / max(len(is_described), 1)


def write_knowledge(
    out: str | Path,
    command: str,
    knowledge: KnowledgeTables,
    *,
    inputs: Mapping[str, str],
    files: Mapping[str, str | bytes],
    force: bool = False,
) -> Path:
    """Write a knowledge folder, complete or not at all.

    Args:
        out: the folder.
        command: name of the writing command.
        knowledge: the tables.
        inputs: SHA-256 hashes of what the tables were made from, such as graph, weights and
            prompts.
        files: contents of further files by name, such as ``README.md``.
        force: replace the folder.

    Returns:
        the folder.

    Raises:
        OutputExistsError: if the folder exists and ``force`` is False.
    """
    names = [info.name for info in knowledge.record.tables]
    tensors = dict(zip(names, knowledge.tables, strict=True))
    contents = {
        KNOWLEDGE: dump_json(as_values(knowledge.record)),
        TABLES: safetensors.torch.save(copied(tensors)),
        **files,
    }
    return write_run(out, command, contents, inputs=inputs, force=force)


def read_knowledge(folder: str | Path) -> KnowledgeTables:
    """Read the tables of a knowledge folder.

    Raises:
        ArtefactError: if the folder is unfinished, incomplete, damaged or of another kind.
    """
    files = knowledge_files(folder)
    record = files.record(KNOWLEDGE, KnowledgeRecord)
    tensors = files.tensors(TABLES)
    size = len(record.entities)
    names = [info.name for info in record.tables]
    has_shape = all(tensor.shape == (size, size) for tensor in tensors.values())
    if set(names) != set(tensors) or not has_shape:
        raise ArtefactError(
            f"{files.folder / TABLES} does not hold the tables in {KNOWLEDGE}, with {size} rows "
            "and columns. Make the folder again."
        )
    return KnowledgeTables(record, tuple(tensors[name].half() for name in names))


def knowledge_files(folder: str | Path) -> RunFiles:
    """Return access to the files of a knowledge folder, each checked by hash when it is read.

    Args:
        folder: the knowledge folder.

    Raises:
        ArtefactError: if the folder is unfinished, incomplete, damaged or of another kind.
    """
    folder = Path(folder)
    return RunFiles(folder, read_finished_run(folder, EXPECTED, KNOWLEDGE))


def read_triples_of(files: RunFiles) -> list[list[str]]:
    """Return the triples of names in a knowledge folder.

    Raises:
        ArtefactError: if the file is missing, has changed, or a line has other columns.
    """
    text = files.bytes(TRIPLES).decode(errors="replace").removesuffix("\n")
    # Split at newlines alone: labels may have other line ends.
    _, *lines = text.split("\n")
    rows = [line.split("\t") for line in lines]
    if any(len(row) != 3 for row in rows):
        raise ArtefactError(
            f"{files.folder / TRIPLES} has lines of other than 3 columns. Make the folder again."
        )
    return rows
