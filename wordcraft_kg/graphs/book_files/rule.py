"""The rule by which a way to read a file is taken, or the file refused with the ways as commands.

A reading is taken if its keys are documented words, and its book hangs together: results are
ingredients elsewhere. Of 22 right readings of public files 20 reuse at least .08 of their results,
of 12 wrong ones 11 at most .04. A book of few results may reuse none, if no other column may hold
the results. A reading that the user names is taken at their word.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.cells import is_number, odd_label
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
_LIKE = 0.5  # share of the rows by which two readings are one
_MOST_READINGS = 4  # in a refusal
_NAME_COLUMNS = (
    "Name the ingredients and, last, the result with --columns, by numbers from 1 in a table "
    "without a header."
)
_FEWEST_ELEMENTS = 2  # one alone, such as water, is a usual thing to make


@dataclass
class ReadingCandidate:
    """The recipes of a file by one way to read it.

    Attributes:
        way: the paths of its ingredients and results.
        reading: the record of this reading, with these paths as text in ``columns``.
        entries: recipes, faults and rows left out.
        names_ingredients_elsewhere: whether a column that is ignored holds labels of ingredients,
            so that it may have the results, or names of the same things.
        fold: whether labels will be in lower case.
    """

    way: Way
    reading: Reading
    entries: Sequence[Entry]
    names_ingredients_elsewhere: bool
    fold: bool

    @cached_property
    def rows(self) -> list[Row]:
        """The recipes."""
        return [entry for entry in self.entries if isinstance(entry, Row)]

    @cached_property
    def num_faults(self) -> int:
        """Number of entries that cannot be read."""
        return sum(isinstance(entry, Fault) for entry in self.entries)

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
        reused_labels = {part for parts, result in self.recipes for part in parts if part != result}
        return len(self.results & reused_labels) / max(len(self.results), 1)

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
        if not self.rows or self.num_faults or are_numbers or odd_label(self.rows):
            return False
        return len(self.way.results) == 1 and not self.is_mostly_single

    def __str__(self) -> str:
        first = self.rows[0]
        parts = " + ".join(label[:40] for label in first.ingredients[:8])
        return f"{parts} = {first.result[:40]} (--columns '{','.join(self.reading.columns)}')"

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

    @property
    def has_damaged_names(self) -> bool:
        """Whether its results are in a column of names, most cells of which have faults."""
        has_name = self.way.is_named or is_name(self.way.results[0][-1][1:])
        return has_name and self.num_faults > len(self.rows)

    def is_like(self, other: "ReadingCandidate") -> bool:
        """Return whether two readings share most of their recipes."""
        smaller = min(len(self.recipes), len(other.recipes))
        return len(self.recipes & other.recipes) >= _LIKE * smaller


def choose(
    path: Path,
    candidates: Sequence[ReadingCandidate],
    anchor: str,
    columns: str,
    *,
    allows_single: bool = False,
) -> ReadingCandidate:
    """Return the one reading of a file that the rule takes.

    Args:
        path: the file, for errors.
        candidates: readings by documented words and shapes, the more certain ones first, and
            guesses, which only refuse them.
        anchor: section of the guide for the file's shape.
        columns: words about the columns that the file has.
        allows_single: whether the user says what a single ingredient means.

    Returns:
        The reading, or one whose faults say what is wrong.

    Raises:
        RecipeFileError: if no documented words name ingredients and results, several readings
            remain, or the only one does not hang together; with the commands that read the file.
    """
    readings = [reading for reading in candidates if reading.rows]
    documented = [reading for reading in readings if reading.way.is_documented]
    named_readings = [reading for reading in documented if reading.way.is_named] or documented
    # Equal shares leave the more certain reading in front.
    best = max(named_readings, key=attrgetter("share"), default=None)
    if best is None:
        for reading in candidates:
            if reading.way.is_documented and reading.num_faults:
                return reading
        problem = f"no documented words name ingredients and a result; {columns}"
        raise refusal(path, problem, anchor, _NAME_COLUMNS)
    # Of two readings of the same recipes, the one that lacks none; of equal ones the best.
    alike = [best, *(reading for reading in documented if reading.is_like(best))]
    best = max(alike, key=lambda reading: len(reading.recipes))
    # Another column of results, whose cells have to be mended first, may be the right one.
    damaged = [
        reading
        for reading in candidates
        if reading.way.parts == best.way.parts and reading.has_damaged_names
    ]
    if damaged:
        return damaged[0]
    rivals = [
        reading
        for reading in readings
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
    # Names of rows are no results for sure, if there is another column.
    is_only_name = not best.way.is_named and bool(best.reading.ignored)
    is_unsure = bool(rivals) or best.names_ingredients_elsewhere or is_only_name
    if not best.hangs_together and (is_unsure or len(best.results) >= FEWEST_RESULTS):
        raise _loose(path, best, rivals, anchor)
    return best


def _loose(
    path: Path, best: ReadingCandidate, rivals: Sequence[ReadingCandidate], anchor: str
) -> RecipeFileError:
    """Return the error for a book that does not hang together."""
    num_results = len(best.results)
    # Where another column names the ingredients, its results are rather named twice.
    is_plausible = best.is_clean and not best.names_ingredients_elsewhere
    problem = (
        f"read as {best if is_plausible else _shown(best)}, {best.share * num_results:.0f} of "
        f"{num_results:,} results are ingredients of other recipes, so that this reading may be "
        "wrong"
    )
    if replace(best, fold=True).hangs_together:
        return refusal(path, problem, anchor, "Labels differ in case only: --case fold joins them.")
    remedy = _NAME_COLUMNS
    if is_plausible:
        remedy = "If it is right, as in chemistry or cooking, say so with these --columns."
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
