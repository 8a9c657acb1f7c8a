"""Documented words: names of columns and keys by which a file is read, in many languages.

A column or key whose words are not here has no role, and the option `columns` gives it one. Columns
of a table are paths of one key, so that tables and JSON have one set of rules.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain, takewhile
from string import ascii_lowercase
from typing import NamedTuple

EACH = "[]"
VALUES = "{}"
KEY = "{key}"
LOOPS = (EACH, VALUES)
Path = tuple[str, ...]
"""Steps: ``.name``, ``[]``, ``[3]``, ``{}``, and ``{key}`` for the key that ``{}`` is at."""
_BETWEEN_WORDS = re.compile(
    r"(?<=[a-z])(?=[A-Z])|(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])"
    "|(?<=[\u3040-\ud7af])(?=[A-Za-z])"
)


@lru_cache(maxsize=10_000)
def words_of(name: str) -> frozenset[str]:
    """Return the words of a column's name or a key, in lower case; numbers are words.

    Example:
        >>> sorted(words_of("Ingredient2_name")), sorted(words_of("canBeMadeWith"))
        (['2', 'ingredient', 'name'], ['be', 'can', 'made', 'with'])
    """
    words = re.findall(r"[^\W_]+", _BETWEEN_WORDS.sub(" ", name).lower())
    # East Asian words have no blanks between them.
    inner = [] if name.isascii() else [word for word in _JOINED if word in name]
    return frozenset((*words, *inner))


_JOINED = (
    *("材料", "原料", "素材", "配料", "成分", "食材", "结果", "結果", "产物", "產物", "成品"),
    *("合成", "配方", "完成品", "名称", "名字", "名前", "数量", "재료", "결과", "조합"),
)
"""Documented words of languages without blanks between words."""


KIND = "kind"
"""Name of the optional column with the kind of reasoning behind a recipe."""
QUANTITIES = "quantities"
"""Name of the optional column with a number for each ingredient, in the order of the row."""
CSV_HEADER = ("ingredient_a", "ingredient_b", "result")


def own_header(num_ingredients: int) -> tuple[str, ...]:
    """Return the columns of our own table for recipes of up to as many ingredients, from two.

    Example:
        >>> own_header(3)
        ('ingredient_a', 'ingredient_b', 'ingredient_c', 'result')
    """
    letters = ascii_lowercase[: max(num_ingredients, 2)]
    return (*(f"ingredient_{letter}" for letter in letters), CSV_HEADER[-1])


RESULT = words_of(
    "result results resulting product products output outputs out outcome outcomes makes made make "
    "creates create created creation crafted yield yields child offspring target gives give "
    "becomes target targets produces produced produce dish obtained obtain to "
    "ergebnis ergebnisse resultat resultate produkt produkte ausgabe erzeugt ergibt gericht "
    "résultat résultats produit produits sortie donne plat "
    "resultado resultados producto productos produto produtos salida saída plato prato "
    "risultato risultati prodotto prodotti uscita piatto "
    "resultaat resultaten uitkomst gerecht wynik wyniki rezultat výsledek výsledky "
    "tulos resultatet utfall sonuç sonuc sonuçlar ürün çıktı eredmény hasil "
    "результат результаты продукт выход блюдо результати "
    "结果 結果 结果物 产物 產物 成品 产出 合成结果 完成品 成果物 生成物 결과 결과물 완성품 النتيجة"
)
INGREDIENT = words_of(
    "ingredient ingredients react reacts reactant reactants reagent reagents input inputs "
    "component components constituent constituents sources parent parents material materials "
    "left right first second third fourth operand operands combines combine precursor precursors "
    "substrate substrates educt educts requires require required requirements from needs "
    "zutat zutaten edukt edukte eingabe eingaben bestandteil bestandteile eltern elternteil "
    "ingrédient ingrédients composant composants réactif réactifs entrée entrées matériau "
    "ingrediente ingredientes ingredienti reactivo reactivos reagente reagenti reagentes entrada "
    "entradas materiale materiali componente componenti componentes padre padres "
    "ingrediënt ingrediënten składnik składniki skladnik skladniki ingredience přísada přísady "
    "ingrediens ingredienser ainesosa ainesosat malzeme malzemeler bileşen girdi hozzávaló "
    "hozzávalók összetevő bahan ingredientele ing mats mat "
    "ингредиент ингредиенты компонент компоненты реагент реагенты вход материал материалы "
    "інгредієнт інгредієнти 材料 原料 素材 配料 成分 合成材料 食材 재료 원료 المكونات مكون"
)
SUMS = words_of(
    "recipe recipes combination combinations combo combos pair pairs formula formulas formulae "
    "crafting craft crafts reaction reactions mix mixes fusion fusions "
    "rezept rezepte recette recettes receta recetas ricetta ricette receita receitas "
    "recept recepten przepis рецепт рецепты 配方 合成 レシピ 조합 조합법"
)
"""A key or column of whole recipes, unless others are ingredients: then it names the recipe."""
ORDINAL = words_of(
    "one two three four 1 2 3 4 5 6 7 8 9 10 11 12 a b c d e f g h i j x y primary secondary other"
)
WEAK = ORDINAL | words_of("element elements item items part parts in thing things slot")
"""Ingredients only beside a result that is named."""
NAME = (
    *("name", "text", "label", "title", "nombre", "nom", "nome", "naam", "nazwa", "название"),
    *("имя", "名称", "名字", "名前", "이름", "item", "element", "tag", "entity", "thing"),
    *("object", "block", "word", "resource", "fluid", "formula"),
)
"""Keys and columns that name a thing, the more certain ones first."""
ID = words_of("id ids uid uuid key slug code symbol emoji icon identifier index no nr")
"""Keys and columns that may name a thing in a second way."""
COUNT = words_of(
    "count counts amount amounts quantity quantities qty number num pieces menge anzahl cantidad "
    "quantité quantité quantita quantidade hoeveelheid ilość количество 数量 개수 stack min max"
)
IGNORED = words_of(
    "image images img url urls link links href path color colour hash date time times user author "
    "discovery discovered discoverer isnew note notes comment comments description desc tier "
    "level depth category categories group type types weight score probability rarity price value "
    "version game source effect effects chance unit units xp duration station machine tool method "
    "relation predicate gender sex energy percent percentage rate mod modid wiki instructions steps"
)
_FORWARD = tuple(
    words_of(words)
    for words in (
        *("can make", "can create", "used in", "used for", "usedfor", "uses", "usage", "usages"),
        *("ingredient of", "into", "makes with", "by product"),
    )
)
"""Words of keys that list what a thing is used for, not what makes it."""
CONTAINERS = SUMS | words_of(
    "items elements entities things objects names ingredients results products"
)
"""Keys of a file's lists of recipes or things."""
_BY = words_of("with from of by using")
_FIRST = ORDINAL | words_of("first second third fourth left right")
_SLOT = WEAK | ID | {"name"}
_NAMES = frozenset(NAME)
_KNOWN = RESULT | INGREDIENT | CONTAINERS | ID
_PROPERTIES = COUNT | IGNORED


