"""Read a recipe book from a file in any readable shape; one guess, which is announced.

:func:`open_source` finds container, encoding and shape. :class:`BookRows` turns the source's
entries into recipes of two ingredients and counts what is left out. :func:`read_book` stops at the
first fault; ``check_book`` takes the same rows and lists all faults.
"""

import hashlib
import json
import logging
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import nearest, one_of
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.container import (
    is_zip,
    json_members,
    opened,
    read_bytes,
    zip_names,
)
from wordcraft_kg.graphs.book_files.dialects import delimiter_of
from wordcraft_kg.graphs.book_files.foreign import foreign_format
from wordcraft_kg.graphs.book_files.guide import GUIDE, refusal
from wordcraft_kg.graphs.book_files.json_shapes import JsonRecipes
from wordcraft_kg.graphs.book_files.lines import SumLines, begins_with_recipe, looks_like_lines
from wordcraft_kg.graphs.book_files.minecraft import (
    MinecraftRecipes,
    folder_files,
    is_recipe_file,
    looks_like_recipe,
    read_folder,
)
from wordcraft_kg.graphs.book_files.rows import (
    NOTHING,
    Fault,
    LeftOut,
    Place,
    RowSource,
    alternatives,
)
from wordcraft_kg.graphs.book_files.tables import ENDINGS, Table
from wordcraft_kg.graphs.book_files.text import check_encoding, decode
from wordcraft_kg.graphs.chains import (
    HALF,
    MOST_INGREDIENTS,
    chain,
    is_half_product,
    is_step,
    makes_nothing,
)
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook, check_label, label_fault

CASES = ("keep", "fold")
INGREDIENTS = ("two", "chain")
_SELF_RESULT = "with an ingredient as the result"
_SELF = "self"  # the `single_ingredient` that combines a single ingredient with itself
HTML_ENTITY = re.compile(r"&(?:#\d+|#x[0-9a-fA-F]+|[A-Za-z]\w+);")
_NUMBERED = re.compile(r"\d+ ?[x×]? +[^\W\d]")
_MANY_NUMBERED = 0.2  # share of the labels
_JSON_ENDINGS = (".json", ".jsonl", ".ndjson", ".ic")
_SAMPLE_LINES = 200


class ReadOptions(TypedDict, total=False):
    """The fields of :class:`BookOptions` as keyword arguments."""

    single_ingredient: str | None
    columns: Sequence[str] | None
    delimiter: str | None
    encoding: str | None
    case: str
    ingredients: str


@dataclass(frozen=True)
class BookOptions:
    """What a user says about a file, instead of a guess.

    Attributes:
        single_ingredient: second ingredient for recipes of one: ``self`` repeats the ingredient,
            another text names a second one, such as furnace; None refuses such recipes, or repeats
            the ingredient if ``ingredients`` is chain.
        columns: names, or numbers from 1, of the columns of ingredients and, last, of the result;
            None to guess.
        delimiter: column delimiter, a character or comma, semicolon, tab, pipe, space; None to
            guess.
        encoding: encoding of the text; None to guess.
        case: ``keep``, or ``fold`` for labels in lower case.
        ingredients: ``two`` refuses recipes of three and more, ``chain`` makes them chains of
            half-products, see :mod:`~wordcraft_kg.graphs.chains`.
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


@dataclass(frozen=True)
class OpenedFile:
    """A file whose shape is known.

    Attributes:
        path: the file or folder.
        source: its entries.
        data: the bytes, before decompression; empty for a folder.
        sha256: hash of the content.
        container: see :class:`~wordcraft_kg.graphs.reading.Reading`.
        encoding: see there.
        has_mark: whether the text began with a byte order mark.
        text: the text; empty for a folder.
    """

    path: Path
    source: RowSource
    sha256: str
    container: str = ""
    encoding: str = ""
    has_mark: bool = False
    text: str = ""


def open_source(path: Path, options: BookOptions) -> OpenedFile:
    """Find a file's container, encoding and shape.

    Raises:
        RecipeFileError: if the file cannot be read, or its shape is unknown or not certain.
    """
    if path.is_dir():
        files = folder_files(path)
        if files:
            contents = list(read_folder(path, files))
            return OpenedFile(path, MinecraftRecipes(contents), _hash_of(contents))
    data = read_bytes(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if is_zip(data) and _is_data_pack(path, data):
        return OpenedFile(path, MinecraftRecipes(json_members(path, data)), sha256, "zip")
    content = opened(path, data)
    decoded = decode(path, content.data, options.encoding)
    source = _source_of(path, Path(content.name).suffix.lower(), decoded.text, options)
    return OpenedFile(
        path, source, sha256, content.container, decoded.encoding, decoded.has_mark, decoded.text
    )


def _is_data_pack(path: Path, data: bytes) -> bool:
    """Return whether an archive holds recipes of Minecraft."""
    names = list(filter(is_recipe_file, zip_names(path, data)))
    if len(names) != 1:
        return bool(names)
    # A single file may be a recipe book, in a folder called recipes.
    return any(looks_like_recipe(*file) for file in json_members(path, data) if file[0] in names)


def _hash_of(contents: Sequence[tuple[str, bytes]]) -> str:
    """Return a hash of files' names and bytes."""
    digest = hashlib.sha256()
    for name, data in contents:
        digest.update(json.dumps([name, len(data)]).encode())
        digest.update(data)
    return digest.hexdigest()


