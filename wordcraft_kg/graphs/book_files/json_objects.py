"""JSON objects whose keys are labels: recipes by result, results by ingredients."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

from wordcraft_kg.graphs.book_files.columns import words_of
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, JsonPart, RawRecipe
from wordcraft_kg.graphs.book_files.json_keys import (
    LOOKED_AT,
    first_keys,
    listed_parts,
    property_keys,
    refuse_joined,
)
from wordcraft_kg.graphs.book_files.json_values import (
    RECIPE_KEYS,
    RESULT_KEYS,
    TEXT_KEYS,
    WRAPPERS,
    is_name,
    is_sum,
    made_by,
    own_name,
    pairs_of,
    plain_key,
)
from wordcraft_kg.graphs.book_files.places import chosen_place, places_in_order
from wordcraft_kg.graphs.book_files.rows import Fault, LeftOut
from wordcraft_kg.graphs.recipes import shown

_KEY_JOINERS = (" + ", "+", ";", "|", "&", ",")
_ABOUT = WRAPPERS | words_of("base bases start starting initial starters basics kinds columns")
"""Keys that say something about a book, and are no result where labels follow."""
PARTNERS = words_of("combinations combination combos combineswith makeswith with makes mixes")
"""Keys around a thing's partners and their results, in their plain form."""
_PERHAPS_PARTNERS = PARTNERS | WRAPPERS
"""Keys around a thing's partners if the labels do not tell another reading."""
_LONG = 10  # labels in lists of one length that are columns rather than ingredients
PAIR_PLACES = ("key", "first", "second")
"""Words of the option `columns` for the pairs under a key."""
_NESTED_PLACES = ("outer", "inner", "value")

Raws = Iterator[RawRecipe | Fault | LeftOut]


# --- recipes by result ---------------------------------------------------------------------------


def recipes_by_result(part: JsonPart) -> FoundShape | None:
    """Return the recipes of an object by result: pairs, a pair, a sum, or null for a base entity.

    Pairs may also be partners and results, with the ingredient as key; the labels tell.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read; keys without a recipe are listed entities. None for
        another shape.

    Raises:
        RecipeFileError: if the labels do not tell, the lists may be columns or about the book, or
            every text may be one label or a pair.
        ConfigError: if the option `columns` names no place of a pair.
    """
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    values = list(value.values())
    if not all(each is None or isinstance(each, (list, str)) for each in values):
        return None
    filled = [each for each in values if each]
    texts = [each for each in filled if isinstance(each, str)]
    if not all(map(is_sum, texts)) or any(map(_holds_things, filled)):
        return None
    # Every doubt is an error before the first recipe is read.
    _refuse_about(part.path, value)
    _refuse_columns(part.path, value)
    refuse_joined(part.path, filled)
    listed = [key for key, each in value.items() if not each]
    rows = rows_by_key(value.items())
    place = chosen_place(part, rows, PAIR_PLACES, likely=0)
    shape = "recipes by result"
    columns: tuple[str, ...] = ()
    raws = recipes_of_results(value.items(), part.where)
    if place != 0:
        shape = "partners and results by ingredient"
        raws = with_result_at(raws, place)
    # The usual order needs no words, unless the option named it.
    if place != 0 or part.columns:
        columns = places_in_order(PAIR_PLACES, place)
    return FoundShape(shape, raws, listed, columns=columns)


def _holds_things(value: Any) -> bool:
    """Return whether a value lists things with recipes of their own, such as those of a tier."""
    if not isinstance(value, list):
        return False
    things = [each for each in value if isinstance(each, dict)]
    keys = set(map(plain_key, first_keys(things)))
    has_result = not keys.isdisjoint(RESULT_KEYS)
    has_name = not keys.isdisjoint(TEXT_KEYS)
    has_recipe = not keys.isdisjoint(RECIPE_KEYS)
    return has_result or (has_name and has_recipe)


def _refuse_about(path: Path, value: Mapping[str, Any]) -> None:
    """Refuse a key such as base that says something about the book, next to results."""
    for key, each in value.items():
        if key not in _ABOUT or not isinstance(each, list) or not each:
            continue
        # Pairs or sums are recipes, also under such a key.
        if not any(isinstance(row, list) or is_sum(row) for row in each):
            seen = f"{key!r} may be a result, or a list for the whole book"
            remedy = 'Write {"entities": [...], "base": [...], "recipes": [[a, b, result]]}.'
            raise refusal(path, seen, "json", remedy)


