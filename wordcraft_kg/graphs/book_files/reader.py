"""Read a recipe book: the bytes, their text, the rows of its shape, and the recipes of the rows.

``containers`` has the bytes, ``text`` their encoding; tables, lines, JSON and data packs yield the
same entries (``rows``), by a reading that ``rule`` takes. :func:`read_book` stops at the first
fault; ``check_book`` takes the same :class:`BookRows` and lists all faults.
"""

import logging
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, Unpack

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import nearest, one_of
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.cells import Cells, trim_unseen, without_markup
from wordcraft_kg.graphs.book_files.containers import Content, read_content
from wordcraft_kg.graphs.book_files.entries import Document
from wordcraft_kg.graphs.book_files.json_books import as_records, rows_of_document
from wordcraft_kg.graphs.book_files.json_text import is_json, load_json
from wordcraft_kg.graphs.book_files.layouts import known_layout
from wordcraft_kg.graphs.book_files.lines import looks_like_lines, read_lines
from wordcraft_kg.graphs.book_files.packs import read_pack
from wordcraft_kg.graphs.book_files.rows import GUIDE, Fault, FileRows, LeftOut, Place, Row, refusal
from wordcraft_kg.graphs.book_files.rule import BookReading
from wordcraft_kg.graphs.book_files.tables import ENDINGS, delimiter_of, read_table
from wordcraft_kg.graphs.book_files.text import check_encoding, decode, foreign_format
from wordcraft_kg.graphs.chains import (
    HALF,
    MOST_INGREDIENTS,
    chain,
    is_step,
    makes_nothing,
)
from wordcraft_kg.graphs.label_notes import count_in, notes_about
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook, RecipeRows, check_label, label_fault

CASES = ("keep", "fold")
INGREDIENTS = ("two", "chain")
_JSON_ENDINGS = (".json", ".jsonl", ".ndjson", ".ic")
_TOTAL = re.compile(r"(?:grand )?totals?|sum|count|summe|gesamt|anzahl|total[ie]?", re.IGNORECASE)
"""A row of totals at the end of a table, which is no recipe of one ingredient."""
SELF_RESULT = "with an ingredient as the result"
REPEATED = "that repeat a recipe"
"""Reasons of rows that no book keeps."""
_CHAIN = "Read it as a chain of half-products with `ingredients` chain."
_COLUMNS = "If they are no recipes, name the right columns with `columns`."
_SELF = "self"  # the `single_ingredient` that combines a single ingredient with itself


class ReadOptions(TypedDict, total=False):
    """The fields of :class:`BookOptions` as keyword arguments.

    Attributes:
        single_ingredient: second ingredient for recipes of one.
        columns: columns or paths of the ingredients and, last, of the result.
        delimiter: column delimiter.
        encoding: encoding of the text.
        case: ``keep`` or ``fold``.
        ingredients: ``two`` or ``chain``.
    """

    single_ingredient: str | None
    columns: Sequence[str] | None
    delimiter: str | None
    encoding: str | None
    case: str
    ingredients: str


@dataclass(frozen=True)
class BookOptions:
    """What a user says about a file; it goes before any documented word.

    Attributes:
        single_ingredient: second ingredient for recipes of one: ``self`` repeats the ingredient,
            another text names a second one, such as furnace; None refuses such recipes, or repeats
            the ingredient if ``ingredients`` is chain.
        columns: names, or numbers from 1, of the columns of ingredients and, last, of the result;
            in JSON paths such as ``recipes[].out.name``; None for documented words.
        delimiter: column delimiter, a character or comma, semicolon, tab, pipe, space; None to
            guess.
        encoding: encoding of the text; None for UTF-8, or that of a byte order mark.
        case: ``keep``, or ``fold`` for labels in lower case.
        ingredients: ``two`` refuses recipes of three and more, ``chain`` makes them chains of
            half-products, see :mod:`~wordcraft_kg.graphs.chains`.

    Raises:
        ConfigError: for a value outside of these.
        RecipeFileError: if ``single_ingredient`` is no label.
    """

    single_ingredient: str | None = None
    columns: Sequence[str] | None = None
    delimiter: str | None = None
    encoding: str | None = None
    case: str = "keep"
    ingredients: str = "two"

    def __post_init__(self) -> None:
        one_of("case", self.case, CASES)
        one_of("ingredients", self.ingredients, INGREDIENTS)
        check_encoding(self.encoding)
        if isinstance(self.columns, str):
            raise ConfigError(f"`columns` {self.columns!r}: expected a list of names or numbers.")
        if self.delimiter is not None:
            delimiter_of(self.delimiter)
        if self.single_ingredient is not None:
            check_label(self.single_ingredient, "`single_ingredient`")


