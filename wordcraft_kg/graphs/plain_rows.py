"""All rows of a plain table at once: the quick way to read a book of millions of recipes.

It takes a table in which each row is three labels and nothing else: no quotes, no blanks around
cells, no comments, no empty cells. It judges nothing: any other table gets None, and is read row by
row, where each oddity has its rule and each fault its line.
"""

from collections import defaultdict
from collections.abc import Callable
from itertools import count

import numpy as np

from wordcraft_kg.graphs.recipes import RecipeRows

_PIECE = 2**20  # characters that are parted at once; all cells of a large book would take gigabytes


def number_plain_rows(
    text: str,
    start: int,
    delimiter: str,
    has_fault: Callable[[str], object],
) -> RecipeRows | None:
    """Return the rows of a plain table, in file order, or None if any row is not plain.

    Args:
        text: text of the file.
        start: place of the first row in it.
        delimiter: one character between cells.
        has_fault: returns a true value for a cell that is no label; each cell is judged once.

    Returns:
        The rows, with labels numbered in the order in which they are met. None also for a table
        without rows.
    """
    # Blanks around cells are looked for below; a blank between cells would be one of them.
    if delimiter == " " or not delimiter.isascii():
        return None
    number_of: defaultdict[str, int] = defaultdict(count().__next__)
    pieces = []
    while start < len(text):
        # Up to the end of a line; a last line may have none.
        end = text.find("\n", start + _PIECE) + 1 or len(text)
        piece = text[start:end]
        start = end
        if not _is_plain(piece, delimiter):
            return None
        # All cells of the piece in one list: a line end parts cells as a delimiter does.
        cells = piece.removesuffix("\n").replace("\n", delimiter).split(delimiter)
        numbers = map(number_of.__getitem__, cells)
        pieces.append(np.fromiter(numbers, np.int64, len(cells)))
    if not pieces:
        return None
    if any(map(has_fault, number_of)):
        return None
    # Three cells each, in file order: shape (num_rows, 3).
    ids = np.concatenate(pieces).reshape(-1, 3)
    return RecipeRows(number_of, ids)


def _is_plain(piece: str, delimiter: str) -> bool:
    """Return whether whole lines consist of three cells each, without blanks and quotes."""
    blanks = (f" {delimiter}", f"{delimiter} ", " \n", "\n ")
    # A byte order mark, and line ends of other systems, have their own rules.
    if any(sign in piece for sign in ('"', "\r", "\ufeff", *blanks)):
        return False
    if piece[0] == " " or piece[-1] == " ":
        return False
    letters = np.frombuffer(piece.encode(errors="surrogatepass"), np.uint8)
    between_cells = ord(delimiter)
    line_end = ord("\n")
    # The signs that part cells, in file order. In UTF-8 no other character holds their bytes.
    is_mark = (letters == between_cells) | (letters == line_end)
    marks = letters[is_mark]
    if letters[-1] != line_end:
        marks = np.append(marks, np.uint8(line_end))
    if len(marks) % 3 != 0:
        return False
    # A row of three cells has two delimiters, then the line's end: shape (num_rows, 3).
    row = (between_cells, between_cells, line_end)
    return bool(np.all(marks.reshape(-1, 3) == row))
