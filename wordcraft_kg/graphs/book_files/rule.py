"""The rule by which a way to read a file is taken, or the file refused with all ways as commands.

A reading is taken if its keys are documented words, and its book hangs together: results are
ingredients elsewhere. Of 22 right readings of public files 20 reuse at least .08 of their results,
of 12 wrong ones 11 at most .04. A book of few results may reuse none; it must have no second
reading that does. A reading that the user names is taken at their word.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.cells import is_number, trim_unseen, without_markup
from wordcraft_kg.graphs.book_files.odd_labels import odd_label
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, Row, refusal
from wordcraft_kg.graphs.book_files.words import words_of
from wordcraft_kg.graphs.label_notes import count_in

ELEMENTS = words_of(
    "water fire earth air wind eau feu terre vent agua fuego tierra aire viento wasser feuer erde "
    "luft acqua fuoco terra aria água fogo ar вода огонь земля воздух 水 火 土 地 風 空気"
)
"""The elements with which many worlds begin, in lower case; they are seldom made."""
LEAST_REUSED = 0.05
"""Share of the results that must be ingredients of other recipes."""
FEWEST_RESULTS = 20
"""Results of the smallest book that the share judges."""
_FEWEST_UNUSED = 5  # of fewer recipes, none may use another's result by chance
_LIKE = 0.5  # share of the rows by which two readings are one
_MOST_READINGS = 4  # in a refusal
_FEWEST_ELEMENTS = 2  # one alone, such as water, is a usual thing to make
_FEWEST_ROWS = 50
_MARGIN = 0.1
_REUSED = 0.2
"""Without a header: rows needed, by how much the share of different pairs must be larger, and the
share of results that are ingredients.

On whole books the right reading has .95 to 1 different pairs, the two others .62 to .70 (kitchen,
everyday, Little Alchemy 2, 60,000 rows of Infinite Craft); on 20 rows all three have .85 to 1.
"""


@dataclass
class BookReading:
    """One way to read a file.

    Attributes:
        columns: names or paths of the ingredients and, last, of the result, as in `columns`.
        entries: recipes, faults and rows left out.
        is_documented: whether its keys are documented words, or its shape is documented.
        is_named: whether results are named as results, rather than only as things.
        num_results: number of ``columns`` with results.
        by_place: whether only the places of labels tell which one is the result.
        num_unmade: number of rows with ingredients and without a result.
        needs_reuse: whether a book of any size must hang together, as numbers beside labels may be
            properties.
        ignored, counts_dropped, several_outputs: see
            :class:`~wordcraft_kg.graphs.book_files.rows.FileRows`.
    """

    columns: tuple[str, ...]
    entries: Sequence[Entry]
    is_documented: bool = True
    is_named: bool = True
    num_results: int = 1
    ignored: tuple[str, ...] = ()
    counts_dropped: int = 0
    several_outputs: int = 0
    by_place: bool = False
    num_unmade: int = 0
    needs_reuse: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether it has no recipe and no fault."""
        return not any(isinstance(entry, Row | Fault) for entry in self.entries)

    @cached_property
    def rows(self) -> list[Row]:
        """The recipes."""
        return [entry for entry in self.entries if isinstance(entry, Row)]

    @cached_property
    def recipes(self) -> set[tuple[frozenset[str], str]]:
        """The recipes without places and order."""
        return {(frozenset(row.ingredients), row.result) for row in self.rows}

    @cached_property
    def num_made(self) -> int:
        """Number of different results."""
        return len({result for _, result in self.recipes})

    @cached_property
    def share(self) -> float:
        """Share of the results that are ingredients of other recipes."""
        return self.share_of(_bare)

    def share_of(self, label: Callable[[str], str]) -> float:
        """Return the share of the results that are ingredients elsewhere, after a change of labels.

        Args:
            label: returns the label that a cell stands for.
        """
        results = {label(made) for made in {made for _, made in self.recipes}}
        parts = {part for parts, made in self.recipes for part in parts if part != made}
        used = set(map(label, parts))
        return len(results & used) / len(results) if results else 0.0

    @cached_property
    def contradictions(self) -> int:
        """Number of recipes that make an element or a part of themselves, or share their pair."""
        labels = {label for parts, made in self.recipes for label in (*parts, made)}
        elements = {label for label in labels if label.casefold() in ELEMENTS}
        if len(elements) < _FEWEST_ELEMENTS:
            elements = set()
        odd = sum(made in elements or made in parts for parts, made in self.recipes)
        return odd + len(self.recipes) - len({parts for parts, _ in self.recipes})

    @property
    def is_mostly_single(self) -> bool:
        """Whether most rows have one ingredient, as a list of ingredients read row by row has."""
        return sum(len(row.ingredients) == 1 for row in self.rows) * 2 > len(self.rows)

    @cached_property
    def has_numbers(self) -> bool:
        """Whether many labels are numbers."""
        texts = [label for row in self.rows for label in (row.ingredients[-1], row.result)]
        return 2 * sum(map(is_number, texts)) > len(self.rows)

    @property
    def is_clean(self) -> bool:
        """Whether each entry can be read, so that the reading may be advised."""
        has_faults = any(isinstance(entry, Fault) for entry in self.entries)
        if not self.rows or has_faults or self.has_numbers or self.odd_label:
            return False
        return self.num_results == 1 and not self.is_mostly_single

    @cached_property
    def odd_label(self) -> str:
        """See :func:`~wordcraft_kg.graphs.book_files.odd_labels.odd_label`."""
        return odd_label(self.rows)

    @cached_property
    def hangs_together(self) -> bool:
        """Whether results are ingredients elsewhere, so that options of single rows may help."""
        return self.share > LEAST_REUSED and self.num_made > 1 and not self.has_numbers

    @cached_property
    def remark(self) -> str:
        """What alone makes several things, and is in no other recipe; empty without one."""
        single = [min(parts) for parts, _ in self.recipes if len(parts) == 1]
        if len(single) < 2 or len(set(single)) > 1:
            return ""
        every_label = [label for parts, made in self.recipes for label in (*parts, made)]
        return single[0] if every_label.count(single[0]) == len(single) else ""

    @property
    def command(self) -> str:
        """The options that read the file so."""
        chain = (
            "" if all(len(row.ingredients) == 2 for row in self.rows) else " --ingredients chain"
        )
        return f"--columns '{','.join(self.columns)}'{chain}"

    def __str__(self) -> str:
        first = self.rows[0]
        sum_of = " + ".join(label[:40] for label in first.ingredients[:8])
        return f"{sum_of} = {first.result[:40]} ({self.command})"

    def is_order_of(self, other: "BookReading") -> bool:
        """Return whether most of its results are labels of another reading."""
        results = {made for _, made in self.recipes}
        labels = {label for parts, made in other.recipes for label in (*parts, made)}
        return len(results & labels) * 2 > len(results)

    def is_like(self, other: "BookReading") -> bool:
        """Return whether two readings share most of their recipes."""
        smaller = min(len(self.recipes), len(other.recipes))
        return len(self.recipes & other.recipes) >= _LIKE * smaller