def _refuse_columns(path: Path, value: Mapping[str, Any]) -> None:
    """Refuse long lists of one length, which may be the columns of a table."""
    filled = [each for each in value.values() if each]
    lengths = set(map(len, filled))
    are_alike = len(filled) > 1 and len(lengths) == 1
    if not are_alike or not all(map(_is_long, filled)):
        return
    (length,) = lengths
    shown_keys = ", ".join(map(repr, islice(value, 6)))
    seen = f"lists of {length:,} labels under {shown_keys}"
    remedy = "If they are columns, name them with `columns`."
    raise refusal(path, f"{seen}; they may be columns, or ingredients", "json", remedy)


def _is_long(value: Any) -> bool:
    return isinstance(value, list) and len(value) >= _LONG and all(map(is_name, value))


def rows_by_key(items: Iterable[tuple[Any, Any]]) -> list[list[str]]:
    """Return rows of a key and two labels by which the place of the result is judged.

    Args:
        items: labels with what holds their recipes.

    Returns:
        At most as many rows as a judgement needs. Empty if a recipe has one, three or more labels,
        or is a sum: then the key is the result.
    """
    rows: list[list[str]] = []
    for key, value in items:
        if isinstance(value, str):
            return []
        if isinstance(value, list) and any(map(is_sum, value)):
            return []
        for pair in pairs_of(value):
            row = [key, *map(own_name, pair)]
            if len(row) != len(PAIR_PLACES):
                return []
            if all(isinstance(label, str) for label in row):
                labels = [label.strip() for label in row]
                rows.append(labels)
        if len(rows) >= LOOKED_AT:
            break
    return rows


def recipes_of_results(items: Iterable[tuple[str, Any]], where: str) -> Raws:
    """Yield the recipes under each result; a result without any is left out.

    Args:
        items: results with what holds their recipes.
        where: keys that lead to the object.
    """
    for result, value in items:
        place = f"{where}['{result}']"
        pairs = pairs_of(value)
        if not value:
            yield LeftOut(place, "without a recipe")
        elif not pairs:
            message = f"{place} is {shown(value)}; expected pairs of ingredients."
            yield Fault(place, "row", message, "pairs")
        for index, pair in enumerate(pairs):
            yield RawRecipe(f"{place}[{index}]", pair, pair, result)


def with_result_at(raws: Raws, place: int) -> Raws:
    """Yield recipes of a key and a pair with another result than the key.

    Args:
        raws: recipes with the key as result.
        place: place of the result among key, first and second of the pair.
    """
    for raw in raws:
        if isinstance(raw, RawRecipe):
            labels = [raw.result, *raw.ingredients]
            result = labels.pop(place)
            yield raw._replace(ingredients=labels, result=result)
        else:
            yield raw


def amounts_by_result(part: JsonPart) -> FoundShape | None:
    """Return the recipes of numbers by result: ``{"torch": {"stick": 1, "coal": 1}}``.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read; None for another shape, such as objects whose keys may
        be properties.
    """
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    rows = list(value.values())
    if not all(isinstance(row, dict) and row for row in rows):
        return None
    numbers = chain.from_iterable(row.values() for row in rows)
    # By type: true is an instance of int, but no number of pieces.
    if not all(type(number) is int and number > 0 for number in numbers):
        return None
    if property_keys(rows, value.keys()):
        return None
    raws = recipes_of_results(value.items(), part.where)
    return FoundShape("numbers of ingredients by result", raws)


# --- results by ingredients ----------------------------------------------------------------------


