"""Check a recipe book under construction: list all errors and suspicious entries, with line numbers.

:func:`~wordcraft_kg.graphs.book_files.read_book` stops at the first error and accepts suspicious entries.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np

from wordcraft_kg.base import (
    RecipeFileError,
    Record,
    counted,
    for_terminal,
    listed,
    nearest,
    quoted,
    stage,
)
from wordcraft_kg.graphs.audit import BookFigures, book_figures
from wordcraft_kg.graphs.book_files.cells import OWN_COLUMNS
from wordcraft_kg.graphs.book_files.files import read_bytes
from wordcraft_kg.graphs.book_files.reader import (
    REPEATED,
    SELF_RESULT,
    BookOptions,
    BookRows,
    ReadOptions,
    book_name,
    open_rows,
    unknown_base,
)
from wordcraft_kg.graphs.book_files.rows import WITHOUT, Fault, Place
from wordcraft_kg.graphs.book_files.writing import csv_line
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import (
    HTML_ENTITY,
    NOTHING,
    Reading,
    Recipe,
    RecipeBook,
    alike_labels,
    is_missing,
)

FAULTY = "with a problem"
"""Reason of rows that are no recipe because of a fault."""
LISTED = 15  # lines or names in a finding, at most
MAX_DUPLICATES = 1_000
"""Repeated recipes with a finding of their own; the others share one."""
_VARYING = re.compile(r"'[^']*'|[\d,]+")
"""Parts of a message that differ among faults of one cause."""


class Finding(Record):
    """An error or a suspicious entry in a recipe book.

    Attributes:
        kind: violated rule, such as ``duplicate``.
        severity: a ``problem`` fails the check, a ``note`` does not.
        lines: line numbers from 1, at most 15; empty for a finding about the whole book.
        message: what was found, and what to do.
    """

    kind: str
    severity: Literal["problem", "note"]
    lines: tuple[int, ...]
    message: str


@dataclass(frozen=True)
class BookCheck:
    """The check of a book.

    Attributes:
        findings: problems first, then notes.
        figures: statistics of the readable recipes; None without any.
        graph: graph of the readable recipes; None without any.
        book: the readable recipes, without repetitions and self results; None without any.
        reading: how the file was read; None if its shape is unknown.
        places: first place of each recipe of the file, in the file's order.
        lost: places of the rows that are no recipe of ``book``, by reason; a reason without places
            has only its number in ``reading``.
        records: cells of a table's rows by the names of its columns, by line.
    """

    findings: tuple[Finding, ...]
    figures: BookFigures | None
    graph: RecipeGraph | None
    book: RecipeBook | None = None
    reading: Reading | None = None
    places: Mapping[Recipe, Place] = field(default_factory=dict)
    lost: Mapping[str, Sequence[Place]] = field(default_factory=dict)
    records: Mapping[Place, Mapping[str, str]] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether the book has no problems."""
        return all(finding.severity == "note" for finding in self.findings)


