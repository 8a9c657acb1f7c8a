"""Recipes, and reading, validating and writing recipe books.

Three layouts are read: CSV or TSV (``ingredient_a,ingredient_b,result``), our own JSON, and the JSON released with the
paper's code (``{"entities": {label: {"recipes": [[a, b], ...]}}}``). Labels are matched exactly. In CSV and TSV, spaces
around a cell do not belong to it unless it is quoted; everything else is kept verbatim.
"""

import csv
import hashlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.artefacts import what_is, write_atomically
from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import nearest

CSV_HEADER = ("ingredient_a", "ingredient_b", "result")
JSON_FORMAT = "wordcraft-kg recipe book 1"
MAX_LABEL_LENGTH = 1_000
"""Characters; a longer label suggests that the file is of another kind."""
MAX_BOOK_SIZE = 2**30
"""Bytes; about 40 million recipes."""
MAX_LINE_LENGTH = 100_000
"""Characters in a line of a CSV or TSV book: a file without line ends fails early, with the reason."""
SELF = "self"
"""The setting ``single_ingredient`` that combines a single ingredient with itself."""


class Recipe(NamedTuple):
    """One unordered pair of ingredients and one of its results; ``ingredient_a <= ingredient_b``."""

    ingredient_a: str
    ingredient_b: str
    result: str

    @classmethod
    def of(cls, one: str, other: str, result: str) -> "Recipe":
        """Return the recipe with its ingredients in canonical order."""
        return cls(one, other, result) if one <= other else cls(other, one, result)

    def __str__(self) -> str:
        return f"{self.ingredient_a} + {self.ingredient_b} -> {self.result}"

    @property
    def is_self_result(self) -> bool:
        """Whether the result is one of its own ingredients."""
        return self.result in (self.ingredient_a, self.ingredient_b)


@dataclass(frozen=True)
class RecipeBook:
    """A validated recipe book: recipes without duplicates, and the counts of what was left out.

    Attributes:
        name: what reports call it; not part of its content.
        recipes: sorted, without duplicates.
        base: the base entities the book declares, sorted, or None where it declares none.
        idle: entities that the book lists but no kept recipe mentions, sorted.
        dropped_self_results: rows left out because their result is one of their own ingredients.
        merged_duplicates: rows left out because they repeat a recipe.
        sha256: hash of the file's bytes, or None for a book that was not read from a file.
    """

    name: str
    recipes: tuple[Recipe, ...]
    base: tuple[str, ...] | None = None
    idle: tuple[str, ...] = ()
    dropped_self_results: int = 0
    merged_duplicates: int = 0
    sha256: str | None = None

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
        """Collect rows ``(ingredient, ingredient, result)`` into a book, counting what is dropped and merged."""
        kept: set[Recipe] = set()
        dropped_labels: set[str] = set()
        dropped = merged = 0
        for one, other, result in rows:
            recipe = Recipe.of(one, other, result)
            if recipe.is_self_result and not keep_self_results:
                dropped += 1
                dropped_labels.update(recipe)
            elif recipe in kept:
                merged += 1
            else:
                kept.add(recipe)
        mentioned = {label for recipe in kept for label in recipe}
        declared = None if base is None else tuple(sorted(set(base)))
        idle = tuple(sorted((dropped_labels.union(listed, declared or ())) - mentioned))
        return cls(name, tuple(sorted(kept)), declared, idle, dropped, merged, sha256)

    @cached_property
    def entities(self) -> tuple[str, ...]:
        """All labels, sorted."""
        return tuple(sorted({label for recipe in self.recipes for label in recipe}.union(self.idle)))