def results_by_two_keys(part: JsonPart) -> FoundShape | None:
    """Return the recipes of ``{a: {b: result}}``, with a list for several results, null for none.

    A key such as combinations may stand between: ``{a: {"combinations": {b: result}}}``.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read; None for another shape.

    Raises:
        RecipeFileError: if inner keys may be properties of things, or the labels do not tell which
            of the three is the result.
        ConfigError: if the option `columns` names no place (outer, inner or value).
    """
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    if not all(each is None or isinstance(each, dict) for each in value.values()):
        return None
    if _is_wrapper_of_sums(value):
        return None
    # A thing with null makes nothing, and is an entity all the same.
    filled = {key: each or {} for key, each in value.items()}
    partners, around, ignored = without_wrapper(filled)
    values = (inner.values() for inner in partners.values())
    leaves = list(chain.from_iterable(values))
    results = list(map(made_by, leaves))
    # Objects with values of other kinds are another shape, unless they hold properties.
    is_nested = any(results) and None not in results
    labels = set(value)
    if is_nested:
        labels.update(leaf for leaf in leaves if isinstance(leaf, str))
    _refuse_properties(part.path, partners, property_keys(partners.values(), labels))
    if not is_nested:
        return None
    rows = _judged_rows(partners)
    # A key such as combinations tells that the inner keys are partners; one such as data does not.
    is_told = not around or plain_key(around) in PARTNERS
    usual = _NESTED_PLACES.index("value")
    place = chosen_place(part, rows, _NESTED_PLACES, likely=usual, must_tell=not is_told)
    columns: tuple[str, ...] = ()
    if place != usual or part.columns:
        columns = places_in_order(_NESTED_PLACES, place)
    raws = _of_two_keys(partners, part.where, place)
    return FoundShape("results by two keys", raws, columns=columns, ignored=ignored)


