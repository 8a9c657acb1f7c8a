"""Read and write recipe books, files that list recipes.

Three layouts are read: CSV or TSV (``ingredient_a,ingredient_b,result``), our own JSON, and the JSON released with the
paper's code (``{"entities": {label: {"recipes": [[a, b], ...]}}}``; Jiang et al. 2020). Labels are matched exactly. In
CSV and TSV, spaces around an unquoted label are ignored.
"""

import csv
import hashlib
import io
import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.artefacts import output_target, what_is, write_atomically
from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.recipes import (
    MAX_LABEL_LENGTH,
    Recipe,
    RecipeBook,
    check_label,
    label_fault,
    shown,
)

CSV_HEADER = ("ingredient_a", "ingredient_b", "result")
KIND = "kind"
"""Optional fourth column: the kind of reasoning behind a recipe."""
DELIMITERS = {".csv": ",", ".tsv": "\t", ".tab": "\t"}
"""Column delimiters by file ending."""
MAX_BOOK_SIZE = 2**30
"""Largest file that is read, in bytes; about 40 million recipes."""
_JSON_FORMAT = "wordcraft-kg recipe book 1"
_MAX_LINE_LENGTH = 100_000  # of a table: a file without line ends fails early, with the reason
_SELF = "self"  # the `single_ingredient` that combines a single ingredient with itself


@stage("reading the book")
def read_book(
    path: str | Path,
    *,
    keep_self_results: bool = False,
    single_ingredient: str | None = None,
    name: str | None = None,
) -> RecipeBook:
    """Read and validate a recipe book from a file, or from a graph folder.

    The file ending selects the layout: ``.csv``, ``.tsv`` (or ``.tab``), ``.json``. In CSV and TSV, leading lines with
    ``#`` are comments; ``# base: a, b`` declares base entities (known at the start), and ``# entities: a, b`` lists
    entities without a recipe. A fourth column ``kind`` may name each recipe's kind of reasoning.

    Args:
        path: the file, or a graph folder.
        keep_self_results: keep recipes with the result among the ingredients.
        single_ingredient: how to read recipes with one ingredient: ``self`` repeats the ingredient, another text
            names a second ingredient, such as furnace. With None such a recipe is an error.
        name: the book's name; None uses the file's or folder's name.

    Raises:
        RecipeFileError: naming the line or JSON key with the first error.
    """
    path = Path(path)
    if (path / "graph.json").is_file():
        path = path / "graph.json"
    if single_ingredient is not None:
        check_label(single_ingredient, "`single_ingredient`")
    data = read_bytes(path)
    text = _decode(path, data)
    ending = path.suffix.lower()
    lines_of_base: dict[str, int] = {}
    kinds: dict[Recipe, str] = {}
    base: Collection[str] | None
    if ending == ".json":
        base, listed, rows, kinds = _parse_json(path, text, single_ingredient)
    elif ending in DELIMITERS:
        table = Table(text, DELIMITERS[ending], single_ingredient)
        base, listed, rows = table.base, table.listed, _without_faults(path, table)
        lines_of_base, kinds = table.base or {}, table.kinds
    else:
        raise RecipeFileError(
            f"{path}: unknown ending '{path.suffix}'; a recipe book is .csv, .tsv or .json."
        )
    sha256 = hashlib.sha256(data).hexdigest()
    name = name or book_name(path)
    book = RecipeBook.of(
        name, rows, listed=listed, keep_self_results=keep_self_results, sha256=sha256
    )
    book = replace(
        book, kinds={recipe: kinds[recipe] for recipe in book.recipes if recipe in kinds}
    )
    if not book.recipes:
        raise RecipeFileError(
            f"{path} has no recipe to keep ({book.dropped_self_results} self results dropped)."
        )
    known = set(book.entities)
    for label, line in lines_of_base.items():
        if label not in known:
            raise RecipeFileError(f"{path}, line {line}: {unknown_base(label, known)}")
    return book if base is None else replace(book, base=tuple(sorted(base)))