@stage("reading the book")
def read_book(
    path: str | Path,
    *,
    keep_self_results: bool = False,
    single_ingredient: str | None = None,
    name: str | None = None,
) -> RecipeBook:
    """Read and validate a recipe book from a file, or from the ``graph.json`` of a graph folder.

    The layout follows the ending: ``.csv``, ``.tsv`` (or ``.tab``), ``.json``. In CSV and TSV, lines that start with
    ``#`` before the header are comments; ``# base: a, b`` declares base entities and ``# entities: a, b`` lists
    entities that no recipe mentions.

    Args:
        path: the file or folder.
        keep_self_results: keep rows whose result is one of their own ingredients.
        single_ingredient: how to read recipes of one ingredient, such as those of a furnace: ``self`` combines it with
            itself, any other text names the entity to combine it with. With None such a recipe is an error.
        name: of the book; None takes the file's or folder's.

    Raises:
        RecipeFileError: naming the line or key of the first thing that is wrong.
    """
    path = Path(path)
    if (path / "graph.json").is_file():
        path = path / "graph.json"
    if single_ingredient is not None:
        check_label(single_ingredient, "`single_ingredient`")
    data = read_bytes(path)
    text = _decode(path, data)
    if path.suffix.lower() == ".json":
        base, listed, rows = _parse_json(path, text, single_ingredient)
    elif path.suffix.lower() in (".csv", ".tsv", ".tab"):
        base, listed, rows = _parse_table(path, text, "," if path.suffix.lower() == ".csv" else "\t", single_ingredient)
    else:
        raise RecipeFileError(f"{path}: unknown ending '{path.suffix}'; a recipe book is .csv, .tsv or .json.")
    absent = dict(base or {})
    for label in listed:
        absent.pop(label, None)
    book = RecipeBook.of(
        name or book_name(path),
        _crossing_off(absent, rows),
        base=base,
        listed=listed,
        keep_self_results=keep_self_results,
        sha256=hashlib.sha256(data).hexdigest(),
    )
    if not book.recipes:
        raise RecipeFileError(f"{path} has no recipe to keep ({book.dropped_self_results} self results dropped).")
    for label, where in absent.items():
        raise RecipeFileError(f"{where}: {unknown_base(label, set(book.entities).difference(absent))}")
    return book


def book_name(path: Path) -> str:
    """Return the name of a book without one of its own: that of its file, or of its graph folder."""
    name = path.parent.name if path.name == "graph.json" else path.stem
    try:
        return check_label(name, "")
    except RecipeFileError:  # a name of control characters or stray bytes
        return "".join(char if char.isprintable() else "_" for char in name) or "book"


def unknown_base(label: str, known: Iterable[str]) -> str:
    """Say that a base entity of a file is none of its entities, and which ones may be meant."""
    return (
        f"the base entity '{label}' is in no recipe.{nearest(label, known)} "
        f"If it is meant, list it as well: # entities: {label}"
    )


def _crossing_off(absent: dict[str, str], rows: Iterable[Sequence[str]]) -> Iterator[Sequence[str]]:
    """Yield rows, and take their labels out of ``absent``."""
    for row in rows:
        if absent:
            for label in row:
                absent.pop(label, None)
        yield row


def write_book(book: RecipeBook, path: Path) -> None:
    """Write a book as ``.csv``, ``.tsv`` or ``.json`` by the ending of ``path``; reading it back gives an equal book.

    Raises:
        RecipeFileError: for another ending.
    """
    ending = path.suffix.lower()
    if ending == ".json":
        write_atomically(path, book_json(book))
    elif ending in (".csv", ".tsv"):
        directives = [("base", book.base), ("entities", book.idle or None)]
        head = [f"# {key}: {_csv_line(labels, ',')}" for key, labels in directives if labels is not None]
        write_atomically(path, [*head, *recipe_table(book.recipes, "," if ending == ".csv" else "\t")])
    else:
        raise RecipeFileError(f"{path}: unknown ending '{ending}'; a recipe book is written as .csv, .tsv or .json.")


def recipe_table(recipes: Iterable[Recipe], delimiter: str = ",") -> Iterator[str]:
    """Yield the lines of a recipe table, header first."""
    yield delimiter.join(CSV_HEADER) + "\n"
    for recipe in recipes:
        yield _csv_line(recipe, delimiter)


