"""Which columns of a table hold ingredients and results: by option, by header, or by the rows.

A table without a header is judged by its rows: a pair of ingredients seldom makes two things, so
the column of results is the one without which the fewest rows share a pair.
"""

import re
from collections.abc import Sequence, Set
from functools import lru_cache
from typing import NamedTuple

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import nearest


def words_of(name: str) -> frozenset[str]:
    """Return the words of a column's name, in lower case; numbers are words.

    Example:
        >>> sorted(words_of("Ingredient2_name")), sorted(words_of("canBeMadeWith"))
        (['2', 'ingredient', 'name'], ['be', 'can', 'made', 'with'])
    """
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[^\W\d_])(?=\d)", " ", name)
    return frozenset(re.findall(r"[^\W_]+", parted.lower()))


KIND = "kind"
"""Name of the optional column with the kind of reasoning behind a recipe."""
_FEWEST_ROWS = 50
_MARGIN = 0.1
"""Without a header: rows needed, and by how much the share of different pairs must be larger.

On whole books the right reading has .95 to 1, the two others .62 to .70 (kitchen, everyday, Little
Alchemy 2, 60,000 rows of Infinite Craft); on samples of 20 rows all three have .85 to 1."""
_RESULT = words_of(
    "result results product products output outputs out outcome makes make creates create "
    "created yields yield child target gives becomes crafted ergebnis resultado resultat "
    "résultat risultato res wynik resultaat sonuç resultatet produit produkt producto prodotto "
    "produto результат 结果 結果 결과"
)
_INGREDIENT = words_of(
    "ingredient ingredients react reactant reactants reagent reagents input inputs component "
    "components parent parents material materials left right first second third fourth "
    "operand combine combines combination combinations zutat zutaten ingrediente ingredientes "
    "ingrédient ingrédients requires ing składnik składniki ingrediënt ingrediënten malzeme "
    "eingabe entrée entrada ингредиент ингредиенты компонент 材料 素材 재료"
)
_SUMS = words_of("recipe recipes")
"""A column of sums, unless others are ingredients: then it names the recipe."""
_WEAK_INGREDIENT = words_of(
    "element item one two three part in with 1 2 3 4 5 6 7 8 9 a b c d e f g h i j x y z"
)
_NAME = words_of("name item element entity thing object block 1")
"""A column with only such words holds the results, if it is the only one left."""
_REUSED = 0.2
"""Share of the labels of a guessed column of results that must be ingredients, too.

Results are ingredients of further recipes: .45 to .92 of them on whole books (everyday, kitchen,
Little Alchemy 2, 189,562 recipes of Infinite Craft)."""
_IGNORED = words_of(
    "id ids emoji icon image url link color colour hash date time user author discovery "
    "discovered discoverer new note notes comment comments description tier level depth "
    "category group type source index no weight score probability rarity price version game"
)
_IDS = frozenset({"id", "ids"})
_COUNT = words_of("count counts amount amounts quantity qty number num pieces")
_PROPERTY = _RESULT | _INGREDIENT | _IGNORED | _COUNT | words_of("name text label title")


class Roles(NamedTuple):
    """The columns that are read, as indices.

    Attributes:
        ingredients: columns of ingredients.
        results: columns of results.
        kind: column of the kinds of reasoning; None without one.
        counts: columns with numbers of pieces, which are not kept.
    """

    ingredients: tuple[int, ...]
    results: tuple[int, ...]
    kind: int | None = None
    counts: tuple[int, ...] = ()

    def shifted(self) -> "Roles":
        """Return the roles of a table with one more column before all others."""
        return Roles(
            ingredients=tuple(i + 1 for i in self.ingredients),
            results=tuple(i + 1 for i in self.results),
            kind=None if self.kind is None else self.kind + 1,
            counts=tuple(i + 1 for i in self.counts),
        )

    @property
    def used(self) -> frozenset[int]:
        """All columns that are read."""
        kind = () if self.kind is None else (self.kind,)
        return frozenset((*self.ingredients, *self.results, *kind))


def roles_of_header(names: Sequence[str]) -> Roles | None:
    """Return the roles of columns by their names, or None if the names do not tell.

    Args:
        names: column names, as in the file.
    """
    words = [words_of(name) for name in names]
    plain = [name.strip().lower() for name in names]
    kind = plain.index(KIND) if KIND in plain else None
    places = range(len(names))
    counts = tuple(i for i in places if words[i] & _COUNT)
    # A column without a name, such as that of row names in R, has no role.
    named = [i for i in places if words[i] and i != kind and i not in counts]
    free = [i for i in named if words[i].isdisjoint(_IGNORED)]
    found = _roles(words, free)
    if found is None:
        # Where all names hold "id", the ids are the labels.
        others = _IGNORED - _IDS
        with_ids = [i for i in named if words[i].isdisjoint(others)]
        found = _roles(words, with_ids)
    if found is None:
        return None
    ingredients, results = found
    return Roles(ingredients, results, kind, counts)


