"""Recipes, recipe books and the rules for labels; ``book_files`` reads and writes the files.

:class:`Reading` records how a book's file was read: the guess that commands announce.

Labels are matched exactly: "Fire" and "fire" are two entities, which ``book_check`` reports.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain, count
from operator import eq
from typing import Any, overload

import msgspec
import numpy as np

from wordcraft_kg.base import Count, RecipeFileError, Record, counted, for_terminal, listed
from wordcraft_kg.base.wording import grouped, spelling_key
from wordcraft_kg.graphs.arrays import (
    Ids,
    frozen,
    sorted_unique,
    stacked,
    without_empty_columns,
)

MOST_INGREDIENTS = 8
"""Most ingredients of a recipe; one that is needed twice counts twice."""
MAX_LABEL_LENGTH = 1_000
"""Most characters in a label; a longer label suggests another kind of file."""
_PIECE = 2**14  # recipes that are made at once from ids
_CONTROLS = "\x7f\x85\u2028\u2029"  # delete and line ends, beside those below 32


class Recipe(tuple[str, ...]):
    """A multiset of ingredients and a result, by labels: the tuple ``(*ingredients, result)``.

    Ingredients are in the order of their labels, one that is needed twice stands twice. A recipe of
    two ingredients unpacks as ``a, b, result``.

    Example:
        >>> recipe = Recipe(["water", "flour", "salt"], "dough")
        >>> print(recipe, recipe == Recipe.of("salt", "water", "flour", "dough"))
        flour + salt + water -> dough True
    """

    __slots__ = ()

    def __new__(cls, ingredients: Iterable[str], result: str) -> "Recipe":
        """Create a recipe.

        Args:
            ingredients: labels of the ingredients, in any order, with repetitions.
            result: label of what they make.

        Raises:
            TypeError: if there is no ingredient.
        """
        labels = (*sorted(ingredients), result)
        if len(labels) < 2:
            raise TypeError(f"{result!r} has no ingredient; a recipe needs one.")
        return tuple.__new__(cls, labels)

    @classmethod
    def of(cls, *labels: str) -> "Recipe":
        """Create a recipe from the labels of the ingredients, in any order, and of the result.

        Raises:
            TypeError: if there is no ingredient.
        """
        *ingredients, result = labels
        return cls(ingredients, result)

    def __getnewargs__(self) -> tuple[tuple[str, ...], str]:
        return self.ingredients, self.result

    def __str__(self) -> str:
        return f"{' + '.join(self.ingredients)} -> {self.result}"

    def __repr__(self) -> str:
        return f"Recipe({self.ingredients!r}, {self.result!r})"

    @property
    def ingredients(self) -> tuple[str, ...]:
        """The ingredients, in the order of their labels."""
        return self[:-1]

    @property
    def result(self) -> str:
        """What the ingredients make."""
        return self[-1]

    @property
    def is_self_result(self) -> bool:
        """Whether the result is also an ingredient."""
        return self.result in self.ingredients


def recipes_of_ids(labels: Sequence[str], rows: Ids) -> tuple[Recipe, ...]:
    """Return the recipes of rows of ids.

    Args:
        labels: the label of each id.
        rows: shape (n, columns), rows (ingredients, padding, result); the padding is no id of a
            label, but their number.
    """
    is_padded = bool((rows[:, :-1] == len(labels)).any())
    # No label is empty, so that the filter takes the padding alone.
    label_of = (*labels, "").__getitem__ if is_padded else labels.__getitem__
    # By column: a million short lists would cost the garbage collector more time than the work.
    columns = [map(label_of, column) for column in rows.T.tolist()]
    recipes: Iterable[tuple[str, ...]] = zip(*columns, strict=True)
    if is_padded:
        recipes = (tuple(filter(None, recipe)) for recipe in recipes)
    # The ingredients are in order already.
    return tuple(map(partial(tuple.__new__, Recipe), recipes))


class RecipeRows(Sequence[Recipe]):
    """Recipes as ids of labels: a sequence that makes each recipe when it is asked for.

    It equals the tuple of its recipes. A book of millions of recipes is read and written by columns
    of ids, without an object for each recipe.

    Attributes:
        labels: the label of each id, unique; recipes need not mention all of them.
        ids: shape (num_recipes, columns), int64, rows (ingredients, padding, result), with two
            columns of ingredients or as many as the largest recipe has. The padding after the last
            ingredient is ``len(labels)``.

    Example:
        >>> rows = RecipeRows(("earth", "mud", "water"), np.array([[0, 2, 1]]))
        >>> print(rows[0], rows == (Recipe.of("earth", "water", "mud"),))
        earth + water -> mud True
    """

    def __init__(self, labels: Iterable[str], ids: Ids):
        """Take ids of labels; nothing is checked.

        Args:
            labels: the label of each id, unique.
            ids: shape (num_recipes, columns), int64, rows (ingredients, padding, result). The array
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
        lengths: list[int] = []

        def measured(recipe: Recipe) -> Recipe:
            lengths.append(len(recipe))
            return recipe

        # One stream of ids, without a list for each of perhaps a million recipes.
        labels = chain.from_iterable(map(measured, recipes))
        ids = np.fromiter(map(number_of.__getitem__, labels), np.int64)
        return cls(number_of, stacked(ids, lengths, len(number_of)))

    def in_order(self) -> "RecipeRows":
        """Return the same rows with ids by sorted label, and ascending ingredients in each row."""
        label_of = self.labels.__getitem__
        order = sorted(range(len(self.labels)), key=label_of)
        # New id by old id: the inverse of the order; the padding stays behind all ids.
        new_id = np.empty(len(order) + 1, dtype=np.int64)
        new_id[order] = np.arange(len(order))
        new_id[-1] = len(order)
        rows = new_id[self.ids]
        rows[:, :-1].sort(axis=1)
        return RecipeRows(map(label_of, order), rows)

    @cached_property
    def mentioned(self) -> tuple[str, ...]:
        """Labels that the recipes mention, in id order."""
        uses = np.bincount(self.ids.ravel(), minlength=len(self.labels))[: len(self.labels)]
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
            return recipes_of_ids(self.labels, self.ids[index])
        return recipes_of_ids(self.labels, self.ids[index][None])[0]

    def __iter__(self) -> Iterator[Recipe]:
        # In pieces: a reader of the first few recipes does not wait for millions.
        for start in range(0, len(self.ids), _PIECE):
            yield from recipes_of_ids(self.labels, self.ids[start : start + _PIECE])

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


