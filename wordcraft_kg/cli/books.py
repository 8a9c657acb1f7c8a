"""``wordcraft-kg books`` and ``wordcraft-kg check-book``."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base import as_values, check_output_file, counted, quoted, whole
from wordcraft_kg.cli.console import Output, aligned, lines_of, split_labels
from wordcraft_kg.cli.failures import with_options
from wordcraft_kg.cli.options import Base, Book, FetchableBook, FileOptions, Force
from wordcraft_kg.graphs.library import DATA_VARIABLE, FETCHABLE, fetch_book

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import BookList, CheckedBook
    from wordcraft_kg.graphs.book_check import Finding

EXAMPLES = {
    "books": (
        "wordcraft-kg books",
        "wordcraft-kg books --fetch little-alchemy-2",
        "wordcraft-kg books --fetch infinite-craft",
        "wordcraft-kg books --fetch inorganic-synthesis",
    ),
    "check-book": (
        "wordcraft-kg check-book recipes.csv",
        "wordcraft-kg check-book recipes.csv --fix mended.csv",
    ),
}


def books(*, fetch: FetchableBook = None, output: Output = Output()) -> None:
    """List the recipe books known by name, or download a published book into the cache.

    Commands accept a book's name in place of a path.

    Args:
        fetch: book to download into the cache; the SHA-256 is checked.
    """
    # The only command that downloads a book: all others work without a network.
    if fetch is not None:
        path = fetch_book(fetch)
        book = FETCHABLE[fetch]
        values = {
            "book": fetch,
            "path": str(path),
            "sha256": book.sha256,
            "url": book.url,
            "note": book.note,
        }
        output.result(
            values,
            [f"{fetch} is in {path} ({book.note})", f"next: wordcraft-kg build-graph {fetch}"],
        )
    else:
        from wordcraft_kg.evaluation.books import view_books

        view = view_books()
        output.result(view, _text_of_books(view))


def _text_of_books(view: "BookList") -> Iterator[str]:
    rows: list[tuple[str, ...]] = [("book", "origin", "entities", "recipes", "")]
    for book in view.books:
        # A built-in book is in the package, wherever that is.
        place = ""
        if book.origin != "built in":
            place = book.path or f"get it: wordcraft-kg books --fetch {book.name}"
        note = f"  ({book.note})" if book.note else ""
        # Right-aligned; a book that is not here has no sizes.
        entities = f"{_size(book.entities):>8}"
        recipes = f"{_size(book.recipes):>8}"
        rows.append((book.name, book.origin, entities, recipes, f"{place}{note}".lstrip()))
    yield from aligned(rows)
    yield "with invented words: made-up:BOOK, such as made-up:everyday; made-up-3:BOOK with seed 3"
    folder = view.data_folder or "not set"
    yield f"your own: any path, or files in the folder that {DATA_VARIABLE} names ({folder})"


def _size(number: int | None) -> str:
    return "" if number is None else f"{number:,}"


def check_book(
    book: Book,
    *,
    base: Base = None,
    limit: int = 10,
    fix: Path | None = None,
    force: Force = False,
    file: FileOptions = FileOptions(),
    output: Output = Output(),
) -> int:
    """Check a recipe book.

    List problems and notes with line numbers, and count recipes and entities.

    The file itself is not changed. The exit code is 1 if there are problems; notes are no
    failures.

    Args:
        book: recipe book: a table, lines a + b = c, JSON, a save of Infinite Craft, a folder of
            Minecraft recipes, also in gzip or zip; or a known book's name.
        limit: findings to show for each kind; the rest are counted. The JSON lists all findings.
        fix: write the mended book to this .csv, .tsv or .json file: readable recipes, each once,
            without results among their ingredients, in UTF-8 and the file's order, tables with
            further columns; what is left out is printed.
    """
    from wordcraft_kg.evaluation.books import view_check

    whole("limit", limit, 0)
    if fix is not None:
        check_output_file(fix, force=force, setting="fix")
    labels = split_labels(base) if base else None
    view = view_check(book, labels, fix=fix, **file.for_reading())
    output.result(view, _text_of_check(view, limit))
    return 0 if view.passed else 1


def _where(finding: "Finding") -> str:
    """Return the lines of a finding before its message; a finding about the whole file has none."""
    if not finding.lines:
        return ""
    noun = "line" if len(finding.lines) == 1 else "lines"
    numbers = ", ".join(map(str, finding.lines))
    return f"{noun} {numbers}: "


def _left_out(view: "CheckedBook") -> Iterator[str]:
    """Yield what the mended book lacks: rows by reason with their places, and columns."""
    assert view.reading is not None
    for reason, places in view.left_out.items():
        number = view.reading.left_out[reason]
        ellipsis = ", ..." if number > len(places) > 0 else ""
        at = f" (at {', '.join(map(str, places))}{ellipsis})" if places else ""
        yield f"left out: {counted(number, 'row')} {reason}{at}"
    if view.columns_left_out:
        yield f"left out: the columns {', '.join(view.columns_left_out)}"


def _text_of_check(view: "CheckedBook", limit: int) -> Iterator[str]:
    if view.reading is not None:
        yield view.reading.line()
    # The limit is one of each kind, or a thousand repetitions would hide a single fault.
    counts: Counter[str] = Counter()
    for finding in view.findings:
        kind = f"{finding.severity} [{finding.kind}]"
        counts[kind] += 1
        if counts[kind] <= limit:
            yield f"{kind} {_where(finding)}{with_options(finding.message)}"
    # Kinds that were cut say so after all findings, where the eye ends.
    for kind, number in counts.items():
        if number > limit:
            yield f"{kind} and {number - limit:,} more; a larger --limit shows them"

    figures = as_values(view.figures)
    # The base is what a user has to see as a whole: a slip in a label makes a base entity.
    if figures.get("base"):
        figures["base"] = ", ".join(map(quoted, figures["base"]))
    has_sets = view.reading is not None and bool(view.reading.arities.keys() - {"2"})
    yield from lines_of(figures, of_sets=has_sets)
    if view.fixed is not None:
        yield f"wrote the mended book to {view.fixed}"
        yield from _left_out(view)
    problems = sum(finding.severity == "problem" for finding in view.findings)
    notes = len(view.findings) - problems
    yield f"{counted(problems, 'problem')}, {notes:,} to look at"
