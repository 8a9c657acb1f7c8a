"""What single JSON values stand for: entities, recipes, results, numbers of pieces."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, islice
from typing import Any

from wordcraft_kg.graphs.book_files.columns import words_of
from wordcraft_kg.graphs.book_files.json_keys import pair_keys
from wordcraft_kg.graphs.recipes import shown

NAME_KEYS = ("text", "name", "item", "id", "label", "title", "tag", "element", "displayName")
"""Keys of an object that stands for an entity, the usual ones first."""
TEXT_KEYS = ("name", "text", "label", "title")
"""Keys of a name, where an id stands beside it."""
_COUNT_KEYS = ("count", "amount", "quantity", "qty", "number")
RECIPE_KEYS = words_of(
    "recipe recipes combinations combination combos canbemadewith madewith madefrom makeswith "
    "ingredients ingredient inputs input components component parents parent reagents "
    "reactants from craftedfrom crafting materials material requires parts pairs"
)
"""Keys of the recipes, or of the ingredients, of a thing."""
RESULT_KEYS = words_of("result results output outputs product products")
ENTITY_LISTS = words_of("elements entities items nodes")
"""Keys of a list of all things, next to their recipes."""
WRAPPERS = ENTITY_LISTS | words_of(
    "recipes data combinations combos results entries content payload book pairs"
)
"""Keys around the recipes, which say nothing about them."""
_MOST_PIECES = 10**12  # a larger number next to a label is no number of pieces


def plain_key(key: str) -> str:
    """Return the letters of a key in lower case.

    Example:
        >>> plain_key("can_be_madeWith")
        'canbemadewith'
    """
    return "".join(char for char in key.lower() if char.isalnum())


# --- entities ------------------------------------------------------------------------------------


def is_name(value: Any) -> bool:
    """Return whether a value may be a label or an id: a text that is not empty, or a number."""
    if isinstance(value, str):
        return bool(value)
    return isinstance(value, int) and not isinstance(value, bool)


def is_entity(value: Any) -> bool:
    """Return whether an object stands for an entity: it has a name, and holds no recipe."""
    if not isinstance(value, dict):
        return False
    has_recipe = any(plain_key(key) in RECIPE_KEYS for key in value)
    has_name = any(is_name(value.get(key)) for key in NAME_KEYS)
    return has_name and not has_recipe and not pair_keys(value)


def own_name(value: Any) -> Any:
    """Return the name of an object that stands for an entity, or any other value as it is."""
    if not isinstance(value, dict):
        return value
    for key in NAME_KEYS:
        if is_name(value.get(key)):
            return value[key]
    return value


# --- recipes -------------------------------------------------------------------------------------


def is_sum(value: Any) -> bool:
    """Return whether a value is a text with a plus between two parts."""
    return isinstance(value, str) and "+" in value.strip("+ ")


def summands(text: str) -> list[str]:
    """Return the parts of a sum; a plus without spaces is part of a label if there is one with."""
    sign = " + " if " + " in text else "+"
    parts = text.split(sign)
    return [part.strip() for part in parts]


def pairs_of(value: Any) -> list[Sequence[Any]]:
    """Return the recipes that a value holds, each as a list of ingredients.

    A list of lists holds several recipes; a list of labels is one recipe, unless each is a sum; an
    object of numbers is one recipe with counts. The number of ingredients is not checked here.

    Returns:
        The recipes; empty for a value that holds none, and if any object in a list is no recipe.
    """
    if isinstance(value, str):
        return [summands(value)] if value.strip() else []
    if isinstance(value, dict):
        return _pairs_of_object(value)
    if not isinstance(value, list) or not value:
        return []
    if all(map(is_sum, value)):
        return [summands(each) for each in value]
    if all(isinstance(each, (str, int)) or is_entity(each) for each in value):
        return [value]
    if all(map(_is_counted, value)):
        ingredients = _with_counts(value)
        return [ingredients]
    if all(isinstance(each, list) for each in value):
        return list(value)
    if all(isinstance(each, dict) for each in value):
        pairs = [pairs_of(each) for each in value]
        # One object that is no recipe must not vanish among others.
        if all(pairs):
            return list(chain.from_iterable(pairs))
    return []


def _pairs_of_object(value: Mapping[str, Any]) -> list[Sequence[Any]]:
    """Return the recipes of an object: an entity, numbers by label, or keys like columns."""
    if any(plain_key(key) in RESULT_KEYS for key in value):
        return []  # a recipe of another thing
    keys = pair_keys(value)
    if keys:
        return [[value[key] for key in keys]]
    if is_entity(value):
        return [[value]]
    if value and all(isinstance(each, (int, float)) for each in value.values()):
        ingredients = _with_counts(value.items())
        return [ingredients]
    if any(isinstance(value.get(key), str) for key in TEXT_KEYS):
        return []  # a thing with its own recipes
    recipes: list[Sequence[Any]] = []
    for key, each in value.items():
        if plain_key(key) in RECIPE_KEYS:
            recipes += pairs_of(each)
    return recipes


def _with_counts(pieces: Iterable[tuple[Any, Any]]) -> list[dict[str, Any]]:
    """Return an object with name and count for each label and its number of pieces."""
    return [{"name": label, "count": number} for label, number in pieces]


def has_count(value: Any) -> bool:
    """Return whether an object names a number of pieces other than one."""
    if not isinstance(value, dict):
        return False
    return any(value.get(key, 1) != 1 for key in _COUNT_KEYS)


def _is_counted(value: Any) -> bool:
    """Return whether a value is a label with a number of pieces, such as ``["iron-plate", 2]``."""
    if not isinstance(value, list) or len(value) != 2:
        return False
    label, number = value
    if not isinstance(label, str):
        return False
    is_number = isinstance(number, (int, float)) and not isinstance(number, bool)
    return is_number and 0 < number < _MOST_PIECES


# --- results -------------------------------------------------------------------------------------


def made_by(value: Any) -> list[Any] | None:
    """Return the results that a value stands for.

    A result is a label, an object with a name, or an object with a key such as ``result``; a list
    holds several.

    Args:
        value: a value of JSON.

    Returns:
        The results. An empty list for an empty value (null, false or an empty text), which says
        that nothing is made; None for a value that is no result, such as a list in a list.
    """
    if isinstance(value, list):
        return _made_by_list(value)
    if isinstance(value, dict):
        outputs = [key for key in value if plain_key(key) in RESULT_KEYS]
        has_recipe = any(plain_key(key) in RECIPE_KEYS for key in value)
        # With ingredients beside the result, the object is a recipe of its own.
        if len(outputs) == 1 and not has_recipe and not pair_keys(value):
            return made_by(value[outputs[0]])
        return [value] if is_entity(value) else None
    if value in (None, "", False):
        return []
    return [value] if is_name(value) else None


def _made_by_list(values: Sequence[Any]) -> list[Any] | None:
    results: list[Any] = []
    for value in values:
        made = None if isinstance(value, list) else made_by(value)
        if made is None:
            return None
        results += made
    return results


def results_of(value: Any, is_output: bool) -> list[Any]:
    """Return the results in a record's value.

    Args:
        value: the value under the key of results, or of the name.
        is_output: whether the key names results, so that a list holds several, and an object
            numbers by product; a name is one result.

    Returns:
        The results, not yet checked; empty for null, an empty text or an empty list.
    """
    if isinstance(value, list) and is_output:
        if all(map(_is_counted, value)):
            return _with_counts(value)
        return [each for each in value if each not in (None, "")]
    if is_output and isinstance(value, dict) and not is_entity(value):
        return list(value)  # numbers by product
    is_empty = value in (None, "", [])
    return [] if is_empty else [value]


# --- words for refusals --------------------------------------------------------------------------


def described(value: Any) -> str:
    """Describe a JSON value for a refusal."""
    if isinstance(value, dict):
        if not value:
            return "an empty JSON object"
        return f"a JSON object with {len(value):,} keys ({_first_keys(value)})"
    if isinstance(value, list):
        size = f"{len(value):,}"
        if not value:
            return f"a JSON list of {size} values"
        if all(isinstance(each, dict) for each in value):
            keys = _first_keys(value[0])
            return f"a JSON list of {size} objects, the first with the keys {keys}"
        return f"a JSON list of {size} values, the first {shown(value[0])}"
    return f"a JSON value, {shown(value)}"


def _first_keys(value: Mapping[str, Any]) -> str:
    return ", ".join(repr(key[:40]) for key in islice(value, 6))
