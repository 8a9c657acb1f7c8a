"""Lists and objects of JSON objects: an entity with its recipes, or a recipe with keys."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import Any, NamedTuple

from wordcraft_kg.graphs.book_files.columns import (
    Roles,
    names_ingredient,
    roles_of_header,
    roles_of_option,
)
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.json_found import FoundShape, JsonPart, RawRecipe
from wordcraft_kg.graphs.book_files.json_ids import names_of_ids, with_names
from wordcraft_kg.graphs.book_files.json_keys import pair_keys, refuse_joined
from wordcraft_kg.graphs.book_files.json_objects import (
    PAIR_PLACES,
    PARTNERS,
    results_by_two_keys,
    rows_by_key,
    with_result_at,
    without_wrapper,
)
from wordcraft_kg.graphs.book_files.json_values import (
    LOOKED_AT,
    NAME_KEYS,
    RECIPE_KEYS,
    RESULT_KEYS,
    TEXT_KEYS,
    is_entity,
    is_name,
    is_sum,
    made_by,
    own_name,
    pairs_of,
    plain_key,
    results_of,
)
from wordcraft_kg.graphs.book_files.places import chosen_place, places_in_order
from wordcraft_kg.graphs.book_files.rows import Fault, LeftOut
from wordcraft_kg.graphs.recipes import shown

_EITHER_WAY = PARTNERS | frozenset({"pairs", "crafting"})
"""Keys of pairs that may be ingredients of a thing, or its partners with their results."""


class Records(NamedTuple):
    """Objects of one kind, such as the rows of a table.

    Attributes:
        part: the value that holds them.
        rows: the objects.
        places: place of each object in the file.
    """

    part: JsonPart
    rows: Sequence[Mapping[str, Any]]
    places: Sequence[str]

    @property
    def keys(self) -> list[str]:
        """All keys of the first objects, in order."""
        return list(dict.fromkeys(chain.from_iterable(islice(self.rows, LOOKED_AT))))


class _Roles(NamedTuple):
    """Keys of records by what they hold.

    Attributes:
        recipes: keys of recipes, or of ingredients.
        outputs: keys that name results.
        names: keys that name the thing itself.
    """

    recipes: list[str]
    outputs: list[str]
    names: list[str]


# --- shapes --------------------------------------------------------------------------------------


def one_record(part: JsonPart) -> FoundShape | None:
    """One recipe, an object with keys like columns, such as the only one of JSON lines."""
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    values = list(value.values())
    is_flat = all(isinstance(each, (str, int, type(None))) for each in values)
    if not is_flat or any("+" in str(each) for each in values):
        return None
    return recipes_of_records(Records(part, [value], [part.where or "the object"]))


def list_of_records(part: JsonPart) -> FoundShape | None:
    """A list of objects: an entity with its recipes, or a recipe with keys like columns."""
    value = part.value
    if not isinstance(value, list) or not value or not all(isinstance(row, dict) for row in value):
        return None
    places = [f"{part.where}[{index}]" for index in range(len(value))]
    return recipes_of_records(Records(part, value, places))


def records_by_name(part: JsonPart) -> FoundShape | None:
    """An object of objects: entities, or recipes, by name."""
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    if not all(isinstance(row, dict) for row in value.values()):
        return None
    places = [f"{part.where}['{key}']" for key in value]
    # Objects that have names of their own are under their ids.
    own = [row for row in value.values() if any(isinstance(row.get(key), str) for key in TEXT_KEYS)]
    key_name = "id" if len(own) == len(value) else "name"
    records = [{key_name: key, **row} for key, row in value.items()]
    # Without such a key the inner keys are ingredients, see results_by_two_keys.
    if not _recipe_keys(records) and not _has_columns(value):
        return None
    return recipes_of_records(Records(part, records, places))


def recipes_of_records(records: Records) -> FoundShape | None:
    """Return the recipes of records, by the names of their keys; None if these do not tell."""
    roles = _roles(records)
    columns = records.part.columns
    if (
        roles.recipes
        and (roles.outputs or roles.names)
        and (columns is None or _names_pair(columns))
    ):
        partners = _partners(records, roles)
        return _entities(records, roles) if partners is None else partners
    return _rows_of_cells(records)


def _names_pair(columns: Sequence[str]) -> bool:
    """Return whether the option `columns` tells what pairs under a key are."""
    return sorted(column.strip().casefold() for column in columns) == sorted(PAIR_PLACES)


# --- roles of keys -------------------------------------------------------------------------------


def _roles(records: Records) -> _Roles:
    rows, keys = records.rows, records.keys
    recipes = _recipe_keys(rows)
    outputs = [key for key in keys if plain_key(key) in RESULT_KEYS]
    names = [key for key in NAME_KEYS if any(is_name(row.get(key)) for row in rows)]
    if not recipes and outputs:
        recipes = _only_recipe_key(rows, [key for key in keys if key not in outputs])
    return _Roles(recipes, outputs, names)


def _recipe_keys(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = dict.fromkeys(chain.from_iterable(islice(rows, LOOKED_AT)))
    named = [key for key in keys if plain_key(key) in RECIPE_KEYS]
    return [key for key in named if any(_is_recipes(row.get(key)) for row in rows)]


def _is_recipes(value: Any) -> bool:
    """Return whether a value may hold recipes: a list, an object, or a sum."""
    return isinstance(value, (list, dict)) or (isinstance(value, str) and "+" in value)


def _only_recipe_key(rows: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> list[str]:
    """Return the only key whose values are all lists of labels or sums, whatever its name."""
    fitting = [key for key in keys if all(_is_listed(row.get(key)) for row in rows)]
    return fitting if len(fitting) == 1 else []


def _is_listed(value: Any) -> bool:
    """Return whether a value is a list of labels or a sum."""
    if isinstance(value, list):
        return len(value) > 1 and all(isinstance(each, (str, int)) for each in value)
    return is_sum(value)


def _has_columns(value: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether all objects have the same keys of ingredients, and a result or their own key.

    Args:
        value: objects by key.
    """
    rows = list(value.values())
    keys = list(dict.fromkeys(chain.from_iterable(islice(rows, LOOKED_AT))))
    keys = [key for key in keys if key not in value]
    roles = roles_of_header(keys)
    if roles is not None:
        used = {keys[i] for i in (*roles.ingredients, *roles.results[:1])}
        return all(used <= row.keys() for row in rows)
    pair = pair_keys(rows[0])
    if not pair or not value.keys().isdisjoint(pair):
        return False
    return all(pair_keys(row) == pair for row in rows)