@stage("reading the book")
def read_book(
    path: str | Path,
    *,
    keep_self_results: bool = False,
    name: str | None = None,
    **options: Unpack[ReadOptions],
) -> RecipeBook:
    """Read and validate a recipe book from a file, or from a graph folder.

    Tables with any delimiter and order of columns, lines ``a + b = c``, JSON by documented keys or
    paths, saves of Infinite Craft and data packs of Minecraft are read, also in gzip or zip. How
    the file was read is in ``reading`` of the result. In tables, leading lines with ``#`` are
    comments; ``# base: a, b`` declares base entities (known at the start), and ``# entities: a, b``
    lists entities without a recipe. A column ``kind`` may name each recipe's kind of reasoning.

    Args:
        path: the file, or the graph folder.
        keep_self_results: keep recipes with the result among the ingredients.
        name: the book's name; None uses the file's or folder's name.
        options: what a user says about the file, see :class:`BookOptions`.

    Returns:
        The book, with the record of how it was read in ``reading``.

    Raises:
        RecipeFileError: naming the line or JSON key with the first error; also if the file cannot
            be read, no reading or several are certain, or it has no recipe to keep.
        ConfigError: for an option outside its values, or `columns` that the file does not have.
    """
    path = Path(path)
    if (path / "graph.json").is_file():
        path = path / "graph.json"
    rows = open_rows(path, BookOptions(**options))
    at_once = rows.all_at_once()
    book = RecipeBook.of(
        name or book_name(path),
        _without_faults(path, rows) if at_once is None else at_once,
        listed=rows.listed,
        keep_self_results=keep_self_results,
        sha256=rows.content.sha256,
    )
    entities = book.entities
    reading = rows.reading(book.merged_duplicates, book.dropped_self_results, entities)
    if makes_nothing(book.recipes):
        left_out = [f"{number:,} {reason}" for reason, number in reading.left_out.items()]
        why = "half-products only" if book.recipes else "no rows"
        if left_out:
            why = ", ".join(left_out)
        raise RecipeFileError(
            f"{path} has no recipe to keep (read as {reading.shape}; {why}). See {GUIDE}."
        )
    declared = None
    if rows.base is not None:
        # Places in JSON are no lines; JSON checks its base when it is opened.
        for label, line in rows.base.items():
            if isinstance(line, int) and label not in entities:
                raise RecipeFileError(f"{path}, line {line}: {unknown_base(label, entities)}")
        declared = tuple(sorted(rows.base))
    kinds = {}
    if rows.kinds:
        # Recipes that the book left out have no kind in it.
        kinds = {recipe: rows.kinds[recipe] for recipe in book.recipes if recipe in rows.kinds}
    logging.getLogger(__name__).info("%s: %s", path, reading.line())
    return replace(book, base=declared, kinds=kinds, reading=reading)


def _without_faults(path: Path, rows: "BookRows") -> Iterator[Recipe]:
    for entry in rows:
        if isinstance(entry, Fault):
            line = f", line {entry.place}" if isinstance(entry.place, int) else ""
            raise RecipeFileError(f"{path}{line}: {entry.message}")
        yield from entry[1]