_SHOWN = 6  # names of columns that are left out, in the line about a file


class Reading(Record, omit_defaults=True, kw_only=True):
    """How a recipe book's file was read, and what became of its rows.

    ``rows`` is the sum of ``kept`` and all numbers in ``left_out``: no row is lost in silence.

    Attributes:
        shape: kind of file, such as "table" or "lines a + b = c".
        container: compression or archive around the file, such as "gzip"; empty without one.
        encoding: encoding of the text; empty if it is not text, such as a folder.
        delimiter: column delimiter of a table; empty for other shapes.
        header: whether a table's first row names the columns.
        columns: columns, keys or fields with the ingredients and, last, the results.
        num_results: number of ``columns`` with results.
        ignored: further columns, which are not read.
        case: "fold" if labels were changed to lower case; empty if they are as in the file.
        rows: recipes in the file; a row with several results counts once for each.
        kept: rows that became a recipe of the book.
        left_out: number of other rows by reason.
        arities: number of rows by their number of ingredients, as digits.
        counts_dropped: ingredients whose number of pieces is not kept.
        trimmed: cells with characters at their ends that cannot be seen, which are left out.
        notes: further remarks.
    """

    shape: str
    container: str = ""
    encoding: str = ""
    delimiter: str = ""
    header: bool = True
    columns: tuple[str, ...] = ()
    num_results: Count = 1
    ignored: tuple[str, ...] = ()
    case: str = ""
    rows: Count = 0
    kept: Count = 0
    left_out: dict[str, Count] = msgspec.field(default_factory=dict)
    arities: dict[str, Count] = msgspec.field(default_factory=dict)
    counts_dropped: Count = 0
    trimmed: Count = 0
    notes: tuple[str, ...] = ()

    def line(self) -> str:
        """Return a sentence for people: shape, columns, rows kept, and rows left out with reasons.

        Example:
            >>> left_out = {"repeated": 1}
            >>> Reading(shape="table", delimiter=";", rows=3, kept=2, left_out=left_out).line()
            "read as table with delimiter ';'; kept 2 of 3 rows (1 repeated)"
        """
        facts = ", ".join(self._facts())
        reasons = ", ".join(f"{number:,} {reason}" for reason, number in self.left_out.items())
        suffix = f" ({reasons})" if reasons else ""
        rows = f"kept {self.kept:,} of {counted(self.rows, 'row')}{suffix}"
        return for_terminal(f"{facts}; {rows}")

    def _facts(self) -> Iterator[str]:
        """Yield what the line says about the file, without what goes without saying."""
        delimiter = f" with delimiter {self.delimiter!r}" if self.delimiter else ""
        yield f"read as {self.shape}{delimiter}"
        ingredients = " + ".join(self.columns[: -self.num_results])
        results = ", ".join(self.columns[-self.num_results :])
        arities = ", ".join(f"{number:,} of {arity}" for arity, number in self.arities.items())
        facts: tuple[tuple[object, str], ...] = (
            (self.columns, f"{ingredients} = {results}"),
            (not self.header, "no header"),
            (self.ignored, f"other columns ignored: {listed(self.ignored, _SHOWN)}"),
            (self.container, f"from {self.container}"),
            (self.encoding not in ("", "utf-8"), f"encoding {self.encoding}"),
            (self.case, "labels in lower case"),
            (self.counts_dropped, f"{counted(self.counts_dropped, 'number')} of pieces not kept"),
            (self.trimmed, f"{counted(self.trimmed, 'cell')} without blanks that cannot be seen"),
            (self.arities.keys() - {"2"}, f"rows by number of ingredients: {arities}"),
        )
        yield from (text for is_said, text in facts if is_said)
        yield from self.notes


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
        quantities: numbers by recipe, one for each ingredient with blanks between, which no score
            depends on; empty for a book without quantities.
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
    quantities: Mapping[Recipe, str] = field(default_factory=dict, hash=False, kw_only=True)
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
            rows: rows (*ingredients, result) of valid labels, in any order; or numbered rows, in
                which ingredients may be in any order, too.
            base: base entities; None if the book declares none.
            listed: further entities, which recipes need not mention.
            keep_self_results: keep rows whose result is among their ingredients. By default they
                are left out: they make nothing new, and give a task away in a triple.
            sha256: hash of the file's bytes; None without a file.

        Raises:
            TypeError: if a row does not have two labels or more.
        """
        whole_rows = (row if isinstance(row, Recipe) else Recipe.of(*row) for row in rows)
        numbered = rows if isinstance(rows, RecipeRows) else RecipeRows.of(whole_rows)
        ordered = numbered.in_order()
        recipe_ids = ordered.ids
        is_self_result = (recipe_ids[:, :-1] == recipe_ids[:, -1:]).any(axis=1)
        num_dropped = 0 if keep_self_results else int(np.sum(is_self_result))
        # No copy of a large book that has no such row.
        if num_dropped:
            recipe_ids = recipe_ids[~is_self_result]
        # By id, which is by label here: texts are compared once, when their ids are given.
        recipe_ids = without_empty_columns(recipe_ids, len(ordered.labels))
        recipes = RecipeRows(ordered.labels, sorted_unique(recipe_ids, range(recipe_ids.shape[1])))
        num_merged = len(recipe_ids) - len(recipes)
        declared = None if base is None else tuple(sorted(set(base)))
        # Entities of omitted rows stay entities, so that ids do not depend on what is left out.
        ordered_labels = ordered.labels if num_dropped else ()
        idle = set(ordered_labels).union(listed, declared or ())
        idle.difference_update(recipes.mentioned)
        return cls(name, recipes, declared, tuple(sorted(idle)), num_dropped, num_merged, sha256)

    @cached_property
    def entities(self) -> tuple[str, ...]:
        """Labels of all entities in the book, sorted."""
        mentioned = RecipeRows.of(self.recipes).mentioned
        idle_labels = set(self.idle).difference(mentioned)
        # Fast for labels that are in order already, as those of a book that was read are.
        return tuple(sorted([*mentioned, *idle_labels]))


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


def shown(value: Any) -> str:
    """Return a value's ``repr``, cut to 80 characters."""
    return repr(value)[:80]


