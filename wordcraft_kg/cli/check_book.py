"""``wordcraft-kg check-book``."""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, aligned, names, split_labels
from wordcraft_kg.cli.options import Base, Book, SingleIngredient

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import CheckedBook
    from wordcraft_kg.graphs.book_check import BookFigures

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
    """Check a recipe book while you write it: list all findings with their lines, and counts. The book is not changed.

    The exit code is 1 if there is a problem. Notes are worth a look, but are not failures.

    Args:
        book: recipe book: a .csv, .tsv or .json file, or a known book's name.
        against: another book; the share of this one's recipes that are in it too is reported.
        limit: most findings of a kind to show; the others are counted. The JSON has all of them.
        all: show all findings.
    """
    from wordcraft_kg.base.settings import whole
    from wordcraft_kg.evaluation.books import view_check

    whole("limit", limit, 0)
    view = view_check(book, split_labels(base) if base else None, against, single_ingredient=single_ingredient)
    output.result(view, _text(view, None if all else limit))
    return 0 if view.passed else 1


def _text(view: "CheckedBook", limit: int | None) -> Iterator[str]:
    found: Counter[tuple[str, str]] = Counter()
    for finding in view.findings:
        found[finding.severity, finding.kind] += 1
        if limit is None or found[finding.severity, finding.kind] <= limit:
            shown = ", ".join(map(str, finding.lines))
            where = f"line{'s' * (len(finding.lines) > 1)} {shown}: " if finding.lines else ""
            yield f"{finding.severity} [{finding.kind}] {where}{finding.message}"
    for (severity, kind), number in found.items():
        if limit is not None and number > limit:
            yield f"{severity} [{kind}] and {number - limit:,} more; --all shows them"
    if not isinstance(view.figures, dict):
        yield from aligned(_rows(view.figures))
    problems = sum(finding.severity == "problem" for finding in view.findings)
    yield f"{counted(problems, 'problem')}, {len(view.findings) - problems:,} to look at"


def _rows(found: "BookFigures") -> Iterator[tuple[str, str]]:
    yield "entities", f"{found.entities:,}, {found.reachable:,} can be made, in {counted(found.max_layer, 'layer')}"
    yield "base", names(found.base, len(found.base))
    yield "recipes", f"{found.recipes:,} of {counted(found.pairs, 'pair')}, {found.self_pairs:,} with itself"
    mean, share = found.mean_recipes_per_craftable, found.share_with_two_recipes
    yield "per craftable", f"{mean:.2f} recipes, {share:.1%} have two or more"
    several, more = found.pairs_with_two_or_three_results, found.pairs_with_more_results
    makers = counted(several, "pair makes", "pairs make")
    yield "several results", f"{makers} two or three things, {more:,} more than that"
    yield "terminal", f"{counted(found.terminal, 'entity', 'entities')} that no recipe uses"
    yield "most used", f"{found.most_used}, in {found.most_used_share:.1%} of the recipes"
    yield "words", f"{found.words:,}, {found.words_with_vector:.1%} with a word vector"
    if found.near_synonym_share is not None:
        share, cosine = found.near_synonym_share, found.near_synonym_cosine
        yield "near-synonyms", f"{share:.1%} of test recipes repeat a train recipe with one (cosine {cosine} or more)"
    if found.against is not None:
        yield "shared", f"{counted(found.shared_recipes or 0, 'recipe')} ({found.shared:.1%}) also in {found.against}"
