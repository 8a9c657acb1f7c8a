"""Documented words: names of columns and keys by which a file is read, in many languages.

A column or key whose words are not here has no role, and the option `columns` gives it one. Columns
of a table are paths of one key, so that tables and JSON have one set of rules.
"""

import re
from collections.abc import Iterable, Iterator, Set
from functools import lru_cache
from itertools import chain
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
_ROLES = INGREDIENT | RESULT | SUMS | ORDINAL | {"in"}


class Way(NamedTuple):
    """A way to read columns or keys.

    Attributes:
        parts: paths of the ingredients.
        results: paths of the results.
        is_named: whether the results are named as results, not only as a thing or a key.
        is_documented: whether all words are documented; the others are guesses, which refuse.
    """

    parts: tuple[Path, ...]
    results: tuple[Path, ...]
    is_named: bool = True
    is_documented: bool = True


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


def name_rank(key: str) -> int:
    """Return how certainly a key names a thing: 0 is most certain."""
    words = words_of(key)
    ranks = [rank for rank, word in enumerate(NAME) if word in words]
    # A name with further words, such as item_name, comes after all plain ones; then ids.
    return (ranks[0] if ranks else 2 * len(NAME)) + len(NAME) * (len(words) > 1)


def has_role(key: str) -> bool:
    """Return whether a key has a word for ingredients, results or recipes."""
    return not words_of(key).isdisjoint(_ROLES)


def _role(path: Path, *, is_list: bool) -> str:
    """Return the role of a column by the words of its key."""
    key = path[-1][1:] if path[-1].startswith(".") else ""
    words = words_of(key)
    is_numbered = bool(words & ORDINAL)
    roles = (
        (path[-1] == KEY, "thing"),
        (not is_plain(key) or key.strip().lower() == KIND, "ignored"),
        (bool(words & RESULT) and bool(words & _BY), "sum"),  # such as canBeMadeWith
        (bool(words & RESULT), "result"),
        (bool(words & INGREDIENT) or words == {"in"}, "part"),
        (bool(words & SUMS), "sum"),
        (words <= _SLOT and (is_numbered or (is_list and words <= WEAK)), "slot"),
        (is_name(key) or bool(words & ID), "thing"),
    )
    return next((role for is_role, role in roles if is_role), "unknown")


def _families(paths: Iterable[Path]) -> list[tuple[Path, ...]]:
    """Return paths in groups that differ in numbers of keys only, as ingredient 1 and 2 do."""
    families: dict[frozenset[str], list[Path]] = {}
    for path in paths:
        families.setdefault(words_of(path[-1][1:]) - _FIRST, []).append(path)
    return list(map(tuple, families.values()))


def ways_by_words(paths: Iterable[Path], lists: Set[Path] = frozenset()) -> Iterator[Way]:
    """Yield the ways in which documented words let columns be read, the more certain ones first.

    Args:
        paths: paths of all columns. Those of a table are ``[]`` and a name.
        lists: paths of columns with lists.
    """
    by_table: dict[Path, list[Path]] = {}
    for path in paths:
        loops = [at for at, step in enumerate(path) if step in LOOPS]
        if loops and path[-1] not in LOOPS:
            by_table.setdefault(path[: loops[-1] + 1], []).append(path)
    for columns in by_table.values():
        by_role: dict[str, list[Path]] = {}
        for path in columns:
            by_role.setdefault(_role(path, is_list=path in lists), []).append(path)
        results = _families(by_role.get("result", ()))
        things = sorted(by_role.get("thing", ()), key=_rank)
        slots = _families(by_role.get("slot", ())) if results or things else []
        slots = [family for family in slots if len(family) > 1 or family[0] in lists]
        parts = _families(by_role.get("part", ()))
        # Words such as first, or a name, are parts of recipes only where nothing else is.
        families = parts or _families(by_role.get("sum", ())) or slots
        # Ingredients under several words, such as an optional one, may all belong to a recipe; in
        # a list, they surely do.
        different = {_plain_words(family): family for family in parts}
        if len(different) > 1:
            union = tuple(chain.from_iterable(different.values()))
            families = [union] if not lists.isdisjoint(union) else [*families, union]
        for family in families:
            yield from (Way(family, result_family) for result_family in results)
            yield from (Way(family, (thing,), is_named=False) for thing in things)


def _plain_words(family: Iterable[Path]) -> frozenset[str]:
    """Return the words of keys, without those that tell ids from names."""
    words = chain.from_iterable(words_of(path[-1][1:]) for path in family)
    return frozenset(words) - ID - _NAMES - _FIRST


def _rank(thing: Path) -> int:
    """Return a key by which names come before ids and the keys of a map."""
    return 4 * len(NAME) if thing[-1] == KEY else name_rank(thing[-1][1:])


@lru_cache(maxsize=1_000)
def label_key(keys: tuple[str, ...]) -> str | None:
    """Return the key of an object with the label of a thing.

    Args:
        keys: all keys.

    Returns:
        The key; None without one, or for a record, which has keys of several roles.
    """
    roles = [key for key in keys if has_role(key) and is_plain(key)]
    names = [key for key in keys if key not in roles and (is_name(key) or is_id(key))]
    has_one_role = len(roles) + bool(names) == 1
    is_result = any(words_of(key) & RESULT for key in roles)
    return min([*roles, *names], key=name_rank) if has_one_role and not is_result else None