def book_json(book: RecipeBook, **extra: Any) -> Iterator[str]:
    """Yield our own JSON layout, one recipe per line so that it diffs well; ``extra`` keys come after the name."""
    dump = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    yield f'{{\n"format": {dump(JSON_FORMAT)},\n"name": {dump(book.name)},\n'
    for key, value in extra.items():
        yield f"{dump(key)}: {dump(value)},\n"
    yield f'"base": {dump(book.base)},\n"entities": {dump(book.entities)},\n"recipes": [\n'
    last = len(book.recipes) - 1
    for index, recipe in enumerate(book.recipes):
        yield dump(recipe) + (",\n" if index < last else "\n")
    yield "]\n}\n"


def check_label(label: Any, where: str) -> str:
    """Return ``label`` if it can name an entity.

    Raises:
        RecipeFileError: if it is not text, is blank or too long, or holds a tab, a line break, another control
            character, half of a character, or what Unicode reserves as no character.
    """
    if not isinstance(label, str):
        raise RecipeFileError(f"{where}: {_shown(label)} is not a label; a label is text.")
    if not label or label.isspace():
        raise RecipeFileError(f"{where}: the label {_shown(label)} is blank; every entity needs a name.")
    if len(label) > MAX_LABEL_LENGTH:
        raise RecipeFileError(f"{where}: a label of {len(label):,} characters; the limit is {MAX_LABEL_LENGTH:,}.")
    if not label.isprintable():
        if any(ord(char) < 32 or char in "\x7f\x85\u2028\u2029" for char in label):
            raise RecipeFileError(f"{where}: the label {_shown(label)} holds a tab, line break or control character.")
        if any("\ud800" <= char <= "\udfff" for char in label):
            raise RecipeFileError(f"{where}: the label {_shown(label)} holds half of a character (a lone surrogate).")
        if "\ufffe" in label or "\uffff" in label:
            raise RecipeFileError(f"{where}: the label {_shown(label)} holds U+FFFE or U+FFFF, which XML cannot hold.")
    return label


def read_directive(line: str, where: str) -> tuple[str, list[str]] | None:
    """Read ``# base: a, b`` or ``# entities: a, b``, which may precede the header of a CSV or TSV book.

    Args:
        line: a line that starts with ``#``.
        where: file and line, for the message of an error.

    Returns:
        ``"base"`` or ``"entities"`` and the labels; None for any other comment.

    Raises:
        RecipeFileError: if the line is too long or a label cannot name an entity.
    """
    key, colon, rest = line[1:].strip().partition(":")
    key = key.strip().lower()
    if not colon or key not in ("base", "entities"):
        return None
    if len(line) > MAX_LINE_LENGTH:
        raise RecipeFileError(f"{where}: a line of {len(line):,} characters; the limit is {MAX_LINE_LENGTH:,}.")
    labels = [cell for row in csv.reader([trimmed(rest, ",")]) for cell in row]
    return key, [check_label(label, where) for label in labels]


def trimmed(line: str, delimiter: str) -> str:
    """Return a line of a table without the spaces around its cells; those within quotes stay."""
    loose = f"{delimiter} " in line or f" {delimiter}" in line or line[:1] == " " or line.rstrip("\r\n")[-1:] == " "
    return _CELLS[delimiter].sub(lambda cell: cell[1].strip(" "), line) if loose else line


# A cell after any spaces: either quoted, up to the spaces before its end, or all up to its end.
_CELLS = {
    delimiter: re.compile(rf' *+("(?:[^"]|"")*+"(?= *+(?:[{delimiter}\r\n]|$))|[^{delimiter}\r\n]*+)')
    for delimiter in ",\t"
}


def _csv_line(labels: Iterable[str], delimiter: str) -> str:
    # Quotes only where they are needed; csv.writer needs a buffer because it only writes to files.
    cells = list(labels)
    if not any(delimiter in cell or '"' in cell or cell != cell.strip() or cell[0] == "#" for cell in cells):
        return delimiter.join(cells) + "\n"
    buffer = io.StringIO()
    csv.writer(buffer, delimiter=delimiter, lineterminator="\n", quoting=csv.QUOTE_ALL).writerow(cells)
    return buffer.getvalue()