def _source_of(path: Path, ending: str, text: str, options: BookOptions) -> RowSource:
    """Return the reader for a text: its beginning counts more than the file's ending."""
    delimiter = None if options.delimiter is None else delimiter_of(options.delimiter)
    named = Path(path.stem + ending)
    is_lines = delimiter is None and _are_lines(text)
    if ending in _JSON_ENDINGS or (text.lstrip()[:1] in ("{", "[") and _is_json(path, text)):
        return JsonRecipes(path, text, options.columns)
    if is_lines and options.columns is not None:
        seen = "lines a + b = c, which have no columns"
        raise refusal(path, seen, "lines", "Leave `columns` out.")
    # Lines are often saved under the ending of a table.
    if is_lines or (
        delimiter is None
        and options.columns is None
        and ending not in ENDINGS
        and looks_like_lines(_first_lines(text))
    ):
        return SumLines(path, text)
    try:
        return Table(path, text, delimiter, options.columns, usual=ENDINGS.get(named.suffix, ","))
    except RecipeFileError:
        foreign = foreign_format(text)
        if foreign is None:
            raise
        raise refusal(path, f"{foreign}, which is not read", "table") from None


def _is_json(path: Path, text: str) -> bool:
    from wordcraft_kg.graphs.book_files.json_text import load_json

    try:
        load_json(path, text)
    except RecipeFileError as error:
        return "not JSON" not in str(error)
    return True


def _first_lines(text: str) -> list[str]:
    lines = text[: 2**17].splitlines()
    return [line for line in lines if line.strip()][:_SAMPLE_LINES]


def _are_lines(text: str) -> bool:
    """Return whether lines are sums whatever the file's ending: no delimiter, or after a sum."""
    lines = _first_lines(text)
    has_delimiter = any(any(sign in line for sign in ",;\t|") for line in lines[:20])
    if not has_delimiter:
        return looks_like_lines(lines)
    # Several results after commas, as in a + b = c, d.
    return all(begins_with_recipe(line) for line in lines)