@stage("checking the book")
def check_book(
    path: Path,
    base: Iterable[str] | None = None,
    name: str | None = None,
    **options: Unpack[ReadOptions],
) -> BookCheck:
    """Check a recipe book, and return all problems and notes.

    The file is read to its end, whatever it holds, by the code of
    :func:`~wordcraft_kg.graphs.book_files.read_book`. Equal findings are one finding with all lines.

    Problems are: an encoding other than UTF-8, labels with commas, bad rows, recipes listed twice or made from themselves, labels in two spellings,
    unused base entities, entities out of reach from the base, and circles of entities that need
    each other. Notes are: an inferred base, invisible characters, HTML entities, singular and
    plural forms of a word, rows that are no recipe, and listed entities without a recipe.

    Args:
        path: a file in any readable shape. Only findings in text have line numbers.
        base: base entities; None uses the file's base, or entities without a recipe.
        name: the book's name; None uses the file's name.
        options: what a user says about the file, see
            :class:`~wordcraft_kg.graphs.book_files.BookOptions`.

    Raises:
        RecipeFileError: if the file cannot be read at all. A file whose shape is not readable is a
            finding instead, but not a folder.
        ConfigError: for an option outside its values, or `columns` that the file does not have.
    """
    book_options = BookOptions(**options)
    if not path.is_dir():
        read_bytes(path)  # raises for a missing or unreadable file
    try:
        rows = open_rows(path, book_options)
    except RecipeFileError as error:
        if path.is_dir():
            raise
        return BookCheck((_problem("unreadable", str(error)),), None, None)
    findings: list[Finding] = []
    encoding = rows.content.encoding
    if encoding not in ("", "utf-8"):
        message = f"the encoding is {encoding}; save the file as UTF-8"
        findings.append(_problem("encoding", message))
    lines_of, book = _read_rows(rows, name or book_name(path), findings)
    reading = rows.reading(book.merged_duplicates, book.dropped_self_results, book.entities)
    findings += _left_out_findings(rows)
    if not book.recipes:
        if not any(finding.severity == "problem" for finding in findings):
            findings.append(_problem("empty", "it has no recipe"))
        return BookCheck(_sorted(findings), None, None, None, reading)
    base_labels = book.base if base is None else tuple(base)
    # The check goes on without unknown base entities, so that it finds everything else too.
    known_base = None if base_labels is None else set(base_labels).intersection(book.entities)
    unknown = sorted(set(base_labels or ()).difference(book.entities))
    if unknown:
        hint = nearest(unknown[0], book.entities)
        message = f"base entities that are not in {book.name}: {_listed(unknown)}{hint}"
        findings.append(_problem("base", message))
    graph = RecipeGraph.from_book(book, known_base)
    line_of = _first_lines(lines_of)
    findings += chain(
        _inferred_base(graph),
        _characters(graph, line_of),
        _spellings(graph, line_of),
        _idle(graph, base_labels),
        _unreachable(graph, line_of),
        _plurals(graph, line_of),
    )
    return BookCheck(
        findings=_sorted(findings),
        figures=book_figures(graph),
        graph=graph,
        book=replace(book, base=None if base_labels is None else graph.base, reading=reading),
        reading=reading,
        places={recipe: places[0] for recipe, places in lines_of.items()},
        lost=_lost(rows, lines_of),
        records=rows.source.records,
    )


def _read_rows(
    rows: BookRows, name: str, findings: list[Finding]
) -> tuple[dict[Recipe, list[Place]], RecipeBook]:
    """Read all rows; add findings about faults, self results and repetitions.

    Rows with a fault are left out, and counted as such.

    Returns:
        The places of each recipe, and the book.
    """
    lines_of: dict[Recipe, list[Place]] = {}
    faults: dict[tuple[str, str], list[Fault]] = {}
    for entry in rows:
        if isinstance(entry, Fault):
            # Without the words in quotes and the numbers, faults of one cause have one message.
            group = entry.group or _VARYING.sub("", entry.message)
            faults.setdefault((entry.kind, group), []).append(entry)
        else:
            place, recipe = entry
            lines_of.setdefault(recipe, []).append(place)
    for (kind, _), alike in faults.items():
        first, *further_faults = alike
        suffix = f" ({len(further_faults):,} more like this)" if further_faults else ""
        lines = _numbers(fault.place for fault in alike)
        findings.append(_problem(kind, f"{first.message}{suffix}", lines))
    findings += _repeated(lines_of)
    # As often as in the file: the book counts repetitions.
    every = chain.from_iterable([recipe] * len(places) for recipe, places in lines_of.items())
    book = RecipeBook.of(name, every, listed=rows.listed)
    known_labels = set(book.entities)
    for label, place in (rows.base or {}).items():
        if label not in known_labels:
            message = unknown_base(label, known_labels)
            findings.append(_problem("base", message, _numbers([place])))
    faulty = [fault.place for fault in chain(*faults.values()) if fault.kind != "directive"]
    if faulty:
        rows.left_out[FAULTY] = faulty
    base = None if rows.base is None else tuple(sorted(known_labels & rows.base.keys()))
    return lines_of, rows.with_facts(replace(book, base=base))


def _left_out_findings(rows: BookRows) -> Iterator[Finding]:
    """Yield findings about rows that are no recipe; those with a fault have findings already."""
    for reason, places in rows.left_out.items():
        lines = _numbers(places)
        message = f"{counted(len(places), 'row')} {reason}"
        # In a table or lines such a row is a slip; in JSON it is a thing without a recipe.
        if reason == WITHOUT and lines:
            yield _problem("row", message, lines)
        elif reason != FAULTY:
            yield _note("left-out", message)


