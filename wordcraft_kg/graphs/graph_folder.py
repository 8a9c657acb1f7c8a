"""Graph folders: write a recipe graph and a split as files, and open graphs from anywhere.

A graph is opened by folder, recipe book file or book name. A folder's bytes depend only on the book
and the split's settings, so two people can compare their folders.
"""

from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Annotated, Literal, Unpack

import msgspec
import numpy as np

from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphError,
    Hash,
    RecipeFileError,
    Record,
    SplitError,
    as_values,
    check_file,
    dump_json,
    parse_record,
    read_json,
    stage,
    staged_folder,
    what_is,
    write_atomically,
)
from wordcraft_kg.graphs.arrays import Ids, stacked
from wordcraft_kg.graphs.audit import Audit, audit
from wordcraft_kg.graphs.book_files import ReadOptions, book_json, recipe_table
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import (
    MOST_INGREDIENTS,
    Reading,
    RecipeBook,
    RecipeRows,
    label_fault,
)
from wordcraft_kg.graphs.splits import Split, SplitConfig, default_config, make_split, read_split
from wordcraft_kg.graphs.train_samples import TrainSample
from wordcraft_kg.graphs.triples import triple_lines

if TYPE_CHECKING:
    import pandas as pd

KG = Literal["partial", "full"]
"""Knowledge graph: triples from the train recipes, or from all recipes."""
GRAPH_FILE = 2**30
"""Most bytes of ``graph.json`` and of ``split.json``: seven million recipes take 400 MB."""
TrainedOn = Literal["partial", "full", "none"]
"""A scorer's training recipes: train, all, or none (a scorer of entity names only)."""
_Labels = Annotated[tuple[str, ...], msgspec.Meta(min_length=2, max_length=MOST_INGREDIENTS + 1)]
"""The ingredients of a recipe, and its result."""


class _Origin(msgspec.Struct, frozen=True):
    """What ``graph.json`` tells of the book, as far as a graph keeps it.

    Attributes:
        base_is_inferred: as in :class:`~wordcraft_kg.graphs.recipe_graph.RecipeGraph`.
        reading: how the book's file was read; None without a file.
    """

    base_is_inferred: bool = False
    reading: Reading | None = None


class _GraphFile(msgspec.Struct):
    """The content of ``graph.json``.

    Attributes:
        format: name and version of the layout.
        name: name of the graph.
        hash: content hash of the graph.
        base: labels of the base entities.
        entities: labels of all entities, sorted.
        recipes: labels (*ingredients, result), in the order of the graph.
        kinds: each recipe's kind; empty for a book without kinds.
        quantities: each recipe's quantities; empty for a book without.
        source: the book.
    """

    format: Literal["wordcraft-kg recipe book 1"]
    name: str
    hash: Hash
    base: list[str]
    entities: list[str]
    recipes: list[_Labels]
    kinds: list[str] = []
    quantities: list[str] = []
    source: _Origin = _Origin()


@dataclass(frozen=True)
class OpenedGraph:
    """A recipe graph with a train/validation/test split.

    Trained models record the source, to open the same graph and split when they are evaluated. To
    train on your own split, write a graph folder (``write_graph_folder``) and open the folder, or
    give the opened graph again whenever a run is opened.

    Attributes:
        graph: the recipe graph.
        split: the split of its recipes.
        source: what was opened: a folder, a file or a book name.
    """

    graph: RecipeGraph
    split: Split
    source: str

    def triples(self, kg: KG) -> Ids:
        """Return the triples of all recipes (full) or the train recipes (partial).

        Args:
            kg: ``full`` or ``partial``.

        Returns:
            Shape (T, 3), sorted.
        """
        return self.graph.triples if kg == "full" else self.split.partial

    def train_sample(self, kg: TrainedOn) -> TrainSample:
        """Return recipes for training a model: train recipes (partial), all (full) or none."""
        rows = {
            "partial": self.split.is_in("train"),
            "full": np.ones(self.graph.num_recipes, dtype=bool),
            "none": np.zeros(self.graph.num_recipes, dtype=bool),
        }
        return TrainSample.of(self.graph, rows[kg])


class PlayedGraph(Record, frozen=True):
    """Identity of a recipe graph and its split.

    Attributes:
        name: name of the graph.
        hash: content hash of the graph.
        kind: kind of the split.
        split_seed: seed of the split.
        split: content hash of the split.
    """

    name: str
    hash: Hash
    kind: str
    split_seed: int
    split: Hash

    @classmethod
    def of(cls, opened: OpenedGraph) -> "PlayedGraph":
        """Return the identity of an opened graph and its split."""
        graph = opened.graph
        split = opened.split
        return cls(graph.name, graph.hash, split.config.kind, split.config.seed, split.hash)


