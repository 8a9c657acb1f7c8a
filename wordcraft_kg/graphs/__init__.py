"""Recipe graphs and everything derived from a graph; trains nothing, imports no torch or PyKEEN.

A recipe combines one to eight ingredients into a result, in most books two. Triples, train/test
splits, crafting tasks and model vocabularies are derived from the recipe graph; triples alone lose
which ingredients make which result. Ids follow the sorted labels: equal graphs have equal ids. A
split records its graph's hash, and derived files record both hashes. The bytes of a graph folder
depend only on the recipe book and the split's settings.

Read ``recipe_graph`` first, then ``splits`` and ``tasks``.

- ``recipes``, ``book_files``, ``book_check``, ``library``: recipe books, as values,
  as files of any shape, under construction, by name, and with invented words;
- ``reading``: how a file was read;
- ``recipe_graph``, ``arrays``, ``triples``, ``planner``: the graph, its id arrays, its
  triples, and the cheapest derivations;
- ``splits``, ``published_splits``, ``folds``, ``train_samples``: recipes held out for tests, drawn
  or from a file, for cross-fitting, or left out and changed to train on less;
- ``tasks``, ``task_search``: crafting tasks and the search for all their shortest plans;
- ``folder``, ``audit``, ``export``: graph folders, views of graphs and entities, other formats.

Entries of ``SPLITS``, ``EXPORTERS`` and ``FETCHABLE`` and new statistics may be added freely. The
order of ids, the formats of hashes and the random draws of splits, folds and tasks may not change:
models, runs and published results refer to them (``tests/graphs/test_recipe_graph.py`` compares).
"""

from wordcraft_kg.graphs.audit import audit as audit
from wordcraft_kg.graphs.book_files import read_book as read_book
from wordcraft_kg.graphs.book_files import write_book as write_book
from wordcraft_kg.graphs.folder import OpenedGraph as OpenedGraph
from wordcraft_kg.graphs.folder import open_graph as open_graph
from wordcraft_kg.graphs.folder import write_graph_folder as write_graph_folder
from wordcraft_kg.graphs.library import fetch_book as fetch_book
from wordcraft_kg.graphs.library import known_books as known_books
from wordcraft_kg.graphs.library import open_book as open_book
from wordcraft_kg.graphs.planner import Derivation as Derivation
from wordcraft_kg.graphs.planner import Planner as Planner
from wordcraft_kg.graphs.planner import layers as layers
from wordcraft_kg.graphs.planner import rounds as rounds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph as RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe as Recipe
from wordcraft_kg.graphs.recipes import RecipeBook as RecipeBook
from wordcraft_kg.graphs.splits import SPLITS as SPLITS
from wordcraft_kg.graphs.splits import Split as Split
from wordcraft_kg.graphs.splits import SplitConfig as SplitConfig
from wordcraft_kg.graphs.splits import make_split as make_split
from wordcraft_kg.graphs.triples import COMBINES_WITH as COMBINES_WITH
from wordcraft_kg.graphs.triples import COMPONENT_OF as COMPONENT_OF
from wordcraft_kg.graphs.triples import RELATIONS as RELATIONS
from wordcraft_kg.graphs.triples import recipe_triples as recipe_triples