class BookRows:
    """The recipes of an opened file, with two ingredients each; iterate once.

    Attributes:
        kinds: kind of reasoning by recipe; complete after the iteration.
        rows: rows that were recipes.
        left_out: number of other entries by reason.
        arities: number of rows by number of ingredients.
    """

    def __init__(self, file: OpenedFile, options: BookOptions):
        self.file = file
        self.options = options
        self.kinds: dict[Recipe, str] = {}
        self.rows = 0
        self.left_out: Counter[str] = Counter()
        self.arities: Counter[int] = Counter()
        self._counts_dropped = 0
        self._halves: dict[str, Recipe] = {}
        self._marked = ""  # a label of the file that ends like a half-product

    @property
    def base(self) -> dict[str, Place] | None:
        """Declared base entities and their places."""
        base = self.file.source.base
        return None if base is None else {self._folded(label): at for label, at in base.items()}

    @property
    def listed(self) -> dict[str, Place]:
        """Entities listed outside of recipes and their places."""
        return {self._folded(label): at for label, at in self.file.source.listed.items()}

    def _folded(self, label: str) -> str:
        return label.lower() if self.options.case == "fold" else label

    def __iter__(self) -> Iterator[tuple[Place, list[Recipe]] | Fault]:
        """Yield each row's place and recipes, the row's own recipe last, and faults.

        A chain is several recipes; its first ones make half-products.
        """
        fold = self.options.case == "fold" or self.options.ingredients == "chain"
        kind_of = self.file.source.kind_of
        pairs = 0
        for entry in self.file.source:
            # The frequent row takes a short way: two ingredients, in a book without kinds.
            if (
                type(entry) is tuple
                and len(entry[1]) == 3
                and not (fold or kind_of or is_half_product(entry[1][2]))
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

    def _row(
        self, place: Place, labels: Sequence[str]
    ) -> Iterator[tuple[Place, list[Recipe]] | Fault]:
        """Yield a row's recipes or its fault; nothing for a row that is left out."""
        self.rows += 1
        self.arities[len(labels) - 1] += 1
        kind = self.file.source.kind_of.get((tuple(sorted(labels[:-1])), labels[-1]), "")
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

        Args:
            merged: number of rows that repeat a recipe.
            self_results: number of rows left out because the result is an ingredient.
            labels: all labels, for remarks about them.
        """
        source, file = self.file.source, self.file
        left_out = Counter(self.left_out)
        left_out["that repeat a recipe"] += merged
        left_out[_SELF_RESULT] += self_results
        reasons = {reason: number for reason, number in left_out.items() if number}
        html = [label for label in labels if "&" in label and HTML_ENTITY.search(label)]
        notes = [*source.notes, *note_of_numbers(labels)]
        if NOTHING in labels:
            notes.append("'Nothing' is kept as an entity")
        if html:
            notes.append(f"{len(html):,} labels with HTML entities, such as {html[0][:60]!r}")
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
            counts_dropped=source.counts_dropped + self._counts_dropped,
            several_outputs=source.several_outputs,
            notes=tuple(notes),
        )


@stage("reading the book")
def read_book(
    path: str | Path,
    *,
    keep_self_results: bool = False,
    name: str | None = None,
    **options: Unpack[ReadOptions],
) -> RecipeBook:
    """Read and validate a recipe book from a file, or from a graph folder.

    Tables with any delimiter and order of columns, lines ``a + b = c``, JSON in the shapes of
    common games, saves of Infinite Craft and folders of Minecraft recipes are read, also in gzip or
    zip. The guess is in ``reading`` of the result. In tables, leading lines with ``#`` are
    comments; ``# base: a, b`` declares base entities (known at the start), and ``# entities: a, b``
    lists entities without a recipe. A column ``kind`` may name each recipe's kind of reasoning.

    Args:
        path: the file, or a graph folder.
        keep_self_results: keep recipes with the result among the ingredients.
        name: the book's name; None uses the file's or folder's name.
        options: what a user says about the file, see :class:`BookOptions`.

    Raises:
        RecipeFileError: naming the line or JSON key with the first error.
        ConfigError: for an option outside its values.
    """
    path = Path(path)
    if (path / "graph.json").is_file():
        path = path / "graph.json"
    chosen = BookOptions(**options)
    file = open_source(path, chosen)
    rows = BookRows(file, chosen)
    book = RecipeBook.of(
        name or book_name(path),
        _without_faults(path, rows),
        listed=rows.listed,
        keep_self_results=keep_self_results,
        sha256=file.sha256,
    )
    entities = book.entities
    reading = rows.reading(book.merged_duplicates, book.dropped_self_results, entities)
    if makes_nothing(book.recipes):
        reasons = ", ".join(f"{number:,} {reason}" for reason, number in reading.left_out.items())
        raise RecipeFileError(
            f"{path} has no recipe to keep (read as {reading.shape}; "
            f"{reasons or ('half-products only' if book.recipes else 'no rows')}). "
            f"See {GUIDE}."
        )
    base = rows.base
    for label, line in (base or {}).items():
        if isinstance(line, int) and label not in entities:
            raise RecipeFileError(f"{path}, line {line}: {unknown_base(label, entities)}")
    declared = None if base is None else tuple(sorted(base))
    kinds = {}
    if rows.kinds:
        kinds = {recipe: rows.kinds[recipe] for recipe in book.recipes if recipe in rows.kinds}
    logging.getLogger(__name__).info("%s: %s", path, reading.line())
    return replace(book, base=declared, kinds=kinds, reading=reading)


def note_of_numbers(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about many labels that begin with numbers of pieces."""
    numbered = [label for label in labels if _NUMBERED.match(label)]
    if len(numbered) <= _MANY_NUMBERED * len(labels):
        return []
    return [
        f"{len(numbered):,} of {counted(len(labels), 'label')} begin with numbers, such as "
        f"{numbered[0][:60]!r}; numbers of pieces are no part of a label"
    ]


def _without_faults(path: Path, rows: BookRows) -> Iterator[Recipe]:
    for entry in rows:
        if isinstance(entry, Fault):
            raise RecipeFileError(place_of(path, entry))
        yield from entry[1]


def place_of(path: Path, fault: Fault) -> str:
    """Return a fault's message with its file and line; places in JSON are in the message."""
    if isinstance(fault.place, int):
        return f"{path}, line {fault.place}: {fault.message}"
    return f"{path}: {fault.message}"


def book_name(path: Path) -> str:
    """Return a book's default name: the file or folder name, without control characters."""
    name = path.parent.name if path.name == "graph.json" else path.stem
    if label_fault(name) is None:
        return name
    return "".join(char if char.isprintable() else "_" for char in name) or "book"


def unknown_base(label: str, known: Any) -> str:
    """Return the error message for a base entity that is not among the ``known`` labels."""
    return (
        f"the base entity '{label}' is in no recipe.{nearest(label, known)} "
        f"If it is meant, list it as well: # entities: {label}"
    )


def _alone(ingredient: str) -> str:
    return (
        f"'{ingredient}' is the only ingredient; a recipe needs two. Write it twice, or build the "
        f"graph with `single_ingredient` {_SELF}, which reads {ingredient} + {ingredient}, or the "
        "name of what it is combined with."
    )