def read_bytes(path: Path) -> bytes:
    """Return a book's bytes.

    Raises:
        RecipeFileError: saying why they cannot be read.
    """
    if path.is_dir():
        raise RecipeFileError(
            f"'{path}' {what_is(path)}; expected a recipe book (.csv, .tsv, .json) or a graph folder."
        )
    try:
        if path.exists() and not path.is_file():
            raise RecipeFileError(f"{path} is not a regular file; give a recipe book (.csv, .tsv, .json).")
        if path.exists() and (size := path.stat().st_size) > MAX_BOOK_SIZE:
            raise RecipeFileError(f"{path} has {size:,} bytes; the limit is {MAX_BOOK_SIZE:,}.")
        return path.read_bytes()
    except FileNotFoundError:
        raise RecipeFileError(f"{path} does not exist. `wordcraft-kg books` lists the books known by name.") from None
    except OSError as error:
        raise RecipeFileError(f"{path} cannot be read: {error.strerror}.") from None


def _decode(path: Path, data: bytes) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise RecipeFileError(
            f"{path}, line {line}: not UTF-8 (byte 0x{data[error.start]:02x}). Save it as UTF-8."
        ) from None
    if not text.strip():
        raise RecipeFileError(f"{path} is empty; a recipe book needs at least one recipe.")
    return text


Parsed = tuple[dict[str, str] | None, list[str], Iterable[Sequence[str]]]
"""Base entities, each with the place that names it, or None; entities listed otherwise; rows of recipes."""


def _parse_table(path: Path, text: str, delimiter: str, single: str | None) -> Parsed:
    base: dict[str, str] | None = None
    listed: list[str] = []
    lines = io.StringIO(text, newline="")
    number = 0
    for line in lines:
        number += 1
        if not line.startswith("#"):
            break
        directive = read_directive(line, f"{path}, line {number}")
        if directive is not None:
            key, labels = directive
            if key == "base":
                base = (base or {}) | dict.fromkeys(labels, f"{path}, line {number}")
            else:
                listed += labels
    header = tuple(cell.strip() for cell in line.rstrip("\r\n")[:MAX_LINE_LENGTH].split(delimiter))
    if header != CSV_HEADER:
        found = line.strip()[:80]
        raise RecipeFileError(
            f"{path}, line {number}: the header is '{found}'; expected '{delimiter.join(CSV_HEADER)}'"
            f"{' separated by tabs' if delimiter == chr(9) else ''}."
        )
    return base, listed, _table_rows(path, lines, delimiter, number, single)


def _table_rows(
    path: Path, lines: io.StringIO, delimiter: str, header_line: int, single: str | None
) -> Iterator[Sequence[str]]:
    def bounded() -> Iterator[str]:
        for count, line in enumerate(lines, start=header_line + 1):
            if len(line) > MAX_LINE_LENGTH:
                raise RecipeFileError(
                    f"{path}, line {count}: a line of {len(line):,} characters; the limit is {MAX_LINE_LENGTH:,}."
                )
            yield trimmed(line, delimiter)

    reader = csv.reader(bounded(), delimiter=delimiter, strict=True)
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise RecipeFileError(f"{path}, line {header_line + reader.line_num}: {error}.") from None
        if len(row) == 3 and all(row) and all(map(str.isprintable, row)) and not any(map(str.isspace, row)):
            if max(map(len, row)) <= MAX_LABEL_LENGTH:
                yield row
                continue
        elif not row:
            continue
        where = f"{path}, line {header_line + reader.line_num}"
        if len(row) != 3:
            count = max(len(row) - 1, 0)
            hint = " For a single ingredient, leave the second cell empty." if count == 1 else ""
            shown = delimiter.join(row)[:80]
            raise RecipeFileError(
                f"{where}: '{shown}' has {count} ingredient{'s' * (count != 1)} and a result"
                f"{'' if len(row) > 1 else ' missing'}; a recipe needs two and a result, in three columns.{hint}"
            )
        yield [check_label(label, where) for label in with_second(row, single, where)]


def with_second(row: Sequence[str], single: str | None, where: str) -> Sequence[str]:
    """Return a row in which a single ingredient has got its second one, see :func:`read_book`; others as they are.

    Raises:
        RecipeFileError: for a row of one ingredient, the other cell being empty, if ``single`` is None.
    """
    one, other, result = row
    if bool(one) == bool(other):
        return row
    return [*_pair_with(one or other, single, where), result]


