"""Typed records: JSON objects with declared fields, checked when read or shown to a user.

A record type is a subclass of :class:`Record`. Reading is strict: an unknown key, a missing key or
a value with the wrong type is an error that names the file and the field. The JSON Schema is
derived from the type and its docstring; no schema is written by hand, and no fact stands twice.

msgspec has no dependencies, imports in milliseconds, and also handles the package's frozen
dataclasses of settings.
"""

import inspect
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform

import msgspec

from wordcraft_kg.base.artefacts import json_text, read_small_file
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.settings import MOST

T = TypeVar("T")

Count = Annotated[int, msgspec.Meta(ge=0, le=MOST)]
"""A number from 0 up that fits a NumPy integer."""
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
"""A number from 0 to 1: a probability or a fraction."""
Coefficient = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
"""A fitted number of a curve; products and sums of a few of them are finite."""
Slope = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
"""A fitted slope of a curve that never falls."""
# The length also refuses a final line break, which the pattern alone allows.
Hash = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$", max_length=64)]
"""A SHA-256 hash in hexadecimal."""


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class for all records (typed JSON objects): immutable, and unknown keys are errors.

    Describe each field in the ``Attributes`` section of the subclass's docstring, which is also the
    description in the JSON Schema.
    """


def parse_record(
    data: bytes,
    kind: type[T],
    path: Path | str,
    *,
    is_verified: bool = False,
) -> T:
    """Parse JSON bytes as a record.

    Args:
        data: UTF-8 text with one JSON value.
        kind: type of the record.
        path: where the bytes come from, for the error.
        is_verified: whether a hash says that the bytes are as they were written. If they do not
            fit, another version of the package wrote them, and the message says so.

    Raises:
        ArtefactError: if the bytes are not JSON or do not fit ``kind``; the message names ``path``
            and the field.
    """
    try:
        return msgspec.json.decode(data, type=kind, dec_hook=_from_array)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        if is_verified:
            raise ArtefactError(
                f"{path} has the format of another version of wordcraft-kg: {_detail(error)}. "
                "Train again."
            ) from None
        raise _damaged(path, error) from None


def read_record(path: Path, kind: type[T]) -> T:
    """Read a JSON file as a record of type ``kind``; errors as in :func:`parse_record`.

    Raises:
        ArtefactError: also if the file is missing or too large for a file of records.
    """
    return parse_record(read_small_file(path), kind, path)


def parse_lines(
    data: bytes,
    kind: type[T],
    path: Path | str,
) -> list[T]:
    """Parse JSON Lines as records, see :func:`parse_record`.

    Args:
        data: UTF-8 text, a JSON value per line; a final newline is optional.
        kind: type of every record.
        path: where the bytes come from, for the error.

    Raises:
        ArtefactError: if a line does not fit; the message also names the line number.
    """
    records = []
    lines = data.removesuffix(b"\n").split(b"\n") if data else []
    for number, line in enumerate(lines, 1):
        records.append(parse_record(line, kind, f"{path}, line {number},"))
    return records


def as_record(
    values: Any,
    kind: type[T],
    path: Path | str,
) -> T:
    """Convert plain values, such as those of a TOML table, to a record or a settings dataclass.

    Args:
        values: dictionaries, lists, strings and numbers.
        kind: type of the result.
        path: where the values come from, for the error.

    Raises:
        ArtefactError: if the values do not fit ``kind``; the message names ``path`` and the field.
    """
    try:
        return msgspec.convert(values, kind, dec_hook=_from_array)
    except msgspec.ValidationError as error:
        raise _damaged(path, error) from None


def _from_array(kind: type[Any], value: Any) -> Any:
    """Make a tuple of labels, such as a recipe, from its JSON array.

    Args:
        kind: a subclass of ``tuple`` with a class method ``of``.
        value: what JSON has in its place.

    Raises:
        TypeError: if ``value`` is no list of strings, or too short.
        NotImplementedError: for any other type.
    """
    if not issubclass(kind, tuple):
        raise NotImplementedError(f"{kind.__name__} has no form in JSON.")
    if not isinstance(value, list) or not all(isinstance(label, str) for label in value):
        raise TypeError(f"Expected `array` of `str` for {kind.__name__}")
    return kind.of(*value)  # type: ignore[attr-defined]


def _schema_of_array(kind: type[Any]) -> dict[str, Any]:
    """Return the JSON Schema of a tuple of labels, see :func:`_from_array`."""
    return {"type": "array", "items": {"type": "string"}, "title": kind.__name__}


def _damaged(path: Path | str, error: Exception) -> ArtefactError:
    return ArtefactError(f"{path} is damaged: {_detail(error)}. Make it again, or restore a copy.")


def _detail(error: Exception) -> str:
    # Fields are in quotes: backticks are for a command's options.
    return str(error).replace("`", "'").removesuffix(".")


def as_lines(records: Iterable[Any]) -> list[str]:
    """Return each record as a line of JSON text, with a final newline.

    Raises:
        TypeError: if a value has no JSON form, such as a NumPy number.
        ArtefactError: if a number is not finite.
    """
    return [json_text(as_values(record)) + "\n" for record in records]


def as_values(record: Any) -> Any:
    """Return a record as JSON values: dictionaries, lists, strings and numbers.

    Raises:
        TypeError: if a value has no JSON form, such as a NumPy number.
        ArtefactError: if a number is not finite.
    """
    # The round trip through text turns tuples into lists and refuses what JSON cannot hold.
    return json.loads(json_text(msgspec.to_builtins(record)))


def checked_values(record: Record) -> Any:
    """Return a record as plain JSON values, see :func:`as_values`, after a check of all fields.

    A record made in Python is not checked by msgspec; this function checks types and bounds.

    Raises:
        ValueError: if a field has another type or is out of bounds, with its name; ArtefactError
            if a number is not finite.
        TypeError: if a value has no JSON form, such as a NumPy number.
    """
    values = as_values(record)
    msgspec.convert(values, type(record), dec_hook=_from_array)
    return values


def schema_of(
    kind: type[Any],
    identifier: str,
    title: str,
) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) for a record type, described by its docstrings.

    Args:
        kind: record type.
        identifier: the schema's ``$id``, a URN or URL.
        title: the schema's title.
    """
    (head,), definitions = msgspec.json.schema_components((kind,), schema_hook=_schema_of_array)
    for definition in definitions.values():
        if "description" in definition:
            definition["description"] = inspect.cleandoc(definition["description"])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": identifier,
        "title": title,
        **head,
        "$defs": definitions,
    }
