"""Recipes, recipe books and the rules for labels; ``book_files`` reads and writes the files.

Labels are matched exactly: "Fire" and "fire" are two entities, which ``book_check`` reports.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.spelling import case_key, grouped, spelling_key
from wordcraft_kg.graphs.reading import Reading

MAX_LABEL_LENGTH = 1_000
"""Most characters in a label; a longer label suggests another kind of file."""


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


@dataclass(frozen=True)
class RecipeBook:
    """A validated list of recipes, from a file or from memory.

    Attributes:
        name: name in reports; not part of the content.
        recipes: sorted, without duplicates.
        base: declared base entities (known at the start), sorted; None if the book declares none.
        idle: entities that the book lists but no recipe in ``recipes`` mentions, sorted.
        dropped_self_results: number of omitted rows whose result is among their ingredients.
        merged_duplicates: number of omitted rows that repeat a recipe.
        sha256: hash of the file's bytes; None for a book that was not read from a file.
        kinds: kind of reasoning by recipe, such as ``making``; empty for a book without kinds.
        reading: how the file was read; None for a book that was not read from a file.
    """

    name: str
    recipes: tuple[Recipe, ...]
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
            rows: rows (ingredient, ingredient, result) of valid labels, in any order.
            base: base entities; None if the book declares none.
            listed: further entities, which recipes need not mention.
            keep_self_results: keep rows whose result is among their ingredients. By default they
                are left out: they make nothing new, and give a task away in a triple.
            sha256: hash of the file's bytes; None without a file.
        """
        kept: set[Recipe] = set()
        # Entities of omitted rows stay entities, so that ids do not depend on what is left out.
        dropped_labels: set[str] = set()
        dropped = merged = 0
        for row in rows:
            recipe = row if isinstance(row, Recipe) else Recipe.of(*row)
            if recipe.is_self_result and not keep_self_results:
                dropped += 1
                dropped_labels.update(recipe)
            elif recipe in kept:
                merged += 1
            else:
                kept.add(recipe)
        mentioned = set(chain.from_iterable(kept))
        declared = None if base is None else tuple(sorted(set(base)))
        idle = tuple(sorted(dropped_labels.union(listed, declared or ()) - mentioned))
        recipes = _sorted(kept, mentioned)
        return cls(name, recipes, declared, idle, dropped, merged, sha256)

    @cached_property
    def entities(self) -> tuple[str, ...]:
        """Labels of all entities in the book, sorted."""
        return tuple(sorted(set(chain.from_iterable(self.recipes)).union(self.idle)))


def _sorted(recipes: Collection[Recipe], labels: Iterable[str]) -> tuple[Recipe, ...]:
    """Return recipes in ascending order; ``labels`` are all of theirs."""
    # By the places of their labels: a million tuples of texts take three times as long to compare.
    place = {label: index for index, label in enumerate(sorted(labels))}
    every = list(recipes)
    places = np.fromiter(map(place.__getitem__, chain.from_iterable(every)), np.int64)
    one, other, result = places.reshape(-1, 3).T
    # lexsort takes the most important key last.
    order = np.lexsort((result, other, one))
    return tuple(map(every.__getitem__, order.tolist()))


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
    if not label.isprintable():
        if any(ord(char) < 32 or char in "\x7f\x85\u2028\u2029" for char in label):
            return f"the label {shown(label)} holds a tab, line break or control character."
        if any("\ud800" <= char <= "\udfff" for char in label):
            return f"the label {shown(label)} holds half of a character (a lone surrogate)."
        if "\ufffe" in label or "\uffff" in label:
            return f"the label {shown(label)} holds U+FFFE or U+FFFF, which XML cannot hold."
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
    :mod:`wordcraft_kg.base.spelling`.
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