def _pair_with(ingredient: str, single: str | None, where: str) -> tuple[str, str]:
    if single is None:
        raise RecipeFileError(
            f"{where}: '{ingredient}' is the only ingredient; a recipe needs two. Write it twice, or build the graph "
            f"with `single_ingredient` {SELF}, which reads {ingredient} + {ingredient}, or the name of what it is "
            "combined with."
        )
    return ingredient, ingredient if single == SELF else single


def _parse_json(path: Path, text: str, single: str | None) -> Parsed:
    def without_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = dict(pairs)
        if len(keys) < len(pairs):
            names = [key for key, _ in pairs]
            twice = next(key for key in names if names.count(key) > 1)
            raise RecipeFileError(f"{path}: the key '{twice}' occurs twice in one object.")
        return keys

    try:
        content = json.loads(text, object_pairs_hook=without_duplicate_keys)
    except json.JSONDecodeError as error:
        raise RecipeFileError(f"{path}, line {error.lineno}, column {error.colno}: not JSON ({error.msg}).") from None
    except RecipeFileError:
        raise
    except RecursionError:
        raise RecipeFileError(f"{path}: nested too deeply for a recipe book.") from None
    except ValueError as error:  # such as a number of thousands of digits
        raise RecipeFileError(f"{path}: not a recipe book ({error}).") from None
    entities = content.get("entities") if isinstance(content, dict) else None
    if isinstance(entities, dict):
        return None, list(entities), _official_rows(path, entities, single)
    if isinstance(entities, list) and isinstance(content.get("recipes"), list):
        known = {check_label(label, f"{path}: entities[{index}]") for index, label in enumerate(entities)}
        base = content.get("base")
        if base is not None:
            if not isinstance(base, list):
                raise RecipeFileError(f"{path}: 'base' is {type(base).__name__}; expected a list of labels or null.")
            places = ((label, f"{path}: base[{index}]") for index, label in enumerate(base))
            base = {_known(label, known, where): where for label, where in places}
        return base, sorted(known), _own_rows(path, content["recipes"], known, single)
    raise RecipeFileError(
        f"{path}: neither of the known layouts. Expected an object with the lists 'entities' and 'recipes', "
        "or the official one with an object 'entities'."
    )


def _own_rows(path: Path, recipes: list[Any], known: set[str], single: str | None) -> Iterator[Sequence[str]]:
    for index, row in enumerate(recipes):
        where = f"{path}: recipes[{index}]"
        if not isinstance(row, list) or len(row) not in (2, 3):
            raise RecipeFileError(f"{where} is {_shown(row)}; expected [ingredient, ingredient, result].")
        labels = [_known(label, known, where) for label in row]
        yield labels if len(labels) == 3 else [*_pair_with(labels[0], single, f"{where} is {_shown(row)}"), labels[1]]


def _official_rows(path: Path, entities: dict[str, Any], single: str | None) -> Iterator[Sequence[str]]:
    known = {check_label(label, f"{path}: entities") for label in entities}
    for result, entry in entities.items():
        where = f"{path}: entities['{result}']"
        if not isinstance(entry, dict) or not isinstance(entry.get("recipes"), list):
            raise RecipeFileError(f"{where} has no list 'recipes'.")
        for index, pair in enumerate(entry["recipes"]):
            here = f"{where}.recipes[{index}]"
            if not isinstance(pair, list) or len(pair) not in (1, 2):
                raise RecipeFileError(f"{here} is {_shown(pair)}; a recipe needs two ingredients.")
            labels = [_known(label, known, here) for label in pair]
            yield [*(labels if len(pair) == 2 else _pair_with(labels[0], single, f"{here} is {_shown(pair)}")), result]


def _known(label: Any, known: set[str], where: str) -> str:
    label = check_label(label, where)
    if label not in known:
        raise RecipeFileError(f"{where}: '{label}' is not among the file's entities.{nearest(label, known)}")
    return label


def _shown(value: Any) -> str:
    return repr(value)[:80]
