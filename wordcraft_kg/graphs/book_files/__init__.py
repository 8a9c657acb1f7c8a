"""Read and write recipe books: files that list recipes, in the shapes that people have.

Read ``reader`` first: :func:`read_book` opens the file (``opening``: ``container``, the encoding by
``text``, the shape), and every shape yields the same entries (``rows``), of which ``book_rows``
makes recipes of two ingredients, and ``cells`` labels:

- ``tables`` with ``dialects`` (delimiter and quotes) and ``columns`` (ingredients and results);
- ``lines``: a + b = c;
- ``json_shapes``: the order of the shapes of JSON, which are in ``json_layouts`` (our own, the
  paper's, saves of Infinite Craft), ``json_tables``, ``json_records`` and ``json_objects``;
  ``places`` tells which of three labels is the result;
- ``minecraft``: folders of recipes.

``guide`` words refusals; ``writing`` writes books. Labels are matched exactly. To add a shape,
write a subclass of ``RowSource``, or a function in ``SHAPES`` of ``json_shapes``.
"""

from wordcraft_kg.graphs.book_files.columns import KIND as KIND
from wordcraft_kg.graphs.book_files.options import BookOptions as BookOptions
from wordcraft_kg.graphs.book_files.options import ReadOptions as ReadOptions
from wordcraft_kg.graphs.book_files.reader import book_name as book_name
from wordcraft_kg.graphs.book_files.reader import read_book as read_book
from wordcraft_kg.graphs.book_files.tables import CSV_HEADER as CSV_HEADER
from wordcraft_kg.graphs.book_files.writing import book_json as book_json
from wordcraft_kg.graphs.book_files.writing import recipe_table as recipe_table
from wordcraft_kg.graphs.book_files.writing import write_book as write_book
