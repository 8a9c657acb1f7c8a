"""Checking a recipe book while it is written: everything that is wrong or odd in one go, with lines.

Reading a book (:func:`~wordcraft_kg.graphs.recipes.read_book`) stops at the first thing that is wrong and accepts what
is merely odd; this goes on, and never changes the file.
"""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from wordcraft_kg.errors import GraphError, RecipeFileError, UnknownEntityError
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import (
    CSV_HEADER,
    Recipe,
    RecipeBook,
    check_label,
    read_book,
    read_bytes,
    read_directive,
)

LISTED = 15
"""How many lines or names a finding lists."""
SIMILAR_FROM = 6
"""Characters from which labels that differ by one letter are listed; shorter ones do so by chance (cat, bat)."""


@dataclass(frozen=True)
class Finding:
    """One thing to look at.

    Attributes:
        kind: name of the rule, such as ``duplicate``.
        severity: a ``problem`` makes the check fail, a ``note`` does not.
        lines: where, from 1; at most 15 of them, and none where the book as a whole is meant.
        message: what was found.
    """

    kind: str
    severity: Literal["problem", "note"]
    lines: tuple[int, ...]
    message: str


@dataclass(frozen=True)
class BookCheck:
    """Result of a check.

    Attributes:
        findings: problems first, each group by line.
        figures: counts of the book; empty if no recipe could be read.
        graph: of the recipes that could be read; None if there is none.
    """

    findings: tuple[Finding, ...]
    figures: Mapping[str, Any]
    graph: RecipeGraph | None

    @property
    def passed(self) -> bool:
        """Whether there is no problem."""
        return all(finding.severity == "note" for finding in self.findings)

    def adding(self, findings: Iterable[Finding], figures: Mapping[str, Any]) -> "BookCheck":
        """Return this check with more findings and figures."""
        return replace(self, findings=_sorted([*self.findings, *findings]), figures={**self.figures, **figures})


def check_book(path: Path, base: Iterable[str] | None = None) -> BookCheck:
    """Check a recipe book.

    Problems are: a byte order mark, line ends other than LF, a label with a comma, rows that are not recipes, recipes
    listed twice or made from themselves, one label in two spellings, entities that cannot be made from the base, and
    circles of entities that need each other. Notes are: singular and plural of one word, long labels that differ by one
    letter, and entities that stand in one recipe only.

    Args:
        path: a ``.csv``, ``.tsv`` or ``.json`` book. Lines are known for tables only; of a JSON book that cannot be
            read, the first error is the only finding.
        base: base entities; None takes the book's own, or infers them.

    Raises:
        RecipeFileError: if the file cannot be read as text.
    """
    findings: list[Finding] = []
    book: RecipeBook | None
    lines_of: dict[Recipe, list[int]] = {}
    if path.suffix.lower() in (".csv", ".tsv", ".tab"):
        book, lines_of = _read_table(path, findings)
    else:
        book = _read_other(path, findings)
    if book is None or not book.recipes:
        if not findings:
            findings.append(Finding("empty", "problem", (), "there is no recipe in it"))
        return BookCheck(_sorted(findings), {}, None)
    try:
        graph = RecipeGraph.from_book(book, base)
    except (GraphError, UnknownEntityError) as error:
        findings.append(Finding("base", "problem", (), str(error)))
        graph = RecipeGraph.from_book(replace(book, base=None))
    line_of: dict[str, int] = {}
    for recipe, numbers in lines_of.items():
        for label in recipe:
            line_of[label] = min(line_of.get(label, numbers[0]), numbers[0])
    findings += [*_spellings(graph, line_of), *_unreachable(graph, line_of), *_twins(graph, line_of)]
    findings += [*_unused_base(graph), *_lonely(graph, line_of)]
    return BookCheck(_sorted(findings), _figures(graph, book), graph)


def _read_other(path: Path, findings: list[Finding]) -> RecipeBook | None:
    read_bytes(path)  # a file that is not there is an error, not a finding
    try:
        book = read_book(path)
    except RecipeFileError as error:
        findings.append(Finding("unreadable", "problem", (), str(error)))
        return None
    if book.dropped_self_results:
        message = f"{book.dropped_self_results} recipes make one of their own ingredients; they are dropped"
        findings.append(Finding("self-result", "problem", (), message))
    if book.merged_duplicates:
        findings.append(Finding("duplicate", "problem", (), f"{book.merged_duplicates} recipes are listed twice"))
    return book


