"""Which of three labels in each row is the result, where no name says so.

Rows such as ``water, earth, mud`` have three readings, one for each place of the result. Many rows
tell by their pairs, see :func:`~wordcraft_kg.graphs.book_files.columns.result_by_rows`. Few rows
tell only by what a reading contradicts, such as a world in which water is made of mud, or a pair
that makes several things.
"""

from collections.abc import Iterable, Sequence

from wordcraft_kg.graphs.book_files.columns import (
    are_reused,
    ingredients_of,
    result_by_rows,
    roles_of_option,
    words_of,
)
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import JsonPart

ELEMENTS = words_of(
    "water fire earth air wind eau feu terre vent agua fuego tierra aire viento wasser feuer erde "
    "luft acqua fuoco terra aria água fogo ar вода огонь земля воздух 水 火 土 地 風 空気"
)
"""The elements with which many worlds begin, in lower case; they are seldom made."""
_FEWEST_ELEMENTS = 2  # one alone, such as water, is a usual thing to make
_CLEAR = 4  # how many times more contradictions each other reading must have
_UNLIKELY = 3  # and how many more yet, for a place where people seldom write the result


def result_place(rows: Sequence[Sequence[str]], likely: int | None = None) -> int | None:
    """Return the place of the result in rows of three labels; None if the rows do not tell.

    On samples of 1, 3 and 10 results of whole books with the result first (kitchen, everyday,
    Little Alchemy 2) it is told for 50, 92 and 99 of 100, and never wrong.

    Args:
        rows: at least one row of three labels, without a header.
        likely: where people write the result in files of this shape; None for no such place.
    """
    by_pairs = result_by_rows(rows)
    by_contradictions = _least_contradicted(rows, likely)
    if by_pairs is None:
        return by_contradictions
    # Where people seldom write the result, both judgements must agree.
    is_usual = likely is None or likely == by_pairs
    is_undisputed = by_contradictions is None and is_usual
    if is_undisputed or by_contradictions == by_pairs:
        return by_pairs
    return None


def _least_contradicted(rows: Sequence[Sequence[str]], likely: int | None) -> int | None:
    """Return the place whose reading the rows contradict clearly least, or None."""
    counts = []
    for place in range(3):
        count = contradictions(rows, place)
        counts.append((count, place))
    first, second, _ = sorted(counts)
    fewest, place = first
    next_fewest, _ = second
    if place == likely:
        return place if next_fewest > _CLEAR * fewest else None
    if next_fewest <= _CLEAR * fewest + _UNLIKELY:
        return None
    # A column of machines makes few contradictions, but machines are no ingredients.
    results = {row[place] for row in rows}
    ingredients = ingredients_of(rows, place)
    return place if are_reused(results, ingredients) else None


def contradictions(rows: Iterable[Sequence[str]], place: int) -> int:
    """Count what speaks against the result at a place of rows of three labels.

    These are rows that make an element, that make one of their ingredients, that make another
    thing of a pair, or that have a twin with result and ingredient exchanged. Recipes that nothing
    leads to say little: a part of a book has many.

    Args:
        rows: rows of three labels.
        place: place of the result, 0 to 2.

    Example:
        >>> rows = [("mud", "water", "earth"), ("brick", "mud", "fire")]
        >>> [contradictions(rows, place) for place in range(3)]
        [0, 1, 2]
    """
    # Without repetitions and without an order of ingredients, which contradict nothing.
    recipes: set[tuple[frozenset[str], str]] = set()
    elements: set[str] = set()
    for row in rows:
        parts = frozenset((*row[:place], *row[place + 1 :]))
        recipes.add((parts, row[place]))
        elements.update(label for label in row if label.casefold() in ELEMENTS)
    if len(elements) < _FEWEST_ELEMENTS:
        elements = set()
    made_elements = sum(made in elements for _, made in recipes)
    made_of_itself = sum(made in parts for parts, made in recipes)
    pairs = {parts for parts, _ in recipes}
    several_results = len(recipes) - len(pairs)
    exchanged = 0
    for parts, made in recipes:
        # A recipe that makes its own ingredient is counted above, and is its own twin.
        if made in parts:
            continue
        for part in parts:
            twin = (parts - {part} | {made}, part)
            exchanged += twin in recipes
    return made_elements + made_of_itself + several_results + exchanged


def chosen_place(
    part: JsonPart,
    rows: Sequence[Sequence[str]],
    names: Sequence[str],
    likely: int,
    *,
    must_tell: bool = True,
) -> int:
    """Return the place of the result by the option `columns`, or by the rows.

    Args:
        part: the value that holds the rows, with the option.
        rows: rows of three labels; without any, the result is at the likely place.
        names: what stands at each place, such as key, first, second: the option's words.
        likely: where people write the result in files of this shape.
        must_tell: whether the rows must tell; otherwise they must not tell another place.

    Raises:
        RecipeFileError: if the rows do not tell, or must not tell what they do; the message shows
            two readings.
        ConfigError: if the option names no such place.
    """
    if part.columns is not None:
        (result,) = roles_of_option(part.columns, names, len(names)).results
        return result
    if not rows:
        return likely
    # Ids say nothing; the names of the same things do.
    rows = part.with_names(rows)
    told = result_place(rows, likely)
    if told == likely or (told is None and not must_tell):
        return likely
    if told is not None and must_tell:
        return told
    # Of three readings the first and the last are those that people write.
    other = told if told is not None else 2 - likely
    first_row = rows[0]
    one_reading = _reading(first_row, names, likely)
    other_reading = _reading(first_row, names, other)
    labels = ", ".join(repr(label[:40]) for label in first_row)
    seen = f"{labels} may be {one_reading} or {other_reading}"
    raise refusal(part.path, seen, "json", "Choose with `columns`.")


def places_in_order(names: Sequence[str], result: int) -> tuple[str, ...]:
    """Return the names of places with that of the result last.

    Args:
        names: what stands at each place.
        result: index of the result's place.
    """
    others = [name for place, name in enumerate(names) if place != result]
    return (*others, names[result])


def _reading(row: Sequence[str], names: Sequence[str], result: int) -> str:
    """Return a row as a recipe, and the option that reads it so."""
    one, other, made = places_in_order([label[:40] for label in row], result)
    columns = ",".join(places_in_order(names, result))
    return f"{one} + {other} = {made} (`columns` {columns})"
