"""Check a recipe book under construction: list all errors and suspicious entries, with line numbers.

:func:`~wordcraft_kg.graphs.book_files.read_book` stops at the first error and accepts suspicious entries.
"""

import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.base.escaping import for_terminal
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files import (
    DELIMITERS,
    Fault,
    Table,
    book_name,
    read_book,
    read_bytes,
    unknown_base,
)
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook, alike_labels

LISTED = 15  # lines or names in a finding, at most
MAX_FINDINGS = 10_000
"""Findings after which reading stops: a file with more errors is not a recipe book."""


class Finding(Record):
    """An error or a suspicious entry in a recipe book.

    ``kind`` is the violated rule, such as ``duplicate``. A ``problem`` fails the check, a ``note`` does not. ``lines``
    are line numbers from 1, at most 15; empty for a finding about the whole book.
    """

    kind: str
    severity: Literal["problem", "note"]
    lines: tuple[int, ...]
    message: str


class BookStatistics(Record, omit_defaults=True):
    """Statistics for a recipe book; the last seven need word vectors or a second book.

    Attributes:
        reachable: base entities (known at the start) and entities that can be made from the base.
        max_layer: rounds of combining all known pairs until the last reachable entity.
        share_with_two_recipes: share of the craftable entities (entities with a recipe) with at least two recipes.
        terminal: craftable entities that no recipe uses.
        self_pairs: entities that combine with themselves.
        most_used_share: share of all recipes that use ``most_used``.
        words_with_vector: share of the words in entity labels with a word vector.
        near_synonym_share: share of the default split's test recipes that repeat a train recipe with one ingredient
            replaced by a near-synonym (cosine ``near_synonym_cosine`` or more).
        against: name of a second book.
        shared_recipes: recipes in both books; ``shared`` is their share in this book.
    """

    entities: Count
    recipes: Count
    pairs: Count
    base: tuple[str, ...]
    reachable: Count
    max_layer: Count
    mean_recipes_per_craftable: float
    share_with_two_recipes: Share
    terminal: Count
    self_pairs: Count
    pairs_with_two_or_three_results: Count
    pairs_with_more_results: Count
    most_used: str
    most_used_share: Share
    words: Count | None = None
    words_with_vector: Share | None = None
    near_synonym_share: Share | None = None
    near_synonym_cosine: float | None = None
    against: str | None = None
    shared_recipes: Count | None = None
    shared: Share | None = None


SHARES = frozenset(
    name for name, kind in BookStatistics.__annotations__.items() if kind in (Share, Share | None)
)
"""Names of the statistics that are shares, from 0 to 1."""


@dataclass(frozen=True)
class BookCheck:
    """The check of a book: findings, problems first, and statistics and graph of the readable recipes, if any."""

    findings: tuple[Finding, ...]
    figures: BookStatistics | None
    graph: RecipeGraph | None

    @property
    def passed(self) -> bool:
        """Whether the book has no problems."""
        return all(finding.severity == "note" for finding in self.findings)

    def adding(self, findings: Iterable[Finding], **figures: Any) -> "BookCheck":
        """Return a copy with more findings, and with new values of ``figures`` by field name."""
        more = None if self.figures is None else msgspec.structs.replace(self.figures, **figures)
        return replace(self, findings=_sorted([*self.findings, *findings]), figures=more)


@stage("checking the book")
def check_book(
    path: Path,
    base: Iterable[str] | None = None,
    name: str | None = None,
    *,
    single_ingredient: str | None = None,
) -> BookCheck:
    """Check a recipe book, and return all problems and notes.

    Problems are: bytes that are not UTF-8, a byte order mark, line ends other than LF, labels with commas, bad rows,
    recipes listed twice or made from themselves, labels in two spellings, unused base entities, entities out of reach
    from the base, and cycles of entities that need each other. Notes are: an inferred base, invisible characters,
    singular and plural forms of a word, entities in only one recipe, and listed entities without a recipe.

    Args:
        path: a ``.csv``, ``.tsv`` or ``.json`` file. Only CSV and TSV findings have line numbers; for an unreadable
            JSON book, the first error is the only finding about the content.
        base: base entities; None uses the file's base, or entities without a recipe.
        name: the book's name; None uses the file's name.
        single_ingredient: see :func:`~wordcraft_kg.graphs.book_files.read_book`.

    Raises:
        RecipeFileError: if the file cannot be read at all.
    """
    text, findings = _decoded(read_bytes(path))
    lines_of: dict[Recipe, list[int]] = {}
    delimiter = DELIMITERS.get(path.suffix.lower())
    if delimiter is None:
        book = _read_other(path, name, single_ingredient, findings)
    else:
        table = Table(text, delimiter, single_ingredient)
        book = _read_table(table, name or book_name(path), findings, lines_of)
    if book is None or not book.recipes:
        if not any(finding.severity == "problem" for finding in findings):
            findings.append(_problem("empty", "it has no recipe"))
        return BookCheck(_sorted(findings), None, None)
    wanted = book.base if base is None else tuple(base)
    if wanted is not None and (unknown := sorted(set(wanted).difference(book.entities))):
        hint = nearest(unknown[0], book.entities)
        findings.append(
            _problem("base", f"base entities that are not in {book.name}: {listed(unknown)}{hint}")
        )
    graph = RecipeGraph.from_book(
        book, None if wanted is None else set(wanted).intersection(book.entities)
    )
    line_of: dict[str, int] = {}
    for recipe, numbers in lines_of.items():
        for label in recipe:
            line_of[label] = min(line_of.get(label, numbers[0]), numbers[0])
    if graph.base_is_inferred:
        entities = counted(len(graph.base), "entity", "entities")
        message = f"no base is named, so the base is the {entities} without a recipe"
        findings.append(
            _note("base", f"{message}: {listed(graph.base)}. Name the base: # base: a, b")
        )
    findings += [*_characters(graph, line_of), *_spellings(graph, line_of), *_idle(graph, wanted)]
    findings += [
        *_unreachable(graph, line_of, lines_of),
        *_plurals(graph, line_of),
        *_lonely(graph, line_of),
    ]
    return BookCheck(_sorted(findings), _statistics(graph), graph)


