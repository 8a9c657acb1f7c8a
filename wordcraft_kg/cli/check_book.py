"""``wordcraft-kg check-book``."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output, aligned, split_labels

if TYPE_CHECKING:
    from wordcraft_kg.graphs.book_check import BookFigures
    from wordcraft_kg.views.books import CheckedBook

EXAMPLES = (
    "wordcraft-kg check-book recipes.csv",
    "wordcraft-kg check-book everyday --against little-alchemy-2",
)


def check_book(
    book: str,
    *,
    base: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    against: str | None = None,
    output: Output = Output(),
) -> int:
    """Check a recipe book while you write it: list all findings with their lines, and counts. The book is not changed.

    The exit code is 1 if there is a problem. Notes are worth a look, but are not failures.

    Args:
        book: recipe book: a .csv, .tsv or .json file, or a known book's name.
        base: comma-separated base entities; may be repeated. Default: the book's own, or else the entities without a
            recipe.
        against: another book; the share of this one's recipes that are in it too is reported.
    """
    from wordcraft_kg.views.books import view_check

    view = view_check(book, split_labels(base) if base else None, against)
    output.result(view, _text(view))
    return 0 if view.passed else 1


def _text(view: "CheckedBook") -> Iterator[str]:
    for finding in view.findings:
        shown = ", ".join(map(str, finding.lines))
        where = f"line{'s' * (len(finding.lines) > 1)} {shown}: " if finding.lines else ""
        yield f"{finding.severity} [{finding.kind}] {where}{finding.message}"
    if not isinstance(view.figures, dict):
        yield from aligned(_rows(view.figures))
    problems = sum(finding.severity == "problem" for finding in view.findings)
    yield f"{problems} problem{'s' * (problems != 1)}, {len(view.findings) - problems} to look at"


def _rows(found: "BookFigures") -> Iterator[tuple[str, str]]:
    yield "entities", f"{found.entities:,}, {found.reachable:,} can be made, in {found.max_layer} layers"
    yield "base", ", ".join(found.base[:10]) + (", ..." if len(found.base) > 10 else "")
    yield "recipes", f"{found.recipes:,} of {found.pairs:,} pairs, {found.self_pairs} with itself"
    mean, share = found.mean_recipes_per_craftable, found.share_with_two_recipes
    yield "per craftable", f"{mean:.2f} recipes, {share:.1%} have two or more"
    several, more = found.pairs_with_two_or_three_results, found.pairs_with_more_results
    yield "several results", f"{several} pairs make two or three things, {more} make more"
    yield "terminal", f"{found.terminal} entities that no recipe uses"
    yield "most used", f"{found.most_used}, in {found.most_used_share:.1%} of the recipes"
    yield "words", f"{found.words:,}, {found.words_with_vector:.1%} with a word vector"
    if found.near_synonym_share is not None:
        share, cosine = found.near_synonym_share, found.near_synonym_cosine
        yield "near-synonyms", f"{share:.1%} of test recipes repeat a train recipe with one (cosine {cosine} or more)"
    if found.against is not None:
        yield "shared", f"{found.shared_recipes:,} recipes ({found.shared:.1%}) are in {found.against} too"
