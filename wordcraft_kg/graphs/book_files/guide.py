"""Refusals of files: the shape seen, the nearest readable shape, and the guide's anchor."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.base.errors import RecipeFileError

GUIDE = "docs/your-file.md"
"""Guide with an example of each readable shape."""
SHAPES = {
    "table": "a table with two columns of ingredients and one of results: a,b,result",
    "lines": "a line for each recipe: water + earth = mud",
    "json": 'JSON such as {"mud": [["water", "earth"]]} or '
    '[{"name": "mud", "recipes": [["water", "earth"]]}]',
    "infinite-craft": 'a save of Infinite Craft: {"items": [{"id": 0, "text": "Water"}, ...]}',
    "minecraft": "a data pack with JSON files in a folder recipe or recipes",
    "compressed": "a file that is gzip, or a zip archive with one recipe book",
    "encodings": "text in UTF-8",
    "arities": "recipes of two ingredients, or any number with `ingredients` chain",
}
"""Readable shapes by the anchor of their section in the guide."""


def refusal(path: Path | str, seen: str, anchor: str, remedy: str = "") -> RecipeFileError:
    """Return the error for a file that is not read; the caller raises it.

    Args:
        path: the file.
        seen: what was seen, and what is missing.
        anchor: key of :data:`SHAPES`: the nearest readable shape.
        remedy: a sentence about what to do; empty if the readable shape says it.

    Returns:
        The error, which names the nearest readable shape and the guide.
    """
    hint = f" {remedy}" if remedy else ""
    return RecipeFileError(
        f"{path}: {seen}.{hint} Nearest readable shape: {SHAPES[anchor]}. See {GUIDE}#{anchor}."
    )


@contextmanager
def naming_the_guide(path: Path) -> Iterator[None]:
    """Add the guide to the refusal of a file that is read inside, unless it names it.

    A damaged graph folder is no file of a user, and no readable shape helps it.

    Args:
        path: the file that is read inside.

    Raises:
        RecipeFileError: the refusal of the code inside, with the address of the guide.
    """
    try:
        yield
    except RecipeFileError as error:
        if GUIDE in str(error) or path.name == "graph.json":
            raise
        raise RecipeFileError(f"{str(error).rstrip('.')}. See {GUIDE}.") from None