def _folded(cell: str) -> str:
    return _bare(cell).lower()


def _num_recipes(best: BookReading) -> Callable[[BookReading], tuple[int, bool]]:
    """Return a key by which readings are larger, and of equal ones the best in front."""
    return lambda each: (len(each.recipes), each is best)


@lru_cache(maxsize=100_000)
def _bare(cell: str) -> str:
    """Return a cell without markup and number of pieces, as the book may have it."""
    label = without_markup(trim_unseen(cell))
    counted = count_in(label)
    return label if counted is None else counted[0]


def choose(
    path: Path,
    candidates: Sequence[BookReading],
    guesses: Iterable[BookReading],
    anchor: str,
    *,
    fold: bool = False,
    allows_single: bool = False,
) -> BookReading | None:
    """Return the one reading of a file that the rule takes.

    Args:
        path: the file, for errors.
        candidates: readings by documented words and shapes, the more certain ones first.
        guesses: further readings, for refusals; iterated only if no named reading is certain.
        anchor: section of the guide for the file's shape.
        fold: whether labels are read in lower case.
        allows_single: whether the user says what a single ingredient means.

    Returns:
        The reading; None if no reading with documented words has a recipe.

    Raises:
        RecipeFileError: if several readings remain, or the only one does not hang together; with
            the commands that read the file.
    """
    readable = [each for each in candidates if each.rows]
    label = _folded if fold else _bare
    shares = {id(each): each.share_of(label) for each in readable}
    documented = [each for each in readable if each.is_documented]
    documented = [
        each for each in documented if not each.needs_reuse or shares[id(each)] > LEAST_REUSED
    ]
    # A key of results that most rows lack is hardly that of their results.
    complete = [each for each in documented if each.num_unmade <= len(each.rows)]
    documented = complete or documented
    named = [each for each in documented if each.is_named] or documented
    # Equal shares leave the more certain reading in front.
    best = max(named, key=lambda each: shares[id(each)], default=None)
    if best is None or not best.is_named or best.by_place or shares[id(best)] <= LEAST_REUSED:
        more = [each for each in guesses if each.rows]
        shares |= {id(each): each.share_of(label) for each in more}
        readable += more
    if best is not None:
        # Of two readings of the same recipes, the one that lacks none.
        best = max((each for each in documented if each.is_like(best)), key=_num_recipes(best))
    others = [each for each in readable if best is None or not each.is_like(best)]
    rivals = [each for each in others if each.is_clean and shares[id(each)] > LEAST_REUSED]
    if best is None:
        return _undocumented(path, candidates, others, anchor)
    # Another order of the same labels is a reading only if it is no odder.
    odd = [each for each in others if each.contradictions < best.contradictions]
    odd = [each for each in odd if each.is_clean and not each.is_documented]
    odd = [each for each in odd if each.is_order_of(best)]
    if odd and (best.by_place or not best.is_named):
        raise _several(path, "two readings fit", [best, *odd], anchor)
    rivals = [
        each for each in rivals if each.is_documented or each.contradictions <= best.contradictions
    ]
    share = shares[id(best)]
    if best.is_mostly_single and not allows_single:
        seen = (
            f"read as {_shown(best)}, most rows have one ingredient: they may be parts of recipes"
        )
        raise _several(path, seen, rivals, anchor)
    # Names of rows may be no results if none is used, and another key may hold the results.
    is_name_unused = not best.is_named and bool(best.ignored) and best.num_made >= _FEWEST_UNUSED
    is_judged = best.num_made >= FEWEST_RESULTS or (is_name_unused and not share)
    if share <= LEAST_REUSED and is_judged:
        raise _loose(path, best, share, rivals, anchor)
    # In a book that hangs together, a much looser reading is none, and neither is a guess.
    close = [each for each in rivals if shares[id(each)] > share * _LIKE]
    if share > LEAST_REUSED:
        close = [each for each in close if each.is_documented]
    if close:
        seen = "two readings fit" if share > LEAST_REUSED else f"{_shown(best)} is not certain"
        is_advised = best.is_clean and share > LEAST_REUSED
        raise _several(path, seen, [best, *close] if is_advised else close, anchor)
    return best