class Way(NamedTuple):
    """A way to read columns or keys.

    Attributes:
        parts: paths of the ingredients.
        results: paths of the results.
        is_named: whether the results are named as results, not only as a thing.
        is_documented: whether all words are documented; the others are guesses for refusals.
        by_keys: whether keys are labels, as in {"mud": [["water", "earth"]]}.
        is_order: whether it is one of three orders of columns whose names say nothing.
    """

    parts: tuple[Path, ...]
    results: tuple[Path, ...]
    is_named: bool = True
    is_documented: bool = True
    by_keys: bool = False
    is_order: bool = False


def is_plain(key: str) -> bool:
    """Return whether a key may hold labels: no numbers of pieces, no properties, no uses."""
    words = words_of(key)
    is_forward = any(forward <= words for forward in _FORWARD)
    return bool(words) and words.isdisjoint(_PROPERTIES) and not is_forward


def is_name(key: str) -> bool:
    """Return whether a key names a thing, such as ``name`` or ``display_name``."""
    words = words_of(key)
    return bool(words & _NAMES) and is_plain(key) and words.isdisjoint(ID)


def is_id(key: str) -> bool:
    """Return whether a key identifies a thing in another way than by its name."""
    return bool(words_of(key) & ID) and is_plain(key)


def is_documented(key: str) -> bool:
    """Return whether a key is a word of recipes or things, so that it is hardly a label."""
    return not words_of(key).isdisjoint(_KNOWN) or is_name(key)


def names_thing(key: str) -> bool:
    """Return whether a key of an object holds the label of the thing, such as ``ingredient``."""
    is_role = bool(words_of(key) & (INGREDIENT | RESULT | ID))
    return is_name(key) or (is_plain(key) and is_role)


def name_rank(key: str) -> int:
    """Return how certainly a key names a thing: 0 is most certain."""
    words = words_of(key)
    ranks = [rank for rank, word in enumerate(NAME) if word in words]
    # A name with further words, such as item_name, comes after all plain ones; then ids.
    return (ranks[0] if ranks else 2 * len(NAME)) + len(NAME) * (len(words) > 1)