# --- labels that may be something else ------------------------------------------------------------

NOTHING = "Nothing"
"""Result of pairs that make nothing in Infinite Craft."""
_MISSING = frozenset({"NA", "N/A", "n/a", "<NA>", "nan", "NaN", "NULL", "null", "None", "-", "--"})
_NUMBER = r"(?P<number>\d{1,3})"  # four digits are rather a year
_LABEL = r"(?P<label>[^\W\d].*|\W*[^\W\d].*)"
_COUNTS = tuple(
    re.compile(pattern)
    for pattern in (
        rf"{_NUMBER}\s*[x×*]?\s+{_LABEL}",  # 2 water, 2x water
        rf"[x×]\s?{_NUMBER}\s+{_LABEL}",  # x2 water
        rf"{_LABEL}(?:\s+x\s?|\s*[×*]\s?){_NUMBER}",  # water x2, water*2
        rf"{_LABEL}\s*\(\s*[x×]?\s?{_NUMBER}\s?[x×]?\s*\)",  # water (2), water (x2)
    )
)
_CLEAR = 0.2  # share of the labels with numbers that is worth a remark
HTML_ENTITY = re.compile(r"&(?:#\d+|#x[0-9a-fA-F]+|[A-Za-z]\w+);")


def is_missing(cell: str) -> bool:
    """Return whether a cell is what programs write for an empty one."""
    return cell in _MISSING