def open_rows(path: Path, options: BookOptions) -> "BookRows":
    """Find a file's container, encoding, shape and reading.

    Args:
        path: a file, or a folder of a data pack.
        options: what the user says about the file.

    Returns:
        The file's rows, to iterate once.

    Raises:
        RecipeFileError: if the file cannot be read, or no reading or several are certain. The
            message names the guide, unless the file is that of a graph folder.
        ConfigError: if the option `columns` names no column.
    """
    try:
        content = read_content(path)
        if content.pack is not None:
            return BookRows(content, read_pack(content.pack), options)
        decoded = decode(path, content.data, options.encoding)
        source = _source_of(path, Path(content.name).suffix.lower(), decoded.text, options)
    except RecipeFileError as error:
        # A damaged graph folder is no file of a user, and no readable shape helps it.
        if GUIDE in str(error) or path.name == "graph.json":
            raise
        raise RecipeFileError(f"{str(error).rstrip('.')}. See {GUIDE}.") from None
    rows = BookRows(content, source, options)
    if rows.whole.odd_label:
        seen = f"{rows.whole.odd_label}, in a form that is not read"
        raise refusal(path, seen, "table", "Write one label in each cell, the same in all.")
    rows.encoding, rows.has_mark, rows.text = decoded.encoding, decoded.has_mark, decoded.text
    return rows


def _source_of(path: Path, ending: str, text: str, options: BookOptions) -> FileRows:
    """Return the rows of a text: its beginning counts more than the file's ending."""
    find = partial(
        rows_of_document,
        path,
        columns=options.columns,
        fold=options.case == "fold",
        allows_single=options.single_ingredient is not None,
    )
    if ending in _JSON_ENDINGS or is_json(text):
        value, is_lines = load_json(path, text)
        # A list of a + b = c, alone or below a key.
        inner = value.values() if isinstance(value, dict) else [value]
        lists = [each for each in inner if isinstance(each, list)]
        is_text = len(lists) == 1 and all(isinstance(each, str) for each in lists[0])
        lines = "\n".join(lists[0]) if is_text else ""
        is_list = is_text and isinstance(value, list)
        if is_list or looks_like_lines(lines, is_table=False):
            return _source_of(path, ".txt", lines, options)
        source = None if options.columns is not None else known_layout(path, value)
        source = source or find(Document(as_records(value)), FileRows("JSON"))
        source.shape += " lines" if is_lines else ""
        return source
    # Lines are often saved under the ending of a table.
    if options.delimiter is None and looks_like_lines(text, is_table=ending in ENDINGS):
        if options.columns is not None:
            seen = "lines a + b = c, which have no columns"
            raise refusal(path, seen, "lines", "Leave --columns out.")
        return read_lines(path, text)
    delimiter = None if options.delimiter is None else delimiter_of(options.delimiter)
    by_name = not all(column.strip().isdecimal() for column in options.columns or ["1"])
    usual = ENDINGS.get(ending, ",")
    try:
        table, document = read_table(path, text, delimiter, usual=usual, is_named=by_name)
        source = find(document, table)
        source.records = dict(zip(document.places, document.value, strict=True))
        return source
    except RecipeFileError:
        foreign = foreign_format(text)
        if foreign is None:
            raise
        raise refusal(path, f"{foreign}, which is not read", "table") from None


