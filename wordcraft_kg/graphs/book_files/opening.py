"""Find how a file is to be read: its container, its encoding, and its shape."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.container import (
    is_zip,
    json_members,
    opened,
    read_bytes,
    zip_names,
)
from wordcraft_kg.graphs.book_files.dialects import delimiter_of
from wordcraft_kg.graphs.book_files.foreign import foreign_format
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_shapes import JsonRecipes
from wordcraft_kg.graphs.book_files.json_text import load_json
from wordcraft_kg.graphs.book_files.lines import SumLines, begins_with_recipe, looks_like_lines
from wordcraft_kg.graphs.book_files.minecraft import (
    MinecraftRecipes,
    folder_files,
    is_recipe_file,
    looks_like_recipe,
    read_folder,
)
from wordcraft_kg.graphs.book_files.options import BookOptions
from wordcraft_kg.graphs.book_files.rows import RowSource
from wordcraft_kg.graphs.book_files.tables import ENDINGS, Table
from wordcraft_kg.graphs.book_files.text import decode

_JSON_ENDINGS = (".json", ".jsonl", ".ndjson", ".ic")
_SAMPLE_LINES = 200


@dataclass(frozen=True)
class OpenedFile:
    """A file whose shape is known.

    Attributes:
        path: the file or folder.
        source: its entries.
        sha256: hash of the content.
        container: see :class:`~wordcraft_kg.graphs.reading.Reading`.
        encoding: see there.
        has_mark: whether the text began with a byte order mark.
        text: the text; empty for a folder.
    """

    path: Path
    source: RowSource
    sha256: str
    container: str = ""
    encoding: str = ""
    has_mark: bool = False
    text: str = ""


def open_source(path: Path, options: BookOptions) -> OpenedFile:
    """Find a file's container, encoding and shape.

    Args:
        path: a file, or a folder of Minecraft recipes.
        options: what the user says about the file; it goes before any guess.

    Returns:
        The file with its entries, which are read only while iterating.

    Raises:
        RecipeFileError: if the file cannot be read, or its shape is unknown or not certain.
        ConfigError: if the option `columns` names no column, or the shape has none.
    """
    if path.is_dir():
        files = folder_files(path)
        if files:
            contents = list(read_folder(path, files))
            return OpenedFile(path, MinecraftRecipes(contents), _hash_of(contents))
    data = read_bytes(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if is_zip(data) and _is_data_pack(path, data):
        return OpenedFile(path, MinecraftRecipes(json_members(path, data)), sha256, "zip")
    content = opened(path, data)
    decoded = decode(path, content.data, options.encoding)
    source = _source_of(path, Path(content.name).suffix.lower(), decoded.text, options)
    return OpenedFile(
        path, source, sha256, content.container, decoded.encoding, decoded.has_mark, decoded.text
    )


def _is_data_pack(path: Path, data: bytes) -> bool:
    """Return whether an archive holds recipes of Minecraft."""
    recipe_names = list(filter(is_recipe_file, zip_names(path, data)))
    if len(recipe_names) != 1:
        return bool(recipe_names)
    # A single file may be a recipe book, in a folder called recipes.
    for name, content in json_members(path, data):
        if name in recipe_names and looks_like_recipe(name, content):
            return True
    return False


def _hash_of(contents: Sequence[tuple[str, bytes]]) -> str:
    """Return a hash of files' names and bytes."""
    digest = hashlib.sha256()
    for name, data in contents:
        digest.update(json.dumps([name, len(data)]).encode())
        digest.update(data)
    return digest.hexdigest()


def _source_of(path: Path, ending: str, text: str, options: BookOptions) -> RowSource:
    """Return the reader for a text: its beginning counts more than the file's ending."""
    delimiter = None if options.delimiter is None else delimiter_of(options.delimiter)
    named = Path(path.stem + ending)
    is_lines = delimiter is None and _are_lines(text)
    begins_like_json = text.lstrip()[:1] in ("{", "[")
    if ending in _JSON_ENDINGS or (begins_like_json and _is_json(path, text)):
        return JsonRecipes(path, text, options.columns)
    if is_lines and options.columns is not None:
        seen = "lines a + b = c, which have no columns"
        raise refusal(path, seen, "lines", "Leave `columns` out.")
    # Lines are often saved under the ending of a table.
    if is_lines or (
        delimiter is None
        and options.columns is None
        and ending not in ENDINGS
        and looks_like_lines(_first_lines(text))
    ):
        return SumLines(path, text)
    try:
        return Table(path, text, delimiter, options.columns, usual=ENDINGS.get(named.suffix, ","))
    except RecipeFileError:
        foreign = foreign_format(text)
        if foreign is None:
            raise
        raise refusal(path, f"{foreign}, which is not read", "table") from None


def _is_json(path: Path, text: str) -> bool:
    try:
        load_json(path, text)
    except RecipeFileError as error:
        return "not JSON" not in str(error)
    return True


def _first_lines(text: str) -> list[str]:
    lines = text[: 2**17].splitlines()
    return [line for line in lines if line.strip()][:_SAMPLE_LINES]


def _are_lines(text: str) -> bool:
    """Return whether lines are sums whatever the file's ending: no delimiter, or after a sum."""
    lines = _first_lines(text)
    start = "\n".join(lines[:20])
    if not any(sign in start for sign in ",;\t|"):
        return looks_like_lines(lines)
    # Several results after commas, as in a + b = c, d.
    return all(begins_with_recipe(line) for line in lines)