def book_name(path: Path) -> str:
    """Return a book's default name: the file or folder name, without control characters."""
    name = path.parent.name if path.name == "graph.json" else path.stem
    if label_fault(name) is None:
        return name
    return "".join(char if char.isprintable() else "_" for char in name) or "book"


def unknown_base(label: str, known: Iterable[str]) -> str:
    """Return the error message for a base entity that is not among the ``known`` labels."""
    return (
        f"the base entity '{label}' is in no recipe.{nearest(label, known)} "
        f"If it is meant, list it as well: # entities: {label}"
    )


def read_bytes(path: Path) -> bytes:
    """Read a recipe book's bytes, or raise a :class:`RecipeFileError` for a missing, too large or unreadable file."""
    if path.is_dir():
        raise RecipeFileError(
            f"'{path}' {what_is(path)}; expected a recipe book (.csv, .tsv, .json) or a graph folder."
        )
    try:
        if path.exists() and not path.is_file():
            raise RecipeFileError(
                f"{path} is not a regular file; give a recipe book (.csv, .tsv, .json)."
            )
        if path.exists() and (size := path.stat().st_size) > MAX_BOOK_SIZE:
            raise RecipeFileError(f"{path} has {size:,} bytes; the limit is {MAX_BOOK_SIZE:,}.")
        return path.read_bytes()
    except FileNotFoundError:
        raise RecipeFileError(
            f"{path} does not exist. `wordcraft-kg books` lists the books known by name."
        ) from None
    except OSError as error:
        raise RecipeFileError(f"{path} cannot be read: {error.strerror}.") from None


def _decode(path: Path, data: bytes) -> str:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = data.count(b"\n", 0, error.start) + 1, data[error.start]
        raise RecipeFileError(
            f"{path}, line {line}: not UTF-8 (byte 0x{byte:02x}). Save the file as UTF-8."
        ) from None
    if not text.strip():
        raise RecipeFileError(f"{path} is empty; a recipe book needs at least one recipe.")
    return text


def _alone(ingredient: str) -> str:
    return (
        f"'{ingredient}' is the only ingredient; a recipe needs two. Write it twice, or build the graph "
        f"with `single_ingredient` {_SELF}, which reads {ingredient} + {ingredient}, or the name of what it is "
        "combined with."
    )


# --- tables ----------------------------------------------------------------------------------------------------------


class Fault(NamedTuple):
    """An invalid line in a CSV or TSV book; ``kind`` is ``directive``, ``header``, ``row`` or ``label``."""

    line: int
    kind: str
    message: str


Row = tuple[int, Sequence[str]]
"""A recipe in a CSV or TSV book: line number from 1, and labels (ingredient, ingredient, result)."""