def count_in(cell: str) -> tuple[str, int] | None:
    """Return the label and the number of pieces in a cell, or None without a number.

    Example:
        >>> count_in("2 water"), count_in("water x2"), count_in("water (2)"), count_in("H2")
        (('water', 2), ('water', 2), ('water', 2), None)
    """
    # Most cells hold no digit, and need no pattern.
    if not any(char.isdigit() for char in cell):
        return None
    for pattern in _COUNTS:
        match = pattern.fullmatch(cell)
        if match:
            return match["label"].strip(), int(match["number"])
    return None


def notes_about(labels: Collection[str]) -> Iterator[str]:
    """Yield remarks about labels that may be something else, for the line about the file."""
    yield from note_of_missing(labels)
    yield from note_of_numbers(labels)


def note_of_missing(labels: Collection[str]) -> Iterator[str]:
    """Yield a remark, or none, about labels that often stand for nothing, such as NA."""
    missing_like_labels = sorted(label for label in labels if label == NOTHING or is_missing(label))
    if missing_like_labels:
        names = ", ".join(map(_quoted, missing_like_labels))
        noun = "an entity" if len(missing_like_labels) == 1 else "entities"
        yield f"{names} kept as {noun}"


def note_of_numbers(labels: Collection[str]) -> Iterator[str]:
    """Yield a remark, or none, about numbers of pieces that may be in labels.

    One label is enough if it stands beside the label without the number.
    """
    counts = {label: count_in(label) for label in labels}
    numbered = [label for label, count in counts.items() if count]
    beside = [label for label, count in counts.items() if count and count[0] in counts]
    if beside or len(numbered) > _CLEAR * len(counts):
        example = _quoted(min(beside or numbered))
        also = " beside the label without it" if beside else ""
        yield (
            f"{counted(len(numbered), 'label')} with numbers, such as {example}{also}; numbers of "
            "pieces are no part of a label"
        )


def _quoted(label: str) -> str:
    return f"'{label[:60]}'"
