"""``wordcraft-kg check-book``."""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, lines_of, split_labels
from wordcraft_kg.cli.failures import with_options
from wordcraft_kg.cli.options import Base, Book, SingleIngredient

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import CheckedBook

EXAMPLES = (
    "wordcraft-kg check-book recipes.csv",
    "wordcraft-kg check-book everyday --against kitchen",
)


def check_book(
    book: Book,
    *,
    base: Base = None,
    against: str | None = None,
    single_ingredient: SingleIngredient = None,
    limit: int = 10,
    all: Flag = False,
    output: Output = Output(),
) -> int:
    """Check a recipe book.

    List problems and notes with line numbers, and count recipes and entities.

    The book is not changed. The exit code is 1 if there are problems; notes are not failures.

    Args:
        book: recipe book: a .csv, .tsv or .json file, or a known book's name.
        against: another book; report the share of recipes that both books have.
        limit: findings to show for each kind; the rest are counted. The JSON lists all findings.
        all: show all findings.
    """
    from wordcraft_kg.base.settings import whole
    from wordcraft_kg.evaluation.books import view_check

    whole("limit", limit, 0)
    view = view_check(
        book, split_labels(base) if base else None, against, single_ingredient=single_ingredient
    )
    output.result(view, _text(view, None if all else limit))
    return 0 if view.passed else 1


def _shown(name: str, value: Any) -> Any:
    """Return a share as a percentage with three digits, any other value as it is."""
    from wordcraft_kg.graphs.book_check import SHARES

    return f"{100 * value:.3g} %" if name in SHARES and value is not None else value


def _text(view: "CheckedBook", limit: int | None) -> Iterator[str]:
    counts: Counter[str] = Counter()
    for finding in view.findings:
        kind = f"{finding.severity} [{finding.kind}]"
        counts[kind] += 1
        if limit is None or counts[kind] <= limit:
            where = ""
            if finding.lines:
                noun = "line" if len(finding.lines) == 1 else "lines"
                where = f"{noun} {', '.join(map(str, finding.lines))}: "
            yield f"{kind} {where}{with_options(finding.message)}"
    for kind, number in counts.items():
        if limit is not None and number > limit:
            yield f"{kind} and {number - limit:,} more; --all shows them"
    from wordcraft_kg.base.records import as_values

    figures = as_values(view.figures)
    yield from lines_of({name: _shown(name, value) for name, value in figures.items()})
    problems = sum(finding.severity == "problem" for finding in view.findings)
    yield f"{counted(problems, 'problem')}, {len(view.findings) - problems:,} to look at"
