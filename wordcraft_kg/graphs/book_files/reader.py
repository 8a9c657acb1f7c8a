"""Read a recipe book: the bytes, their text, the rows of its shape, and the recipes of the rows.

:func:`read_book` stops at the first fault; ``check_book`` takes the same :class:`BookRows` and
lists all faults.
"""

import logging
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace as replace_field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypedDict, Unpack

from msgspec.structs import replace

from wordcraft_kg.base import ConfigError, RecipeFileError, counted, nearest, one_of, stage
from wordcraft_kg.graphs.book_files.cells import is_number, odd_label
from wordcraft_kg.graphs.book_files.documents import Document, read_document
from wordcraft_kg.graphs.book_files.files import (
    Content,
    check_encoding,
    is_json,
    load_json,
    read_content,
)
from wordcraft_kg.graphs.book_files.layouts import known_layout, read_pack
from wordcraft_kg.graphs.book_files.rows import (
    GUIDE,
    Fault,
    FileRows,
    LeftOut,
    Place,
    Row,
    fault_at,
    refusal,
)
from wordcraft_kg.graphs.book_files.texts import (
    ENDINGS,
    delimiter_of,
    looks_like_lines,
    read_lines,
    read_table,
)
from wordcraft_kg.graphs.recipes import (
    MOST_INGREDIENTS,
    Reading,
    Recipe,
    RecipeBook,
    RecipeRows,
    check_label,
    label_fault,
    notes_about,
)

CASES = ("keep", "fold")
_JSON_ENDINGS = (".json", ".jsonl", ".ndjson", ".ic")
_TOTAL = re.compile(r"(?:grand )?totals?|sum|count|summe|gesamt|anzahl|total[ie]?", re.IGNORECASE)
"""A row of totals at the end of a table, which is no recipe of one ingredient."""
SELF_RESULT = "with an ingredient as the result"
REPEATED = "that repeat a recipe"
"""Reasons of rows that no book keeps."""
_SELF = "self"  # the `single_ingredient` that combines a single ingredient with itself
_ALONE = "alone"  # the `single_ingredient` that keeps a set of one
_TOO_MANY = f"with more than {MOST_INGREDIENTS} ingredients"


class ReadOptions(TypedDict, total=False):
    """The fields of :class:`BookOptions` as keyword arguments.

    Attributes:
        single_ingredient: second ingredient for recipes of one.
        columns: columns or paths of the ingredients and, last, of the result.
        delimiter: column delimiter.
        encoding: encoding of the text.
        case: ``keep`` or ``fold``.
    """

    single_ingredient: str | None
    columns: Sequence[str] | None
    delimiter: str | None
    encoding: str | None
    case: str


@dataclass(frozen=True)
class BookOptions:
    """What a user says about a file; it goes before any documented word.

    Attributes:
        single_ingredient: second ingredient for recipes of one: ``self`` repeats the ingredient,
            ``alone`` adds none, another text names a second one, such as furnace. None adds none in
            a book of larger sets and refuses such recipes in a book of pairs, where a cell may be
            missing.
        columns: names, or numbers from 1, of the columns of ingredients and, last, of the result;
            in JSON paths such as ``recipes[].out.name``; None for documented words.
        delimiter: column delimiter, a character or comma, semicolon, tab, pipe, space; None to
            guess.
        encoding: encoding of the text; None for UTF-8, or that of a byte order mark.
        case: ``keep``, or ``fold`` for labels in lower case.

    Raises:
        ConfigError: for a value outside of these.
        RecipeFileError: if ``single_ingredient`` is no label.
    """

    single_ingredient: str | None = None
    columns: Sequence[str] | None = None
    delimiter: str | None = None
    encoding: str | None = None
    case: str = "keep"

    def __post_init__(self) -> None:
        one_of("case", self.case, CASES)
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
    in_folder = Path(path) / "graph.json"
    path = in_folder if in_folder.is_file() else Path(path)
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
    if not book.recipes:
        left_out = [f"{number:,} {reason}" for reason, number in reading.left_out.items()]
        reasons = ", ".join(left_out) or "no rows"
        raise RecipeFileError(
            f"{path} has no recipe to keep (read as {reading.shape}; {reasons}). See {GUIDE}."
        )
    # Places in JSON are no lines; JSON checks its base when it is opened.
    for label, line in (rows.base or {}).items():
        if isinstance(line, int) and label not in entities:
            raise RecipeFileError(f"{path}, line {line}: {unknown_base(label, entities)}")
    declared = None if rows.base is None else tuple(sorted(rows.base))
    logging.getLogger(__name__).info("%s: %s", path, reading.line())
    return rows.with_facts(replace_field(book, base=declared, reading=reading))


