"""The recipe graph for a crafting game: entities, recipes and base entities, with lookups.

All other data (triples, splits, tasks, dynamics of environments) are derived from this class.

A recipe is a multiset of one to eight ingredients and a result. All recipes are one array,
:attr:`RecipeGraph.sets`, with a column for each place of an ingredient and one for the result: a
graph of pairs has the rows (a, b, result), and a graph of larger sets as many columns as its
largest set needs, with a padding that is no entity. Code for sets reads ``sets`` and asks for
:attr:`~RecipeGraph.sizes` where it matters; code for pairs reads :attr:`RecipeGraph.recipes`, which
refuses a graph of other sets with one message.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import chain, compress, pairwise

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import GraphError, UnknownEntityError, counted, nearest
from wordcraft_kg.graphs.arrays import (
    Ids,
    absent,
    different_ingredients,
    frozen,
    row_keys,
    sorted_unique,
    stacked,
    without_empty_columns,
)
from wordcraft_kg.graphs.recipes import (
    MOST_INGREDIENTS,
    Reading,
    Recipe,
    RecipeBook,
    RecipeRows,
    check_label,
    recipes_of_ids,
)
from wordcraft_kg.graphs.triples import COMBINES_WITH, recipe_triples, triples_by_recipe

Entity = int | str
"""An entity, by id or by label."""


class RecipeGraph:
    """An immutable graph of recipes; each recipe combines one to eight entities into a result.

    Entities have ids ``0 .. num_entities - 1`` by sorted label, so equal graphs have equal ids.
    Equality and hash depend on entities, base and recipes, not on the name. A pair may have several
    results; all of them are kept.

    Attributes:
        name: name in reports.
        entities: labels in id order.
        base_ids: shape (num_base,), int64, ascending: entities known at the start of play.
        sets: shape (num_recipes, columns), int64, rows ``(ingredients, padding, result)`` with
            ascending ingredients; sorted, unique. There are two columns of ingredients, or as many
            as the largest recipe has; ``num_entities`` is the padding after the last ingredient.
        base_is_inferred: whether no base was given, so that the base is the entities without a
            recipe; not part of the content.
        kinds: each recipe's kind of reasoning, empty if unknown; None for a book without kinds;
            not part of the content.
        quantities: each recipe's quantities, empty if unknown; None for a book without; not part of
            the content.
        reading: how the book's file was read; None without a file; not part of the content.

    Example:
        >>> graph = RecipeGraph.from_book(open_book("kitchen"))
        >>> graph.labels(graph.results("flour", "water"))
        ('dough',)
        >>> len(graph), "dough" in graph, "tractor" in graph
        (80, True, False)
    """

    def __init__(
        self,
        entities: Iterable[str],
        recipes: Ids,
        base_ids: Sequence[int] | Ids,
        name: str = "graph",
    ):
        """Build a graph from ids; most callers want :meth:`from_book` or :meth:`from_recipes`.

        Args:
            entities: labels, sorted, unique.
            recipes: shape (num_recipes, columns), rows ``(ingredients, padding, result)`` of ids,
                rows and ingredients in any order; the padding is the number of entities.
            base_ids: ids of the base entities, in any order.
            name: name in reports.

        Raises:
            GraphError: if labels are not sorted and unique, an id is out of range, or a recipe has
                more than :data:`~wordcraft_kg.graphs.recipes.MOST_INGREDIENTS` ingredients.
        """
        self.name = name
        self.base_is_inferred = False
        self.kinds: tuple[str, ...] | None = None
        self.quantities: tuple[str, ...] | None = None
        self.reading: Reading | None = None
        self.entities = tuple(entities)
        if any(label >= next_label for label, next_label in pairwise(self.entities)):
            raise GraphError("entity labels must be sorted and unique.")
        # A copy, whose ingredients are sorted below. A graph without recipes may come as an empty
        # list, which has another shape.
        rows = np.array(recipes, dtype=np.int64, order="C")
        rows = rows if rows.size else rows.reshape(0, 3)
        base = np.unique(np.asarray(base_ids, dtype=np.int64))
        padding = len(self.entities)
        rows[:, :-1].sort(axis=1)
        is_padding = rows == padding
        # Each recipe has a first ingredient and a result.
        is_padding[:, [0, -1]] = False
        for id_kind, ids in (("recipe", rows[~is_padding]), ("base", base)):
            if ids.size and (ids.min() < 0 or ids.max() >= padding):
                raise GraphError(f"a {id_kind} id is outside 0 .. {padding - 1}.")
        rows = without_empty_columns(rows, padding)
        self.sets: Ids = frozen(sorted_unique(rows, range(rows.shape[1])))
        self.base_ids: Ids = frozen(base)
        if rows.shape[1] > MOST_INGREDIENTS + 1:
            raise GraphError(
                f"a recipe has {rows.shape[1] - 1} ingredients; the most are {MOST_INGREDIENTS}."
            )

    @classmethod
    def from_book(cls, book: RecipeBook, base: Iterable[str] | None = None) -> "RecipeGraph":
        """Turn a recipe book into a graph.

        Args:
            book: the validated recipes.
            base: labels of the base entities; None takes the book's base or, if it declares none,
                the entities that no recipe makes.

        Raises:
            UnknownEntityError: if a base label is not in the book.
        """
        entities = book.entities
        index = {label: i for i, label in enumerate(entities)}
        rows = RecipeRows.of(book.recipes)
        # A label that no recipe mentions may be no entity; its place is never looked up.
        ids = (index.get(label, -1) for label in rows.labels)
        id_of_label = np.fromiter(ids, np.int64, len(rows.labels))
        # The padding of the rows becomes that of the graph.
        recipes = np.append(id_of_label, len(entities))[rows.ids]
        labels = book.base if base is None else sorted(set(base))
        if labels is None:
            base_ids = absent(recipes[:, -1], len(entities))
        else:
            for label in labels:
                if label not in index:
                    hint = nearest(label, entities)
                    raise UnknownEntityError(f"base entity '{label}' is not in {book.name}.{hint}")
            base_ids = np.array([index[label] for label in labels], dtype=np.int64)
        graph = cls(entities, recipes, base_ids, book.name)
        graph.base_is_inferred = labels is None
        graph.reading = book.reading
        if book.kinds:
            graph.kinds = tuple(book.kinds.get(recipe, "") for recipe in graph.recipe_labels())
        if book.quantities:
            graph.quantities = tuple(
                book.quantities.get(recipe, "") for recipe in graph.recipe_labels()
            )
        return graph

    def part(self, is_chosen: NDArray[np.bool_]) -> "RecipeGraph":
        """Return the graph of some recipes, with all entities, the same base and name.

        Args:
            is_chosen: shape (num_recipes,).
        """
        graph = RecipeGraph(self.entities, self.sets[is_chosen], self.base_ids, self.name)
        graph.kinds = self.kinds and tuple(compress(self.kinds, is_chosen))
        graph.quantities = self.quantities and tuple(compress(self.quantities, is_chosen))
        return graph

    def to_book(self) -> RecipeBook:
        """Return the recipe book of the graph, which lists all entities."""
        rows = RecipeRows(self.entities, self.sets)
        nothing = [""] * self.num_recipes
        idle = sorted(set(self.entities).difference(rows.mentioned))
        return RecipeBook(
            self.name,
            rows,
            self.base,
            tuple(idle),
            kinds=_told(rows, self.kinds or nothing),
            quantities=_told(rows, self.quantities or nothing),
        )

    @classmethod
    def from_recipes(
        cls,
        recipes: Iterable[Sequence[str]],
        base: Iterable[str] | None = None,
        name: str = "graph",
    ) -> "RecipeGraph":
        """Build a graph from labels, in memory; also of recipes that a recipe book leaves out.

        Args:
            recipes: rows ``(*ingredients, result)`` of labels, in any order. A row whose result is
                among its ingredients is kept.
            base: labels of the base entities; None for the entities that no recipe makes.
            name: name in reports.

        Returns:
            The graph; equal recipes and base give equal ids and hash, whatever their order.

        Raises:
            RecipeFileError: if a label cannot name an entity.
            UnknownEntityError: if a base label is in no recipe.
            TypeError: if a row does not have two labels or more.
        """
        rows: list[list[str]] = []
        for index, row in enumerate(recipes):
            rows.append([check_label(label, f"row {index}") for label in row])
        return cls.from_book(RecipeBook.of(name, rows, keep_self_results=True), base)

    # --- contents --------------------------------------------------------------------------------

    @property
    def num_entities(self) -> int:
        """Number of entities."""
        return len(self.entities)

    @cached_property
    def has_pairs_only(self) -> bool:
        """Whether each recipe has two ingredients."""
        return bool(np.all(self.sizes == 2))

    @property
    def most_ingredients(self) -> int:
        """Places for ingredients in :attr:`sets`: the largest recipe's number, 2 or more."""
        return self.sets.shape[1] - 1

    def most_leaves(self, attempts: int) -> int:
        """Return the most starting ingredients of a plan with so many attempts."""
        # Each further attempt makes one ingredient of another.
        return attempts * (self.most_ingredients - 1) + 1

    @cached_property
    def recipes(self) -> Ids:
        """All recipes of a graph of pairs, shape (num_recipes, 3), rows (a, b, result), as sorted.

        Code that cannot take sets of other sizes reads this, and refuses them so.

        Raises:
            GraphError: if a recipe has more than two ingredients, or one.
        """
        size = self.sizes
        other_sizes = np.flatnonzero(size != 2)
        if len(other_sizes):
            row = other_sizes[np.argmax(size[other_sizes])]
            (recipe,) = self.recipe_labels(self.sets[[row]])
            raise GraphError(
                f"the recipe {recipe} has {counted(int(size[row]), 'ingredient')}; the open-ended "
                "world, and other books as knowledge, take recipes of 2 so far. Tasks, "
                "`train-recipes`, link predictors, agents and their planner take all."
            )
        return self.sets

    @cached_property
    def sizes(self) -> Ids:
        """Number of ingredients of each recipe, shape (num_recipes,)."""
        return frozen(np.sum(self.sets[:, :-1] != self.num_entities, axis=1))

    @property
    def num_recipes(self) -> int:
        """Number of recipes; an ingredient pair with two results counts twice."""
        return len(self.sets)

    @property
    def num_pairs(self) -> int:
        """Number of distinct pairs, or larger sets, of ingredients in the recipes."""
        return len(self.pair_starts) - 1

    @property
    def has_self_results(self) -> bool:
        """Whether a recipe makes one of its ingredients; books drop such recipes by default."""
        return bool((self.sets[:, :-1] == self.sets[:, -1:]).any())

    @property
    def num_self_pairs(self) -> int:
        """Number of entities that combine with themselves."""
        heads, relations, tails = self.triples.T
        return int(np.sum((heads == tails) & (relations == COMBINES_WITH)))

    @property
    def base(self) -> tuple[str, ...]:
        """Base entity labels, sorted."""
        return self.labels(self.base_ids)

    @cached_property
    def hash(self) -> str:
        """SHA-256 hash of entities, base and recipes, equal for equal graphs on any machine."""
        # The first line is a version: another way to hash gets another number. Pairs have 1.
        num_columns = self.sets.shape[1]
        version = 1 if num_columns == 3 else 2
        facts: list[object] = [self.entities, self.base, num_columns][: version + 1]
        digest = hashlib.sha256(f"wordcraft-kg recipe graph {version}\n".encode())
        digest.update(json.dumps(facts).encode())
        digest.update(self.sets.astype("<i8").tobytes())  # little-endian on any machine
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RecipeGraph):
            return NotImplemented
        return self.hash == other.hash

    def __hash__(self) -> int:
        return hash(self.hash)

    def __repr__(self) -> str:
        sizes = f"{self.num_entities:,} entities, {self.num_recipes:,} recipes"
        return f"RecipeGraph({self.name!r}, {sizes}, hash {self.hash[:12]})"

    def __len__(self) -> int:
        return self.num_entities

    def __contains__(self, label: object) -> bool:
        return label in self._index

    def __bool__(self) -> bool:
        return True  # a graph without entities is a graph too

    # --- labels and ids --------------------------------------------------------------------------

    @cached_property
    def _index(self) -> dict[str, int]:
        return {label: i for i, label in enumerate(self.entities)}

    def id_of(self, entity: Entity) -> int:
        """Return the id of an entity given by label or id.

        Raises:
            UnknownEntityError: with the most similar labels, or with the range of ids.
        """
        if isinstance(entity, str):
            index = self._index.get(entity)
            if index is None:
                raise UnknownEntityError(
                    f"no entity '{entity}' in {self.name}.{nearest(entity, self.entities)}"
                )
            return index
        if not 0 <= entity < self.num_entities:
            raise UnknownEntityError(
                f"no entity id {entity} in {self.name}; ids are 0 .. {self.num_entities - 1}."
            )
        return int(entity)

    def ids_of(self, labels: Iterable[str]) -> Ids:
        """Return the ids of many labels.

        Raises:
            KeyError: if a label is no entity.
        """
        return np.fromiter(map(self._index.__getitem__, labels), np.int64)

    def labels(self, ids: Iterable[int]) -> tuple[str, ...]:
        """Return the labels for entity ids.

        Raises:
            IndexError: for ``num_entities``, the padding of many arrays, or a larger id.
        """
        return tuple(map(self.entities.__getitem__, ids))

    def recipe_labels(self, recipes: Ids | None = None) -> list[Recipe]:
        """Convert recipes from ids, rows of :attr:`sets`, to labels; None converts all."""
        return list(recipes_of_ids(self.entities, self.sets if recipes is None else recipes))

    # --- lookups ---------------------------------------------------------------------------------

    @cached_property
    def pair_starts(self) -> Ids:
        """First row of each ingredient pair, then ``num_recipes``; shape (num_pairs + 1,).

        Pair ``p`` has the rows ``pair_starts[p] : pair_starts[p + 1]``. In a graph of larger sets,
        each distinct set of ingredients counts as a pair.
        """
        # Recipes are sorted by pair, so a new pair begins where a row differs from the row before.
        is_first = np.ones(self.num_recipes, dtype=bool)
        changes = np.diff(self.sets[:, :-1], axis=0)
        is_first[1:] = np.any(changes != 0, axis=1)
        return frozen(np.append(np.flatnonzero(is_first), self.num_recipes))

    @cached_property
    def pair_of_recipe(self) -> Ids:
        """Pair number of each recipe, 0 to ``num_pairs`` - 1, shape (num_recipes,)."""
        return frozen(np.repeat(np.arange(self.num_pairs), np.diff(self.pair_starts)))

    @cached_property
    def by_result(self) -> tuple[Ids, Ids]:
        """Recipe index by result: rows ``order[starts[i] : starts[i + 1]]`` make entity i.

        Two arrays ``(starts, order)`` of shapes (num_entities + 1,) and (num_recipes,).
        """
        return _group(self.sets[:, -1], np.arange(self.num_recipes), self.num_entities)

    @cached_property
    def by_ingredient(self) -> tuple[Ids, Ids]:
        """Recipe index by ingredient: rows ``order[starts[i] : starts[i + 1]]`` use entity i.

        Two arrays ``(starts, order)``; the first has the shape (num_entities + 1,).
        """
        # A self pair uses its ingredient once.
        users, entities = different_ingredients(self.sets, self.num_entities)
        return _group(entities, users, self.num_entities)

    def results(self, *ingredients: Entity) -> Ids:
        """Return the ids of all results from combining entities, ascending, possibly empty.

        ``outcomes`` is a dictionary, for callers that ask often.

        Args:
            ingredients: ids or labels, one that is needed twice stands twice.

        Raises:
            UnknownEntityError: if the graph has no such entity.
        """
        ids = sorted(map(self.id_of, ingredients))
        num_places = self.sets.shape[1] - 1
        if not 0 < len(ids) <= num_places:
            return np.empty(0, dtype=np.int64)
        # The recipes of the ingredient with the fewest uses.
        rows = min(map(self.uses_of, ids), key=len)
        padding = [self.num_entities] * (num_places - len(ids))
        is_equal = (self.sets[rows, :-1] == [*ids, *padding]).all(axis=1)
        return frozen(self.sets[rows[is_equal], -1])

    @cached_property
    def outcomes(self) -> dict[tuple[int, ...], tuple[int, ...]]:
        """Result ids by ingredient ids, ascending with repetitions, for many fast lookups."""
        return outcomes_of(self.sets, self.num_entities)

    def rows_of(self, recipes: Ids) -> Ids:
        """Return the row of each recipe in :attr:`sets`, or -1 for a recipe that is not there.

        Args:
            recipes: shape (n, columns), rows (ingredients, padding, result), ingredients ascending.
        """
        tables = [self.sets, recipes]
        width = max(table.shape[1] for table in tables)
        for index, table in enumerate(tables):
            # Tables of smaller sets get columns of padding before the result.
            lacking = np.full((len(table), width - table.shape[1]), self.num_entities)
            tables[index] = np.column_stack([table[:, :-1], lacking, table[:, -1]])
        # In one call, so that the numbers can be compared; the first ones ascend like the recipes.
        graph_keys, keys = np.split(row_keys(np.concatenate(tables)), [self.num_recipes])
        rows = np.searchsorted(graph_keys, keys)
        # Behind the last recipe is none: the last one itself differs then.
        rows = np.minimum(rows, max(len(graph_keys) - 1, 0))
        is_known = graph_keys[rows] == keys if len(graph_keys) else np.zeros(len(keys), dtype=bool)
        return np.where(is_known, rows, -1)

    def rows_of_labels(self, recipes: Sequence[Sequence[str]]) -> Ids:
        """Return the row of each recipe in :attr:`sets`, or -1 for a recipe that is not there.

        Args:
            recipes: n recipes (*ingredients, result) by labels, ingredients in any order.

        Raises:
            KeyError: if a label is no entity.
        """
        ids = self.ids_of(chain.from_iterable(recipes))
        rows = stacked(ids, list(map(len, recipes)), self.num_entities)
        rows[:, :-1].sort(axis=1)
        return self.rows_of(rows)

    def recipes_of(self, result: Entity) -> Ids:
        """Return the row indices of recipes that make ``result``, ascending.

        Raises:
            UnknownEntityError: if the graph has no such entity.
        """
        return _member(self.by_result, self.id_of(result))

    def uses_of(self, entity: Entity) -> Ids:
        """Return the row indices of recipes that use ``entity`` as ingredient, ascending.

        Raises:
            UnknownEntityError: if the graph has no such entity.
        """
        return _member(self.by_ingredient, self.id_of(entity))

    @property
    def recipe_counts(self) -> Ids:
        """Number of recipes that make each entity, shape (num_entities,)."""
        return np.diff(self.by_result[0])

    @property
    def use_counts(self) -> Ids:
        """Number of recipes with each entity as ingredient, shape (num_entities,)."""
        return np.diff(self.by_ingredient[0])

    @cached_property
    def triples(self) -> Ids:
        """All triples ``(head, relation, tail)`` of the recipes, shape (num_triples, 3), sorted."""
        return frozen(recipe_triples(self.sets, self.num_entities))

    def triples_by_recipe(self, is_chosen: NDArray[np.bool_]) -> tuple[Ids, Ids]:
        """Return the triples that each of some recipes gives.

        Args:
            is_chosen: shape (num_recipes,).

        Returns:
            Numbers of the recipes among the chosen ones, shape (M,), and triples, shape (M, 3).
        """
        return triples_by_recipe(self.sets[is_chosen], self.num_entities)


