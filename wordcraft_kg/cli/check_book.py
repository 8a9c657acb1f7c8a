"""``wordcraft-kg check-book``."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output, aligned, split_labels

if TYPE_CHECKING:
    from wordcraft_kg.graphs.book_check import BookCheck, Finding
    from wordcraft_kg.graphs.recipe_graph import RecipeGraph

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
    """Check a recipe book while writing it: all findings with their lines, and its counts; never changes it.

    Exit code 1 if there is a problem. Notes are places to look at and do not fail.

    Args:
        book: recipe book: a .csv, .tsv or .json file, or a known book's name.
        base: base entities, repeatable, commas separate. Default: the book's own, else the entities without a recipe.
        against: another book; says what share of this one's recipes stand in it too.
    """
    from wordcraft_kg.graphs.book_check import check_book as check
    from wordcraft_kg.graphs.library import locate_book, open_book

    located = locate_book(book)
    path = located.path / "graph.json" if (located.path / "graph.json").is_file() else located.path
    other = None if against is None else open_book(against)
    found = check(path, split_labels(base) if base else located.base, located.name)
    graph = found.graph
    if graph is not None:
        found = found.adding(*_about_words(graph))
    if graph is not None and other is not None:
        shared = len(set(graph.recipe_labels()) & set(other.recipes))
        figures = {"against": other.name, "shared_recipes": shared, "shared": shared / graph.num_recipes}
        found = found.adding((), figures)
    values = {"book": book, "path": str(path), "passed": found.passed, "figures": found.figures}
    output.result(values | {"findings": [asdict(finding) for finding in found.findings]}, _text(found))
    return 0 if found.passed else 1


def _about_words(graph: "RecipeGraph") -> tuple[list["Finding"], dict[str, Any]]:
    """What needs word vectors: words without one, and test recipes that nearly repeat a train recipe."""
    from wordcraft_kg.errors import SplitError
    from wordcraft_kg.graphs.book_check import Finding, listed
    from wordcraft_kg.graphs.splits import SplitConfig, make_split
    from wordcraft_kg.models.scorers.features import glove_features
    from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM, near_synonym_recipes

    features = glove_features(graph.entities)
    words, missing = features.words, features.missing_words
    figures: dict[str, Any] = {"words": len(words), "words_with_vector": 1 - len(missing) / len(words)}
    findings = []
    if missing:
        message = f"{len(missing)} of {len(words)} words have no word vector: {listed(missing)}"
        findings.append(Finding("vector", "note", (), message))
    try:
        split = make_split(graph, SplitConfig())
    except SplitError:  # too few recipes to split
        return findings, figures
    tests = split.is_in("test")
    figures["near_synonym_share"] = float(near_synonym_recipes(split, features)[tests].mean())
    figures["near_synonym_cosine"] = NEAR_SYNONYM
    return findings, figures


def _text(found: "BookCheck") -> Iterator[str]:
    for finding in found.findings:
        shown = ", ".join(map(str, finding.lines))
        where = f"line{'s' * (len(finding.lines) > 1)} {shown}: " if finding.lines else ""
        yield f"{finding.severity} [{finding.kind}] {where}{finding.message}"
    figures = found.figures
    if figures:
        yield from aligned(_rows(figures))
    problems = sum(finding.severity == "problem" for finding in found.findings)
    yield f"{problems} problem{'s' * (problems != 1)}, {len(found.findings) - problems} to look at"


def _rows(figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "entities", f"{figures['entities']:,}, {figures['reachable']:,} can be made, in {figures['max_layer']} layers"
    yield "base", ", ".join(figures["base"][:10]) + (", ..." if len(figures["base"]) > 10 else "")
    yield "recipes", f"{figures['recipes']:,} of {figures['pairs']:,} pairs, {figures['self_pairs']} with itself"
    mean, share = figures["mean_recipes_per_craftable"], figures["share_with_two_recipes"]
    yield "per craftable", f"{mean:.2f} recipes, {share:.1%} have two or more"
    several, more = figures["pairs_with_two_or_three_results"], figures["pairs_with_more_results"]
    yield "several results", f"{several} pairs make two or three things, {more} make more"
    yield "terminal", f"{figures['terminal']} entities that no recipe uses"
    yield "most used", f"{figures['most_used']}, in {figures['most_used_share']:.1%} of the recipes"
    yield "words", f"{figures['words']:,}, {figures['words_with_vector']:.1%} with a word vector"
    if "near_synonym_share" in figures:
        share, cosine = figures["near_synonym_share"], figures["near_synonym_cosine"]
        yield "near-synonyms", f"{share:.1%} of test recipes repeat a train recipe with one (cosine {cosine} or more)"
    if "against" in figures:
        yield (
            "shared",
            f"{figures['shared_recipes']:,} recipes ({figures['shared']:.1%}) stand in {figures['against']} too",
        )