def _without_faults(path: Path, rows: "BookRows") -> Iterator[Recipe]:
    for entry in rows:
        if isinstance(entry, Fault):
            line = f", line {entry.place}" if isinstance(entry.place, int) else ""
            raise RecipeFileError(f"{path}{line}: {entry.message}")
        yield entry[1]


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
        content = read_content(path, options.encoding)
        if content.pack is not None:
            return BookRows(content, read_pack(content.pack), options)
        source = _source_of(path, Path(content.name).suffix.lower(), content.text, options)
    except RecipeFileError as error:
        # A damaged graph folder is no file of a user, and no readable shape helps it.
        if GUIDE in str(error) or path.name == "graph.json":
            raise
        raise RecipeFileError(f"{str(error).rstrip('.')}. See {GUIDE}.") from None
    rows = BookRows(content, source, options)
    odd = "" if source.is_exact else odd_label(rows.whole)
    if odd:
        raise refusal(
            path,
            f"{odd}, in a form that is not read",
            "table",
            "Write one label in each cell, the same in all; what is a label as it stands needs a "
            "table with the columns ingredient_a,ingredient_b,result alone.",
        )
    return rows


def _source_of(path: Path, ending: str, text: str, options: BookOptions) -> FileRows:
    """Return the rows of a text: its beginning counts more than the file's ending."""
    fold = options.case == "fold"
    find = partial(
        read_document,
        path,
        columns=options.columns,
        fold=fold,
        allows_single=options.single_ingredient is not None,
    )
    if ending in _JSON_ENDINGS or is_json(text):
        value, is_lines = load_json(path, text)
        source = None if options.columns is not None else known_layout(path, value)
        shape = "JSON lines" if is_lines else "JSON"
        return source or find(Document(value), FileRows(Reading(shape=shape)))
    # Lines are often saved under the ending of a table.
    if options.delimiter is None and looks_like_lines(text):
        if options.columns is not None:
            raise refusal(
                path, "lines a + b = c, which have no columns", "lines", "Leave --columns out."
            )
        return read_lines(path, text)
    delimiter = None if options.delimiter is None else delimiter_of(options.delimiter)
    usual = ENDINGS.get(ending, ",")
    table, document = read_table(path, text, delimiter, usual=usual, columns=options.columns)
    source = find(document, table)
    source.records = dict(zip(document.places, document.value, strict=True))
    return source