def outcomes_of(recipes: Ids, padding: int) -> dict[tuple[int, ...], tuple[int, ...]]:
    """Return result ids by ingredient ids, ascending with repetitions.

    Args:
        recipes: shape (n, columns), rows (ingredients, padding, result), sorted.
        padding: value after the last ingredient.
    """
    results_of: dict[tuple[int, ...], list[int]] = {}
    for *ids, result in recipes.tolist():
        ingredients = tuple(entity for entity in ids if entity != padding)
        results_of.setdefault(ingredients, []).append(result)
    return {ingredients: tuple(results) for ingredients, results in results_of.items()}


def _told(recipes: Iterable[Recipe], texts: Iterable[str]) -> dict[Recipe, str]:
    """Return the texts of recipes that have one."""
    return {recipe: text for recipe, text in zip(recipes, texts, strict=True) if text}


def _member(index: tuple[Ids, Ids], key: int) -> Ids:
    starts, order = index
    return order[starts[key] : starts[key + 1]]


def _group(
    keys: Ids,
    values: Ids,
    size: int,
) -> tuple[Ids, Ids]:
    """Group ``values`` by key: group ``k`` is ``ordered[starts[k] : starts[k + 1]]``, ascending."""
    starts = np.concatenate([[0], np.cumsum(np.bincount(keys, minlength=size))])
    # By key first, then by value: one number for both, which is sorted faster than two columns.
    num_values = int(values.max(initial=0)) + 1
    numbers = keys * num_values + values
    numbers.sort()
    return frozen(starts), frozen(numbers % num_values)