class Table:
    """A CSV or TSV recipe book, read line by line; iterate once over recipes and invalid lines.

    ``base`` (None without a declaration) and ``listed`` map labels in ``# base`` and ``# entities`` to line numbers;
    ``kinds`` maps recipes to their kinds.
    """

    def __init__(self, text: str, delimiter: str, single: str | None):
        """Read ``text`` up to the header; ``single`` is ``single_ingredient`` in :func:`read_book`."""
        self.base: dict[str, int] | None = None
        self.listed: dict[str, int] = {}
        self.kinds: dict[Recipe, str] = {}
        self._has_kinds = False
        self._delimiter, self._single = delimiter, single
        self._lines = enumerate(io.StringIO(text, newline=""), start=1)
        self._head = list(self._read_head())

    def __iter__(self) -> Iterator[Row | Fault]:
        """Yield recipes and invalid lines in file order."""
        yield from self._head
        for number, line in self._lines:
            if self._is_header(line):
                yield Fault(number, "header", "the header is repeated in the middle")
            elif (row := self._read(number, line)) is not None:
                yield row

    def _read_head(self) -> Iterator[Row | Fault]:
        number, line = 0, ""
        for number, line in self._lines:
            if not line.startswith("#"):
                break
            fault = self._read_directive(number, line)
            if fault is not None:
                yield fault
        if not number or self._is_header(line):
            self._has_kinds = line.rstrip().endswith(KIND)
            return
        expected = (
            self._delimiter.join(CSV_HEADER)
            + "'"
            + " separated by tabs" * (self._delimiter == "\t")
        )
        yield Fault(
            number,
            "header",
            f"the header is '{line.strip()[:80]}'; expected '{expected}; {KIND} may follow.",
        )
        # A misspelt header is not a recipe, unlike a recipe in the header's place.
        is_header = (
            sum(cell.strip() in CSV_HEADER for cell in line.split(self._delimiter)) >= 2
            or line[0] == "#"
        )
        if not is_header and (row := self._read(number, line)) is not None:
            yield row

    def _is_header(self, line: str) -> bool:
        if CSV_HEADER[0] not in line[:_MAX_LINE_LENGTH]:
            return False
        header = tuple(map(str.strip, line.rstrip("\r\n").split(self._delimiter)))
        return header in (CSV_HEADER, (*CSV_HEADER, KIND))

    def _read_directive(self, number: int, line: str) -> Fault | None:
        key, colon, rest = line[1:].strip().partition(":")
        key = key.strip().lower()
        if not colon or key not in ("base", "entities"):
            return None
        if len(line) > _MAX_LINE_LENGTH:
            return Fault(number, "directive", _too_long(line))
        labels = [cell for row in csv.reader([trimmed(rest, ",")]) for cell in row]
        for fault in filter(None, map(label_fault, labels)):
            return Fault(number, "directive", fault)
        if key == "base":
            self.base = (self.base or {}) | dict.fromkeys(labels, number)
        else:
            self.listed |= dict.fromkeys(labels, number)
        return None

    def _read(self, number: int, line: str) -> Row | Fault | None:
        if len(line) > _MAX_LINE_LENGTH:
            return Fault(number, "row", _too_long(line))
        line = trimmed(line.rstrip("\r\n"), self._delimiter)
        if not line:
            return None
        cells = line.split(self._delimiter)
        if '"' in line:
            try:
                (cells,) = csv.reader([line], delimiter=self._delimiter, strict=True)
            except csv.Error as error:
                return Fault(
                    number,
                    "row",
                    f"{error}; a quoted cell ends in its line, and a quote in it is doubled.",
                )
        kind = cells.pop() if self._has_kinds and len(cells) == 4 else ""
        if kind and (fault := label_fault(kind)):
            return Fault(number, "label", fault)
        row = self._labels(number, cells)
        if kind and not isinstance(row, Fault):
            recipe = Recipe.of(*row[1])
            if self.kinds.setdefault(recipe, kind) != kind:
                return Fault(
                    number,
                    "row",
                    f"{recipe} has the kind '{kind}' here, and '{self.kinds[recipe]}' above.",
                )
        return row

    def _labels(self, number: int, cells: list[str]) -> Row | Fault:
        if len(cells) != 3:
            return Fault(number, "row", self._not_three(cells))
        is_plain = (
            all(cells) and all(map(str.isprintable, cells)) and not any(map(str.isspace, cells))
        )
        if is_plain and max(map(len, cells)) <= MAX_LABEL_LENGTH:
            return number, cells
        one, other, result = cells
        faults = []
        if bool(one) != bool(other):
            one = one or other
            if self._single is None:
                faults.append(_alone(one))
            other = one if self._single in (None, _SELF) else self._single
        faults += filter(None, map(label_fault, (one, other, result)))
        return (
            Fault(number, "label", " Also, ".join(dict.fromkeys(faults)))
            if faults
            else (number, (one, other, result))
        )

    def _not_three(self, cells: Sequence[str]) -> str:
        count = len(cells) - 1
        hint = " For a single ingredient, leave the second cell empty." if count == 1 else ""
        return (
            f"'{self._delimiter.join(cells)[:80]}' has {count} ingredient{'s' * (count != 1)} and a result"
            f"{'' if count else ' missing'}; a recipe needs two and a result, in three columns.{hint}"
        )


def _without_faults(path: Path, table: Table) -> Iterator[Sequence[str]]:
    for row in table:
        if isinstance(row, Fault):
            raise RecipeFileError(f"{path}, line {row.line}: {row.message}")
        yield row[1]


def _too_long(line: str) -> str:
    return f"a line of {len(line):,} characters; the limit is {_MAX_LINE_LENGTH:,}."


