"""Knowledge from outside the train recipes, as link features.

It comes from tables of a source, another book, or further word vectors.

Outside knowledge is the same in all folds. Recipes that both books share are left out of the other
book: a train recipe is in the train part already, and a test recipe must not be learned. So a
held-out train recipe finds as little of itself in the other book as a test recipe does.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from msgspec.structs import replace
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.labels import LabelIndex
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.settings import FeatureSpec
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import is_in
from wordcraft_kg.models.knowledge.folder import (
    KNOWLEDGE,
    TABLES,
    check_same_split,
    knowledge_files,
    read_knowledge,
)
from wordcraft_kg.models.recipes.encoder_fitting import fit_encoder
from wordcraft_kg.models.recipes.fitting import LinkTables, Words, word_features
from wordcraft_kg.models.recipes.memory import fitting_workers
from wordcraft_kg.models.scorers.features import ENCODED, EntityFeatures, make_features
from wordcraft_kg.models.scorers.kernel import cosines
from wordcraft_kg.models.scorers.neighbours.link_rows import CELLS, LinkRows
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder

_OF_A_BOOK = ("graph", "split", "overrides")
"""Inputs of a knowledge folder that differ between books; other inputs, such as weights, are of the
source."""
_DIM = 384
"""Length of a word vector, about, to say before the start how much memory another book takes."""
REWORDED = 0.7
"""Cosine of word vectors from which a recipe of another book rewords a test recipe, for each of the
three words."""
MOST_MISSING = 0.5
"""Largest share of labels without a word vector, over a graph and other books together."""
_Tables = dict[tuple[tuple[str, ...], str, str], Tensor]
"""Tables by source, name and role. A source is its name and the hashes of its own inputs."""
_VECTOR_FILES = (".npy", ".txt", ".gz")
"""Endings of files with word vectors."""


class OutsideSource(Record, frozen=True, kw_only=True):
    """A source of outside knowledge in a trained model.

    Attributes:
        name: the source's display name.
        kind: ``tables`` of a knowledge folder, another ``book``, or ``words``.
        sha256: hash of the tables, the other graph or the vectors.
        coverage: share of the graph's entities that the source describes.
        recipes: recipes of another book that are used.
        left_out: recipes of another book that are also recipes of this graph, and not used.
        left_out_test: those among them that are test or validation recipes of this split.
        left_out_without: further recipes of another book that are left out because a book in
            ``without`` has them.
        reworded: used recipes that reword a test or validation recipe by near-synonyms.
        makes: labels of the graph's entities that a used recipe of another book makes; None for
            other sources, and in folders from before this field.
    """

    name: str
    kind: Literal["tables", "book", "words"]
    sha256: Hash
    coverage: Share
    recipes: Count = 0
    left_out: Count = 0
    left_out_test: Count = 0
    left_out_without: Count = 0
    reworded: Count = 0
    makes: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class OutsideKnowledge:
    """Link features from all sources of outside knowledge.

    Attributes:
        tables: the features, over the entities of a graph.
        sources: records of the sources, in the order of the settings.
        books: the sources that are books.
    """

    tables: LinkTables
    sources: tuple[OutsideSource, ...]
    books: tuple["OtherBook", ...] = ()


class OtherBook(NamedTuple):
    """Another book's recipes, without the recipes that both books share.

    Attributes:
        labels: the graph's E labels, then those of the book alone.
        recipes: ids by ``labels``, shape (n, 3).
        source: record of the book.
    """

    labels: tuple[str, ...]
    recipes: Ids
    source: OutsideSource


def open_outside(
    specs: Sequence[str],
    opened: OpenedGraph,
    features: str,
    *,
    allow_missing: bool = False,
    without: Sequence[RecipeGraph] = (),
) -> OutsideKnowledge:
    """Open sources of outside knowledge for a graph's entities.

    Args:
        specs: knowledge folders, graphs or books, and word vectors.
        opened: the graph; its split says which shared recipes are counted as test recipes.
        features: word vectors by which another book's recipes are compared.
        allow_missing: use zeros for labels without a vector.
        without: books whose recipes are left out of the books in ``specs``.

    Returns:
        features in the order of the sources, those of knowledge folders last.

    Raises:
        ConfigError: if a source describes none of the entities, is the graph itself, or lacks word
            vectors.
        ArtefactError: if a folder is incomplete or damaged.
    """
    folders = _Tables()
    pairs: list[Tensor] = []
    parts: list[Tensor] = []
    sources: list[OutsideSource] = []
    books: list[OtherBook] = []
    for spec in specs:
        if (Path(spec) / KNOWLEDGE).is_file():
            sources.append(_of_folder(spec, opened, folders))
            continue
        if is_book(spec):
            other = open_other_book(spec, opened, without=without)
            tables, book = _of_book(other, opened, features, allow_missing)
            books.append(book)
            source = book.source
        else:
            tables, source = _of_words(spec, opened, allow_missing)
        pairs += tables.pairs
        parts += tables.parts
        sources.append(source)
    # After all folders are read: tables of several folders may have become one.
    for (_, _, role), table in folders.items():
        if role == "pair":
            pairs.append(table)
        else:
            parts.append(table)
    return OutsideKnowledge(LinkTables(pairs, parts), tuple(sources), tuple(books))


def is_book(spec: str) -> bool:
    """Return whether a source is another book, not a knowledge folder or word vectors."""
    if (Path(spec) / KNOWLEDGE).is_file():
        return False
    source = FeatureSpec.parse(spec)
    path = Path(source.source)
    if not source.is_path or path.suffix in _VECTOR_FILES:
        return False
    return not (path / ENCODED).is_file()


def _of_folder(spec: str, opened: OpenedGraph, tables: _Tables) -> OutsideSource:
    """Add a folder's tables to those of other folders, and return its record.

    Tables of one name and source complete each other, as those of several books.

    Args:
        spec: a knowledge folder.
        opened: the graph with its split.
        tables: tables of the folders before; changed in place.

    Raises:
        ConfigError: if the folder describes none of the entities, or is of another split.
        ArtefactError: if the folder is incomplete or damaged.
    """
    entities = opened.graph.entities
    check_same_split(spec, opened)
    knowledge = read_knowledge(spec)
    name = knowledge.record.source
    coverage = knowledge.coverage(entities)
    if not coverage:
        raise ConfigError(
            f"`with` '{spec}': {name} describes none of the {len(entities):,} entities, such as "
            f"'{entities[0]}'. Make the folder for this graph."
        )
    of_entities = knowledge.of_entities(entities)
    run = knowledge_files(spec).run
    own_inputs = [sha256 for key, sha256 in run.inputs.items() if key not in _OF_A_BOOK]
    origin = (name, *sorted(own_inputs))
    for info, table in zip(of_entities.record.tables, of_entities.tables, strict=True):
        key = (origin, info.name, info.role)
        new = table.float()
        before = tables.get(key)
        # 0 is a cell that the earlier folder says nothing about.
        tables[key] = new if before is None else before.where(before != 0, new)
    return OutsideSource(name=name, kind="tables", sha256=run.outputs[TABLES], coverage=coverage)


def _of_words(
    spec: str,
    opened: OpenedGraph,
    allow_missing: bool,
) -> tuple[LinkTables, OutsideSource]:
    """Return the cosines of further word vectors, a feature of both relations, and their record."""
    features = make_features(spec, opened.graph.entities, allow_missing=allow_missing)
    alike = text_of(features)
    source = OutsideSource(
        name=features.source,
        kind="words",
        sha256=features.sha256,
        coverage=float(features.known.mean()),
    )
    return LinkTables([alike], [alike]), source


def text_of(features: EntityFeatures) -> Tensor:
    """Return the cosines of word vectors, (E, E); zeros for one-hot vectors, which are no words."""
    if features.is_one_hot:
        size = len(features.known)
        return torch.zeros(size, size)
    return cosines(torch.tensor(features.vectors))


def describe_source(source: OutsideSource) -> str:
    """Return a line about a source: coverage, and a book's used and left-out recipes."""
    text = f"{source.name} ({source.kind}) describes {source.coverage:.0%} of the entities"
    if source.kind == "book":
        text += (
            f"; {source.recipes:,} recipes used, {source.left_out:,} shared recipes left out "
            f"({source.left_out_test:,} of them test or validation recipes), "
            f"{source.reworded:,} used recipes reword a test or validation recipe"
        )
        if source.left_out_without:
            text += f"; {source.left_out_without:,} recipes of books in `without` left out"
    return text