class BookRows:
    """The recipes of a file's rows, with two ingredients each; iterate once.

    Attributes:
        content: the file's bytes and container.
        source: its rows.
        encoding, has_mark, text: of its text, see ``text.Decoded``; empty for a data pack.
        kinds: kind of reasoning by recipe; complete after the iteration.
        rows: rows that were recipes.
        left_out: number of other entries by reason.
        places_left_out: their places by reason.
        arities: number of rows by number of ingredients.
        whole: all recipes, to judge what may be advised; empty for our own shapes.
    """

    def __init__(self, content: Content, source: FileRows, options: BookOptions):
        """Take a file's rows; they are read while iterating.

        Args:
            content: the file's bytes.
            source: its rows, which were not iterated yet.
            options: what the user says about the file.
        """
        self.content = content
        self.source = source
        self.options = options
        self.encoding = ""
        self.has_mark = False
        self.text = ""
        self.kinds: dict[Recipe, str] = {}
        self.rows = 0
        self.left_out: Counter[str] = Counter()
        self.places_left_out: dict[str, list[Place]] = {}
        self.arities: Counter[int] = Counter()
        self._counts_dropped = 0
        self._halves: set[Recipe] = set()
        self._changes = options.case == "fold" or options.ingredients == "chain"
        self._cells: Cells | None = None
        self.whole = BookReading((), ())
        # These shapes are hardly met by chance, and users know their columns.
        is_named = options.columns is not None
        self._is_sure = is_named or source.is_exact or source.columns[:1] == ("sum",)
        # Shapes of our own hold any label, so that a book is read as it was written.
        if not source.is_exact and source.numbered is None:
            source.entries = list(source.entries)
            self.whole = BookReading((), source.entries)
            self._cells = Cells(self.whole.rows)

    def all_at_once(self) -> RecipeRows | None:
        """Return the recipes of all rows, if they are nothing but plain pairs; None to iterate.

        Rows are counted as by an iteration.
        """
        numbered = self.source.numbered
        if numbered is None or self._changes:
            return None
        self.rows += len(numbered)
        self.arities[2] += len(numbered)
        return numbered

    @property
    def base(self) -> dict[str, Place] | None:
        """Declared base entities and their places."""
        base = self.source.base
        return None if base is None else {self._label(label): at for label, at in base.items()}

    @property
    def listed(self) -> dict[str, Place]:
        """Entities listed outside of recipes and their places."""
        return {self._label(label): place for label, place in self.source.listed.items()}

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
        for entry in self.source.entries:
            if isinstance(entry, Row):
                self.rows += 1
                yield from self._row(entry)
            elif isinstance(entry, Fault):
                # A directive is no row, and what it declares is no recipe.
                self.rows += int(entry.kind != "directive")
                yield entry
            else:
                self.rows += 1
                self.left_out[entry.reason] += 1
                self.places_left_out.setdefault(entry.reason, []).append(entry.place)

    def _row(self, row: Row) -> Iterator[tuple[Place, list[Recipe]] | Fault]:
        """Yield a row's recipes or its fault; nothing for a row that is left out."""
        place, ingredients, result, kind = row
        cells = (*ingredients, result)
        if self._cells is not None and not self._cells.are_clean(cells):
            ingredients, result = self._labels(self._cells, row)
        blank = next((label for label in (*ingredients, result) if not label), None)
        if blank is not None:
            message = f"{cells!r:.80} has a blank label; every entity needs a name."
            yield self._fault(place, "label", message)
            return
        self.arities[len(ingredients)] += 1
        if self._changes:
            ingredients = [self._folded(label) for label in ingredients]
            result = self._folded(result)
        recipes: list[Recipe] | Fault | LeftOut
        if len(ingredients) == 2:
            recipes = self._pair(place, ingredients, result)
        else:
            recipes = self._paired(place, ingredients, result)
        if isinstance(recipes, LeftOut):
            self.left_out[recipes.reason] += 1
        elif isinstance(recipes, Fault):
            yield recipes
        else:
            known = self.kinds.setdefault(recipes[-1], kind) if kind else kind
            if known != kind:
                message = f"{recipes[-1]} has the kind '{kind}' here, and '{known}' above."
                yield self._fault(place, "row", message)
                return
            yield place, recipes

    def _fault(self, place: Place, kind: str, message: str, group: str = "") -> Fault:
        where = f"{place}: " if isinstance(place, str) else ""
        return Fault(place, kind, where + message, group)

    def _labels(self, cells: Cells, row: Row) -> tuple[list[str], str]:
        """Return the labels in a row's cells; two and more pieces of one thing are a pair."""
        found = list(map(cells.counted_label, row.ingredients))
        result, _ = cells.counted_label(row.result)
        labels = [label for label, _ in found]
        is_several = len(found) == 1 and found[0][1] > 1
        return labels * 2 if is_several else labels, result

    def _pair(self, place: Place, ingredients: Sequence[str], result: str) -> list[Recipe] | Fault:
        """Return a row's pair, unless its half-products are not those that chains make."""
        recipe = Recipe.of(ingredients[0], ingredients[1], result)
        if not is_step(recipe):
            message = (
                f"the label {result[:80]!r} ends like a half-product, in{HALF!r}, and is not that "
                f"of {ingredients[0][:80]!r} and {ingredients[1][:80]!r}; rename it."
            )
            return self._fault(place, "label", message)
        return [recipe]

    def _paired(
        self, place: Place, ingredients: Sequence[str], result: str
    ) -> list[Recipe] | Fault | LeftOut:
        """Return the recipes of two ingredients for a row of one, or of three and more."""
        is_chain = self.options.ingredients == "chain"
        if len(ingredients) > MOST_INGREDIENTS:
            message = (
                f"{len(ingredients):,} ingredients of '{result[:80]}'; the limit is "
                f"{MOST_INGREDIENTS:,}."
            )
            return self._fault(place, "row", message, "many ingredients")
        if len(ingredients) > 2 and not is_chain:
            remedy = f"{_COLUMNS} See {GUIDE}#arities."
            if self._is_sure or self.whole.hangs_together:
                remedy = f"{_CHAIN} See {GUIDE}#arities."
            message = (
                f"{' + '.join(ingredients)[:80]!r} are {len(ingredients):,} ingredients of "
                f"'{result[:80]}'; a recipe needs two. {remedy}"
            )
            return self._fault(place, "row", message, f"{len(ingredients)} ingredients")
        distinct = list(dict.fromkeys(ingredients))
        if len(distinct) == 1 and _TOTAL.fullmatch(distinct[0]):
            message = f"'{distinct[0]}' alone is rather a total than an ingredient; remove it."
            return self._fault(place, "row", message, "total")
        self._counts_dropped += len(ingredients) - len(distinct)
        if len(distinct) > 1:
            return self._chained(place, distinct, result)
        (one,) = distinct
        if len(ingredients) > 1:
            # Several pieces of one thing, not a single ingredient that something else makes into.
            return [Recipe.of(one, one, result)]
        single = self.options.single_ingredient
        if single is None and not is_chain:
            remedy = _COLUMNS
            hangs_together = self._is_sure or self.whole.hangs_together
            if hangs_together and one != self.whole.remark:
                remedy = (
                    f"Write it twice, or build the graph with `single_ingredient` {_SELF}, which "
                    f"reads {one} + {one}, or the name of what it is combined with."
                )
            message = f"'{one}' is the only ingredient; a recipe needs two. {remedy}"
            return self._fault(place, "label", message)
        return [Recipe.of(one, one if single in (None, _SELF) else str(single), result)]

    def _chained(
        self, place: Place, ingredients: Sequence[str], result: str
    ) -> list[Recipe] | Fault | LeftOut:
        """Return a chain without the half-products of earlier rows, which are no repetition."""
        if result in ingredients:
            # As a whole, like a pair that makes one of its ingredients; never as part of a chain.
            return LeftOut(place, SELF_RESULT)
        marked = next((label for label in (*ingredients, result) if " + " in label), None)
        if marked is not None and len(ingredients) > 2:
            message = f"the label {marked[:80]!r} looks like a half-product; rename its ' + '."
            return self._fault(place, "label", message)
        *halves, last = chain(ingredients, result)
        too_long = label_fault(halves[-1].result) if halves else None
        if too_long is not None:
            message = f"the half-product of {len(ingredients) - 1:,} ingredients has {too_long}"
            return self._fault(place, "label", message, "long half-product")
        new = [half for half in halves if half not in self._halves]
        self._halves.update(new)
        return [*new, last]

    def reading(self, merged: int, self_results: int, labels: Collection[str]) -> Reading:
        """Return the record of how the file was read, after the iteration.

        The numbers of an iteration are complete only then.

        Args:
            merged: number of rows that repeat a recipe.
            self_results: number of rows left out because the result is an ingredient.
            labels: all labels, for remarks about them.
        """
        source = self.source
        left_out = Counter(self.left_out)
        left_out[REPEATED] += merged
        left_out[SELF_RESULT] += self_results
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
            container=self.content.container,
            encoding=self.encoding,
            delimiter=source.delimiter,
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


def book_name(path: Path) -> str:
    """Return a book's default name: the file or folder name, without control characters."""
    name = path.parent.name if path.name == "graph.json" else path.stem
    if label_fault(name) is None:
        return name
    return "".join(char if char.isprintable() else "_" for char in name) or "book"


def unknown_base(label: str, known: Any) -> str:
    """Return the error message for a base entity that is not among the known labels.

    Args:
        label: the base entity.
        known: labels of all entities, of which the most similar one is named.
    """
    return (
        f"the base entity '{label}' is in no recipe.{nearest(label, known)} "
        f"If it is meant, list it as well: # entities: {label}"
    )