# --- a recipe in each record ---------------------------------------------------------------------


def _rows_of_cells(records: Records) -> FoundShape | None:
    """Records with keys like the columns of a table."""
    keys, columns = records.keys, records.part.columns
    if columns is None:
        roles = roles_of_header(keys) or _told_roles(records)
    else:
        roles = roles_of_option(columns, keys, len(keys))
    if roles is None:
        return None
    parts = [keys[i] for i in roles.ingredients]
    made = [keys[i] for i in roles.results]
    counts = [keys[i] for i in roles.counts]
    if len(parts) == 1:
        refuse_joined(records.part.path, [row.get(parts[0]) for row in records.rows])

    def raws() -> Iterator[RawRecipe | Fault]:
        for row, place in zip(records.rows, records.places, strict=True):
            ingredients = _flat(row[key] for key in parts if row.get(key) not in (None, ""))
            results = [each for key in made for each in results_of(row.get(key), True)]
            dropped = sum(row.get(key) not in (None, "", 1, "1") for key in counts)
            if not ingredients or not results:
                expected = f"{', '.join(parts)} and {', '.join(made)}"
                message = f"{place} is {shown(row)}; expected {expected}."
                yield Fault(place, "row", message, "keys")
                continue
            for result in results:
                yield RawRecipe(place, row, ingredients, result, counts=dropped)

    ignored = tuple(key for key in keys if key not in (*parts, *made))
    return FoundShape(
        "a list of objects",
        raws(),
        columns=(*parts, *made),
        num_results=len(made),
        ignored=ignored,
    )


def _told_roles(records: Records) -> Roles | None:
    """Return the roles of three keys such as a, b and c, if the labels tell which is the result."""
    keys = records.keys
    cells: list[list[Any]] = [
        [row.get(key) for key in keys] for row in islice(records.rows, LOOKED_AT)
    ]
    if not all(isinstance(cell, str) and cell for cell in chain.from_iterable(cells)):
        return None
    if len(keys) != len(PAIR_PLACES) or not all(map(names_ingredient, keys)):
        return None
    result = chosen_place(records.part, cells, keys, likely=2)
    return Roles(tuple(place for place in range(3) if place != result), (result,))


def _flat(values: Iterator[Any]) -> list[Any]:
    """Return values with those in lists one by one."""
    flat: list[Any] = []
    for value in values:
        if isinstance(value, list):
            flat += value
        elif isinstance(value, dict) and not is_entity(value):
            # Numbers by label, such as {"iron-plate": 1}; another object is no ingredient.
            held = pairs_of(value)
            flat += held[0] if len(held) == 1 else [value]
        else:
            flat.append(value)
    return flat


# --- the recipes of a thing ----------------------------------------------------------------------


