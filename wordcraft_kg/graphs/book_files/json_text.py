"""Parse JSON and JSON lines, with errors that name the line."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError

_JUDGED_LINES = 1_000  # lines by which JSON lines are told from damaged JSON


def load_json(path: Path, text: str) -> tuple[Any, bool]:
    """Parse JSON, or JSON lines as a list.

    Args:
        path: the file, for errors.
        text: the whole text.

    Returns:
        The value, and whether it was JSON lines.

    Raises:
        RecipeFileError: if it is neither, with the line of the first fault; or for JSON that no
            book can be, such as an object with a key twice.
    """
    try:
        return _loads(path, text), False
    except json.JSONDecodeError as error:
        # A second value after the first one is what JSON lines look like to a parser.
        begins_another = error.msg == "Extra data" and error.lineno > 1
        if begins_another and _are_json_lines(text):
            return _parsed_lines(path, text), True
        raise _not_json(path, error.lineno, error) from None


def parsed_json(path: Path | str, text: str, line: int | None = None) -> Any:
    """Parse one JSON value.

    Args:
        path: the file, for errors.
        text: the value.
        line: number of the text's line in the file; None for a text that is the whole file.

    Raises:
        RecipeFileError: if it is not JSON, with the line; or for JSON that no book can be, such as
            an object with a key twice.
    """
    try:
        return _loads(path, text)
    except json.JSONDecodeError as error:
        raise _not_json(path, error.lineno if line is None else line, error) from None


def _lines_of(text: str) -> list[str]:
    """Return lines between line feeds; other separators, such as U+2028, may stand in a text."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _are_json_lines(text: str) -> bool:
    filled = [line for line in _lines_of(text) if line.strip()]
    judged = filled[:_JUDGED_LINES]
    return len(filled) > 1 and all(line.lstrip()[:1] in "{[" for line in judged)


def _parsed_lines(path: Path, text: str) -> list[Any]:
    values = []
    for number, line in enumerate(_lines_of(text), start=1):
        if line.strip():
            values.append(parsed_json(path, line, number))
    return values


def _not_json(path: Path | str, line: int, error: json.JSONDecodeError) -> RecipeFileError:
    return RecipeFileError(f"{path}, line {line}, column {error.colno}: not JSON ({error.msg}).")


def _loads(path: Path | str, text: str) -> Any:
    """Parse JSON; an object with a key twice is refused, where Python would drop the first.

    Raises:
        json.JSONDecodeError: if it is not JSON.
        RecipeFileError: if it is JSON that no book can be.
    """

    def without_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        value = dict(pairs)
        if len(value) < len(pairs):
            counts = Counter(key for key, _ in pairs)
            repeated = [key for key in value if counts[key] > 1]
            raise RecipeFileError(f"{path}: the key '{repeated[0]}' occurs twice in one object.")
        return value

    try:
        return json.loads(text, object_pairs_hook=without_duplicate_keys)
    except (json.JSONDecodeError, RecipeFileError):
        raise
    except RecursionError:
        raise RecipeFileError(f"{path}: nested too deeply for a recipe book.") from None
    except ValueError as error:  # such as a number of thousands of digits
        raise RecipeFileError(f"{path}: not a recipe book ({error}).") from None


def is_json(path: Path, text: str) -> bool:
    """Return whether a text is JSON or JSON lines, whatever its file's ending.

    Args:
        path: the file, for errors.
        text: its text.
    """
    if text.lstrip()[:1] not in ("{", "["):
        return False
    try:
        load_json(path, text)
    except RecipeFileError as error:
        return "not JSON" not in str(error)
    return True