def _roles(
    words: Sequence[frozenset[str]], free: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Return the columns of ingredients and of results, or None if the names do not tell.

    Args:
        words: words of each column's name.
        free: columns that may have a role.
    """
    results = [i for i in free if words[i] & _RESULT]
    others = [i for i in free if i not in results]
    ingredients = [i for i in others if words[i] & _INGREDIENT]
    if not ingredients:
        ingredients = [i for i in others if words[i] & _SUMS]
    names = [i for i in others if "name" in words[i]]
    # Words such as "a" or "item" may be labels of a first recipe, unless a result is named.
    if not ingredients and (results or names):
        ingredients = [i for i in others if words[i] & _WEAK_INGREDIENT]
    rest = [i for i in others if i not in ingredients]
    if ingredients and not results:
        # The only other column must be the result, or the only one that is called a name.
        candidates = rest
        if len(rest) > 1:
            candidates = [i for i in rest if i in names]
        if len(candidates) == 1:
            results = candidates
    elif results and not ingredients and len(rest) == 2:
        # Two other columns beside a result can only be its ingredients.
        ingredients = rest
    if not ingredients or not results:
        return None
    return tuple(ingredients), tuple(results)


def roles_of_option(columns: Sequence[str], names: Sequence[str] | None, width: int) -> Roles:
    """Return the roles that the option `columns` gives: ingredients, and last the result.

    Args:
        columns: names of columns, or numbers from 1.
        names: the table's header; None without one.
        width: number of columns.

    Raises:
        ConfigError: if a column does not exist, or one is named twice.
    """
    by_name: dict[str, int] = {}
    for i, name in enumerate(names or ()):
        # Of columns of one name, the first one is meant.
        by_name.setdefault(name.strip().casefold(), i)
    chosen = []
    for column in columns:
        index = by_name.get(column.strip().casefold())
        # A name goes before a number: a header may hold numbers.
        if index is None and column.strip().isdecimal():
            number = int(column)
            if 1 <= number <= width:
                index = number - 1
        if index is None:
            there = ", ".join(map(repr, names or ())) or f"numbers from 1 to {width}"
            hint = nearest(column, names or ())
            raise ConfigError(f"`columns` {column!r}: no such column; the table has {there}.{hint}")
        chosen.append(index)
    if len(chosen) < 2 or len(set(chosen)) < len(chosen):
        raise ConfigError(
            f"`columns` {','.join(columns)}: expected different columns, of the ingredients and, "
            "last, of the result."
        )
    *ingredients, result = chosen
    kind = by_name.get(KIND)
    if kind in chosen:
        kind = None
    return Roles(tuple(ingredients), (result,), kind)


def result_by_rows(rows: Sequence[Sequence[str]]) -> int | None:
    """Return the index of the result in rows of three cells, or None if the rows do not tell.

    Args:
        rows: rows without a header.

    Returns:
        The index, 0 to 2; always None for fewer than 50 rows.
    """
    if len(rows) < _FEWEST_ROWS:
        return None
    num_rows = len(set(map(tuple, rows)))
    shares = []
    for place in range(3):
        one, other = (each for each in range(3) if each != place)
        # Neither order nor repetition counts: a pair may stand in both orders.
        pairs = {frozenset((row[one], row[other])) for row in rows}
        share = len(pairs) / num_rows
        shares.append((share, place))
    first, second, _ = sorted(shares, reverse=True)
    largest, result = first
    next_largest, _ = second
    if largest - next_largest < _MARGIN:
        return None
    # Where a pair makes several things, a column of machines looks like one of results.
    results = {row[result] for row in rows}
    ingredients = ingredients_of(rows, result)
    return result if are_reused(results, ingredients) else None


def ingredients_of(rows: Sequence[Sequence[str]], result: int) -> set[str]:
    """Return the labels of rows at all places but that of the result.

    Args:
        rows: rows of labels.
        result: index of the result.
    """
    ingredients: set[str] = set()
    for row in rows:
        ingredients.update(row[:result], row[result + 1 :])
    return ingredients


def are_reused(results: Set[str], ingredients: Set[str]) -> bool:
    """Return whether enough labels of a column are ingredients, too, to be those of results.

    Args:
        results: different labels of the column.
        ingredients: different labels of the columns of ingredients.
    """
    reused = results & ingredients
    return len(reused) >= max(_REUSED * len(results), 1)


def names_a_result(name: str) -> bool:
    """Return whether a column's name tells that it holds results, without a look at the rows."""
    words = words_of(name)
    return bool(words & _RESULT) or words <= _NAME


def readings(row: Sequence[str]) -> str:
    """Return two readings of a row of three cells, for a refusal.

    Args:
        row: exactly three cells.
    """
    a, b, c = row
    return f"{a} + {b} = {c} (`columns` 1,2,3) or {b} + {c} = {a} (`columns` 2,3,1)"


def repeated_cells(names: Sequence[str], roles: Roles, rows: Sequence[Sequence[str]]) -> list[str]:
    """Return names of columns that are cells below, too: the header may be a recipe.

    Args:
        names: cells of the first row.
        roles: the columns that are read.
        rows: cells of the rows below, which may be shorter.
    """
    repeated = []
    for column in (*roles.ingredients, *roles.results):
        name = names[column]
        below = {row[column] for row in rows if len(row) > column}
        if name in below:
            repeated.append(name)
    return repeated


@lru_cache(maxsize=10_000)
def names_ingredient(key: str) -> bool:
    """Return whether a key of an object names an ingredient, such as ``first`` or ``b``."""
    words = words_of(key)
    is_ingredient = bool(words & (_INGREDIENT | _WEAK_INGREDIENT))
    is_other = bool(words & (_IGNORED | _COUNT))
    return is_ingredient and not is_other


@lru_cache(maxsize=10_000)
def names_property(key: str) -> bool:
    """Return whether a key of an object names a property of a thing, such as ``emoji``."""
    return bool(words_of(key) & _PROPERTY)
