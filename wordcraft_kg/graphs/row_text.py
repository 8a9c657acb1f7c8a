"""The text of many rows of ids: what tables and JSON of millions of recipes and triples consist of.

A line of its own for each row would take most of the time in which a large graph is written.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from wordcraft_kg.graphs.arrays import Ids

_PIECE = 2**13  # rows in a piece of text: its arrays fit into a processor's cache


def row_text(rows: Ids, columns: Sequence[Iterable[str]]) -> Iterator[str]:
    r"""Yield the text of rows in pieces of many rows.

    All cells are encoded once, one behind the other. The bytes of a row are then looked up by their
    places, for thousands of rows at once.

    Args:
        rows: shape (n, k), ids.
        columns: k times the text of each id, with delimiters and line ends.

    Example:
        >>> labels = ["earth", "mud", "water"]
        >>> columns = [f"{label}," for label in labels], [f"{label}\n" for label in labels]
        >>> "".join(row_text(np.array([[0, 1], [2, 1]]), columns))
        'earth,mud\nwater,mud\n'
    """
    if not len(rows):
        return
    # Texts of all columns follow each other, so a column's ids begin behind those of the last one.
    texts: list[bytes] = []
    first_of_column = []
    for column in columns:
        first_of_column.append(len(texts))
        texts += [text.encode() for text in column]
    letters = np.frombuffer(b"".join(texts), np.uint8)
    # Half the memory of usual indices, and a quarter less time.
    index_type = np.int32 if len(letters) < 2**31 else np.int64
    lengths = np.array(list(map(len, texts)))
    lengths = lengths.astype(index_type)
    # The letters hold all texts now; the objects would take far more memory.
    del texts
    starts = np.cumsum(lengths, dtype=index_type) - lengths
    for first in range(0, len(rows), _PIECE):
        # Place of each cell's text, row by row: shape (rows in the piece * k,).
        piece = rows[first : first + _PIECE] + first_of_column
        cells = piece.ravel()
        cell_lengths = lengths[cells]
        ends = np.cumsum(cell_lengths, dtype=index_type)
        # Letter i of the piece is letter i + shift of all texts, with a shift for each cell.
        shifts = starts[cells] - (ends - cell_lengths)
        places = np.arange(ends[-1], dtype=index_type)
        places += np.repeat(shifts, cell_lengths)
        yield letters[places].tobytes().decode()


def json_recipes(recipes: Ids, texts: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a JSON array of recipes, with a comma between two of them.

    Args:
        recipes: shape (n, columns), rows (ingredients, padding, result) of ids; the padding after
            the last ingredient is the number of texts.
        texts: each entity's label as JSON.
    """
    if not len(recipes):
        return
    first = [f"[{text}, " for text in texts]
    middle_texts = [*(f"{text}, " for text in texts), ""]
    last = [f"{text}],\n" for text in texts]
    columns = [first, *[middle_texts] * (recipes.shape[1] - 2), last]
    yield from row_text(recipes[:-1], columns)
    labels = [texts[entity] for entity in recipes[-1].tolist() if entity < len(texts)]
    yield f"[{', '.join(labels)}]\n"