def _undocumented(
    path: Path, candidates: Iterable[BookReading], others: Iterable[BookReading], anchor: str
) -> BookReading | None:
    """Refuse a file without documented words, with the readings that hang together.

    Args:
        path: the file.
        candidates: readings by documented words.
        others: all readings with recipes.
        anchor: see :func:`choose`.

    Returns:
        A reading whose faults say what is wrong; None without one.
    """
    # The columns of a small table without a header may be in any order.
    clean = [each for each in others if each.is_clean]
    orders = [each for each in clean if each.share_of(_folded) > LEAST_REUSED]
    orders = [each for each in orders if each.num_made * each.share_of(_folded) > 1]
    orders = orders or [each for each in clean if "".join(each.columns).isdecimal()]
    if orders:
        # Of several orders of the same labels, the least odd ones.
        least = min(each.contradictions for each in orders)
        orders = [each for each in orders if each.contradictions == least]
        seen = "no key or column is a documented word for a result and its ingredients"
        raise _several(path, seen, orders, anchor)
    return next((each for each in candidates if not each.is_empty), None)


def _loose(
    path: Path, best: BookReading, share: float, rivals: Sequence[BookReading], anchor: str
) -> RecipeFileError:
    """Return the error for a book that does not hang together."""
    seen = (
        f"read as {_shown(best)}, {share * best.num_made:.0f} of {best.num_made:,} results are "
        "ingredients of other recipes, so that this reading may be wrong"
    )
    if best.share_of(_folded) > LEAST_REUSED:
        return refusal(path, seen, anchor, "Labels differ in case only: --case fold joins them.")
    if not rivals and best.is_named and best.is_clean:
        remedy = f"If it is right, as in chemistry or cooking, say so: {best.command}."
        return refusal(path, seen, anchor, remedy)
    return _several(path, seen, rivals, anchor)


def _shown(candidate: BookReading) -> str:
    columns = candidate.columns
    results = ", ".join(columns[-candidate.num_results :])
    return f"{' + '.join(columns[: -candidate.num_results])} = {results}"


def _several(
    path: Path, seen: str, readings: Sequence[BookReading], anchor: str
) -> RecipeFileError:
    if not readings:
        remedy = "Name the ingredients and, last, the result with --columns."
        return refusal(path, seen, anchor, remedy)
    texts = list(dict.fromkeys(map(str, readings)))
    shown = " or ".join(texts[:_MOST_READINGS])
    return refusal(path, f"{seen}: {shown}", anchor, "Choose with --columns.")


def result_place(readings: Sequence[BookReading]) -> int | None:
    """Return which of three readings of the same rows the labels tell; None if they do not.

    The right one has the fewest pairs that make several things.

    Args:
        readings: readings that differ in the place of the result.
    """
    recipes = [reading.recipes for reading in readings]
    if len(recipes) != 3 or min(map(len, recipes)) < _FEWEST_ROWS:
        return None
    shares = [len({parts for parts, _ in each}) / len(each) for each in recipes]
    ranked = sorted(range(len(shares)), key=lambda place: -shares[place])
    best, second = ranked[:2]
    is_clear = shares[best] - shares[second] >= _MARGIN
    # Where a pair makes several things, a column of machines looks like one of results.
    return best if is_clear and readings[best].share >= _REUSED else None
