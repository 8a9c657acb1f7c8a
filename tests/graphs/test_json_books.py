"""JSON that could be read in a wrong way: read as it is meant, or refused with what was seen."""

import json

import pytest

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.graphs import open_book, read_book

MUD = ("earth", "water", "mud")
STEAM = ("fire", "water", "steam")
CLAY = ("earth", "water", "clay")
CLOUD = ("fire", "water", "cloud")
TWO = {MUD, STEAM}
FOUR = {MUD, STEAM, CLAY, CLOUD}
ROWS = [["water", "earth", "mud"], ["fire", "water", "steam"]]
NAMES = ("ingredient_a", "ingredient_b", "result")
ELEMENTS = [{"id": i, "name": n} for i, n in enumerate(("water", "earth", "mud"), 1)]


@pytest.fixture
def put(tmp_path):
    def put(content, name="book.json"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return put


READ = {
    "pandas, default": (
        {name: {str(i): row[at] for i, row in enumerate(ROWS)} for at, name in enumerate(NAMES)},
        TWO,
    ),
    "pandas, index": (
        {str(i): dict(zip(NAMES, row, strict=True)) for i, row in enumerate(ROWS)},
        TWO,
    ),
    "pandas, split": ({"columns": NAMES, "index": [0, 1], "data": ROWS}, TWO),
    "columns": ({name: [row[at] for row in ROWS] for at, name in enumerate(NAMES)}, TWO),
    "cache of a bot": (
        {
            "water+earth": {"result": "mud", "emoji": "x", "isNew": False},
            "fire+water": {"result": "steam", "emoji": "y", "isNew": True},
        },
        TWO,
    ),
    "sums with named results": (
        {"water+earth": {"name": "mud", "emoji": "x"}, "fire+water": {"name": "steam"}},
        TWO,
    ),
    "two keys with properties": (
        {"water": {"earth": {"result": "mud", "emoji": "x"}, "fire": {"result": "steam"}}},
        TWO,
    ),
    "a and b by result": (
        {"mud": {"a": "water", "b": "earth"}, "steam": {"a": "fire", "b": "water"}},
        TWO,
    ),
    "first and second by result": (
        {
            "mud": {"first": "water", "second": "earth"},
            "steam": {"first": "fire", "second": "water"},
        },
        TWO,
    ),
    "labels with amounts": (
        [
            {"name": "mud", "ingredients": [["water", 1], ["earth", 3]], "result": "mud"},
            {"name": "steam", "ingredients": [["fire", 1], ["water", 2]], "result": "steam"},
        ],
        TWO,
    ),
    "some with results": (
        {
            "mud": {"ingredients": [{"name": "water", "amount": 1}, {"name": "earth"}]},
            "steam": {
                "ingredients": [{"name": "fire"}, {"name": "water"}],
                "results": [{"name": "steam", "amount": 2}],
            },
        },
        TWO,
    ),
    "sums with several results": (
        {"water+earth": ["mud", "clay"], "fire+water": ["steam", "cloud"]},
        FOUR,
    ),
    "semicolons with several results": (
        {"water;earth": ["mud", "clay"], "fire;water": ["steam", "cloud"]},
        FOUR,
    ),
    "tuples as keys": ({"('water', 'earth')": "mud", "('fire', 'water')": "steam"}, TWO),
    "lists as keys": ({'["water","earth"]': "mud", '["fire","water"]': "steam"}, TWO),
    "pairs with ids": (
        {
            "mud": [{"id": 1, "ingredient1": "water", "ingredient2": "earth"}],
            "steam": [{"id": 2, "ingredient1": "fire", "ingredient2": "water"}],
        },
        TWO,
    ),
    "pairs with ids of a named thing": (
        [{"name": "mud", "recipes": [{"id": 1, "a": "water", "b": "earth"}]}],
        {MUD},
    ),
    "elements by id": (
        {
            "elements": {
                "1": {"name": "water"},
                "2": {"name": "earth"},
                "3": {"name": "mud", "parents": [[1, 2]]},
            }
        },
        {MUD},
    ),
    "elements next to recipes": (
        {"elements": ELEMENTS, "combinations": [{"first": 1, "second": 2, "result": 3}]},
        {MUD},
    ),
    "a save with ids as text": (
        {
            "items": [
                {"id": "0", "text": "water"},
                {"id": "1", "text": "earth"},
                {"id": "2", "text": "mud", "recipes": [[0, 1]]},
            ]
        },
        {MUD},
    ),
    "a save with a label of digits": (
        {"items": [{"id": 0, "text": "water"}, {"id": 1, "text": "0", "recipes": [[0, 0]]}]},
        {("water", "water", "0")},
    ),
    "elements with a label of digits": (
        [{"id": 1, "name": "water"}, {"id": 2, "name": "1", "recipes": [[1, 1]]}],
        {("water", "water", "1")},
    ),
    "two columns of results": (
        [["in 1", "in 2", "out 1", "out 2"], [*ROWS[0], "clay"], [*ROWS[1], "cloud"]],
        FOUR,
    ),
    "several results in an object": (
        [{"a": "water", "b": "earth", "result": ["mud", "clay"]}],
        {MUD, CLAY},
    ),
    "ingredients in a list": ([[["water", "earth"], "mud"], [["fire", "water"], "steam"]], TWO),
    "a list under any name": (
        [{"elements": row[:2], "result": row[2]} for row in ROWS],
        TWO,
    ),
    "a sum under any name": ([{"pair": "water+earth", "result": "mud"}], {MUD}),
    "objects as results": (
        {"combos": [{"combo": row[:2], "result": {"text": row[2], "emoji": "x"}} for row in ROWS]},
        TWO,
    ),
    "one object": ({"a": "water", "b": "earth", "result": "mud"}, {MUD}),
    "blanks around labels": (
        {"mud": [["water ", "earth"]], " steam": [[" fire", "water"]]},
        TWO,
    ),
    "partners below a key": (
        {"water": {"emoji": "x", "combinations": {"earth": "mud", "fire": "steam"}}, "mud": {}},
        TWO,
    ),
    "partners of named things": (
        [{"name": "water", "combinations": {"earth": "mud", "fire": "steam"}}, {"name": "mud"}],
        TWO,
    ),
    "pairs of partner and result": (
        {
            "water": [["earth", "mud"], ["fire", "steam"]],
            "earth": [["fire", "lava"], ["air", "dust"]],
            "fire": [["air", "smoke"], ["mud", "brick"], ["dust", "ash"]],
        },
        {
            *TWO,
            ("earth", "fire", "lava"),
            ("air", "earth", "dust"),
            ("air", "fire", "smoke"),
            ("fire", "mud", "brick"),
            ("dust", "fire", "ash"),
        },
    ),
    "things by tier": (
        {
            "tier 1": [{"name": "mud", "recipes": [["water", "earth"]]}],
            "tier 2": [{"name": "steam", "recipes": [["fire", "water"]]}],
        },
        TWO,
    ),
    "recipes by tier": (
        {"tier 1": {"mud": [["water", "earth"]]}, "tier 2": {"steam": [["fire", "water"]]}},
        TWO,
    ),
    "pages of a scraper": (
        [
            {"page": i, "items": [{"a": r[0], "b": r[1], "result": r[2]}]}
            for i, r in enumerate(ROWS)
        ],
        TWO,
    ),
    "recipes under an unknown key": (
        {"reactions": [{"reagents": row[:2], "products": [row[2]]} for row in ROWS]},
        TWO,
    ),
    "sums under an unknown key": ({"cache": {"water;earth": {"result": "mud"}}}, {MUD}),
    "names by id": (
        {"elements": {"1": "water", "2": "earth", "3": "mud"}, "recipes": {"3": [["1", "2"]]}},
        {MUD},
    ),
    "names by index": (
        {"items": ["water", "earth", "mud"], "recipes": {"2": [["0", "1"]]}},
        {MUD},
    ),
    "names next to sums of ids": (
        {"names": {"1": "water", "2": "earth", "3": "mud"}, "combos": {"1+2": 3}},
        {MUD},
    ),
    "Nothing of a bot": (
        {
            "Water;Earth": {"result": "Mud"},
            "Fire;Wind": {"result": "Nothing"},
        },
        {("Earth", "Water", "Mud")},
    ),
    "numbers of pieces in and out": (
        [
            {"id": "m", "in": {"water": 1, "earth": 2}, "out": {"mud": 1}},
            {"id": "s", "in": {"fire": 1, "water": 1}, "out": {"steam": 3}},
        ],
        TWO,
    ),
    "keys without meaning": ([dict(zip("xyz", row, strict=True)) for row in ROWS], TWO),
    "a pair with an element as the key's ingredient": ({"mud": [["water", "earth"]]}, {MUD}),
    "common partners": (
        {"water": {"earth": "mud", "fire": "steam"}, "mud": {"fire": "brick"}},
        {*TWO, ("fire", "mud", "brick")},
    ),
}


@pytest.mark.parametrize("case", READ)
def test_json_is_read_as_it_is_meant(put, case):
    content, expected = READ[case]
    book = read_book(put(content))
    assert {tuple(recipe) for recipe in book.recipes} == expected
    reading = book.reading
    assert reading.rows == reading.kept + sum(reading.left_out.values())


REFUSED = {
    "properties": (
        {"water": {"emoji": "W", "category": "liquid"}, "mud": {"emoji": "M", "category": "solid"}},
        "may be properties .'water' has 'emoji' 'W'. or ingredients",
    ),
    "numbers that are properties": (
        {"sword": {"damage": 7, "speed": 2}, "axe": {"damage": 9, "speed": 1}},
        "may be properties .'sword' has 'damage' 7.",
    ),
    "a partner of all": (
        {"water": {"dust": "mud"}, "fire": {"dust": "ash"}},
        "may be properties .'water' has 'dust' 'mud'. or ingredients .water . dust = 'mud'.",
    ),
    "columns with a strange one": (
        {"in1": ["a", "b"], "in2": ["c", "d"], "out": ["e", "f"], "foo": ["g", "h"]},
        "'in1' and 'foo' may be columns of a table, or results.*`columns`",
    ),
    "long lists": (
        {"x": list("abcdefghij"), "y": list("klmnopqrst")},
        "they may be columns, or ingredients",
    ),
    "sums on either side": ({"water+earth": "mud+fire"}, "sums on either side"),
    "commas in keys": (
        {"mud, wet": ["water", "earth"], "steam, hot": ["fire", "water"]},
        "'mud, wet' may be made of .*or be a sum",
    ),
    "a key that is no list": ({"('water', 'earth')": "mud", "('x')": "y"}, "is no list of labels"),
    "an unknown id": (
        {"elements": ELEMENTS, "recipes": [{"a": 1, "b": 9, "result": 3}]},
        "none has the id '9'",
    ),
    "products next to names": (
        [
            {"name": "mud", "parents": [["water", "earth"]], "products": ["brick"]},
            {"name": "brick", "parents": [["mud", "fire"]], "products": ["wall"]},
        ],
        "'name' 'mud' and 'products' .'brick'. both name things",
    ),
    "commas in all ingredients": (
        {"mud": ["water, earth", "rain, dirt"]},
        "'water, earth' may be one label, or water . earth",
    ),
    "commas in a text": (
        [{"name": "mud", "ingredients": "water, earth"}],
        "may be one label, or water . earth",
    ),
    "partners with results": (
        [{"name": "water", "combinations": [{"with": "earth", "makes": "mud"}]}],
        "expected pairs of ingredients",
    ),
    "keys of a pattern": (
        {"torch": {"recipes": {"top": "coal", "bottom": "stick"}}},
        "may be torch . top = coal .*outer,inner,value.* or top . coal = torch .*inner,value,outer",
    ),
    "partners that are like pairs": (
        {"lamp": [["oil", "wick"]]},
        "may be oil . wick = lamp .*first,second,key.* or lamp . oil = wick .*key,first,second",
    ),
    "keys without meaning": (
        [{"a": "oil", "b": "wick", "c": "lamp"}],
        "may be oil . wick = lamp .*a,b,c.* or wick . lamp = oil .*b,c,a",
    ),
    "a single pair of an element": ({"water": [["earth", "mud"]]}, "may be earth . mud = water"),
    "combinations that are like pairs": (
        [{"name": "lamp", "combinations": [["oil", "wick"]]}],
        "may be oil . wick = lamp .*first,second,key",
    ),
    "one pair that is none": (
        {"mud": [{"a": "water", "b": "earth"}, {"x": "rain"}]},
        "expected pairs of ingredients",
    ),
    "many partners": (
        {f"a{i}": [[f"a{i + j}", f"a{(i + j) // 2}"] for j in range(1, 9)] for i in range(12)},
        "may be a1 . a0 = a0 .*first,second,key.* or a0 . a1 = a0 .*key,first,second",
    ),
    "a list for the book": (
        {"mud": ["water", "earth"], "base": ["water", "fire"]},
        "'base' may be a result, or a list for the whole book",
    ),
    "one id twice": (
        {"items": [{"id": 0, "text": "x"}, {"id": 0, "text": "y", "recipes": [[0, 0]]}]},
        "the id 0 belongs to 'x' and 'y'",
    ),
    "ids that are lists": (
        {"items": [{"id": [1], "text": "x", "recipes": [[0, 0]]}]},
        "is not a label",
    ),
    "recipes that are a number": (
        {"items": [{"id": 0, "text": "x", "recipes": 5}]},
        "expected a list of pairs",
    ),
    "text that is a list": ({"items": [{"id": 0, "text": ["x"]}]}, "'text' is no text"),
    "kinds in conflict": (
        {
            "entities": ["a", "b", "c"],
            "recipes": [["a", "b", "c"], ["b", "a", "c"]],
            "kinds": ["k", "m"],
        },
        "has the kind 'm' here, and 'k' above",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_json_that_could_be_read_otherwise_is_refused(put, case):
    content, says = REFUSED[case]
    with pytest.raises(RecipeFileError, match=says):
        read_book(put(content))


def test_two_edges_of_one_recipe_may_not_differ_in_kind(put):
    ends = (("a", "tail"), ("b", "tail"), ("c", "head"))
    incidences = [
        {"edge": edge, "node": node, "direction": side} for edge in (1, 2) for node, side in ends
    ]
    edges = [{"edge": 1, "attrs": {"kind": "k"}}, {"edge": 2, "attrs": {"kind": "m"}}]
    path = put({"network-type": "directed", "edges": edges, "incidences": incidences})
    with pytest.raises(RecipeFileError, match="has the kind 'm' here, and 'k' above"):
        read_book(path)


def test_columns_choose_in_lists_and_are_refused_elsewhere(put):
    lists = put(ROWS)
    assert {tuple(r) for r in read_book(lists, columns=["1", "2", "3"]).recipes} == TWO
    turned = read_book(put([list(NAMES), *ROWS]), columns=["result", "ingredient_b", "1"])
    assert tuple(turned.recipes[0]) == ("earth", "mud", "water")
    strange = put({"x": ["water"], "y": ["earth"], "z": ["mud"]})
    assert {tuple(r) for r in read_book(strange, columns=["x", "y", "z"]).recipes} == {MUD}
    with pytest.raises(ConfigError, match="which has no columns; leave `columns` out"):
        read_book(put({"water+earth": ["mud"]}), columns=["1", "2", "3"])


LAMP = {"lamp": [["oil", "wick"]]}


@pytest.mark.parametrize(
    "content",
    [LAMP, {"lamp": {"oil": "wick"}}, [{"name": "lamp", "combinations": [["oil", "wick"]]}]],
    ids=["pairs", "nested", "named"],
)
def test_columns_choose_what_a_key_with_two_labels_is(put, content):
    words = ("outer", "inner", "value") if isinstance(content, dict) and content != LAMP else ()
    key, first, second = words or ("key", "first", "second")
    path = put(content)
    as_result = read_book(path, columns=[first, second, key])
    assert {tuple(recipe) for recipe in as_result.recipes} == {("oil", "wick", "lamp")}
    as_ingredient = read_book(path, columns=[key, first, second])
    assert {tuple(recipe) for recipe in as_ingredient.recipes} == {("lamp", "oil", "wick")}


@pytest.mark.parametrize("name", [pytest.param("everyday", marks=pytest.mark.slow), "kitchen"])
def test_pairs_of_whole_books_are_read_by_result(put, name):
    recipes = open_book(name).recipes
    for some in (recipes[::10], recipes):
        pairs = {}
        for one, other, result in some:
            pairs.setdefault(result, []).append([one, other])
        assert {*read_book(put(pairs)).recipes} == {*some}


def test_numbers_of_pieces_next_to_labels_are_counted(put):
    row = {"item1": "water", "item1_count": 2, "item2": "earth", "result": "mud", "result_count": 3}
    assert read_book(put([row])).reading.counts_dropped == 2


def test_other_line_separators_may_stand_in_json_lines(put):
    rows = [{"a": a, "b": b, "result": c, "note": "x\u2028y"} for a, b, c in ROWS]
    text = "\n".join(json.dumps(row, ensure_ascii=False) for row in rows)
    assert {tuple(r) for r in read_book(put(text, "book.jsonl")).recipes} == TWO


@pytest.mark.slow
def test_results_named_like_keys_of_a_wrapper_are_results(put):
    """The book everyday makes a book, and the recipes of everything else must not vanish."""
    book = open_book("everyday")
    pairs, sums = {}, {}
    for one, other, result in book.recipes:
        pairs.setdefault(result, []).append([one, other])
        sums.setdefault(result, []).append(f"{one} + {other}")
    assert "book" in pairs
    for content in (pairs, sums):
        assert {*read_book(put(content)).recipes} == {*book.recipes}