def _partners(records: Records, roles: _Roles) -> FoundShape | None:
    """Things with their partners and the results: ``{"combinations": {"earth": "mud"}}``."""
    if roles.outputs or len(roles.recipes) != 1:
        return None
    (key,) = roles.recipes
    by_name: dict[str, dict[str, Any]] = {}
    for row in records.rows:
        partners = row.get(key) or {}
        name = row.get(roles.names[0])
        is_map = isinstance(partners, dict) and not pair_keys(partners)
        if not is_map or not isinstance(name, str) or name in by_name:
            return None
        results = [made_by(each) for each in partners.values()]
        if None in results or any(type(each) is int for each in partners.values()):
            return None
        by_name[name] = {key: partners}
    if not without_wrapper(by_name)[1]:
        return None
    found = results_by_two_keys(records.part._replace(value=by_name))
    if found is not None:
        found.ignored = tuple(each for each in records.keys if each not in (key, roles.names[0]))
    return found


def _entities(records: Records, roles: _Roles) -> FoundShape:
    """Objects with a key for recipes or ingredients, and one for the results or the name."""
    path = records.part.path
    refuse_joined(path, [row.get(key) for row in records.rows for key in roles.recipes])
    made = _made_key(records, roles)
    names = names_of_ids(path, ((row.get("id"), row) for row in records.rows))
    raws: list[RawRecipe | Fault | LeftOut] = []
    listed: list[Any] = []
    for row, place in zip(records.rows, records.places, strict=True):
        results = results_of(row.get(made), bool(roles.outputs))
        if not results and roles.outputs and roles.names:
            # Some tools leave out the product of a recipe that is called like it.
            results = results_of(row.get(roles.names[0]), False)
        values = [row[key] for key in roles.recipes if row.get(key)]
        held = [pairs_of(value) for value in values]
        if not results:
            message = f"{place} is {shown(row)}; {made!r} names no result."
            raws.append(Fault(place, "row", message, "result"))
        elif not all(held):
            message = f"{place} is {shown(row)}; expected pairs of ingredients."
            raws.append(Fault(place, "row", message, "pairs"))
        elif not held:
            raws.append(LeftOut(place, "without a recipe"))
            listed += results if not roles.outputs else []
        for pair in chain.from_iterable(held):
            here = f"{place}.{roles.recipes[0]}"
            raws += [RawRecipe(here, pair, pair, result) for result in results]
    columns = (*roles.recipes, made)
    ignored = tuple(key for key in records.keys if key not in columns)
    result_place = _result_place(records, roles, names)
    if result_place != 0:
        columns = places_in_order(PAIR_PLACES, result_place)
    shifted = with_result_at(iter(raws), result_place) if result_place else raws
    found = FoundShape("a list of objects", shifted, listed, columns=columns, ignored=ignored)
    return with_names(path, found, names)


def _result_place(records: Records, roles: _Roles, names: Mapping[Any, str]) -> int:
    """Return the place of the result among a thing's name and the labels of its pairs.

    Args:
        records: things with pairs.
        roles: their keys.
        names: labels by id.
    """
    columns = records.part.columns
    is_open = all(plain_key(key) in _EITHER_WAY for key in roles.recipes) and not roles.outputs
    if columns is None and not is_open:
        return 0
    labels = set(names.values())
    items = []
    for row in records.rows:
        items += [(row.get(roles.names[0]), row.get(key)) for key in roles.recipes]
    rows = rows_by_key(items)
    has_ids = any(label in names and label not in labels for row in rows for label in row[1:])
    if has_ids:
        rows = []
    return chosen_place(records.part, rows, PAIR_PLACES, likely=0)


def _made_key(records: Records, roles: _Roles) -> str:
    """Return the key of results: that of outputs, or of names if there is none.

    Raises:
        RecipeFileError: if both name entities, so that a recipe could make either.
    """
    if not roles.outputs:
        return roles.names[0]
    if not roles.names:
        return roles.outputs[0]
    name, output = roles.names[0], roles.outputs[0]
    used = _used_names(records, roles.recipes)
    alike = 0
    others: list[Mapping[str, Any]] = []
    for row in records.rows:
        results = list(map(own_name, results_of(row.get(output), True)))
        if row.get(name) in results:
            alike += 1
        elif results and is_name(row.get(name)) and row[name] in used:
            others.append(row)
    if len(others) > alike:
        row = others[0]
        seen = f"{name!r} {shown(row[name])} and {output!r} {shown(row[output])} both name things"
        raise refusal(records.part.path, f"{seen}; either may be what is made", "json")
    return output


def _used_names(records: Records, recipe_keys: Sequence[str]) -> set[Any]:
    """Return the names and ids that stand in recipes."""
    used: set[Any] = set()
    for row in records.rows:
        for pair in chain.from_iterable(pairs_of(row.get(key)) for key in recipe_keys):
            used.update(name for name in map(own_name, pair) if is_name(name))
    return used