def _lost(rows: BookRows, lines_of: Mapping[Recipe, Sequence[Place]]) -> dict[str, list[Place]]:
    """Return the places of all rows that are no recipe of the book, by reason."""
    lost = defaultdict[str, list[Place]](list, rows.left_out)
    for recipe, places in lines_of.items():
        if recipe.is_self_result:
            lost[SELF_RESULT] += places
        else:
            lost[REPEATED] += places[1:]
    return {reason: places for reason, places in lost.items() if places}


def _inferred_base(graph: RecipeGraph) -> Iterator[Finding]:
    if graph.base_is_inferred and graph.base:
        entities = counted(len(graph.base), "entity", "entities")
        yield _note(
            "base",
            f"no base is named, so the base is the {entities} without a recipe. Name the base: "
            f"# base: {csv_line(graph.base, ',').strip()}",
        )


def _repeated(lines_of: Mapping[Recipe, Sequence[Place]]) -> Iterator[Finding]:
    """Yield findings about self results, in one, and about recipes that are listed twice."""
    selves = [recipe for recipe in lines_of if recipe.is_self_result]
    duplicates = (recipe for recipe, places in lines_of.items() if len(places) > 1)
    twice = [recipe for recipe in duplicates if not recipe.is_self_result]
    if selves:
        subject = (
            f"'{selves[0].result}' is made from itself"
            if len(selves) == 1
            else f"{len(selves):,} recipes make one of their ingredients, such as {selves[0]}"
        )
        lines = _lines_of(lines_of, selves)
        yield _problem("self-result", f"{subject}; such rows are dropped", lines)
    for recipe in twice[:MAX_DUPLICATES]:
        places = lines_of[recipe]
        message = f"{recipe} is listed {len(places):,} times"
        # Places in JSON have no line number, so the message names them.
        json_places = [place for place in places[:LISTED] if isinstance(place, str)]
        if json_places:
            message = f"{message}: {', '.join(json_places)}"
        yield _problem("duplicate", message, _numbers(places))
    unlisted_recipes = twice[MAX_DUPLICATES:]
    if unlisted_recipes:
        message = f"{len(unlisted_recipes):,} more recipes are listed more than once"
        yield _problem("duplicate", message, _lines_of(lines_of, unlisted_recipes))


def _lines_of(lines_of: Mapping[Any, Sequence[Place]], keys: Iterable[Any]) -> list[int]:
    """Return the line numbers of recipes or labels, as many as a finding shows."""
    return _numbers(chain.from_iterable(lines_of.get(key, ()) for key in keys))


def _numbers(places: Iterable[Place]) -> list[int]:
    """Return the line numbers among places, ascending, as many as a finding shows."""
    numbers = (place for place in places if isinstance(place, int))
    return sorted(islice(numbers, LISTED))


def _first_lines(lines_of: Mapping[Recipe, Sequence[Place]]) -> dict[str, int]:
    """Return the first line of each label."""
    line_of: dict[str, int] = {}
    for recipe, places in lines_of.items():
        first = places[0]
        if isinstance(first, int):
            for label in recipe:
                line_of[label] = min(line_of.get(label, first), first)
    return line_of


def _problem(kind: str, message: str, lines: Iterable[int] = ()) -> Finding:
    return Finding(kind, "problem", tuple(lines)[:LISTED], message)


def _note(kind: str, message: str, lines: Iterable[int] = ()) -> Finding:
    return Finding(kind, "note", tuple(lines)[:LISTED], message)


def _at(labels: Iterable[str], line_of: Mapping[str, int]) -> list[int]:
    """Return the first lines of labels, ascending, each once; JSON has none."""
    return sorted({line_of[label] for label in labels if label in line_of})


