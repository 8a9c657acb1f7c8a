"""Read and write recipe books: files that list recipes, in documented shapes.

Read ``reader`` first: :func:`read_book` takes a file's bytes (``containers``) and text (``text``),
and one of four readers of its shape, which yield the same rows (``rows``):

- ``tables``, with a header of documented words (``words``), or columns that the user names;
- ``lines``: a + b = c;
- ``json_books``: documented keys, or ``paths`` that the user names; ``layouts`` has formats of
  their own, such as ours, the paper's, HIF and saves of Infinite Craft;
- ``packs``: Minecraft.

``rule`` takes one reading of a table or of JSON, or refuses the file with the commands that read
it. ``entries`` and ``cells`` find labels, ``writing`` writes books. Labels are matched exactly.
"""

from wordcraft_kg.graphs.book_files.reader import BookOptions as BookOptions
from wordcraft_kg.graphs.book_files.reader import ReadOptions as ReadOptions
from wordcraft_kg.graphs.book_files.reader import book_name as book_name
from wordcraft_kg.graphs.book_files.reader import read_book as read_book
from wordcraft_kg.graphs.book_files.texts import CSV_HEADER as CSV_HEADER
from wordcraft_kg.graphs.book_files.words import KIND as KIND
from wordcraft_kg.graphs.book_files.writing import book_json as book_json
from wordcraft_kg.graphs.book_files.writing import recipe_table as recipe_table
from wordcraft_kg.graphs.book_files.writing import write_book as write_book
