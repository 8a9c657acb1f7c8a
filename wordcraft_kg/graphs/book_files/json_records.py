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
from wordcraft_kg.graphs.book_files.json_keys import LOOKED_AT, first_keys, pair_keys, refuse_joined
from wordcraft_kg.graphs.book_files.json_objects import (
    PAIR_PLACES,
    PARTNERS,
    results_by_two_keys,
    rows_by_key,
    with_result_at,
    without_wrapper,
)
from wordcraft_kg.graphs.book_files.json_values import (
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
        return first_keys(self.rows)

    def values(self, keys: Sequence[str]) -> list[Any]:
        """Return the values under some keys, object by object; None where a key is missing.

        Args:
            keys: the keys, in the order of the values of one object.
        """
        values: list[Any] = []
        for row in self.rows:
            values += [row.get(key) for key in keys]
        return values


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
    """Return the one recipe of an object with keys like columns, such as a single JSON line.

    Args:
        part: a value in the file.

    Returns:
        The recipe; None for another shape, such as values that are sums.

    Raises:
        RecipeFileError: see :func:`recipes_of_records`.
        ConfigError: if the option `columns` names no key.
    """
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    values = list(value.values())
    is_flat = all(isinstance(each, (str, int, type(None))) for each in values)
    has_sum = any("+" in str(each) for each in values)
    if not is_flat or has_sum:
        return None
    place = part.where or "the object"
    return recipes_of_records(Records(part, [value], [place]))


def list_of_records(part: JsonPart) -> FoundShape | None:
    """Return the recipes of a list of objects: entities with recipes, or recipes with keys.

    Args:
        part: a value in the file.

    Returns:
        The recipes; None for another shape.

    Raises:
        RecipeFileError: see :func:`recipes_of_records`.
        ConfigError: if the option `columns` names no key.
    """
    value = part.value
    if not isinstance(value, list) or not value:
        return None
    if not all(isinstance(row, dict) for row in value):
        return None
    places = [f"{part.where}[{index}]" for index in range(len(value))]
    return recipes_of_records(Records(part, value, places))


def records_by_name(part: JsonPart) -> FoundShape | None:
    """Return the recipes of an object of objects: entities, or recipes, by name.

    Args:
        part: a value in the file.

    Returns:
        The recipes; None for another shape.

    Raises:
        RecipeFileError: see :func:`recipes_of_records`.
        ConfigError: if the option `columns` names no key.
    """
    value = part.value
    if not isinstance(value, dict) or not value:
        return None
    if not all(isinstance(row, dict) for row in value.values()):
        return None
    places = [f"{part.where}['{key}']" for key in value]
    # Objects that have names of their own are under their ids.
    key_name = "id" if all(map(_has_text, value.values())) else "name"
    records = [{key_name: key, **row} for key, row in value.items()]
    # Without such a key the inner keys are ingredients, see results_by_two_keys.
    if not _recipe_keys(records) and not _has_columns(value):
        return None
    return recipes_of_records(Records(part, records, places))


def recipes_of_records(records: Records) -> FoundShape | None:
    """Return the recipes of records, by the names of their keys; None if these do not tell.

    Args:
        records: objects of one kind.

    Raises:
        RecipeFileError: if every ingredient may be one label or several, two keys may both name
            the result, the labels do not tell which of three is the result, or ids are not clear.
        ConfigError: if the option `columns` names no key.
    """
    roles = _roles(records)
    columns = records.part.columns
    are_things = bool(roles.recipes) and bool(roles.outputs or roles.names)
    # Other words in the option `columns` are keys of a table.
    is_free = columns is None or _names_pair(columns)
    if not are_things or not is_free:
        return _rows_of_cells(records)
    partners = _partners(records, roles)
    return _entities(records, roles) if partners is None else partners


def _has_text(row: Mapping[str, Any]) -> bool:
    """Return whether an object has a name that is a text."""
    return any(isinstance(row.get(key), str) for key in TEXT_KEYS)


def _names_pair(columns: Sequence[str]) -> bool:
    """Return whether the option `columns` tells what pairs under a key are."""
    return sorted(column.strip().casefold() for column in columns) == sorted(PAIR_PLACES)


# --- roles of keys -------------------------------------------------------------------------------


def _roles(records: Records) -> _Roles:
    keys = records.keys
    recipes = _recipe_keys(records.rows)
    outputs = [key for key in keys if plain_key(key) in RESULT_KEYS]
    names = []
    for key in NAME_KEYS:
        if any(map(is_name, records.values([key]))):
            names.append(key)
    if not recipes and outputs:
        others = [key for key in keys if key not in outputs]
        recipes = _only_recipe_key(records, others)
    return _Roles(recipes, outputs, names)


def _recipe_keys(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    recipes = []
    for key in first_keys(rows):
        # The name alone says little: "parts" may hold a number of parts.
        is_named = plain_key(key) in RECIPE_KEYS
        if is_named and any(_is_recipes(row.get(key)) for row in rows):
            recipes.append(key)
    return recipes


def _is_recipes(value: Any) -> bool:
    """Return whether a value may hold recipes: a list, an object, or a sum."""
    return isinstance(value, (list, dict)) or (isinstance(value, str) and "+" in value)


def _only_recipe_key(records: Records, keys: Sequence[str]) -> list[str]:
    """Return the only key whose values are all lists of labels or sums, whatever its name."""
    fitting = [key for key in keys if all(map(_is_listed, records.values([key])))]
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
    # A key that also stands outside is a label.
    keys = [key for key in first_keys(rows) if key not in value]
    roles = roles_of_header(keys)
    if roles is not None:
        # One result is enough; further keys of results may be missing here and there.
        needed = {keys[i] for i in (*roles.ingredients, *roles.results[:1])}
        return all(needed <= row.keys() for row in rows)
    pair = pair_keys(rows[0])
    if not pair or not value.keys().isdisjoint(pair):
        return False
    return all(pair_keys(row) == pair for row in rows)


# --- a recipe in each record ---------------------------------------------------------------------


def _rows_of_cells(records: Records) -> FoundShape | None:
    """Records with keys like the columns of a table."""
    keys = records.keys
    columns = records.part.columns
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
        refuse_joined(records.part.path, records.values(parts))

    expected = f"{', '.join(parts)} and {', '.join(made)}"

    def raws() -> Iterator[RawRecipe | Fault]:
        for row, place in zip(records.rows, records.places, strict=True):
            filled = [row[key] for key in parts if row.get(key) not in (None, "")]
            ingredients = _flat(filled)
            results: list[Any] = []
            for key in made:
                results += results_of(row.get(key), True)
            # One piece is what a recipe without a number means, so that nothing is lost.
            dropped = sum(row.get(key) not in (None, "", 1, "1") for key in counts)
            if not ingredients or not results:
                message = f"{place} is {shown(row)}; expected {expected}."
                yield Fault(place, "row", message, "keys")
                continue
            for result in results:
                yield RawRecipe(place, row, ingredients, result, counts=dropped)

    read = (*parts, *made)
    return FoundShape(
        "a list of objects",
        raws(),
        columns=read,
        num_results=len(made),
        ignored=tuple(key for key in keys if key not in read),
    )


def _told_roles(records: Records) -> Roles | None:
    """Return the roles of three keys such as a, b and c, if the labels tell which is the result."""
    keys = records.keys
    if len(keys) != len(PAIR_PLACES) or not all(map(names_ingredient, keys)):
        return None
    rows: list[list[Any]] = []
    for record in islice(records.rows, LOOKED_AT):
        row = [record.get(key) for key in keys]
        if not all(isinstance(cell, str) and cell for cell in row):
            return None
        rows.append(row)
    result = chosen_place(records.part, rows, keys, likely=2)
    ingredients = tuple(place for place in range(3) if place != result)
    return Roles(ingredients, (result,))


def _flat(values: Sequence[Any]) -> list[Any]:
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
    (recipe_key,) = roles.recipes
    name_key = roles.names[0]
    by_name: dict[str, dict[str, Any]] = {}
    for row in records.rows:
        partners = row.get(recipe_key) or {}
        name = row.get(name_key)
        is_map = isinstance(partners, dict) and not pair_keys(partners)
        if not is_map or not isinstance(name, str) or name in by_name:
            return None
        made = list(partners.values())
        # Numbers are amounts of an ingredient, no results.
        has_numbers = any(type(each) is int for each in made)
        if has_numbers or None in map(made_by, made):
            return None
        by_name[name] = {recipe_key: partners}
    _, wrapper, _ = without_wrapper(by_name)
    if not wrapper:
        return None
    found = results_by_two_keys(records.part._replace(value=by_name))
    if found is not None:
        read = (recipe_key, name_key)
        found.ignored = tuple(key for key in records.keys if key not in read)
    return found


def _entities(records: Records, roles: _Roles) -> FoundShape:
    """Objects with a key for recipes or ingredients, and one for the results or the name."""
    path = records.part.path
    # Before any row is read: texts that all hold a comma may be labels or pairs.
    refuse_joined(path, records.values(roles.recipes))
    made = _made_key(records, roles)
    ids = [(row.get("id"), row) for row in records.rows]
    names = names_of_ids(path, ids)
    has_outputs = bool(roles.outputs)
    raws: list[RawRecipe | Fault | LeftOut] = []
    listed: list[Any] = []
    for row, place in zip(records.rows, records.places, strict=True):
        results = results_of(row.get(made), has_outputs)
        if not results and has_outputs and roles.names:
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
            # A thing by its name is an entity of the book also without a recipe.
            if not has_outputs:
                listed += results
        # All ways to make a thing stand in its one object.
        here = f"{place}.{roles.recipes[0]}"
        for pair in chain.from_iterable(held):
            raws += [RawRecipe(here, pair, pair, result) for result in results]
    columns = (*roles.recipes, made)
    ignored = tuple(key for key in records.keys if key not in columns)
    found = FoundShape("a list of objects", raws, listed, columns=columns, ignored=ignored)
    result_place = _result_place(records, roles, names)
    # Place 0 is the usual reading: the object is the result, and its pairs are ingredients.
    if result_place != 0:
        found.columns = places_in_order(PAIR_PLACES, result_place)
        found.raws = with_result_at(iter(raws), result_place)
    return with_names(path, found, names)


def _result_place(records: Records, roles: _Roles, names: Mapping[Any, str]) -> int:
    """Return the place of the result among a thing's name and the labels of its pairs.

    Args:
        records: things with pairs.
        roles: their keys.
        names: labels by id.
    """
    is_either_way = all(plain_key(key) in _EITHER_WAY for key in roles.recipes)
    is_open = is_either_way and not roles.outputs
    if records.part.columns is None and not is_open:
        return 0
    items = []
    for row in records.rows:
        name = row.get(roles.names[0])
        for key in roles.recipes:
            items.append((name, row.get(key)))
    rows = rows_by_key(items)
    # Ids of ingredients, beside a name, say nothing about the result.
    in_pairs = set(chain.from_iterable(row[1:] for row in rows))
    ids = in_pairs.intersection(names).difference(names.values())
    if ids:
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
    name_key = roles.names[0]
    output_key = roles.outputs[0]
    used = _used_names(records, roles.recipes)
    # Records called like their result, and records called like an ingredient of any record.
    alike = 0
    others: list[Mapping[str, Any]] = []
    for row in records.rows:
        name = row.get(name_key)
        results = list(map(own_name, results_of(row.get(output_key), True)))
        if name in results:
            alike += 1
        elif results and is_name(name) and name in used:
            others.append(row)
    if len(others) > alike:
        name = shown(others[0][name_key])
        output = shown(others[0][output_key])
        seen = f"{name_key!r} {name} and {output_key!r} {output} both name things"
        raise refusal(records.part.path, f"{seen}; either may be what is made", "json")
    return output_key


def _used_names(records: Records, recipe_keys: Sequence[str]) -> set[Any]:
    """Return the names and ids that stand in recipes."""
    used: set[Any] = set()
    for value in records.values(recipe_keys):
        for pair in pairs_of(value):
            used.update(filter(is_name, map(own_name, pair)))
    return used