def _characters(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    """Yield findings about single labels."""
    for label in graph.entities:
        visible = for_terminal(label)
        has_entity = "&" in label and HTML_ENTITY.search(label) is not None
        is_padded = label != label.strip()
        marks = (
            (has_entity, _note, "html", "holds an HTML entity; write the character itself"),
            (" + " in label, _note, "several", f"is one entity here. {OWN_COLUMNS}"),
            (is_missing(label), _note, "missing", "may be a missing value; leave the cell empty"),
            (label == NOTHING, _note, "nothing", "in Infinite Craft means no result"),
            (visible != label, _note, "invisible", "holds an invisible character; remove it"),
            (is_padded, _problem, "space", "begins or ends with a space; remove it"),
            (
                "," in label,
                _problem,
                "comma",
                "contains a comma, at which other tools may split it",
            ),
        )
        for is_odd, finding, kind, message in marks:
            if is_odd:
                yield finding(kind, f"the label '{visible}' {message}", _at([label], line_of))


def _idle(graph: RecipeGraph, base: tuple[str, ...] | None) -> Iterator[Finding]:
    num_recipes = graph.recipe_counts + graph.use_counts
    idle = graph.labels(np.flatnonzero(num_recipes == 0))
    is_unused = graph.use_counts[graph.base_ids] == 0
    unused = () if base is None else graph.labels(graph.base_ids[is_unused])
    if unused:
        yield _problem("base", f"base entities that no recipe uses: {_listed(unused)}")
    idle_labels = [label for label in idle if label not in unused]
    if idle_labels:
        yield _note("idle", f"listed, but in no recipe: {_listed(idle_labels)}")


def _spellings(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    for labels in alike_labels(graph.entities):
        names = " and ".join(map(repr, labels))
        yield _problem(
            "spelling",
            f"{names} count as different entities; if they are the same thing, use one spelling",
            _at(labels, line_of),
        )


def _unreachable(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    if not graph.base:
        message = (
            "no entity lacks a recipe, so no base can be inferred and nothing can be made. Name the "
            "base: # base: a, b in the book, or build-graph --base a,b"
        )
        yield _problem("unreachable", message)
        return
    import networkx as nx

    is_idle = graph.recipe_counts + graph.use_counts == 0
    is_outside = (layers(graph) < 0) & ~is_idle
    labels = graph.labels(np.flatnonzero(is_outside))
    if labels:
        subject = counted(len(labels), "entity", "entities")
        message = (
            f"{subject} cannot be made from the base ({_listed(graph.base)}): {_listed(labels)}"
        )
        yield _problem("unreachable", message, _at(labels[:LISTED], line_of))
    # An arrow from each ingredient to what it makes; those within reach have no arrow to them.
    makes = nx.DiGraph(
        (ingredient, result)
        for *ingredients, result in graph.sets[is_outside[graph.sets[:, -1]]].tolist()
        for ingredient in ingredients
    )
    for circle in sorted(nx.strongly_connected_components(makes), key=min):
        # Else they wait for something else, which is out of reach, too.
        if len(circle) > 1 and all(
            not circle.isdisjoint(graph.sets[row, :-1].tolist())
            for entity in circle
            for row in graph.recipes_of(entity)
        ):
            labels = graph.labels(sorted(circle))
            yield _problem(
                "cycle",
                "every recipe of these needs another of them, so none can be made first: "
                f"{_listed(labels)}",
                _at(labels[:LISTED], line_of),
            )


def _plurals(graph: RecipeGraph, line_of: Mapping[str, int]) -> Iterator[Finding]:
    for label in graph.entities:
        plurals = [f"{label}es", f"{label}s"]
        if label.endswith("y"):
            plurals.append(f"{label[:-1]}ies")
        for plural in sorted(plurals):
            if plural in graph:
                yield _note(
                    "plural",
                    f"'{label}' and '{plural}' are singular and plural of one word",
                    _at((label, plural), line_of),
                )


def _listed(labels: Iterable[str]) -> str:
    """Return the first 15 labels, in quotes if they hold a comma, and the number of all others."""
    return listed([*map(quoted, labels)], most=LISTED)


def _sorted(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings with problems first, then by line."""

    def order(finding: Finding) -> tuple[bool, tuple[int, ...], str, str]:
        is_note = finding.severity != "problem"
        # A finding without lines is about the whole book, and goes first.
        return is_note, finding.lines[:1] or (0,), finding.kind, finding.message

    return tuple(sorted(findings, key=order))