def entities_frame(graph: RecipeGraph) -> "pd.DataFrame":
    """Return a data frame with a row per entity, in id order.

    Columns are ``entity`` (label), ``base`` (bool), ``layer`` (crafting rounds, missing if
    unreachable), ``recipes`` and ``uses`` (number of recipes that make and use the entity).
    """
    import pandas as pd

    depth = layers(graph)
    return pd.DataFrame(
        {
            "entity": graph.entities,
            "base": np.isin(np.arange(graph.num_entities), graph.base_ids),
            "layer": pd.Series(depth, dtype="Int64").mask(depth < 0),
            "recipes": graph.recipe_counts,
            "uses": graph.use_counts,
        }
    )


@stage("writing the graph folder")
def write_graph_folder(
    out: str | Path,
    book: RecipeBook,
    split: Split,
    *,
    force: bool = False,
) -> Audit:
    """Write a recipe graph and a split to a folder, complete or not at all.

    The folder holds ``graph.json``, ``split.json``, ``recipes.csv``, ``entities.tsv``, triples in
    ``triples/full.tsv``, ``partial.tsv`` and ``unseen.tsv``, and the statistics in ``audit.json``.

    Args:
        out: the folder.
        book: source of the graph, for its hash, kinds and counts of omitted rows.
        split: a split of the graph.
        force: whether to replace an existing ``out``.

    Returns:
        The statistics.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False.
        RecipeFileError: if the book's name could not name a folder; no command would open it.
        OSError: if a file cannot be written; nothing is left then.

    Example:
        >>> book = open_book("kitchen")
        >>> split = make_split(RecipeGraph.from_book(book), SplitConfig("by-goal", seed=1))
        >>> _ = write_graph_folder("graphs/kitchen-by-goal", book, split)
        >>> open_graph("graphs/kitchen-by-goal").split.hash == split.hash
        True
    """
    if not _is_folder_name(book.name):
        raise RecipeFileError(
            f"the book's name is {book.name[:100]!r}; expected a name without folders and "
            "control characters. Rename the book."
        )
    graph = split.graph
    with staged_folder(Path(out), force=force) as folder:
        names = ("sha256", "dropped_self_results", "merged_duplicates")
        source = {name: getattr(book, name) for name in names}
        if graph.base_is_inferred:
            source["base_is_inferred"] = True
        if book.reading is not None:
            source["reading"] = as_values(book.reading)
        # Labels of the graph's recipes, in id order, so that equal graphs give equal files.
        recipes = RecipeRows(graph.entities, graph.sets)
        graph_book = replace(book, name=graph.name, recipes=recipes, base=graph.base)
        write_atomically(
            folder / "graph.json", book_json(graph_book, hash=graph.hash, source=source)
        )
        write_atomically(folder / "split.json", split.to_json())
        write_atomically(folder / "recipes.csv", recipe_table(graph_book))
        frame = entities_frame(graph)
        frame.insert(0, "id", range(len(frame)))
        table = frame.to_csv(sep="\t", index=False, lineterminator="\n")
        write_atomically(folder / "entities.tsv", table)
        (folder / "triples").mkdir()
        parts = {"full": graph.triples, "partial": split.partial, "unseen": split.unseen}
        for name, triples in parts.items():
            lines = triple_lines(triples, graph.entities)
            write_atomically(folder / "triples" / f"{name}.tsv", lines)
        record = audit(graph, split, book)
        write_atomically(folder / "audit.json", dump_json(as_values(record)))
    return record


GraphLike = str | Path | RecipeGraph | OpenedGraph
"""A graph folder, a book's file or name, a graph, or an opened graph."""


