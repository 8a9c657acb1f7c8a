"""Typed records: JSON objects with declared fields, checked when read from a file or shown to a user.

A record type is a subclass of :class:`Record`. Reading is strict: an unknown key, a missing key or a value with the
wrong type is an error that names the file and the field. The JSON Schema is derived from the type.

msgspec has no dependencies, imports in milliseconds, and also handles the package's frozen dataclasses of settings.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform

import msgspec

from wordcraft_kg.base.artefacts import read_small_file
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.settings import MOST

T = TypeVar("T")

Count = Annotated[int, msgspec.Meta(ge=0, le=MOST)]
"""A number from 0 up that fits a NumPy integer."""
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
"""A number from 0 to 1: a probability or a fraction."""
# The length also refuses a final line break, which the pattern alone allows.
Hash = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$", max_length=64)]
"""A SHA-256 hash in hexadecimal."""


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class for all records (typed JSON objects): instances are immutable, and unknown keys are errors."""


def parse_record(data: bytes, kind: type[T], path: Path | str) -> T:
    """Parse JSON bytes as a record of type ``kind``; an ArtefactError names ``path`` and the field that is wrong."""
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _damaged(path, error) from None


def read_record(path: Path, kind: type[T]) -> T:
    """Read a JSON file as a record of type ``kind``, with the errors of :func:`parse_record`."""
    return parse_record(read_small_file(path), kind, path)


def parse_lines(data: bytes, kind: type[T], path: Path | str) -> list[T]:
    """Parse lines of JSON as records of type ``kind``, see :func:`parse_record`; errors also name the line."""
    lines = data.removesuffix(b"\n").split(b"\n") if data else []
    return [
        parse_record(line, kind, f"{path}, line {number},") for number, line in enumerate(lines, 1)
    ]


def as_record(values: Any, kind: type[T], path: Path | str) -> T:
    """Convert plain values to ``kind``, a record or a settings dataclass, with the errors of :func:`parse_record`."""
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise _damaged(path, error) from None


def _damaged(path: Path | str, error: Exception) -> ArtefactError:
    # Fields are in quotes: backticks are for a command's options.
    reason = str(error).replace("`", "'").removesuffix(".")
    return ArtefactError(f"{path} is damaged: {reason}. Make it again, or restore a copy.")


def as_lines(records: Iterable[Any]) -> list[str]:
    """Return each record as a line of JSON text, with a final newline."""
    return [
        json.dumps(as_values(record), ensure_ascii=False, allow_nan=False) + "\n"
        for record in records
    ]


def as_values(record: Any) -> Any:
    """Return a record as JSON values; TypeError without a JSON form, ValueError for a number that is not finite."""
    return json.loads(json.dumps(msgspec.to_builtins(record), allow_nan=False))


def checked_values(record: Record) -> Any:
    """Return a record as plain JSON values, see :func:`as_values`; a ValueError names a field out of bounds."""
    values = as_values(record)
    msgspec.convert(values, type(record))
    return values


def schema_of(kind: type[Any], identifier: str, title: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) for the record type ``kind``."""
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": identifier,
        "title": title,
    }
    return {**head, **msgspec.json.schema(kind)}
