"""The rule by which a way to read a file is taken, or the file refused with all ways as commands.

A reading is taken if its keys are documented words, and its book hangs together: results are
ingredients elsewhere. Of 22 right readings of public files 20 reuse at least .08 of their results,
of 12 wrong ones 11 at most .04. A book of few results may reuse none; it must have no second
reading that does. A reading that the user names is taken at their word.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.cells import FileLabels, is_number, odd_label
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, Row, refusal
from wordcraft_kg.graphs.book_files.words import Way, is_name, words_of
from wordcraft_kg.graphs.recipes import Reading

ELEMENTS = words_of(
    "water fire earth air wind eau feu terre vent agua fuego tierra aire viento wasser feuer erde "
    "luft acqua fuoco terra aria água fogo ar вода огонь земля воздух 水 火 土 地 風 空気"
)
"""The elements with which many worlds begin, in lower case; they are seldom made."""
LEAST_REUSED = 0.05
"""Share of the results that must be ingredients of other recipes."""
FEWEST_RESULTS = 20
"""Results of the smallest book that the share judges."""
_FEWEST_NAMES = 5  # if they are names of rows beside other columns
_LIKE = 0.5  # share of the rows by which two readings are one
_MOST_READINGS = 4  # in a refusal
_NAME_COLUMNS = "Name the ingredients and, last, the result with --columns."
_FEWEST_ELEMENTS = 2  # one alone, such as water, is a usual thing to make
_FEWEST_ROWS = 50
_MARGIN = 0.1
_REUSED = 0.2
"""Without a header: rows needed, by how much the share of different pairs must be larger, and the
share of results that are ingredients.

