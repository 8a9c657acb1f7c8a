"""The recipe graph and everything derived from it; trains nothing and imports neither torch nor PyKEEN.

The recipe graph is the only source of truth. Triples lose which pair makes which result, so recipes stay objects, and
triples, splits, tasks and vocabularies are derived from them. Ids follow the sorted labels: equal graphs have equal
ids. A split names the hash of its graph, and every file that is derived from both names both. Splits draw from a
generator of their own; the bytes of a graph folder depend on the book and the settings of the split alone.
"""

from wordcraft_kg.graphs.audit import audit
from wordcraft_kg.graphs.book_files import read_book, write_book
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph, write_graph_folder
from wordcraft_kg.graphs.library import fetch_book, known_books, open_book
from wordcraft_kg.graphs.planner import Derivation, Planner, layers, rounds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook
from wordcraft_kg.graphs.splits import SPLITS, Split, SplitConfig, make_split
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS, recipe_triples

__all__ = [
    "COMBINES_WITH",
    "COMPONENT_OF",
    "RELATIONS",
    "SPLITS",
    "Derivation",
    "OpenedGraph",
    "Planner",
    "Recipe",
    "RecipeBook",
    "RecipeGraph",
    "Split",
    "SplitConfig",
    "audit",
    "fetch_book",
    "known_books",
    "layers",
    "make_split",
    "open_book",
    "open_graph",
    "read_book",
    "recipe_triples",
    "rounds",
    "write_book",
    "write_graph_folder",
]