class BookRows:
    """The recipes of a file's rows; iterate once.

    Attributes:
        content: the file's text and container.
        source: its rows.
        options: what the user says about the file.
        base: declared base entities and their places; None without a declaration.
        listed: entities listed outside of recipes and their places.
        kinds, quantities: kind of reasoning, and quantities, by recipe; complete after the
            iteration.
        rows: rows that were recipes.
        left_out: places of other entries by reason.
        arities: number of rows by number of ingredients.
    """

    def __init__(
        self,
        content: Content,
        source: FileRows,
        options: BookOptions,
    ):
        """Take a file's rows; they are read while iterating.

        Args:
            content: the file's text.
            source: its rows, which were not iterated yet.
            options: what the user says about the file.
        """
        self.content = content
        self.source = source
        self.options = options
        label_of = str.lower if options.case == "fold" else str
        self.listed = {label_of(label): place for label, place in source.listed.items()}
        self.base: dict[str, Place] | None = None
        if source.base is not None:
            self.base = {label_of(label): place for label, place in source.base.items()}
        self.kinds: dict[Recipe, str] = {}
        self.quantities: dict[Recipe, str] = {}
        self.rows = 0
        self.left_out: defaultdict[str, list[Place]] = defaultdict(list)
        self.arities: Counter[int] = Counter()
        self._other_quantities = 0

    def all_at_once(self) -> RecipeRows | None:
        """Return the recipes of all rows, if they are nothing but plain pairs; None to iterate.

        Rows are counted as by an iteration.
        """
        numbered = self.source.numbered
        if numbered is None or self.options.case == "fold":
            return None
        self.rows += len(numbered)
        self.arities[2] += len(numbered)
        return numbered

    @property
    def whole(self) -> list[Row]:
        """All recipes as the file has them."""
        return [entry for entry in self.source.entries if isinstance(entry, Row)]

    def __iter__(self) -> Iterator[tuple[Place, Recipe] | Fault]:
        """Yield each row's place and recipe, and faults."""
        for entry in self.source.entries:
            parsed_row = self._recipe(entry) if isinstance(entry, Row) else entry
            # A directive is no row, and what it declares is no recipe.
            self.rows += not (isinstance(entry, Fault) and entry.kind == "directive")
            if isinstance(parsed_row, LeftOut):
                self.left_out[parsed_row.reason].append(parsed_row.place)
            elif isinstance(parsed_row, Fault):
                yield parsed_row
            else:
                yield entry.place, parsed_row

    def _recipe(self, row: Row) -> Recipe | Fault | LeftOut:
        """Return a row's recipe or its fault, or why it is left out."""
        place, ingredients, result, kind, quantities = row
        self.arities[len(ingredients)] += 1
        if self.options.case == "fold":
            ingredients = [label.lower() for label in ingredients]
            result = result.lower()
        recipe = self._set(place, ingredients, result)
        if not isinstance(recipe, Recipe):
            return recipe
        if kind:
            first_kind = self.kinds.setdefault(recipe, kind)
            if first_kind != kind:
                message = f"{recipe} has the kind '{kind}' here, and '{first_kind}' above."
                return fault_at(place, "row", message)
        if quantities:
            numbers = quantities.split()
            if len(numbers) != len(ingredients) or not all(map(is_number, numbers)):
                number = counted(len(ingredients), "ingredient")
                message = f"the quantities '{quantities[:80]}' of {number}; expected a number each."
                return fault_at(place, "row", message, "quantities")
            # In the order of the recipe's ingredients; of a recipe that is repeated, the first.
            in_order = [number for _, number in sorted(zip(ingredients, numbers, strict=True))]
            first_numbers = self.quantities.setdefault(recipe, " ".join(in_order))
            self._other_quantities += first_numbers != " ".join(in_order)
        return recipe

    @cached_property
    def _has_sets(self) -> bool:
        """Whether a recipe of the file has three ingredients or more."""
        return any(len(row.ingredients) > 2 for row in self.whole)

    def _set(
        self, place: Place, ingredients: Sequence[str], result: str
    ) -> Recipe | Fault | LeftOut:
        """Return the recipe of a row's ingredients, each as often as it is there."""
        if 1 < len(ingredients) <= MOST_INGREDIENTS:
            return Recipe(ingredients, result)
        if len(ingredients) > MOST_INGREDIENTS:
            return LeftOut(place, _TOO_MANY)
        (label,) = ingredients
        if _TOTAL.fullmatch(label):
            message = f"'{label}' alone is rather a total than an ingredient; remove it."
            return fault_at(place, "row", message, "total")
        single = self.options.single_ingredient
        if single is None and not self._has_sets:
            message = (
                f"'{label}' is the only ingredient, in a book of pairs. Write it twice, or build "
                f"the graph with `single_ingredient` {_SELF} (which reads {label} + {label}), "
                f"{_ALONE} (a recipe of one ingredient), or the name of what it is combined with. "
                "If it is no ingredient, name the right columns with `columns`."
            )
            return fault_at(place, "label", message)
        second = {None: (), _ALONE: (), _SELF: (label,)}.get(single, (single,))
        return Recipe((label, *second), result)

    def with_facts(self, book: RecipeBook) -> RecipeBook:
        """Return a book with the kinds and quantities of those rows that became its recipes."""
        # Millions of recipes without any are not looked at one by one.
        has_facts = bool(self.kinds) or bool(self.quantities)
        recipes = set(book.recipes) if has_facts else set()
        return replace_field(
            book,
            kinds={recipe: kind for recipe, kind in self.kinds.items() if recipe in recipes},
            quantities={
                recipe: numbers for recipe, numbers in self.quantities.items() if recipe in recipes
            },
        )

    def reading(self, merged: int, self_results: int, labels: Collection[str]) -> Reading:
        """Return the record of how the file was read, after the iteration.

        The numbers of an iteration are complete only then.

        Args:
            merged: number of rows that repeat a recipe.
            self_results: number of rows left out because the result is an ingredient.
            labels: all labels, for remarks about them.
        """
        left_out = Counter({reason: len(places) for reason, places in self.left_out.items()})
        left_out[REPEATED] += merged
        left_out[SELF_RESULT] += self_results
        reading = self.source.reading
        notes = [*reading.notes, *notes_about(labels)]
        if self._other_quantities:
            notes.append(
                f"{counted(self._other_quantities, 'repeated recipe')} with other quantities, of "
                "which the first row counts"
            )
        return replace(
            reading,
            container=self.content.container,
            encoding=self.content.encoding,
            case="fold" if self.options.case == "fold" else "",
            rows=self.rows,
            kept=self.rows - left_out.total(),
            left_out={reason: number for reason, number in left_out.items() if number},
            arities={str(arity): self.arities[arity] for arity in sorted(self.arities)},
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