def _decoded(data: bytes) -> tuple[str, list[Finding]]:
    findings = []
    if data.startswith(b"\xef\xbb\xbf"):
        findings.append(
            _problem("bom", "the file starts with a byte order mark; save it without one", [1])
        )
    text = data.decode("utf-8-sig", errors="replace")
    lines = list(io.StringIO(text, newline=""))
    returns = [number for number, line in enumerate(lines, start=1) if "\r" in line]
    if returns:
        message = (
            f"{counted(len(returns), 'line')} with a carriage return (CRLF or CR); end lines in LF"
        )
        findings.append(
            _problem("line-ends", message, returns if len(returns) < len(lines) // 2 else ())
        )
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError:
        bad = [number for number, line in enumerate(lines, start=1) if "\ufffd" in line]
        findings.append(_problem("encoding", "not UTF-8; save it as UTF-8", bad))
    return text, findings


def _read_other(
    path: Path, name: str | None, single: str | None, findings: list[Finding]
) -> RecipeBook | None:
    try:
        book = read_book(path, name=name, single_ingredient=single)
    except RecipeFileError as error:
        findings.append(_problem("unreadable", str(error)))
        return None
    if book.dropped_self_results:
        recipes = counted(book.dropped_self_results, "recipe")
        findings.append(
            _problem("self-result", f"{recipes} made from the result itself; such rows are dropped")
        )
    if book.merged_duplicates:
        findings.append(
            _problem("duplicate", f"{counted(book.merged_duplicates, 'row')} listed before")
        )
    return book


def _read_table(
    table: Table, name: str, findings: list[Finding], lines_of: dict[Recipe, list[int]]
) -> RecipeBook:
    for row in table:
        line = row[0]
        if len(findings) >= MAX_FINDINGS:
            message = (
                f"{len(findings):,} findings above; this line and those below it were not read"
            )
            findings.append(_problem("row", message, [line]))
            break
        if isinstance(row, Fault):
            findings.append(_problem(row.kind, row.message, [line]))
            continue
        recipe = Recipe.of(*row[1])
        if recipe.is_self_result:
            message = f"'{recipe.result}' is made from itself; such rows are dropped"
            findings.append(_problem("self-result", message, [line]))
        lines_of.setdefault(recipe, []).append(line)
    for recipe, numbers in lines_of.items():
        if len(numbers) > 1 and not recipe.is_self_result:
            findings.append(
                _problem("duplicate", f"{recipe} is listed {len(numbers):,} times", numbers)
            )
    known = {label for recipe in lines_of for label in recipe}.union(table.listed)
    for label, number in (table.base or {}).items():
        if label not in known:
            findings.append(_problem("base", unknown_base(label, known), [number]))
    base = None if table.base is None else known & table.base.keys()
    return RecipeBook.of(name, lines_of, base=base, listed=table.listed)


def _problem(kind: str, message: str, lines: Iterable[int] = ()) -> Finding:
    return Finding(kind, "problem", tuple(lines)[:LISTED], message)


def _note(kind: str, message: str, lines: Iterable[int] = ()) -> Finding:
    return Finding(kind, "note", tuple(lines)[:LISTED], message)


def _at(labels: Iterable[str], line_of: Mapping[str, int]) -> list[int]:
    return sorted({line_of[label] for label in labels if label in line_of})


def _characters(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    for label in graph.entities:
        if "," in label:
            message = f"the label '{label}' contains a comma, at which other tools may split it"
            yield _problem("comma", message, _at([label], line_of))
        if (visible := for_terminal(label)) != label:
            message = (
                f"'{visible}' holds an invisible character; remove it, or replace it by a space"
            )
            yield _note("invisible", message, _at([label], line_of))


def _idle(graph: RecipeGraph, base: tuple[str, ...] | None) -> Iterator[Finding]:
    idle = graph.labels(np.flatnonzero(graph.recipe_counts + graph.use_counts == 0))
    unused = (
        graph.labels(graph.base_ids[graph.use_counts[graph.base_ids] == 0])
        if base is not None
        else ()
    )
    if unused:
        yield _problem("base", f"base entities that no recipe uses: {listed(unused)}")
    others = [label for label in idle if label not in unused]
    if others:
        yield _note("idle", f"listed, but in no recipe: {listed(others)}")


def _spellings(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    for labels in alike_labels(graph.entities):
        message = f"{' and '.join(map(repr, labels))} count as different entities; use one spelling"
        yield _problem("spelling", message, _at(labels, line_of))


def _unreachable(
    graph: RecipeGraph, line_of: Mapping[str, int], lines_of: Mapping[Recipe, list[int]]
) -> Iterator[Finding]:
    import networkx as nx

    idle = graph.recipe_counts + graph.use_counts == 0
    outside = set(np.flatnonzero((layers(graph) < 0) & ~idle).tolist())
    needs = nx.DiGraph()
    needs.add_nodes_from(sorted(outside))
    for a, b, result in graph.recipes.tolist():
        needs.add_edges_from(
            (part, result) for part in (a, b) if part in outside and result in outside
        )
    for island in sorted(nx.weakly_connected_components(needs), key=min):
        labels = graph.labels(sorted(island))
        subject = counted(len(labels), "entity", "entities")
        message = f"{subject} cannot be made from the base ({listed(graph.base)}): {listed(labels)}"
        yield _problem("unreachable", message, _at(labels[:LISTED], line_of))
    for circle in sorted(nx.strongly_connected_components(needs), key=min):
        if len(circle) > 1 and _is_closed(graph, circle):
            labels = graph.labels(sorted(circle))
            lines = sorted(
                number
                for recipe in lines_of
                if recipe.result in labels
                for number in lines_of[recipe]
            )
            message = f"every recipe of these needs another of them, so none can be made first: {listed(labels)}"
            yield _problem("cycle", message, lines)


def _is_closed(graph: RecipeGraph, entities: set[int]) -> bool:
    pairs = (
        pair for entity in entities for pair in graph.recipes[graph.recipes_of(entity), :2].tolist()
    )
    return all(not entities.isdisjoint(pair) for pair in pairs)


def _plurals(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    for label in graph.entities:
        endings = {f"{label}s", f"{label}es"} | (
            {f"{label[:-1]}ies"} if label.endswith("y") else set()
        )
        for plural in sorted(endings):
            if plural in graph:
                message = f"'{label}' and '{plural}' are singular and plural of one word"
                yield _note("plural", message, _at((label, plural), line_of))


def _lonely(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    lonely = graph.labels(np.flatnonzero(graph.recipe_counts + graph.use_counts == 1))
    if lonely:
        message = (
            f"{counted(len(lonely), 'entity', 'entities')} in one recipe only: {listed(lonely)}"
        )
        yield _note("lonely", message, _at(lonely[:LISTED], line_of))


def _statistics(graph: RecipeGraph) -> BookStatistics:
    layer = layers(graph)
    made = graph.recipe_counts[graph.recipe_counts > 0]
    results = np.diff(graph.pair_starts)
    most_used = int(np.argmax(graph.use_counts))
    return BookStatistics(
        entities=graph.num_entities,
        recipes=graph.num_recipes,
        pairs=graph.num_pairs,
        base=graph.base,
        reachable=int(np.sum(layer >= 0)),
        max_layer=max(int(layer.max()), 0),
        mean_recipes_per_craftable=float(made.mean()),
        share_with_two_recipes=float(np.mean(made >= 2)),
        terminal=int(np.sum((graph.use_counts == 0) & (graph.recipe_counts > 0))),
        self_pairs=graph.num_self_pairs,
        pairs_with_two_or_three_results=int(np.sum((results == 2) | (results == 3))),
        pairs_with_more_results=int(np.sum(results > 3)),
        most_used=graph.entities[most_used],
        most_used_share=float(graph.use_counts[most_used] / graph.num_recipes),
    )


def listed(labels: Iterable[str]) -> str:
    """Join the first 15 labels with commas, and count the remaining labels."""
    labels = list(labels)
    more = len(labels) - LISTED
    return ", ".join(labels[:LISTED]) + (f" and {more:,} more" if more > 0 else "")


def _sorted(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple(
        sorted(
            findings,
            key=lambda f: (f.severity != "problem", f.lines[:1] or (0,), f.kind, f.message),
        )
    )
