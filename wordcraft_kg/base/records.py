"""Typed records: JSON objects with declared fields, checked when read or shown to a user.

A record type is a subclass of :class:`Record`. Reading is strict: an unknown key, a missing key or
a value with the wrong type is an error that names the file and the field. The JSON Schema is
derived from the type, and the descriptions of its properties from the ``Attributes`` section of
the class docstring; no schema is written by hand, and no fact stands twice.

msgspec has no dependencies, imports in milliseconds, and also handles the package's frozen
dataclasses of settings.
"""

import inspect
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform

import msgspec
from msgspec.inspect import DataclassType, Field, StructType, Type, type_info

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

_SECTION = re.compile(r"^Attributes:\n((?:(?: .*)?\n)*)", re.MULTILINE)
"""The ``Attributes`` section of a docstring; group 1 has the indented lines below the heading."""
_ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): ((?:.*)(?:\n {5,}.*)*)", re.MULTILINE)
"""An entry of the section; groups: the name, or several names with commas, and the text."""


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class for all records (typed JSON objects): immutable, and unknown keys are errors.

    Describe each field in the ``Attributes`` section of the subclass's docstring; :func:`schema_of`
    copies these descriptions into the JSON Schema.
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
        return msgspec.json.decode(data, type=kind, dec_hook=_tuple_of_texts)
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
        return msgspec.convert(values, kind, dec_hook=_tuple_of_texts)
    except msgspec.ValidationError as error:
        raise _damaged(path, error) from None


def _tuple_of_texts(kind: type, value: Any) -> Any:
    """Return a value of a subclass of tuples of texts, such as a recipe, for its JSON array.

    Raises:
        ValueError: for any other value, which msgspec reports with its place.
    """
    is_array = isinstance(value, list) and all(isinstance(text, str) for text in value)
    if not (is_array and issubclass(kind, tuple)):
        raise ValueError(f"Expected an array of texts, got {type(value).__name__}")
    return tuple.__new__(kind, value)


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
    msgspec.convert(values, type(record), dec_hook=_tuple_of_texts)
    return values


def schema_of(
    kind: type[Any],
    identifier: str,
    title: str,
) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) for a record type, with a description of each field.

    Args:
        kind: record type.
        identifier: the schema's ``$id``, a URN or URL.
        title: the schema's title.
    """
    records = _records_in(kind)
    (head, *references), definitions = msgspec.json.schema_components((kind, *records))
    # References tell under which name msgspec has put each class: a name that two modules use is
    # qualified by both modules.
    for reference, (record, fields) in zip(references, records.items(), strict=True):
        definition = definitions[reference["$ref"].removeprefix("#/$defs/")]
        if record.__doc__:
            definition["description"] = _SECTION.sub("", _docstring(record)).strip()
        texts = attributes_of(record)
        for number, field in enumerate(fields):
            if field.name not in texts:
                continue
            if "prefixItems" in definition:  # a record that is written as an array
                definition["prefixItems"][number]["description"] = texts[field.name]
            else:
                definition["properties"][field.encode_name]["description"] = texts[field.name]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": identifier,
        "title": title,
        **head,
        "$defs": definitions,
    }


def attributes_of(kind: type[Any]) -> dict[str, str]:
    """Return the descriptions in the ``Attributes`` sections of a class and its bases, by name.

    An entry ``low, high: the interval`` describes both names. A class's description takes
    precedence over the description in a base class.
    """
    texts: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        section = _SECTION.search(_docstring(each))
        for entry in _ENTRY.finditer(section[1] if section else ""):
            text = " ".join(entry[2].split())
            texts |= dict.fromkeys(entry[1].split(", "), text)
    return texts


def _docstring(kind: type[Any]) -> str:
    return inspect.cleandoc(kind.__doc__ or "") + "\n"


def _records_in(kind: type[Any]) -> dict[type[Any], tuple[Field, ...]]:
    """Return the fields of all records and dataclasses that a type holds, by class."""
    found: dict[type[Any], tuple[Field, ...]] = {}
    waiting: list[Any] = [type_info(kind)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, StructType | DataclassType):
            if node.cls in found:  # a record may hold itself
                continue
            found[node.cls] = node.fields
        if isinstance(node, Type | Field):
            # Descriptions of types are records themselves: an item type, a key type, fields.
            waiting += msgspec.structs.astuple(node)
        elif isinstance(node, tuple):
            waiting += node
    return found