On whole books the right reading has .95 to 1 different pairs, the two others .62 to .70 (kitchen,
everyday, Little Alchemy 2, 60,000 rows of Infinite Craft); on 20 rows all three have .85 to 1.
"""


def share_of_reused(recipes: Iterable[tuple[Iterable[str], str]]) -> float:
    """Return the share of the results that are ingredients of other recipes.

    Args:
        recipes: ingredients and result of each.
    """
    recipes = list(recipes)
    results = {result for _, result in recipes}
    reused_labels = {part for parts, result in recipes for part in parts if part != result}
    return len(results & reused_labels) / max(len(results), 1)


@dataclass
class ReadingCandidate:
    """The recipes of a file by one way to read it.

    Attributes:
        way: the paths of its ingredients and results.
        reading: the record of this reading, with these paths as text in ``columns``.
        entries: recipes, faults and rows left out.
        texts: the labels of its texts.
        fold: whether labels will be in lower case.
    """

    way: Way
    reading: Reading
    entries: Sequence[Entry]
    texts: FileLabels
    fold: bool

    @cached_property
    def rows(self) -> list[Row]:
        """The recipes."""
        return [entry for entry in self.entries if isinstance(entry, Row)]

    @cached_property
    def recipes(self) -> set[tuple[frozenset[str], str]]:
        """The recipes without places and order."""
        label_of = str.lower if self.fold else str
        return {
            (frozenset(map(label_of, row.ingredients)), label_of(row.result)) for row in self.rows
        }

    @cached_property
    def results(self) -> set[str]:
        """The different results."""
        return {result for _, result in self.recipes}

    @cached_property
    def share(self) -> float:
        """Share of the results that are ingredients of other recipes."""
        return share_of_reused(self.recipes)

    @property
    def hangs_together(self) -> bool:
        """Whether enough results are ingredients of other recipes."""
        return self.share > LEAST_REUSED

    @cached_property
    def contradictions(self) -> int:
        """Number of recipes that make an element or a part of themselves, or share their pair."""
        elements = {label for label in self.labels if label.casefold() in ELEMENTS}
        if len(elements) < _FEWEST_ELEMENTS:
            elements = set()
        odd = sum(result in elements or result in parts for parts, result in self.recipes)
        return odd + len(self.recipes) - len({parts for parts, _ in self.recipes})

    @cached_property
    def labels(self) -> set[str]:
        """All labels of its recipes."""
        return {label for parts, result in self.recipes for label in (*parts, result)}

    @property
    def is_mostly_single(self) -> bool:
        """Whether most rows have one ingredient, as a list of ingredients read row by row has."""
        return sum(len(row.ingredients) == 1 for row in self.rows) * 2 > len(self.rows)

    @cached_property
    def is_clean(self) -> bool:
        """Whether each entry can be read, so that the reading may be advised."""
        texts = [label for row in self.rows for label in (row.ingredients[-1], row.result)]
        are_numbers = 2 * sum(map(is_number, texts)) > len(self.rows)
        has_faults = any(isinstance(entry, Fault) for entry in self.entries)
        if not self.rows or has_faults or are_numbers or odd_label(self.rows):
            return False
        return len(self.way.results) == 1 and not self.is_mostly_single

    @property
    def command(self) -> str:
        """The options that read the file so."""
        return f"--columns '{','.join(self.reading.columns)}'"

    def __str__(self) -> str:
        first = self.rows[0]
        parts = " + ".join(label[:40] for label in first.ingredients[:8])
        return f"{parts} = {first.result[:40]} ({self.command})"

    def is_rival_of(self, best: "ReadingCandidate") -> bool:
        """Return whether a reading fits about as well as the best one of documented words."""
        if self.way.is_documented:
            return self.share > max(best.share * _LIKE, LEAST_REUSED)
        # Another order of the same labels, if that is less odd.
        are_same_labels = len(self.results & best.labels) * 2 > len(self.results)
        if are_same_labels and self.contradictions < best.contradictions:
            return True
        is_better = self.hangs_together and not best.hangs_together
        return is_better and self.contradictions <= best.contradictions

    def is_damaged_rival_of(self, best: "ReadingCandidate") -> bool:
        """Return whether other results of the same ingredients may be right, but have faults."""
        if not self.texts.faults or self.way.parts != best.way.parts or self is best:
            return False
        num_faults = sum(isinstance(entry, Fault) for entry in self.entries)
        has_name = self.way.is_named or is_name(self.way.results[0][-1][1:])
        is_fault_of_form = has_name and num_faults > len(self.rows)
        return is_fault_of_form or (not self.is_like(best) and self.is_rival_of(best))

    def is_like(self, other: "ReadingCandidate") -> bool:
        """Return whether two readings share most of their recipes."""
        smaller = min(len(self.recipes), len(other.recipes))
        return len(self.recipes & other.recipes) >= _LIKE * smaller


def choose(
    path: Path,
    candidates: Sequence[ReadingCandidate],
    guesses: Iterable[ReadingCandidate],
    anchor: str,
    *,
    allows_single: bool = False,
) -> ReadingCandidate | None:
    """Return the one reading of a file that the rule takes.

    Args:
        path: the file, for errors.
        candidates: readings by documented words and shapes, the more certain ones first.
        guesses: further readings, for refusals; iterated only if no named reading is certain.
        anchor: section of the guide for the file's shape.
        allows_single: whether the user says what a single ingredient means.

    Returns:
        The reading; None if no reading with documented words has a recipe.

    Raises:
        RecipeFileError: if several readings remain, or the only one does not hang together; with
            the commands that read the file.
    """
    documented = [reading for reading in candidates if reading.rows]
    named_readings = [reading for reading in documented if reading.way.is_named] or documented
    # Equal shares leave the more certain reading in front.
    best = max(named_readings, key=attrgetter("share"), default=None)
    if best and best.way.is_named and best.hangs_together:
        further_readings = []
    else:
        further_readings = [reading for reading in guesses if reading.rows]
    if best is None:
        told_order = _told_order([reading for reading in further_readings if reading.way.is_order])
        return told_order or _undocumented(path, candidates, further_readings, anchor)
    # Of two readings of the same recipes, the one that lacks none; of equal ones the best.
    alike = [best, *(reading for reading in documented if reading.is_like(best))]
    best = max(alike, key=lambda reading: len(reading.recipes))
    # Another column of results, whose cells have to be mended first, may be the right one.
    damaged = [reading for reading in candidates if reading.is_damaged_rival_of(best)]
    if damaged:
        return damaged[0]
    rivals = [
        reading
        for reading in (*documented, *further_readings)
        if not reading.is_like(best) and reading.is_clean and reading.is_rival_of(best)
    ]
    if best.is_mostly_single and not allows_single:
        problem = (
            f"read as {_shown(best)}, most rows have one ingredient: they may be parts of recipes"
        )
        raise _several(path, problem, rivals, anchor)
    if best.hangs_together and rivals:
        readings = [best, *rivals] if best.is_clean else rivals
        raise _several(path, "two readings fit", readings, anchor)
    # Names of rows may be no results if another key may hold the results.
    is_unsure = not best.way.is_named and bool(best.reading.ignored)
    fewest_results = _FEWEST_NAMES if is_unsure else FEWEST_RESULTS
    if not best.hangs_together and (rivals or len(best.results) >= fewest_results):
        raise _loose(path, best, rivals, anchor)
    return best


def _undocumented(
    path: Path,
    candidates: Iterable[ReadingCandidate],
    readable: Iterable[ReadingCandidate],
    anchor: str,
) -> ReadingCandidate | None:
    """Refuse a file without documented words, with the readings that hang together.

    Args:
        path: the file.
        candidates: readings by documented words.
        readable: all readings with recipes.
        anchor: see :func:`choose`.

    Returns:
        A reading whose faults say what is wrong; None without one.
    """
    clean = [reading for reading in readable if reading.is_clean]
    ways = [
        reading
        for reading in clean
        if replace(reading, fold=True).share > max(LEAST_REUSED, 1 / len(reading.results))
    ]
    # The columns of a small table without a header may be in any order.
    ways = ways or [reading for reading in clean if reading.way.is_order]
    if not ways:
        faulty = (
            reading
            for reading in candidates
            if any(isinstance(entry, Row | Fault) for entry in reading.entries)
        )
        return next(faulty, None)
    # Of several orders of the same labels, the least odd ones.
    min_contradictions = min(reading.contradictions for reading in ways)
    ways = [reading for reading in ways if reading.contradictions == min_contradictions]
    raise _several(
        path, "no key or column is a documented word for a result and its ingredients", ways, anchor
    )


def _loose(
    path: Path, best: ReadingCandidate, rivals: Sequence[ReadingCandidate], anchor: str
) -> RecipeFileError:
    """Return the error for a book that does not hang together."""
    num_results = len(best.results)
    problem = (
        f"read as {_shown(best)}, {best.share * num_results:.0f} of {num_results:,} results are "
        "ingredients of other recipes, so that this reading may be wrong"
    )
    if replace(best, fold=True).hangs_together:
        return refusal(path, problem, anchor, "Labels differ in case only: --case fold joins them.")
    remedy = _NAME_COLUMNS
    if best.way.is_named and best.is_clean:
        remedy = f"If it is right, as in chemistry or cooking, say so: {best.command}."
    return _several(path, problem, rivals, anchor, remedy)


def _shown(candidate: ReadingCandidate) -> str:
    num_parts = len(candidate.way.parts)
    columns = candidate.reading.columns
    return f"{' + '.join(columns[:num_parts])} = {', '.join(columns[num_parts:])}"


def _several(
    path: Path,
    problem: str,
    readings: Sequence[ReadingCandidate],
    anchor: str,
    remedy: str = _NAME_COLUMNS,
) -> RecipeFileError:
    """Return the error with the commands of several readings, or a remedy without any."""
    if not readings:
        return refusal(path, problem, anchor, remedy)
    texts = list(dict.fromkeys(map(str, readings)))
    shown = " or ".join(texts[:_MOST_READINGS])
    return refusal(path, f"{problem}: {shown}", anchor, "Choose with --columns.")


def _told_order(orders: Sequence[ReadingCandidate]) -> ReadingCandidate | None:
    """Return which of three orders of the same columns the labels tell; None if they do not.

    The right one has the fewest pairs that make several things.
    """
    if len(orders) != 3 or min(len(candidate.recipes) for candidate in orders) < _FEWEST_ROWS:
        return None

    def share_of_pairs(order: ReadingCandidate) -> float:
        return len({parts for parts, _ in order.recipes}) / len(order.recipes)

    *_, second, best = sorted(orders, key=share_of_pairs)
    is_clear = share_of_pairs(best) - share_of_pairs(second) >= _MARGIN
    # Where a pair makes several things, a column of machines looks like one of results.
    return best if is_clear and best.share >= _REUSED else None
