"""Typed records: what is read from a file or shown to others is a value of a known type, checked once.

A record is a frozen :class:`Record`. Reading one is strict: an unknown key, a missing one or a value of another type is
an error that names the file and the field. Its JSON Schema comes from the type, so that no schema is written by hand.

msgspec does the work: it depends on nothing, imports in milliseconds, and takes the package's frozen dataclasses of
settings as well.
"""

from pathlib import Path
from typing import Any, TypeVar

import msgspec

from wordcraft_kg.errors import ArtefactError

T = TypeVar("T")


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all records: frozen, by keyword, without room for unknown keys."""


def parse_record(data: bytes, kind: type[T], path: Path | str) -> T:
    """Read a record from JSON bytes.

    Raises:
        ArtefactError: naming ``path`` and the field, if the bytes are not JSON or not such a record.
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtefactError(f"{path} is damaged: {error}. Make it again, or restore a copy.") from None


def read_record(path: Path, kind: type[T]) -> T:
    """Read a record from a JSON file.

    Raises:
        ArtefactError: if the file is missing, or damaged, see :func:`parse_record`.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ArtefactError(f"{path} is missing; the folder is incomplete or not of the expected kind.") from None
    return parse_record(data, kind, path)


def as_values(record: Any) -> Any:
    """Return a record as plain values: dictionaries, lists, strings and numbers, ready for JSON."""
    return msgspec.to_builtins(record)


def schema_of(kind: type[Any], identifier: str, title: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a record's type."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": identifier, "title": title}
    return {**head, **msgspec.json.schema(kind)}