def _read_table(path: Path, findings: list[Finding]) -> tuple[RecipeBook, dict[Recipe, list[int]]]:
    """Read what can be read, with a finding for each line that cannot."""
    data = read_bytes(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise RecipeFileError(f"{path}, line {line}: not UTF-8. Save it as UTF-8.") from None
    if data.startswith(b"\xef\xbb\xbf"):
        findings.append(Finding("bom", "problem", (1,), "the file starts with a byte order mark; save it without one"))
    returns = [number for number, line in enumerate(data.split(b"\n"), start=1) if b"\r" in line]
    if returns:
        message = f"{len(returns)} line{'s' * (len(returns) > 1)} with a carriage return (CRLF or CR); end lines in LF"
        findings.append(Finding("line-ends", "problem", tuple(returns[:LISTED]), message))
    declared: dict[str, list[str]] = {}
    lines_of: dict[Recipe, list[int]] = {}
    for number, cells in _rows(text, path, declared, findings):
        try:
            recipe = Recipe.of(*(check_label(cell, "") for cell in cells))
        except RecipeFileError as error:
            findings.append(Finding("label", "problem", (number,), str(error).removeprefix(": ")))
            continue
        for cell in cells:
            if "," in cell:
                message = f"the label '{cell}' holds a comma, which other tools may split"
                findings.append(Finding("comma", "problem", (number,), message))
        if recipe.is_self_result:
            message = f"'{recipe.result}' is made from itself; such rows are dropped"
            findings.append(Finding("self-result", "problem", (number,), message))
        lines_of.setdefault(recipe, []).append(number)
    for recipe, numbers in lines_of.items():
        if len(numbers) > 1 and not recipe.is_self_result:
            message = f"{recipe.ingredient_a} + {recipe.ingredient_b} -> {recipe.result} is listed {len(numbers)} times"
            findings.append(Finding("duplicate", "problem", tuple(numbers[:LISTED]), message))
    idle = declared.get("entities", ())
    return RecipeBook.of(path.stem, lines_of, base=declared.get("base"), listed=idle), lines_of


def _rows(
    text: str, path: Path, declared: dict[str, list[str]], findings: list[Finding]
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of three cells with their lines; fill ``declared`` from the directives above the header."""
    delimiter = "," if path.suffix.lower() == ".csv" else "\t"
    expected = delimiter.join(CSV_HEADER)
    header_seen = False
    for number, line in enumerate(io.StringIO(text), start=1):
        line = line.rstrip("\n")
        if not header_seen and line.startswith("#"):
            try:
                directive = read_directive(line, "")
            except RecipeFileError as error:
                findings.append(Finding("directive", "problem", (number,), str(error).removeprefix(": ")))
                continue
            if directive is not None:
                declared.setdefault(directive[0], []).extend(directive[1])
            continue
        if not line.strip():
            continue
        try:
            (cells,) = csv.reader([line], delimiter=delimiter, strict=True)
        except csv.Error as error:
            findings.append(Finding("row", "problem", (number,), f"not a row of cells: {error}"))
            continue
        if not header_seen:
            header_seen = True
            if tuple(cell.strip() for cell in cells) == CSV_HEADER:
                continue
            findings.append(Finding("header", "problem", (number,), f"expected the header {expected!r}"))
        if len(cells) == 3:
            yield number, cells
        else:
            message = f"{len(cells)} cell{'s' * (len(cells) != 1)}; a recipe has two ingredients and a result"
            findings.append(Finding("row", "problem", (number,), message))


def _at(labels: Iterable[str], line_of: Mapping[str, int]) -> tuple[int, ...]:
    return tuple(sorted({line_of[label] for label in labels if label in line_of})[:LISTED])


def _unused_base(graph: RecipeGraph) -> Iterator[Finding]:
    unused = graph.labels(graph.base_ids[graph.use_counts[graph.base_ids] == 0])
    if unused:
        yield Finding("base", "problem", (), f"base entities that no recipe uses: {listed(unused)}")


def _spellings(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    """Labels that are the same but for case, spaces and punctuation."""
    groups: dict[str, list[str]] = {}
    for label in graph.entities:
        groups.setdefault("".join(filter(str.isalnum, label.casefold())) or label, []).append(label)
    for labels in groups.values():
        if len(labels) > 1:
            message = f"{' and '.join(map(repr, labels))} count as different entities; use one spelling"
            yield Finding("spelling", "problem", _at(labels, line_of), message)


def _unreachable(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    """What cannot be made from the base, island by island, and the circles that nothing from the base starts."""
    import networkx as nx

    outside = set(np.flatnonzero(layers(graph) < 0).tolist())
    needs = nx.DiGraph()
    needs.add_nodes_from(sorted(outside))
    for a, b, result in graph.recipes.tolist():
        needs.add_edges_from((part, result) for part in (a, b) if part in outside and result in outside)
    for island in sorted(nx.weakly_connected_components(needs), key=min):
        labels = graph.labels(sorted(island))
        subject = f"{len(labels)} entities" if len(labels) > 1 else "1 entity"
        message = f"{subject} cannot be made from the base ({listed(graph.base)}): {listed(labels)}"
        yield Finding("unreachable", "problem", _at(labels, line_of), message)
    for circle in sorted(nx.strongly_connected_components(needs), key=min):
        if len(circle) > 1:
            labels = graph.labels(sorted(circle))
            message = f"need each other, and nothing from the base starts them: {listed(labels)}"
            yield Finding("cycle", "problem", _at(labels, line_of), message)


def _twins(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    """Singular and plural of one word, and longer labels that are one edit apart."""
    known = set(graph.entities)
    plurals = set()
    for label in graph.entities:
        for plural in (f"{label}s", f"{label}es", f"{label[:-1]}ies" if label.endswith("y") else label):
            if plural in known and plural != label:
                plurals.add((label, plural))
                message = f"'{label}' and '{plural}' are singular and plural of one word"
                yield Finding("plural", "note", _at((label, plural), line_of), message)
    # Two labels one edit apart leave the same text when one letter is taken from one or both of them.
    left: dict[str, set[str]] = {}
    for label in graph.entities:
        if len(label) >= SIMILAR_FROM:
            for rest in {label, *(label[:i] + label[i + 1 :] for i in range(len(label)))}:
                left.setdefault(rest, set()).add(label)
    pairs = {(one, other) for labels in left.values() for one in labels for other in labels if one < other}
    for one, other in sorted(pairs - plurals):
        if abs(len(one) - len(other)) <= 1 and _one_edit_apart(one, other):
            message = f"'{one}' and '{other}' differ by one letter"
            yield Finding("similar", "note", _at((one, other), line_of), message)


def _one_edit_apart(one: str, other: str) -> bool:
    same = 0
    while same < min(len(one), len(other)) and one[same] == other[same]:
        same += 1
    return any(one[same + i :] == other[same + j :] for i, j in ((1, 1), (1, 0), (0, 1)))


def _lonely(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    lonely = graph.labels(np.flatnonzero(graph.recipe_counts + graph.use_counts == 1))
    if lonely:
        message = f"{len(lonely)} entities stand in one recipe only: {listed(lonely)}"
        yield Finding("lonely", "note", _at(lonely, line_of), message)


def _figures(graph: RecipeGraph, book: RecipeBook) -> dict[str, Any]:
    layer = layers(graph)
    made = graph.recipe_counts[graph.recipe_counts > 0]
    results = np.diff(graph.pair_starts)
    firsts = graph.recipes[graph.pair_starts[:-1]]
    most_used = int(np.argmax(graph.use_counts))
    return {
        "entities": graph.num_entities,
        "recipes": graph.num_recipes,
        "pairs": graph.num_pairs,
        "base": list(graph.base),
        "reachable": int(np.sum(layer >= 0)),
        "max_layer": int(layer.max()),
        "mean_recipes_per_craftable": float(made.mean()),
        "share_with_two_recipes": float(np.mean(made >= 2)),
        "terminal": int(np.sum((graph.use_counts == 0) & (graph.recipe_counts > 0))),
        "self_pairs": int(np.sum(firsts[:, 0] == firsts[:, 1])),
        "pairs_with_two_or_three_results": int(np.sum((results == 2) | (results == 3))),
        "pairs_with_more_results": int(np.sum(results > 3)),
        "most_used": graph.entities[most_used],
        "most_used_share": float(graph.use_counts[most_used] / graph.num_recipes),
    }


def listed(labels: Iterable[str]) -> str:
    """Join labels with commas, the first 15 of them."""
    labels = list(labels)
    more = len(labels) - LISTED
    return ", ".join(labels[:LISTED]) + (f" and {more} more" if more > 0 else "")


def _sorted(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(findings, key=lambda f: (f.severity != "problem", f.lines[:1] or (0,), f.kind, f.message)))
