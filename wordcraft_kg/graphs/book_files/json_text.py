"""Parse JSON and JSON lines, with errors that name the line."""

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import RecipeFileError

_START = re.compile(r'\s*(?:[\[{]\s*)+"')
"""Brackets before a text in quotes, as at the start of lists of labels and of objects."""


def is_json(text: str) -> bool:
    """Return whether a text begins as JSON does, whatever its file's ending."""
    return _START.match(text) is not None


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
        # JSON lines look to a parser like a value in the first line, and more behind it.
        first_value = text[: error.pos].strip()
        if error.msg != "Extra data" or error.lineno == 1 or "\n" in first_value:
            raise _not_json(path, error.lineno, error) from None
    # Only line feeds: other separators, such as U+2028, may stand in a text.
    lines = enumerate(text.split("\n"), start=1)
    return [parsed_json(path, line, number) for number, line in lines if line.strip()], True


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
