"""Recipe graphs and everything derived from a graph; this package trains nothing and imports neither torch nor PyKEEN.

A recipe combines two ingredients into a result. Triples, train/test splits, crafting tasks and model vocabularies are
derived from the recipe graph; triples alone lose which pair makes which result. Ids follow the sorted labels: equal
graphs have equal ids. A split records its graph's hash, and derived files record both hashes. The bytes of a graph
folder depend only on the recipe book and the split's settings.
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
