"""Recipe graphs and everything derived from a graph; trains nothing, imports no torch or PyKEEN.

A recipe combines one to eight ingredients into a result, in most books two. Triples, train/test
splits, crafting tasks and model vocabularies are derived from the recipe graph; triples alone lose
which ingredients make which result. Ids follow the sorted labels: equal graphs have equal ids. A
split records its graph's hash, and derived files record both hashes. The bytes of a graph folder
depend only on the recipe book and the split's settings.

Read ``recipe_graph`` first, then ``splits`` and ``tasks``.

- ``recipes``, ``book_files``, ``book_check``, ``library``: recipe books, as values,
  as files of any shape, under construction, by name, and with invented words;
- ``recipe_graph``, ``arrays``, ``triples``, ``planner``: the graph, its id arrays, its
  triples, and the cheapest derivations;
- ``splits``, ``train_samples``: recipes held out for tests, drawn or from a file; for
  cross-fitting; or left out and changed to train on less;
- ``tasks``: crafting tasks and the search for all their shortest plans;
- ``graph_folder``, ``audit``, ``export``: graph folders, views of graphs and entities, other
  formats.

Entries of ``SPLITS``, ``EXPORTERS`` and ``FETCHABLE`` and new statistics may be added freely. The
order of ids, the formats of hashes and the random draws of splits, folds and tasks may not change:
models, runs and published results refer to them (``tests/graphs/test_recipe_graph.py`` compares).
"""

from wordcraft_kg.graphs.arrays import (
    Ids as Ids,
    are_among as are_among,
    distinct as distinct,
    frozen as frozen,
    padded as padded,
    recipe_keys as recipe_keys,
)
from wordcraft_kg.graphs.audit import SplitSummary as SplitSummary, audit as audit
from wordcraft_kg.graphs.book_files import read_book as read_book, write_book as write_book
from wordcraft_kg.graphs.graph_folder import (
    KG as KG,
    GraphLike as GraphLike,
    OpenedGraph as OpenedGraph,
    PlayedGraph as PlayedGraph,
    TrainedOn as TrainedOn,
    default_split as default_split,
    open_graph as open_graph,
    write_graph_folder as write_graph_folder,
)
from wordcraft_kg.graphs.library import (
    fetch_book as fetch_book,
    known_books as known_books,
    open_book as open_book,
)
from wordcraft_kg.graphs.planner import (
    Derivation as Derivation,
    Planner as Planner,
    layers as layers,
    rounds as rounds,
)
from wordcraft_kg.graphs.recipe_graph import Entity as Entity, RecipeGraph as RecipeGraph
from wordcraft_kg.graphs.recipes import (
    MOST_INGREDIENTS as MOST_INGREDIENTS,
    Recipe as Recipe,
    RecipeBook as RecipeBook,
    check_label as check_label,
    label_fault as label_fault,
)
from wordcraft_kg.graphs.splits import (
    PARTS as PARTS,
    SPLITS as SPLITS,
    Part as Part,
    Split as Split,
    SplitConfig as SplitConfig,
    make_split as make_split,
)
from wordcraft_kg.graphs.tasks import (
    MAX_DEPTH as MAX_DEPTH,
    TaskPart as TaskPart,
    TaskSet as TaskSet,
    make_tasks as make_tasks,
)
from wordcraft_kg.graphs.train_samples import (
    OUTSIDE as OUTSIDE,
    Folds as Folds,
    TrainSample as TrainSample,
    describe_train_sample as describe_train_sample,
    draw_train_sample as draw_train_sample,
    fold_of_tasks as fold_of_tasks,
    is_subsample as is_subsample,
    make_folds as make_folds,
)
from wordcraft_kg.graphs.triples import (
    COMBINES_WITH as COMBINES_WITH,
    COMPONENT_OF as COMPONENT_OF,
    RELATIONS as RELATIONS,
    Relation as Relation,
    is_in as is_in,
    recipe_triples as recipe_triples,
    triples_hash as triples_hash,
)
