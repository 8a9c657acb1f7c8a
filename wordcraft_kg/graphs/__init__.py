"""The recipe graph and everything derived from it; trains nothing and imports neither torch nor PyKEEN."""

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