# --- another book ---------------------------------------------------------------------------------


def _of_book(
    other: OtherBook,
    opened: OpenedGraph,
    features: str,
    allow_missing: bool,
) -> tuple[LinkTables, OtherBook]:
    """Return another book's link features for the graph's entities, and the book."""
    size = opened.graph.num_entities
    book, vectors = with_words_of(other, opened, features, allow_missing=allow_missing)
    # The book's lists are made with all entities; the tables are of the graph's entities alone.
    rows = LinkRows(Words.of(vectors).lists(book.recipes))
    pairs: list[Tensor] = []
    parts: list[Tensor] = []
    # A block has the links of its entities with all entities of both books.
    for some in torch.arange(size).split(max(1, CELLS // len(book.labels))):
        pairs.append(rows.combines(some.numpy())[:, :size])
        parts.append(rows.components(some.numpy())[:, :size])
    # combinesWith is symmetric, and its features are so but for rounding.
    both = torch.cat(pairs)
    of_pairs = (both + both.transpose(0, 1)) / 2
    tables = LinkTables(_by_feature(of_pairs), _by_feature(torch.cat(parts)))
    return tables, book


def _by_feature(features: Tensor) -> tuple[Tensor, ...]:
    """Return features (E, E, F) as a table (E, E) for each feature."""
    return features.permute(2, 0, 1).contiguous().unbind()


def open_other_book(
    spec: str,
    opened: OpenedGraph,
    *,
    keep_train: bool = False,
    without: Sequence[RecipeGraph] = (),
) -> OtherBook:
    """Open another book's recipes without the recipes that both books share.

    Labels that differ in case, article or plural are one entity. Rewordings are not counted yet,
    see :func:`with_words_of`.

    Args:
        spec: a book or a graph folder.
        opened: the graph; its split says which shared recipes are test recipes.
        keep_train: keep shared recipes of the train part.
        without: further books whose recipes are left out.

    Raises:
        ConfigError: if the source is no book, is the graph itself, has no other recipes, or memory
            does not suffice.
        ArtefactError: if a graph folder is incomplete or damaged.
    """
    graph = opened.graph
    try:
        other = open_graph(spec).graph
    except RecipeFileError as error:
        raise ConfigError(
            f"`with` '{spec}': expected a knowledge folder, a graph folder, a book or word "
            f"vectors. {error}"
        ) from None
    if other.hash == graph.hash:
        raise ConfigError(f"`with` '{spec}' is the graph itself. Give another book.")
    index = LabelIndex(graph.entities)
    own = {label: index.find(label) for label in other.entities}
    rest = [label for label, entity in own.items() if entity is None]
    labels = (*graph.entities, *rest)
    fitting_workers(len(labels), other.num_recipes, _DIM, most=1)
    new = {label: graph.num_entities + row for row, label in enumerate(rest)}
    places = [new[label] if entity is None else entity for label, entity in own.items()]
    ids = np.array(places, dtype=np.int64)
    rows = _distinct(ids[other.recipes])
    held_out = graph.recipes[~opened.split.is_in("train")]
    shared = is_in(rows, held_out if keep_train else graph.recipes, len(labels))
    left_out = int(shared.sum())
    # A recipe that equals a left-out one once labels are compared is left out, too.
    for book in without:
        theirs = ids[other.recipes[shared_recipes(other, book)]]
        shared |= is_in(rows, _distinct(theirs), len(labels))
    made = np.unique(rows[~shared, 2])
    covered = {entity for entity in own.values() if entity is not None}
    source = OutsideSource(
        name=other.name,
        kind="book",
        sha256=other.hash,
        coverage=len(covered) / max(graph.num_entities, 1),
        recipes=int((~shared).sum()),
        left_out=left_out,
        left_out_test=int(is_in(rows, held_out, len(labels)).sum()),
        left_out_without=int(shared.sum()) - left_out,
        makes=tuple(graph.labels(made[made < graph.num_entities])),
    )
    if not source.recipes:
        raise ConfigError(
            f"`with` '{spec}': all {len(rows):,} recipes are recipes of the graph, or of a book in "
            "`without`. Give another book."
        )
    return OtherBook(labels, rows[~shared], source)


def _distinct(recipes: Ids) -> Ids:
    """Return different recipes, shape (n, 3), the smaller ingredient first.

    Books may share recipes, and labels of a book that are one entity in another make two recipes
    equal.
    """
    rows = recipes.copy()
    rows[:, :2].sort(axis=1)
    return np.unique(rows, axis=0)


def with_words_of(
    book: OtherBook,
    opened: OpenedGraph,
    features: str,
    *,
    allow_missing: bool = False,
) -> tuple[OtherBook, EntityFeatures]:
    """Return the book with its rewordings counted, and word vectors for all labels.

    Args:
        book: from :func:`open_other_book`.
        opened: the graph with its split.
        features: word vectors.
        allow_missing: use zeros for labels without a vector.

    Raises:
        ConfigError: if most labels have no vector, and ``allow_missing`` is False.
    """
    vectors = words_of_books(features, book.labels, allow_missing=allow_missing)
    held_out = opened.graph.recipes[~opened.split.is_in("train")]
    reworded = _reworded(book.recipes, held_out, vectors)
    return book._replace(source=replace(book.source, reworded=reworded)), vectors


def words_of_books(
    features: str,
    labels: Sequence[str],
    *,
    allow_missing: bool = False,
) -> EntityFeatures:
    """Return word vectors for the labels of a graph and of other books.

    A large book has names and numbers that no vectors know. They may be more than in the graph
    itself: the book's other entities still help.

    Args:
        features: word vectors.
        labels: all labels.
        allow_missing: use zeros for any number of labels without a vector.

    Raises:
        ConfigError: if most labels have no vector, and ``allow_missing`` is False.
    """
    vectors = word_features(features, labels, allow_missing=True)
    missing = int((~vectors.known).sum())
    if missing <= MOST_MISSING * len(labels):
        if missing:
            logging.getLogger(__name__).info(
                "%s of %s labels of all books have no word vector.",
                f"{missing:,}",
                f"{len(labels):,}",
            )
        return vectors
    return word_features(features, labels, allow_missing=allow_missing)


def recipes_together(books: Sequence[OtherBook], labels: Iterable[str]) -> Ids:
    """Return the different recipes of several books.

    Args:
        books: the books.
        labels: all their labels, whose places are the ids of the result.

    Returns:
        shape (n, 3), the smaller ingredient first.
    """
    place = {label: row for row, label in enumerate(labels)}
    rows = []
    for book in books:
        ids = np.array([place[label] for label in book.labels])
        rows.append(ids[book.recipes])
    return _distinct(np.concatenate(rows))


def encoder_of_books(
    books: Sequence[OtherBook],
    num_own: int,
    features: str,
    *,
    allow_missing: bool = False,
    seed: int = 0,
    device: str = "cpu",
    stop: Callable[[], bool] = lambda: False,
) -> PairEncoder:
    """Fit a pair encoder to the recipes of other books, and keep what scores the graph's entities.

    Link features tell which entities other books combine, and what they are part of; the encoder
    tells what a whole pair makes. Like them, it is the same in all folds.

    Args:
        books: other books without the recipes that they share with the graph, one or more.
        num_own: number of the graph's entities, which come first in each book.
        features: word vectors, through which the encoder knows entities that no book has.
        allow_missing: use zeros for labels without a vector.
        seed: seed of weights, batches and negatives.
        device: where to compute.
        stop: whether to end the fit.

    Raises:
        KeyboardInterrupt: if ``stop`` has returned True.
        ConfigError: if most labels have no vector, and ``allow_missing`` is False.
    """
    # In order of appearance, so that the graph's entities keep their ids.
    distinct: dict[str, None] = {}
    for book in books:
        distinct |= dict.fromkeys(book.labels)
    labels = tuple(distinct)
    words = words_of_books(features, labels, allow_missing=allow_missing)
    # Rounded as a model stores them.
    vectors = words.unit_vectors.astype(np.float16).astype(np.float32)
    encoder = fit_encoder(
        recipes_together(books, labels),
        torch.from_numpy(vectors),
        torch.Generator().manual_seed(seed),
        device=device,
        stop=stop,
    )
    return encoder.of_first(num_own)


def shared_recipes(graph: RecipeGraph, other: RecipeGraph) -> NDArray[np.bool_]:
    """Mark a graph's recipes that ``other`` has, shape (num_recipes,).

    Labels are compared as in :func:`open_other_book`.
    """
    size = graph.num_entities
    index = LabelIndex(graph.entities)
    # An entity that the graph lacks has a number of its own.
    ids = size + np.arange(other.num_entities)
    for row, label in enumerate(other.entities):
        place = index.find(label)
        if place is not None:
            ids[row] = place
    rows = graph.recipes.copy()
    theirs = ids[other.recipes]
    # Ingredients have no order.
    rows[:, :2].sort(axis=1)
    theirs[:, :2].sort(axis=1)
    return is_in(rows, theirs, size + other.num_entities)


def _reworded(recipes: Ids, held_out: Ids, features: EntityFeatures) -> int:
    """Count recipes that equal a held-out recipe up to near-synonyms.

    Args:
        recipes: ids, shape (n, 3); ingredients may have either order.
        held_out: ids, shape (m, 3).
        features: word vectors of all entities.
    """
    own = np.unique(held_out)
    # Rows of the held-out entities alone: all pairs of a large book would take gigabytes.
    cosines = features.unit_vectors[own] @ features.unit_vectors.T
    alike = cosines >= REWORDED
    # An entity without a vector equals itself, too.
    alike[np.arange(len(own)), own] = True
    is_reworded = np.zeros(len(recipes), dtype=bool)
    one, other, made = recipes.T
    # Rows of `alike` for the entities of each held-out recipe.
    rows = np.searchsorted(own, held_out)
    for a, b, result in rows.tolist():
        in_order = alike[a, one] & alike[b, other]
        reversed_order = alike[a, other] & alike[b, one]
        has_ingredients = in_order | reversed_order
        is_reworded |= has_ingredients & alike[result, made]
    return int(is_reworded.sum())
