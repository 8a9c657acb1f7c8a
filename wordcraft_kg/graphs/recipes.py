"""Recipes, recipe books and the rules for labels; ``book_files`` reads and writes the files.

Labels are matched exactly: "Fire" and "fire" are two entities, which ``book_check`` reports.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, count
from operator import eq
from typing import Any, NamedTuple, overload

import numpy as np

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.wording import case_key, grouped, spelling_key
from wordcraft_kg.graphs.arrays import Ids, frozen, sorted_unique
from wordcraft_kg.graphs.reading import Reading

MAX_LABEL_LENGTH = 1_000
"""Most characters in a label; a longer label suggests another kind of file."""
_PIECE = 2**14  # recipes that are made at once from ids
_CONTROLS = "\x7f\x85\u2028\u2029"  # delete and line ends, beside those below 32


class Recipe(NamedTuple):
    """Two unordered ingredients and a result, by labels.

    Attributes:
        ingredient_a: the ingredient whose label comes first; make recipes with :meth:`of`.
        ingredient_b: the other ingredient; equal for an entity combined with itself.
        result: what the ingredients make.
    """

    ingredient_a: str
    ingredient_b: str
    result: str

    @classmethod
    def of(
        cls,
        one: str,
        other: str,
        result: str,
    ) -> "Recipe":
        """Create a recipe from ingredients in any order.

        Args:
            one: label of an ingredient.
            other: label of the other ingredient; may be the same.
            result: label of what they make.
        """
        if one <= other:
            return cls(one, other, result)
        return cls(other, one, result)

    def __str__(self) -> str:
        return f"{self.ingredient_a} + {self.ingredient_b} -> {self.result}"

    @property
    def is_self_result(self) -> bool:
        """Whether the result is also an ingredient."""
        return self.result in (self.ingredient_a, self.ingredient_b)


class RecipeRows(Sequence[Recipe]):
    """Recipes as ids of labels: a sequence that makes each recipe when it is asked for.

    It equals the tuple of its recipes. A book of millions of recipes is read and written by columns
    of ids, without an object for each recipe.

    Attributes:
        labels: the label of each id, unique; recipes need not mention all of them.
        ids: shape (num_recipes, 3), int64, rows (ingredient, ingredient, result).

    Example:
        >>> rows = RecipeRows(("earth", "mud", "water"), np.array([[0, 2, 1]]))
        >>> print(rows[0], rows == (Recipe("earth", "water", "mud"),))
        earth + water -> mud True
    """

    def __init__(self, labels: Iterable[str], ids: Ids):
        """Take ids of labels; nothing is checked.

        Args:
            labels: the label of each id, unique.
            ids: shape (num_recipes, 3), int64, rows (ingredient, ingredient, result). The array
                becomes read-only.
        """
        self.labels = tuple(labels)
        self.ids: Ids = frozen(ids)

    @classmethod
    def of(cls, recipes: Iterable[Recipe]) -> "RecipeRows":
        """Number the labels of recipes, in the order in which they are met.

        Args:
            recipes: recipes in any order, which stays; rows with ids are returned as they are.
        """
        if isinstance(recipes, RecipeRows):
            return recipes
        number_of: defaultdict[str, int] = defaultdict(count().__next__)
        # One stream of ids, without a list for each of perhaps a million recipes.
        ids = map(number_of.__getitem__, chain.from_iterable(recipes))
        numbered = np.fromiter(ids, np.int64).reshape(-1, 3)
        return cls(number_of, numbered)

    def in_order(self) -> "RecipeRows":
        """Return the same rows with ids by sorted label, and ascending ingredients in each row."""
        label_of = self.labels.__getitem__
        order = sorted(range(len(self.labels)), key=label_of)
        # New id by old id: the inverse of the order.
        new_id = np.empty(len(order), dtype=np.int64)
        new_id[order] = np.arange(len(order))
        a, b, result = new_id[self.ids].T
        smaller = np.minimum(a, b)
        larger = np.maximum(a, b)
        rows = np.column_stack([smaller, larger, result])
        return RecipeRows(map(label_of, order), rows)

    @cached_property
    def mentioned(self) -> tuple[str, ...]:
        """Labels that the recipes mention, in id order."""
        uses = np.bincount(self.ids.ravel(), minlength=len(self.labels))
        if uses.all():
            return self.labels
        return tuple(map(self.labels.__getitem__, np.flatnonzero(uses).tolist()))

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, index: int) -> Recipe: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Recipe, ...]: ...

    def __getitem__(self, index: int | slice) -> Recipe | tuple[Recipe, ...]:
        if isinstance(index, slice):
            return self._made(self.ids[index])
        return self._made(self.ids[index][None])[0]

    def __iter__(self) -> Iterator[Recipe]:
        # In pieces: a reader of the first few recipes does not wait for millions.
        for start in range(0, len(self.ids), _PIECE):
            yield from self._made(self.ids[start : start + _PIECE])

    def _made(self, rows: Ids) -> tuple[Recipe, ...]:
        """Return the recipes of rows of ids, shape (n, 3); by column, which is faster."""
        ids_a, ids_b, ids_of_results = rows.T.tolist()
        label_of = self.labels.__getitem__
        ingredients_a = map(label_of, ids_a)
        ingredients_b = map(label_of, ids_b)
        results = map(label_of, ids_of_results)
        return tuple(map(Recipe, ingredients_a, ingredients_b, results))

    def __eq__(self, other: object) -> bool:
        if isinstance(other, RecipeRows) and self.labels == other.labels:
            return np.array_equal(self.ids, other.ids)
        if not isinstance(other, RecipeRows | tuple):
            return NotImplemented
        return len(self) == len(other) and all(map(eq, self, other))

    def __hash__(self) -> int:
        # That of the tuple, which is equal.
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))


@dataclass(frozen=True)
class RecipeBook:
    """A validated list of recipes, from a file or from memory.

    Attributes:
        name: name in reports; not part of the content.
        recipes: sorted, without duplicates: a tuple, or :class:`RecipeRows`, which equal the tuple.
        base: declared base entities (known at the start), sorted; None if the book declares none.
        idle: entities that the book lists but no recipe in ``recipes`` mentions, sorted.
        dropped_self_results: number of omitted rows whose result is among their ingredients.
        merged_duplicates: number of omitted rows that repeat a recipe.
        sha256: hash of the file's bytes; None for a book that was not read from a file.
        kinds: kind of reasoning by recipe, such as ``making``; empty for a book without kinds.
        reading: how the file was read; None for a book that was not read from a file.
    """

    name: str
    recipes: Sequence[Recipe]
    base: tuple[str, ...] | None = None
    idle: tuple[str, ...] = ()
    dropped_self_results: int = 0
    merged_duplicates: int = 0
    sha256: str | None = None
    kinds: Mapping[Recipe, str] = field(default_factory=dict, hash=False)
    # Two shapes of one content are one book.
    reading: Reading | None = field(default=None, compare=False)

    @classmethod
    def of(
        cls,
        name: str,
        rows: Iterable[Sequence[str]],
        *,
        base: Iterable[str] | None = None,
        listed: Iterable[str] = (),
        keep_self_results: bool = False,
        sha256: str | None = None,
    ) -> "RecipeBook":
        """Make a book, and count the rows that are left out.

        Args:
            name: name in reports.
            rows: rows (ingredient, ingredient, result) of valid labels, in any order; or numbered
                rows, in which ingredients may be in any order, too.
            base: base entities; None if the book declares none.
            listed: further entities, which recipes need not mention.
            keep_self_results: keep rows whose result is among their ingredients. By default they
                are left out: they make nothing new, and give a task away in a triple.
            sha256: hash of the file's bytes; None without a file.

        Raises:
            TypeError: if a row does not have three labels.
        """
        numbered = rows if isinstance(rows, RecipeRows) else RecipeRows.of(map(_recipe_of, rows))
        ordered = numbered.in_order()
        kept = ordered.ids
        num_dropped = 0
        if not keep_self_results:
            a, b, result = kept.T
            is_self_result = (result == a) | (result == b)
            num_dropped = int(np.sum(is_self_result))
            # No copy of a large book that has no such row.
            if num_dropped:
                kept = kept[~is_self_result]
        # By id, which is by label here: texts are compared once, when their ids are given.
        recipes = RecipeRows(ordered.labels, sorted_unique(kept, (0, 1, 2)))
        num_merged = len(kept) - len(recipes)
        declared = None if base is None else tuple(sorted(set(base)))
        # Entities of omitted rows stay entities, so that ids do not depend on what is left out.
        known = ordered.labels if num_dropped else ()
        idle = set(known).union(listed, declared or ())
        idle.difference_update(recipes.mentioned)
        return cls(name, recipes, declared, tuple(sorted(idle)), num_dropped, num_merged, sha256)

    @cached_property
    def entities(self) -> tuple[str, ...]:
        """Labels of all entities in the book, sorted."""
        mentioned = RecipeRows.of(self.recipes).mentioned
        others = set(self.idle).difference(mentioned)
        # Fast for labels that are in order already, as those of a book that was read are.
        return tuple(sorted([*mentioned, *others]))


def _recipe_of(row: Sequence[str]) -> Recipe:
    """Return the recipe of a row (ingredient, ingredient, result)."""
    return row if isinstance(row, Recipe) else Recipe.of(*row)


def label_fault(label: Any) -> str | None:
    """Return why a value cannot be an entity label, or None for a valid label.

    Labels stand in tables, XML and terminals, so they hold no line breaks and control characters,
    no halves of characters, and none of the code points that Unicode reserves as no character.
    """
    if not isinstance(label, str):
        return f"{shown(label)} is not a label; a label is text."
    if not label or label.isspace():
        return f"the label {shown(label)} is blank; every entity needs a name."
    if len(label) > MAX_LABEL_LENGTH:
        return f"a label of {len(label):,} characters; the limit is {MAX_LABEL_LENGTH:,}."
    # isprintable is a quick test; some characters that it refuses are allowed, such as U+00A0.
    if label.isprintable():
        return None
    subject = f"the label {shown(label)} holds"
    if any(ord(char) < 32 or char in _CONTROLS for char in label):
        return f"{subject} a tab, line break or control character."
    if any("\ud800" <= char <= "\udfff" for char in label):
        return f"{subject} half of a character (a lone surrogate)."
    if "\ufffe" in label or "\uffff" in label:
        return f"{subject} U+FFFE or U+FFFF, which XML cannot hold."
    return None


def check_label(label: Any, where: str) -> str:
    """Return a value that is a valid entity label, see :func:`label_fault`.

    Args:
        label: the value, of any type.
        where: place in a file, for the error.

    Raises:
        RecipeFileError: if it is not valid; the message names the place.
    """
    fault = label_fault(label)
    if fault is not None:
        raise RecipeFileError(f"{where}: {fault}")
    return str(label)


def alike_labels(labels: Iterable[str]) -> list[tuple[str, ...]]:
    """Return groups of labels that differ only by spelling, probably typos.

    Differences are case, width, Unicode composition, variation selectors, and blanks, hyphens,
    apostrophes and points between letters. Labels that differ in a digit or a sign, such as ``O2``
    and ``O2-``, or ``1.0`` and ``10``, are different things; see
    :mod:`wordcraft_kg.base.wording`.
    """
    return grouped(labels, spelling_key)


def case_variants(labels: Iterable[str]) -> list[tuple[str, ...]]:
    """Return groups of labels that differ only in case, width or variation selectors.

    Such labels are different entities, often by accident: a chat bot lists results as ``Lava`` and
    ingredients as ``lava``, and half of the recipes are out of reach.

    Example:
        >>> case_variants(["Lava", "Stone", "lava"])
        [('Lava', 'lava')]
    """
    return grouped(labels, case_key)


def shown(value: Any) -> str:
    """Return a value's ``repr``, cut to 80 characters."""
    return repr(value)[:80]
