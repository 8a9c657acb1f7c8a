"""The recipes of a file's rows: two ingredients each, chains for more, and counts for the line."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from itertools import islice

from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.cells import (
    JUDGED_ENTRIES,
    Cells,
    count_in,
    notes_about,
    trim_unseen,
    without_markup,
)
from wordcraft_kg.graphs.book_files.guide import GUIDE
from wordcraft_kg.graphs.book_files.opening import OpenedFile
from wordcraft_kg.graphs.book_files.options import BookOptions
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, LeftOut, Place, alternatives
from wordcraft_kg.graphs.chains import HALF, MOST_INGREDIENTS, chain, is_half_product, is_step
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import Recipe, RecipeRows, label_fault

_TOTAL = re.compile(r"(?:grand )?totals?|sum|count|summe|gesamt|anzahl|total[ie]?", re.IGNORECASE)
"""A row of totals at the end of a table, which is no recipe of one ingredient."""
_SELF_RESULT = "with an ingredient as the result"
_SELF = "self"  # the `single_ingredient` that combines a single ingredient with itself


class BookRows:
    """The recipes of an opened file, with two ingredients each; iterate once.

    Attributes:
        kinds: kind of reasoning by recipe; complete after the iteration.
        rows: rows that were recipes.
        left_out: number of other entries by reason.
        arities: number of rows by number of ingredients.
    """

    def __init__(self, file: OpenedFile, options: BookOptions):
        """Take a file's entries; they are read while iterating.

        Args:
            file: the opened file, whose entries were not iterated yet.
            options: what the user says about the file.
        """
        self.file = file
        self.options = options
        self.kinds: dict[Recipe, str] = {}
        self.rows = 0
        self.left_out: Counter[str] = Counter()
        self.arities: Counter[int] = Counter()
        self._counts_dropped = 0
        self._halves: dict[str, Recipe] = {}
        self._marked = ""  # a label of the file that ends like a half-product
        # Shapes of our own hold any label, so that a book is read as it was written.
        self._cells: Cells | None = None

    @property
    def base(self) -> dict[str, Place] | None:
        """Declared base entities and their places."""
        base = self.file.source.base
        if base is None:
            return None
        return {self._label(label): place for label, place in base.items()}

    @property
    def listed(self) -> dict[str, Place]:
        """Entities listed outside of recipes and their places."""
        listed = self.file.source.listed
        return {self._label(label): place for label, place in listed.items()}

    def _label(self, cell: str) -> str:
        """Return the label of an entity that is declared or listed, which counts for nothing."""
        label = cell
        if self._cells is not None:
            label = without_markup(trim_unseen(cell))
            found = count_in(label) if self._cells.example else None
            label = label if found is None else found[0]
        return self._folded(label)

    def _folded(self, label: str) -> str:
        return label.lower() if self.options.case == "fold" else label

    def __iter__(self) -> Iterator[tuple[Place, list[Recipe]] | Fault]:
        """Yield each row's place and recipes, the row's own recipe last, and faults.

        A chain is several recipes; its first ones make half-products.
        """
        fold = self._changes_pairs
        kind_of = self.file.source.kind_of
        pairs = 0
        for entry in self._entries():
            # The frequent row takes a short way: two ingredients, in a book without kinds.
            if (
                type(entry) is tuple
                and len(entry[1]) == 3
                and not (fold or kind_of or is_half_product(entry[1][2]))
                and (self._cells is None or self._cells.are_clean(entry[1]))
            ):
                pairs += 1
                yield entry[0], [Recipe.of(*entry[1])]
            elif isinstance(entry, Fault):
                yield entry
            elif isinstance(entry, LeftOut):
                self.rows += 1
                self.left_out[entry.reason] += 1
            else:
                yield from self._row(*entry)
        if pairs:
            self.rows += pairs
            self.arities[2] += pairs

    def all_at_once(self) -> RecipeRows | None:
        """Return the recipes of all rows, if the file is nothing but plain pairs; None to iterate.

        Rows are counted as by an iteration.
        """
        source = self.file.source
        if not source.is_exact or self._changes_pairs:
            return None
        rows = source.all_rows()
        if rows is not None and len(rows):
            self.rows += len(rows)
            self.arities[2] += len(rows)
        return rows

    @property
    def _changes_pairs(self) -> bool:
        """Whether an option may change the labels or the number of recipes of a pair."""
        return self.options.case == "fold" or self.options.ingredients == "chain"

    def _entries(self) -> Iterator[Entry]:
        """Yield the file's entries; the first ones tell whether cells hold numbers of pieces."""
        source = self.file.source
        if source.is_exact:
            yield from source
            return
        entries = iter(source)
        first = list(islice(entries, JUDGED_ENTRIES))
        self._cells = Cells(first)
        yield from first
        yield from entries

    def _row(
        self, place: Place, cells: Sequence[str]
    ) -> Iterator[tuple[Place, list[Recipe]] | Fault]:
        """Yield a row's recipes or its fault; nothing for a row that is left out."""
        self.rows += 1
        *parts, made = cells
        kind = self.file.source.kind_of.get((tuple(sorted(parts)), made), "")
        labels = cells if self._cells is None else self._labels(self._cells, cells)
        blank = next((label for label in labels if not label), None)
        if blank is not None:
            where = f"{place}: " if isinstance(place, str) else ""
            message = f"{where}{cells!r:.80} has a blank label; every entity needs a name."
            yield Fault(place, "label", message)
            return
        self.arities[len(labels) - 1] += 1
        labels = list(map(self._folded, labels))
        recipes: list[Recipe] | Fault | LeftOut
        if len(labels) == 3:
            recipes = self._pair(place, labels)
        else:
            recipes = self._paired(place, labels)
        if isinstance(recipes, LeftOut):
            self.left_out[recipes.reason] += 1
        elif isinstance(recipes, Fault):
            yield recipes
        else:
            if kind:
                self.kinds[recipes[-1]] = kind
            yield place, recipes

    def _labels(self, cells: Cells, row: Sequence[str]) -> list[str]:
        """Return the labels in a row's cells; two and more pieces of one thing are a pair."""
        *ingredients, result = map(cells.counted_label, row)
        labels = [label for label, _ in ingredients]
        if len(ingredients) == 1:
            _, pieces = ingredients[0]
            if pieces > 1:
                labels *= 2
        result_label, _ = result
        return [*labels, result_label]

    def _pair(self, place: Place, labels: Sequence[str]) -> list[Recipe] | Fault:
        """Return a row's pair, unless its half-products are not those that chains make."""
        recipe = Recipe.of(labels[0], labels[1], labels[2])
        marked = next(filter(is_half_product, labels), None)
        if marked is None:
            return [recipe]
        self._marked = self._marked or marked
        if self._halves:
            return self._collision(place)
        if not is_step(recipe):
            where = f"{place}: " if isinstance(place, str) else ""
            message = (
                f"{where}the label {labels[-1][:80]!r} ends like a half-product, in{HALF!r}, and "
                f"is not that of {labels[0][:80]!r} and {labels[1][:80]!r}; rename it."
            )
            return Fault(place, "label", message)
        return [recipe]

    def _collision(self, place: Place) -> Fault:
        """Return the fault of a book with half-products of its own and with chains."""
        where = f"{place}: " if isinstance(place, str) else ""
        message = (
            f"{where}the label {self._marked[:80]!r} ends like a half-product, in{HALF!r}, and "
            "other rows become chains; rename it, or write its chain as one row."
        )
        return Fault(place, "label", message)

    def _paired(self, place: Place, labels: Sequence[str]) -> list[Recipe] | Fault | LeftOut:
        """Return the recipes of two ingredients for a row of one, or of three and more."""
        *ingredients, result = labels
        where = f"{place}: " if isinstance(place, str) else ""
        single = self.options.single_ingredient
        is_chain = self.options.ingredients == "chain"
        message = alternatives(ingredients)
        if message is not None:
            return Fault(place, "row", where + message, "alternatives")
        if len(ingredients) > MOST_INGREDIENTS:
            message = (
                f"{where}{len(ingredients):,} ingredients of '{result[:80]}'; the limit is "
                f"{MOST_INGREDIENTS:,}."
            )
            return Fault(place, "row", message, "many ingredients")
        if len(ingredients) > 2 and not is_chain:
            message = (
                f"{where}{' + '.join(ingredients)[:80]!r} are {len(ingredients):,} ingredients of "
                f"'{result[:80]}'; a recipe needs two. Read it as a chain of half-products with "
                f"`ingredients` chain. See {GUIDE}#arities."
            )
            return Fault(place, "row", message, f"{len(ingredients)} ingredients")
        distinct = list(dict.fromkeys(ingredients))
        if len(distinct) == 1 and _TOTAL.fullmatch(distinct[0]):
            message = (
                f"{where}'{distinct[0]}' alone is rather a total than an ingredient; remove it."
            )
            return Fault(place, "row", message, "total")
        self._counts_dropped += len(ingredients) - len(distinct)
        if len(distinct) > 1:
            return self._chained(place, distinct, result)
        (one,) = distinct
        if len(ingredients) > 1:
            # Several pieces of one thing, not a single ingredient that something else makes into.
            return [Recipe.of(one, one, result)]
        if single is None and not is_chain:
            return Fault(place, "label", where + _alone(one))
        other = one if single in (None, _SELF) else single
        return [Recipe.of(one, other, result)]

    def _chained(
        self, place: Place, ingredients: Sequence[str], result: str
    ) -> list[Recipe] | Fault | LeftOut:
        """Return a chain without the half-products of earlier rows, which are no repetition."""
        where = f"{place}: " if isinstance(place, str) else ""
        if result in ingredients:
            # As a whole, like a pair that makes one of its ingredients; never as part of a chain.
            return LeftOut(place, _SELF_RESULT)
        marked = next(filter(is_half_product, (*ingredients, result)), None)
        if marked is not None:
            message = f"the label {marked[:80]!r} ends like a half-product, in{HALF!r}; rename it."
            return Fault(place, "label", where + message)
        if self._marked and len(ingredients) > 2:
            return self._collision(place)
        *halves, last = chain(ingredients, result)
        too_long = label_fault(halves[-1].result) if halves else None
        if too_long is not None:
            message = f"the half-product of {len(ingredients) - 1:,} ingredients has {too_long}"
            return Fault(place, "label", where + message, "long half-product")
        new = []
        for half in halves:
            known = self._halves.setdefault(half.result, half)
            if known is half:
                new.append(half)
            elif known != half:
                message = f"'{half}' and '{known}' would be one half-product; rename a ' + '."
                return Fault(place, "label", where + message)
        return [*new, last]

    def reading(self, merged: int, self_results: int, labels: Collection[str]) -> Reading:
        """Return the record of how the file was read, after the iteration.

        The numbers of an iteration are complete only then.

        Args:
            merged: number of rows that repeat a recipe.
            self_results: number of rows left out because the result is an ingredient.
            labels: all labels, for remarks about them.
        """
        file = self.file
        source = file.source
        left_out = Counter(self.left_out)
        left_out["that repeat a recipe"] += merged
        left_out[_SELF_RESULT] += self_results
        reasons = {reason: number for reason, number in left_out.items() if number}
        notes = [*source.notes, *notes_about(labels)]
        trimmed = source.trimmed
        counts_dropped = source.counts_dropped + self._counts_dropped
        if self._cells is not None:
            trimmed += self._cells.trimmed
            counts_dropped += self._cells.numbers
            if self._cells.unwrapped:
                number = counted(self._cells.unwrapped, "cell")
                notes.insert(0, f"{number} without quotes or markup")
            if self._cells.example:
                notes.insert(0, f"numbers read as pieces, such as '{self._cells.example[:60]}'")
        return Reading(
            shape=source.shape,
            container=file.container,
            encoding=file.encoding,
            delimiter=source.delimiter,
            quote=source.quote,
            header=source.header,
            columns=source.columns,
            num_results=source.num_results,
            ignored=source.ignored,
            case="fold" if self.options.case == "fold" else "",
            rows=self.rows,
            kept=self.rows - sum(reasons.values()),
            left_out=reasons,
            arities={str(arity): self.arities[arity] for arity in sorted(self.arities)},
            counts_dropped=counts_dropped,
            trimmed=trimmed,
            several_outputs=source.several_outputs,
            notes=tuple(notes),
        )


def _alone(ingredient: str) -> str:
    return (
        f"'{ingredient}' is the only ingredient; a recipe needs two. Write it twice, or build the "
        f"graph with `single_ingredient` {_SELF}, which reads {ingredient} + {ingredient}, or the "
        "name of what it is combined with."
    )