def open_graph(
    source: GraphLike, config: SplitConfig | None = None, **options: Unpack[ReadOptions]
) -> OpenedGraph:
    """Open a recipe graph and a train/validation/test split.

    Args:
        source: a graph folder, a recipe book file, the name of a known book, or a graph; an opened
            graph is returned as it is.
        config: how to split a book or a graph; ignored for a graph folder, which has its split.
            None takes :func:`default_split`.
        options: what a user says about a book's file, such as ``columns``, see
            :class:`~wordcraft_kg.graphs.book_files.BookOptions`; ignored for a graph folder.

    Raises:
        ArtefactError: if a graph folder is incomplete or damaged, or its files belong to different
            graphs.
        RecipeFileError: if a book cannot be read, or there is no such folder, file or book.
        SplitError: if the book is too small for ``config``, or has no kinds of recipes for a split
            by kind.
        ConfigError: if an option is out of range, or ``source`` is no graph.

    Example:
        >>> opened = open_graph("kitchen")
        >>> opened.graph.num_entities, len(opened.triples("partial"))
        (80, 790)
    """
    if isinstance(source, OpenedGraph):
        return source
    if isinstance(source, RecipeGraph):
        return _split(source, config, source.name)
    if not isinstance(source, str | Path):
        raise ConfigError(
            f"`graph` {source!r}: expected a graph folder, a book's file or name, a RecipeGraph or "
            "an OpenedGraph."
        )
    folder = Path(source)
    # Another folder may hold recipes of Minecraft, if the user says how to read them.
    is_graph_folder = (folder / "graph.json").is_file() if options else folder.is_dir()
    if is_graph_folder:
        graph = _read_graph(folder)
        content = read_json(folder / "split.json", GRAPH_FILE)
        split = read_split(content, graph, str(folder / "split.json"))
        return OpenedGraph(graph, split, str(source))
    return _split(RecipeGraph.from_book(open_book(source, **options)), config, str(source))


def _split(graph: RecipeGraph, config: SplitConfig | None, source: str) -> OpenedGraph:
    split = default_split(graph) if config is None else make_split(graph, config)
    return OpenedGraph(graph, split, source)


def _read_graph(folder: Path) -> RecipeGraph:
    """Read ``graph.json``, and compare the graph with its hash."""
    path = folder / "graph.json"
    if not path.is_file():
        raise ArtefactError(
            f"'{folder}' {what_is(folder)}; expected a graph folder. "
            "Make a graph folder: wordcraft-kg build-graph"
        )
    check_file(path, GRAPH_FILE)
    content = parse_record(path.read_bytes(), _GraphFile, path)
    damaged = f"{path} is damaged or was edited"
    remedy = "Build the graph again with `wordcraft-kg build-graph`."
    # Commands without `out` write to a folder of this name, which must not lead anywhere else.
    if not _is_folder_name(content.name):
        raise ArtefactError(
            f"{damaged}: its name is {content.name[:100]!r}; expected a name without folders and "
            f"control characters. {remedy}"
        )
    # Once for each label, not in each recipe.
    texts = chain(content.entities, filter(None, content.kinds), filter(None, content.quantities))
    fault = next(filter(None, map(label_fault, texts)), None)
    if fault is not None:
        raise ArtefactError(f"{damaged}: {fault} {remedy}")
    id_of = {label: entity for entity, label in enumerate(content.entities)}
    lengths = list(map(len, content.recipes))
    try:
        ids = np.fromiter(map(id_of.__getitem__, chain.from_iterable(content.recipes)), np.int64)
        base = [id_of[label] for label in content.base]
        rows = stacked(ids, lengths, len(id_of))
        graph = RecipeGraph(content.entities, rows, base, content.name)
    except KeyError as error:
        raise ArtefactError(f"{damaged}: {error} is none of its entities. {remedy}") from None
    except GraphError as error:
        raise ArtefactError(f"{damaged}: {error} {remedy}") from None
    # Kinds and quantities, which the hash leaves out, stand in the order of the recipes.
    lists = (content.kinds, content.quantities)
    are_complete = all(len(facts) in (0, graph.num_recipes) for facts in lists)
    if graph.hash != content.hash or not are_complete or not np.array_equal(graph.sets, rows):
        raise ArtefactError(f"{damaged}: its content does not match its hash. {remedy}")
    graph.kinds = tuple(content.kinds) or None
    graph.quantities = tuple(content.quantities) or None
    graph.base_is_inferred = content.source.base_is_inferred
    graph.reading = content.source.reading
    return graph


def _is_folder_name(name: str) -> bool:
    """Return whether a text is the name of one folder, on every system."""
    # Windows separates folders by both slashes, and has drives such as C:.
    is_one_part = PureWindowsPath(name).name == name and name != ".."
    return is_one_part and label_fault(name) is None


def default_split(graph: RecipeGraph) -> Split:
    """Return the split without chosen settings; for a tiny graph, keep all recipes in train."""
    try:
        return make_split(graph, default_config(graph))
    except SplitError:
        # A graph of a few recipes still opens, for tasks and play; it only has no test part.
        return make_split(graph, SplitConfig("none"))