def _judged_rows(partners: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return rows (outer key, inner key, value) by which the place of the result is judged."""
    rows: list[list[str]] = []
    # Enough to tell which label is the result; all rows of a large book would take seconds.
    for one, inner in islice(partners.items(), LOOKED_AT):
        for other, made in inner.items():
            if isinstance(made, str):
                rows.append([one, other, made])
    return rows


def _is_wrapper_of_sums(value: Mapping[str, Any]) -> bool:
    """Return whether a single key stands around sums: ``{"cache": {"water+earth": "mud"}}``."""
    if len(value) > 1:
        return False
    (inner,) = value.values()
    if not inner:
        return False
    has_sums_as_keys = bool(_common_joiners(inner))
    return has_sums_as_keys or all(map(is_sum, inner.values()))


def without_wrapper(
    things: Mapping[str, Mapping[str, Any]],
) -> tuple[Mapping[str, Mapping[str, Any]], str, tuple[str, ...]]:
    """Return the partners of things without the key around them, such as combinations.

    Args:
        things: an object for each thing; empty for a thing that makes nothing.

    Returns:
        Partners and results by thing, the key that was around them, and the keys beside it. Things
        stay as they are, with an empty key, if no such key is around the partners of all.
    """
    # Dicts in place of sets: what is left out is named in the order of the file.
    keys: dict[str, None] = {}
    around: dict[str, None] = {}
    for inner in things.values():
        keys |= dict.fromkeys(inner)
        for key, each in inner.items():
            if isinstance(each, dict):
                around[key] = None
    if len(around) != 1:
        return things, "", ()
    (wrapper,) = around
    if plain_key(wrapper) not in _PERHAPS_PARTNERS:
        return things, "", ()
    unwrapped = {thing: inner.get(wrapper) or {} for thing, inner in things.items()}
    if not all(isinstance(partners, dict) for partners in unwrapped.values()):
        return things, "", ()
    del keys[wrapper]
    return unwrapped, wrapper, tuple(keys)


def _of_two_keys(partners: Mapping[str, Mapping[str, Any]], where: str, result_place: int) -> Raws:
    for one, inner in partners.items():
        for other, value in inner.items():
            place = f"{where}['{one}']['{other}']"
            results = made_by(value)
            if not results:
                yield LeftOut(place, "without a result")
            for made in results or ():
                labels = [one, other, made]
                result = labels.pop(result_place)
                yield RawRecipe(place, [one, other, made], labels, result)


def _refuse_properties(
    path: Path,
    value: Mapping[str, Any],
    keys: Sequence[str],
) -> None:
    """Refuse objects with keys that may be properties of things."""
    if not keys:
        return
    key = keys[0]
    thing = next(each for each, inner in value.items() if inner and key in inner)
    made = shown(value[thing][key])
    names = ", ".join(repr(each[:40]) for each in keys[:6])
    as_property = f"{thing[:40]!r} has {key[:40]!r} {made}"
    as_recipe = f"{thing[:40]} + {key[:40]} = {made}"
    raise refusal(
        path,
        f"objects with the keys {names}, which may be properties ({as_property}) or ingredients "
        f"({as_recipe}); recipes in a known shape are missing",
        "json",
    )


def results_by_sum(part: JsonPart) -> FoundShape | None:
    """Return the recipes of an object of results by a key such as ``"water+earth"``.

    Args:
        part: a value in the file.

    Returns:
        The recipes, made as they are read; a key with null or an empty text is left out. None for
        another shape.

    Raises:
        RecipeFileError: if the keys could be parted in two ways, only some are lists of labels, or
            either side may be the result.
    """
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    results = [made_by(each) for each in value.values()]
    parts = _parts_of_keys(part.path, list(value))
    if parts is None or None in results:
        return None
    results_of_key = zip(value, results, strict=True)
    made_of = {key: made for key, made in results_of_key if made}
    _refuse_sums_on_both_sides(part.path, made_of)
    _refuse_several_results(part.path, made_of)

    def raws() -> Raws:
        for key, labels, made in zip(value, parts, results, strict=True):
            place = f"{part.where}['{key}']"
            if not made:
                yield LeftOut(place, "without a result")
            for result in made or ():
                yield RawRecipe(place, key, labels, result)

    return FoundShape("results by a sum", raws())


def _refuse_sums_on_both_sides(path: Path, made_of: Mapping[str, Sequence[Any]]) -> None:
    """Refuse keys that are sums with results that are all sums: either may be the result."""
    results = list(chain.from_iterable(made_of.values()))
    if not results or not all(map(is_sum, results)):
        return
    first_key = next(iter(made_of))
    first_result = shown(results[0])
    seen = f"sums on either side: {first_key[:60]!r} may make {first_result}, or be made of it"
    raise refusal(path, seen, "json")


def _refuse_several_results(path: Path, made_of: Mapping[str, Sequence[Any]]) -> None:
    """Refuse keys with a comma or & that all have several labels.

    Labels with such signs are usual, and several labels may be the ingredients.
    """
    if not made_of or not all(len(results) > 1 for results in made_of.values()):
        return
    key, results = next(iter(made_of.items()))
    if "," in key or "&" in key:
        seen = f"{key[:60]!r} may be made of {shown(results)}, or be a sum that makes them"
        raise refusal(path, seen, "json")


def _parts_of_keys(path: Path, keys: Sequence[str]) -> list[list[str]] | None:
    """Return the ingredients in keys such as ``water+earth`` or ``["water", "earth"]``.

    Returns:
        None if not all keys hold two ingredients.

    Raises:
        RecipeFileError: if keys could be parted in two ways, or only some are lists.
    """
    if all(key.startswith(("(", "[")) and key.endswith((")", "]")) for key in keys):
        return _lists_in_keys(path, keys)
    joiners = _common_joiners(keys)
    # " + " holds "+": the longer one is meant.
    if " + " in joiners and "+" in joiners:
        joiners.remove("+")
    if len(joiners) > 1:
        one, other, *_ = joiners
        seen = f"keys such as {keys[0][:60]!r} could be parted at {one!r} or {other!r}"
        raise refusal(path, seen, "json")
    if not joiners:
        return None
    (joiner,) = joiners
    parts = []
    for key in keys:
        labels = key.split(joiner)
        parts.append([label.strip() for label in labels])
    return parts


def _common_joiners(keys: Iterable[str]) -> list[str]:
    """Return the signs that part each key in two labels."""
    fitting = list(_KEY_JOINERS)
    for key in keys:
        fitting = [joiner for joiner in fitting if _has_two(key, joiner)]
    return fitting


def _lists_in_keys(path: Path, keys: Sequence[str]) -> list[list[str]]:
    lists = []
    for key in keys:
        labels = listed_parts(key)
        if labels is None:
            raise refusal(path, f"the key {key[:60]!r} is no list of labels", "json")
        lists.append(labels)
    return lists


def _has_two(key: str, joiner: str) -> bool:
    labels = key.split(joiner)
    return len(labels) == 2 and all(label.strip() for label in labels)