def _role(path: Path) -> tuple[str, int]:
    """Return the role of the labels at a path, and the place of the step that tells it."""
    # The keys of a map name things.
    is_inside = path[-1:] == (KEY,)
    for at in range(len(path) - 1, -1, -1):
        if not path[at].startswith("."):
            continue
        key = path[at][1:]
        words = words_of(key)
        if not is_plain(key) or key.strip().lower() == KIND:
            return "ignored", at
        if words & RESULT and words & _BY:
            return "sum", at  # such as canBeMadeWith
        if words & RESULT:
            return "result", at
        if words & INGREDIENT or words == {"in"}:
            # Lists of objects within a list of ingredients are rather choices, as in Minecraft.
            are_choices = path[at + 1 : at + 3] == (EACH, EACH) and len(path) > at + 3
            return ("ignored" if are_choices else "part"), at
        num_loops = sum(step in LOOPS for step in path[at:])
        # A formula names a thing, as in {"reactants": [{"formula": "H2"}]}.
        is_inside = is_inside or ("formula" in words and path[at - 1] in LOOPS and at > 2)
        is_numbered = bool(words & SUMS and words & ORDINAL)  # combinationA: {"name": ...}
        if is_numbered or (words & SUMS and (not is_inside or num_loops > 1)):
            return "sum", at
        is_slot = bool(words & ORDINAL) or (words <= WEAK and num_loops > 0)
        if words <= _SLOT and is_slot and not is_inside:
            return "slot", at
        if not is_name(key) and not words & ID:
            # A container of things may have any name.
            return ("thing" if is_inside else "unknown"), at
        is_inside = True
    return "thing", len(path)


def _around(path: Path, at: int) -> Path:
    """Return a path up to the last list or object before a place."""
    loops = [i for i, step in enumerate(path[:at]) if step in LOOPS]
    return path[: loops[-1] + 1] if loops else ()


def _families(paths: Iterable[Path]) -> list[tuple[Path, ...]]:
    """Return paths in groups that differ in numbers of keys only, as ingredient 1 and 2 do."""
    families: dict[tuple[object, ...], list[Path]] = {}
    for path in paths:
        steps = (words_of(step[1:]) - _FIRST if step.startswith(".") else step for step in path)
        families.setdefault(tuple(steps), []).append(path)
    return list(map(tuple, families.values()))


def _plain_words(family: Iterable[Path]) -> frozenset[str]:
    """Return the words of the last keys, without those that tell ids from names."""
    keys = [[step for step in path if step.startswith(".")][-1] for path in family]
    return frozenset(chain.from_iterable(map(words_of, keys))) - ID - _NAMES - _FIRST


def _common(paths: Sequence[Path]) -> Path:
    """Return the steps with which all paths begin."""
    steps = zip(*paths, strict=False)
    return tuple(level[0] for level in takewhile(lambda level: len(set(level)) == 1, steps))


def _is_around(thing: Path, path: Path) -> bool:
    """Return whether the object with a thing's name holds what is at a path."""
    outer = _around(thing, len(thing))
    return bool(outer) and path[: len(outer)] == outer and thing != path


def _rank(thing: Path) -> tuple[int, int]:
    """Return a key by which the innermost thing comes first, and its name before id and key."""
    rank = 4 * len(NAME) if thing[-1] == KEY else name_rank(thing[-1][1:])
    return -len(_around(thing, len(thing))), rank


def ways_by_words(paths: Iterable[Path]) -> Iterator[Way]:
    """Yield the ways in which documented words let labels be read, the more certain ones first.

    Args:
        paths: paths of all labels. Those of a table are ``[]`` and a name.
    """
    by_role: dict[str, dict[Path, int]] = {}
    for path in paths:
        role, at = _role(path)
        by_role.setdefault(role, {})[path] = at
    results = by_role.get("result", {})
    things = sorted(by_role.get("thing", {}), key=_rank)
    unknown = tuple(by_role.get("unknown", ()))
    slots = [family for family in _families(by_role.get("slot", {})) if results or things]
    slots = [family for family in slots if len(family) > 1 or family[0][-1] in LOOPS]
    parts = _families(by_role.get("part", {}))
    # Words such as first, or a name, are parts of recipes only where nothing else is.
    families = parts or _families(by_role.get("sum", {})) or slots
    # Ingredients under several words, such as an optional one, may all belong to a recipe.
    different = {_plain_words(family): family for family in parts}
    if len(different) == 2:
        families = [*families, tuple(chain.from_iterable(different.values()))]
    # Two columns of other names beside a result are rather its ingredients: a guess.
    if not families and len(unknown) in (1, 2):
        yield from (
            Way(unknown, result_family, is_documented=False) for result_family in _families(results)
        )
    for family in families:
        around = _common(family)
        for result_family in _families(results):
            outer = _around(result_family[0], results[result_family[0]])
            # Lists that no list holds together are columns, or one recipe.
            are_columns = EACH in result_family[0] and not _around(around, len(around))
            if around[: len(outer)] == outer and not are_columns:
                yield Way(family, result_family)
        near = (thing for thing in things if _is_around(thing, around))
        yield from (Way(family, (thing,), is_named=False) for thing in near)
        guesses = (guess for guess in unknown if _is_around(guess, around))
        yield from (Way(family, (guess,), False, False) for guess in guesses)