def trimmed(line: str, delimiter: str) -> str:
    """Strip spaces around the cells in a table row; spaces within quotes stay."""
    loose = (
        f"{delimiter} " in line
        or f" {delimiter}" in line
        or line[:1] == " "
        or line.rstrip("\r\n")[-1:] == " "
    )
    return _CELLS[delimiter].sub(lambda cell: cell[1].strip(" "), line) if loose else line


# A cell after any spaces: either quoted, up to the spaces before its end, or all up to its end.
_CELLS = {
    delimiter: re.compile(
        rf' *+("(?:[^"]|"")*+"(?= *+(?:[{delimiter}\r\n]|$))|[^{delimiter}\r\n]*+)'
    )
    for delimiter in ",\t"
}


# --- JSON ------------------------------------------------------------------------------------------------------------

_Raw = tuple[str, list[Any], list[Any], Any]
"""A recipe in a JSON file: place for errors, raw value, ingredients, result."""


def _parse_json(
    path: Path, text: str, single: str | None
) -> tuple[list[str] | None, Iterable[str], Iterable[Sequence[str]], dict[Recipe, str]]:
    content = _load_json(path, text)
    entities = content.get("entities") if isinstance(content, dict) else None
    if isinstance(entities, dict):
        known = {check_label(label, f"{path}: entities") for label in entities}
        return None, entities, _rows(_official_recipes(path, entities), known, single), {}
    if isinstance(entities, list) and isinstance(content.get("recipes"), list):
        known = {
            check_label(label, f"{path}: entities[{index}]") for index, label in enumerate(entities)
        }
        base = content.get("base")
        if base is not None and not isinstance(base, list):
            raise RecipeFileError(
                f"{path}: 'base' is {type(base).__name__}; expected a list of labels or null."
            )
        for index, label in enumerate(base or ()):
            _known(label, known, f"{path}: base[{index}]")
        recipes = [*_rows(_own_recipes(path, content["recipes"]), known, single)]
        return base, known, recipes, _kinds(content.get("kinds"), recipes, f"{path}: kinds")
    raise RecipeFileError(
        f"{path}: neither of the known layouts. Expected an object with the lists 'entities' and 'recipes', "
        "or the official layout with an object 'entities'."
    )


def _kinds(kinds: Any, recipes: list[Sequence[str]], where: str) -> dict[Recipe, str]:
    if kinds is None:
        return {}
    if not isinstance(kinds, list) or len(kinds) != len(recipes):
        raise RecipeFileError(
            f'{where} is {shown(kinds)}; expected a list with a kind, or "", for each recipe.'
        )
    rows = enumerate(zip(recipes, kinds, strict=True))
    return {
        Recipe.of(*row): check_label(kind, f"{where}[{index}]")
        for index, (row, kind) in rows
        if kind != ""
    }


def _load_json(path: Path, text: str) -> Any:
    def without_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = dict(pairs)
        if len(keys) < len(pairs):
            names = [key for key, _ in pairs]
            twice = next(key for key in names if names.count(key) > 1)
            raise RecipeFileError(f"{path}: the key '{twice}' occurs twice in one object.")
        return keys

    try:
        return json.loads(text, object_pairs_hook=without_duplicate_keys)
    except json.JSONDecodeError as error:
        raise RecipeFileError(
            f"{path}, line {error.lineno}, column {error.colno}: not JSON ({error.msg})."
        ) from None
    except RecipeFileError:
        raise
    except RecursionError:
        raise RecipeFileError(f"{path}: nested too deeply for a recipe book.") from None
    except ValueError as error:  # such as a number of thousands of digits
        raise RecipeFileError(f"{path}: not a recipe book ({error}).") from None


def _own_recipes(path: Path, recipes: list[Any]) -> Iterator[_Raw]:
    for index, row in enumerate(recipes):
        where = f"{path}: recipes[{index}]"
        if not isinstance(row, list) or len(row) not in (2, 3):
            raise RecipeFileError(
                f"{where} is {shown(row)}; expected [ingredient, ingredient, result]."
            )
        yield where, row, row[:-1], row[-1]


