"""Read and write recipe books: files that list recipes, in documented shapes.

Read ``reader`` first: :func:`read_book` takes a file's bytes and text (``files``), and one of three
readers of its shape, which yield the same rows (``rows``):

- ``texts``: tables, with a header of documented words or columns that the user names, and lines
  a + b = c;
- ``documents``: JSON, by documented keys (``words``) or by paths that the user names; the rows of a
  table are a document, too;
- ``layouts``: formats of their own: ours, the paper's, dumps of Infinite Craft, packs of Minecraft.

``cells`` finds the labels in cells, for all shapes. ``rule`` takes one way to read a document, or
refuses the file with the commands that read it. ``writing`` writes books. Labels are matched
exactly.
"""

from wordcraft_kg.graphs.book_files.reader import (
    BookOptions as BookOptions,
    ReadOptions as ReadOptions,
    book_name as book_name,
    read_book as read_book,
)
from wordcraft_kg.graphs.book_files.words import KIND as KIND
from wordcraft_kg.graphs.book_files.writing import (
    book_json as book_json,
    recipe_table as recipe_table,
    write_book as write_book,
)