def _official_recipes(path: Path, entities: dict[str, Any]) -> Iterator[_Raw]:
    for result, entry in entities.items():
        where = f"{path}: entities['{result}']"
        if not isinstance(entry, dict) or not isinstance(entry.get("recipes"), list):
            raise RecipeFileError(f"{where} has no list 'recipes'.")
        for index, pair in enumerate(entry["recipes"]):
            here = f"{where}.recipes[{index}]"
            if not isinstance(pair, list) or len(pair) not in (1, 2):
                raise RecipeFileError(f"{here} is {shown(pair)}; a recipe needs two ingredients.")
            yield here, pair, pair, result


def _rows(recipes: Iterable[_Raw], known: set[str], single: str | None) -> Iterator[Sequence[str]]:
    for where, row, ingredients, result in recipes:
        *labels, made = (_known(label, known, where) for label in (*ingredients, result))
        if len(labels) == 1:
            if single is None:
                raise RecipeFileError(f"{where} is {shown(row)}: {_alone(labels[0])}")
            labels.append(labels[0] if single == _SELF else single)
        yield *labels, made


def _known(label: Any, known: set[str], where: str) -> str:
    label = check_label(label, where)
    if label not in known:
        raise RecipeFileError(
            f"{where}: '{label}' is not among the file's entities.{nearest(label, known)}"
        )
    return label


# --- writing ---------------------------------------------------------------------------------------------------------


def write_book(book: RecipeBook, path: Path) -> None:
    """Write a recipe book as ``.csv``, ``.tsv`` or ``.json``; reading the file restores an equal book."""
    ending = path.suffix.lower()
    target = output_target(path)
    if ending == ".json":
        write_atomically(target, book_json(book))
    elif ending in (".csv", ".tsv"):
        directives = [("base", book.base), ("entities", book.idle or None)]
        head = [
            f"# {key}: {_csv_line(labels, ',')}" for key, labels in directives if labels is not None
        ]
        write_atomically(
            target,
            [*head, *recipe_table(book.recipes, "," if ending == ".csv" else "\t", book.kinds)],
        )
    else:
        raise RecipeFileError(
            f"{path}: unknown ending '{ending}'; a recipe book is written as .csv, .tsv or .json."
        )


def recipe_table(
    recipes: Iterable[Recipe], delimiter: str = ",", kinds: Mapping[Recipe, str] | None = None
) -> Iterator[str]:
    """Yield table lines: a header, then (ingredient, ingredient, result) per recipe, with its kind if any has one."""
    yield delimiter.join((*CSV_HEADER, KIND) if kinds else CSV_HEADER) + "\n"
    for recipe in recipes:
        yield _csv_line((*recipe, kinds.get(recipe, "")) if kinds else recipe, delimiter)


def book_json(book: RecipeBook, **extra: Any) -> Iterator[str]:
    """Yield a book in this package's JSON layout, one recipe per line; ``extra`` adds top-level keys."""
    dump = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    yield f'{{\n"format": {dump(_JSON_FORMAT)},\n"name": {dump(book.name)},\n'
    if book.kinds:
        extra["kinds"] = [book.kinds.get(recipe, "") for recipe in book.recipes]
    for key, value in extra.items():
        yield f"{dump(key)}: {dump(value)},\n"
    yield f'"base": {dump(book.base)},\n"entities": {dump(book.entities)},\n"recipes": [\n'
    last = len(book.recipes) - 1
    for index, recipe in enumerate(book.recipes):
        yield dump(recipe) + (",\n" if index < last else "\n")
    yield "]\n}\n"


def _csv_line(labels: Iterable[str], delimiter: str) -> str:
    # Quotes only where they are needed; csv.writer needs a buffer because it only writes to files.
    cells = list(labels)
    if not any(
        delimiter in cell or '"' in cell or cell != cell.strip() or cell[:1] == "#"
        for cell in cells
    ):
        return delimiter.join(cells) + "\n"
    buffer = io.StringIO()
    csv.writer(buffer, delimiter=delimiter, lineterminator="\n", quoting=csv.QUOTE_ALL).writerow(
        cells
    )
    return buffer.getvalue()
