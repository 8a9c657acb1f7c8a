"""The rule of the reader: each kind of wrong reading is read right, or refused with commands that work."""

import json
import random
import re

import pytest
from hypothesis import given, strategies as st

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.graphs import open_book, read_book
from wordcraft_kg.graphs.book_check import check_book

ROWS = (
    ("water", "earth", "mud"),
    ("water", "fire", "steam"),
    ("earth", "fire", "lava"),
    ("lava", "air", "stone"),
    ("mud", "fire", "brick"),
    ("brick", "stone", "wall"),
)

NAMES = sorted({label for row in ROWS for label in row})

IDS = {name: number for number, name in enumerate(NAMES, 1)}

KITCHEN = tuple(map(tuple, open_book("kitchen").recipes))


def records(*keys, rows=ROWS, **more):
    return [{**dict(zip(keys, row, strict=True)), **more} for row in rows]


def listed(parts, result, rows=ROWS, **more):
    return [{parts: [a, b], result: c, **more} for a, b, c in rows]


def cells(header, *columns, rows=ROWS):
    return header + "\n" + "".join(",".join(f(*row) for f in columns) + "\n" for row in rows)


def first(a, b, c):
    return a


def second(a, b, c):
    return b


def result(a, b, c):
    return c


READ = {
    # The result under another key than the row's id or name.
    **{
        f"result under {key}": listed(parts, key, id=7)
        for parts, key in (
            ("ingredients", "resultId"),
            ("inputs", "output_item"),
            ("reactants", "produces"),
            ("zutaten", "ergebnis"),
            ("ingredientes", "plato"),
            ("ингредиенты", "результат"),
            ("材料", "结果"),
            ("素材", "完成品"),
            ("재료", "결과"),
            ("składniki", "wynik"),
            ("malzemeler", "sonuç"),
        )
    },
    "a recipe's own name": [
        {"name": f"Make {c}", "inputs": [a, b], "gives": c} for a, b, c in ROWS
    ],
    # One ingredient is no pair.
    "item and path": [
        {"name": c, "ingredients": [{"item": x, "item_path": f"/{x}", "count": 2} for x in (a, b)]}
        for a, b, c in ROWS
    ],
    "item and its name": [
        {"name": c, "ingredients": [{"item": x, "item_name": x.title()} for x in (a, b)]}
        for a, b, c in ROWS
    ],
    "ingredient and quantity": [
        {"id": 1, "name": c, "ingredients": [{"ingredient": a, "quantity": 2}, {"ingredient": b}]}
        for a, b, c in ROWS
    ],
    # Counts and effects are no labels.
    "effects beside": listed("ingredients", "result", effects=["heals"], power=3),
    "counts in columns": cells(
        "Item,Station,Ingredient 1,Qty 1,Ingredient 2,Qty 2",
        *(result, lambda a, b, c: "Oven", first, lambda a, b, c: "2"),
        *(second, lambda a, b, c: "1"),
    ),
    # Lists in cells, and other signs between names.
    **{
        f"sign {sign.strip()}": [{"name": c, "recipes": [f"{a}{sign}{b}"]} for a, b, c in ROWS]
        for sign in (" + ", "+", ", ")
    },
    "numbered objects": [
        {
            "combinationA": {"name": a, "emoji": "x"},
            "combinationB": {"name": b, "emoji": "y"},
            "result": {"name": c, "emoji": "z"},
        }
        for a, b, c in ROWS
    ],
    "labels that are words of columns": cells(
        "a,b,result,type,note",
        *(first, second, result, lambda a, b, c: "item", lambda a, b, c: "n"),
    ),
    "comments between rows": "a,b,result\n" + "".join(f"# part\n{a},{b},{c}\n" for a, b, c in ROWS),
    # Groups and containers.
    "tiers": {f"tier {i}": {c: {"recipe": [a, b]}} for i, (a, b, c) in enumerate(ROWS)},
    "groups of a list": {
        "groups": [
            {"name": "Air", "elements": [{"name": c, "reactions": [[a, b]]} for a, b, c in ROWS]}
        ]
    },
    "an API's page": {"count": 6, "results": listed("ingredients", "name", url="https://a")},
    "two keys": {
        "water": {"earth": "mud", "fire": "steam"},
        "earth": {"fire": "lava"},
        "lava": {"air": "stone"},
        "mud": {"fire": "brick"},
        "brick": {"stone": "wall"},
    },
}


def recipes(book):
    return {tuple(recipe) for recipe in book.recipes}


def expected(rows):
    return {(*sorted(row[:2]), row[2]) for row in rows}


@pytest.mark.parametrize("case", READ)
def test_a_file_is_read_as_it_is_meant(put, case):
    book = read_book(put(READ[case], "book.txt"))
    assert recipes(book) == expected(ROWS)
    reading = book.reading
    assert reading.rows == reading.kept + sum(reading.left_out.values())


CHEMISTRY = [(f"a{i}", f"b{i}", f"c{i}") for i in range(30)]


def test_a_book_that_does_not_hang_together_is_refused_with_the_command_that_reads_it(put):
    path = put(records("reactant 1", "reactant 2", "product", rows=CHEMISTRY), "book.txt")
    with pytest.raises(RecipeFileError, match=r"a0 \+ b0 = c0 \(--columns") as caught:
        read_book(path)
    (columns,) = re.findall(r"--columns '([^']+)'", str(caught.value))
    assert recipes(read_book(path, columns=columns.split(","))) == expected(CHEMISTRY)


@pytest.mark.parametrize("form", ["wool:{}", "C=C{}", "item_{}", "元素{}", "2-thing {}"])
def test_numbers_and_signs_in_all_labels_are_parts_of_names(put, form):
    rows = [tuple(form.format(IDS[label]) for label in row) for row in ROWS]
    assert recipes(read_book(put(records("a", "b", "result", rows=rows), "book.txt"))) == expected(
        rows
    )


BY_PATHS = {
    "[][0],[][1],[][2]": list(map(list, ROWS)),
    "[][0][],[][1]": [[[a, b], c] for a, b, c in ROWS],
    "[][0][0],[][1][0],[][2][0]": [[[x, chr(0x1F300 + IDS[x])] for x in row] for row in ROWS],
    "{key},{}": {f"{a}+{b}": c for a, b, c in ROWS},
    "{key},{}.result": {f"{a};{b}": {"result": c, "emoji": "x"} for a, b, c in ROWS},
    "{},{key}": {c: f"{a} + {b}" for a, b, c in ROWS},
    "{}{key},{key}": {c: {a: 1, b: 3} for a, b, c in ROWS},
    "[].in{key},[].products{key}": [{"in": {a: 1, b: 3}, "products": {c: 1}} for a, b, c in ROWS],
    "[].ingredients[][0],[].name": [
        {"name": c, "ingredients": [[a, 1], [b, 3]]} for a, b, c in ROWS
    ],
    "[].name,[].combinations[].with,[].combinations[].makes": [
        {"name": a, "combinations": [{"with": b, "makes": c}]} for a, b, c in ROWS
    ],
}


@pytest.mark.parametrize("columns", BY_PATHS)
def test_json_of_other_shapes_is_refused_and_read_by_paths(put, columns):
    path = put(BY_PATHS[columns], "book.txt")
    with pytest.raises(RecipeFileError):
        read_book(path)
    assert recipes(read_book(path, columns=columns.split(","))) == expected(ROWS)


PARTNERS = {"water": [["earth", "mud"], ["fire", "steam"]], "earth": [["fire", "lava"]]}


def test_two_readings_are_refused_with_both_commands(put):
    path = put(PARTNERS, "book.txt")
    with pytest.raises(RecipeFileError, match="two readings fit") as caught:
        read_book(path)
    columns = re.findall(r"--columns '([^']+)'", str(caught.value))
    found = [recipes(read_book(path, columns=each.split(","))) for each in columns]
    assert expected(ROWS[:3]) in found
    assert len(found) == 2


NO_WORDS = "no documented words name ingredients and a result"

EMOJI = [
    {
        "elements": [chr(0x1F300 + IDS[a]), chr(0x1F300 + IDS[b])],
        "result": {"emoji": chr(0x1F300 + IDS[c]), "name": c},
    }
    for a, b, c in ROWS
]

REFUSED = {
    # One thing under two names.
    "ids in objects": (
        [
            {"id": IDS[c], "name": c, "ingredients": [{"id": IDS[x], "amount": 2} for x in (a, b)]}
            for a, b, c in ROWS
        ],
        "the file has '[].id', '[].name', '[].ingredients'",
    ),
    "emoji": (EMOJI, "0 of 6 results are ingredients of other recipes"),
    "slugs of a few": (
        [{"slug": f"{c}_x", "title": c, "recipe": [f"{a}_x", f"{b}_x"]} for a, b, c in ROWS[:1]],
        "0 of 1 results are ingredients of other recipes",
    ),
    "ids by key": (
        {
            "names": {str(IDS[n]): n for n in NAMES},
            "recipes": {str(IDS[c]): [[str(IDS[a]), str(IDS[b])]] for a, b, c in ROWS},
        },
        NO_WORDS,
    ),
    "ids in a table": (
        cells(
            "in 1,in 2,name",
            *(lambda a, b, c: str(IDS[a]), lambda a, b, c: str(IDS[b]), result),
        ),
        NO_WORDS,
    ),
    "an unknown key of results": (
        [
            {"name": f"Recipe {i}", "ingredients": [a, b], "zorkel": c}
            for i, (a, b, c) in enumerate(ROWS)
        ],
        "0 of 6 results are ingredients of other recipes",
    ),
    "unknown keys": (records("foo", "bar", "baz"), "the file has '[].foo', '[].bar', '[].baz'"),
    "a named result that is used nowhere, beside a key with ingredients": (
        [{"ingredients": [a, b], "result": f"energy {c}", "zorkel": c} for a, b, c in ROWS],
        "0 of 6 results are ingredients of other recipes",
    ),
    # Numbers of pieces in forms that are not read never stay in labels.
    **{
        f"pieces as {form}": (
            cells(
                "ingredients,result",
                lambda a, b, c, form=form: f"{form.format(a, 2)};{form.format(b, 3)}",
                result,
            ),
            "holds a number",
        )
        for form in ("{0}: {1}", "{0}:{1}", "{1}x{0}", "{1}-{0}", "鱼{0}鱼{1}")
    },
    "pieces in brackets": (
        "ingredients,result\negg (1);milk (2),omelet\noil (2);salt (1),dip\n",
        "'egg (1)' holds a number",
    ),
    "a remark as ingredient": (
        {**{x: [["from start."]] for x in "ab"}, **{c: [[a, b]] for a, b, c in ROWS}},
        "name the right columns",
    ),
    "lines in a list of cells": (
        [{"name": c, "recipe": f"{c} = {a} + {b}"} for a, b, c in ROWS],
        "holds the sign of a recipe",
    ),
    "addresses": (cells("a,b,result", lambda a, b, c: f"https://x.org/{a}", second, result), "://"),
    "tags": (cells("a,b,result", lambda a, b, c: f"<b>{a}</b>", second, result), "holds markup"),
    "ids of rows beside an unknown key of results": (
        [{"id": f"{a}-{b}-{c}", "ingredients": [a, b], "gizmo": c} for a, b, c in ROWS[:6]],
        "0 of 6 results are ingredients of other recipes",
    ),
    "choices in a list": (
        [
            {"parts": [{"item": a, "n": 2}, {"item": [b, "oak"], "n": 1}], "result": c}
            for a, b, c in ROWS
        ],
        NO_WORDS,
    ),
    "numbers beside words of columns": (
        "Ingredient Name,First Effect,Strength,Second Effect\n"
        + "".join(f"{a},Weakness to {b},3,30\n" for a, b, c in ROWS),
        NO_WORDS,
    ),
    "choices of two": (
        cells("a,b,result", lambda a, b, c: f"{a} or oak", second, result),
        "holds a choice",
    ),
    "pairs below the name of a list": (
        {"data": {f"{a},{b}": c for a, b, c in ROWS}},
        NO_WORDS,
    ),
    "triples below the name of a list": ({"data": ROWS}, NO_WORDS),
    "numbers of pieces that are ids as well": (
        {
            "items": [{"id": IDS[n], "name": n} for n in NAMES],
            "recipes": {c: [[a, 2], [b, 1]] for a, b, c in ROWS},
        },
        "a number beside a name",
    ),
    "ids of things that have no row": (
        cells(
            "id,name,input 1 id,input 2 id",
            *(lambda a, b, c: str(IDS[c]), result),
            *(lambda a, b, c: str(IDS[a]), lambda a, b, c: str(IDS[b])),
        ),
        NO_WORDS,
    ),
    "ids beside numbers of pieces": (
        [{"first": IDS[a], "second": IDS[b], "result": f"2 {c}"} for a, b, c in ROWS],
        "is a number, no name",
    ),
    "markup in another column of results": (
        cells(
            "needs,title,makes",
            *(lambda a, b, c: f"{a} + {b}", lambda a, b, c: f"**{c}**", first),
        ),
        "has quotes or markup",
    ),
    "emoji before names of results": (
        cells("a,b,result", first, second, lambda a, b, c: f"\N{FIRE} {c}"),
        "with other signs",
    ),
    "emoji as results": (
        cells("a,b,result", first, second, lambda a, b, c: chr(0x1F300 + IDS[c])),
        "is a sign",
    ),
    "lines of A x B": (
        "".join(f"{a} x {b} = {c}\n" for a, b, c in ROWS),
        "no lines a + b = c with a sign",
    ),
    "properties": (
        {"water": {"emoji": "W", "kind": "wet"}, "mud": {"emoji": "M", "kind": "x"}},
        NO_WORDS,
    ),
    "numbers that are properties": (
        {"axe": {"damage": 7, "speed": 2}, "bow": {"damage": 9}},
        NO_WORDS,
    ),
    "effects as result": (
        [{"ingredients": ["herb", "salt"], "result": {"energy": 40}}],
        "result{key}",
    ),
    "potions by effects": ([{"name": n, "effects": ["heal", "rest"]} for n in NAMES], "effects"),
    "uses": ([{"name": a, "usedIn": [c]} for a, _, c in ROWS], "usedIn"),
    "edges": ([{"source": a, "target": c} for a, _, c in ROWS], "target"),
    "items without recipes": ([{"name": n, "weight": 3} for n in NAMES], "'[].name', '[].weight'"),
    "cooking of many dishes": (
        [{"name": f"dish {i}", "ingredients": [f"a{i % 7}", f"b{i % 5}"]} for i in range(40)],
        "0 of 40 results are ingredients of other recipes",
    ),
    "other cases": (
        listed("inputs", "output", rows=[(a, b, c.upper()) for a, b, c in KITCHEN]),
        "--case fold",
    ),
    "parts in rows": (
        "id,ingredient,result\n" + "".join(f"1,{a},{c}\n1,{b},{c}\n" for a, b, c in ROWS),
        "most rows have one ingredient",
    ),
    "choices of two ingredients": (
        [{"ingredients": [[a, "oak"], [b, "fir"]], "result": c} for a, b, c in ROWS],
        "may be choices of an ingredient",
    ),
    "choices beside ingredients": (
        [{"ingredients": [["oak", "fir"], "coal"], "result": "x"}],
        "may be choices of an ingredient",
    ),
    "numbers as results": (
        "a,b,result\nwater,earth,12\nfire,sand,13\n",
        "line 2: '12' is a number, no name",
    ),
    "weights": ("a,b,weight\nwater,earth,0.5\nfire,sand,0.25\n", "weight"),
    "merged cells": ("a,b,result\nwater,earth,mud\n,fire,steam\n", "line 3: a blank cell before"),
    "a missing value": ("a,b,result\nice,NA,water\n", "line 2: 'NA' may be a missing value"),
    "or": ("Result,Recipe\nmud,water + earth or rain + dirt\n", "'or' between them"),
    "breaks": ("Result,Recipe\nmud,water + earth<br>rain + dirt\n", "'<br>' between them"),
    "another sign": ("Recipe,Result\na + b,c\nx & y,z\n", "may be one ingredient or several"),
    "another header below": (
        "First,Second,Result\na,b,c\n\nResult,First,Second\n",
        "names the columns again",
    ),
    "an id of nothing": (
        {"elements": [{"id": 1, "name": "a"}], "recipes": [{"a": 1, "b": 9, "result": 1}]},
        "is a number, no name",
    ),
    **{
        f"the sign {sign.strip()}": (
            [{"name": c, "recipes": [f"{a}{sign}{b}"]} for a, b, c in ROWS],
            "may be one ingredient or several",
        )
        for sign in (" x ", " and ", " & ", "/", " × ")
    },
    "Python lists": (
        cells("name,ingredients", result, lambda a, b, c: f"\"['{a}', '{b}']\""),
        "is a list; leave its brackets out",
    ),
    "images": (
        cells("first,second,result", lambda a, b, c: f"![](b.png) {a}", second, result),
        "has quotes or markup around a label",
    ),
    "sums in several columns": (
        "Result,Recipe 1,Recipe 2\n" + "".join(f"{c},{a}+{b},{b}+{a}\n" for a, b, c in ROWS),
        "holds a sum",
    ),
    "a table of Markdown": (
        "| First | Second | Result |\n|---|---|---|\n| a | b | c |\n",
        "a table of Markdown",
    ),
    "columns of lists": (
        {"first": ["water"], "second": ["earth"], "result": ["mud"]},
        NO_WORDS,
    ),
    "lines in a list": ([f"{a} + {b} = {c}" for a, b, c in ROWS], NO_WORDS),
    "bullets": ("".join(f"- {a} + {b} = {c}\n" for a, b, c in ROWS), "begin as with '-'"),
    "results before sums": ("".join(f"{c} = {a} + {b}\n" for a, b, c in ROWS), "result is last"),
    "many labels under keys": ({"x": list("abcdef"), "y": list("klmnop")}, NO_WORDS),
    "two lists": (
        {"one": listed("parents", "child"), "two": listed("inputs", "output", rows=KITCHEN)},
        "two readings fit",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_book_for_sure_is_refused(put, case):
    content, says = REFUSED[case]
    with pytest.raises(RecipeFileError, match=re.escape(says)) as caught:
        read_book(put(content, "book.txt"))
    assert "--single-ingredient" not in str(caught.value)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        (["nope", "ingredients[]"], "no such column"),
        (["[].ingredients[]"], "expected different columns"),
        (["[].ingredients[", "[].gives"], "a path of keys"),
    ],
)
def test_wrong_paths_are_refused_with_the_grammar_or_the_paths(put, columns, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        read_book(put(READ["a recipe's own name"], "book.txt"), columns=columns)


def test_paths_read_any_json(put):
    deep = {"a.b": {"made": [{"of": [{"x": [a, b]}], "out": {"nm": c}} for a, b, c in ROWS]}}
    book = read_book(
        put(deep, "book.txt"), columns=[r"a\.b.made[].of[].x[]", r"a\.b.made[].out.nm"]
    )
    assert recipes(book) == expected(ROWS)


def test_a_row_without_ingredients_or_result_is_left_out_and_counted(put):
    rows = [*records("a", "b", "result"), {"a": "x", "b": "y"}, {"result": "z"}]
    book = read_book(put(rows, "book.txt"))
    assert recipes(book) == expected(ROWS)
    assert book.reading.left_out == {"without ingredients or result": 2}


@given(seed=st.integers(0, 2**32), shape=st.sampled_from(["records", "things", "table"]))
def test_the_order_of_keys_rows_and_columns_changes_nothing(tmp_path_factory, seed, shape):
    rng = random.Random(seed)
    rows = rng.sample(KITCHEN, 60)
    if shape == "table":
        order = rng.sample(range(3), 3)
        lines = [[row[i] for i in order] for row in [("in1", "in2", "out"), *rows]]
        text = "\n".join(map(",".join, lines))
    else:
        key = "result" if shape == "records" else "name"
        content = [
            {"id": i, "emoji": "x", "inputs": [a, b], key: c} for i, (a, b, c) in enumerate(rows)
        ]
        content = [dict(rng.sample(list(each.items()), 4)) for each in content]
        text = json.dumps(content)
    path = tmp_path_factory.mktemp("orders") / "book.txt"
    path.write_text(text)
    assert recipes(read_book(path)) == expected(rows)


OWN = "ingredient_a,ingredient_b,result\n"

OTHER = "first,second,result\n"

MUD = ("earth", "water", "mud")

STEAM = ("fire", "water", "steam")


NUMBERS = {
    "of a game of merging": (
        OTHER + "axe (1),axe (1),axe (2)\naxe (2),axe (2),axe (3)\n",
        "book.csv",
    ),
    "before": (OTHER + "2 water,earth,mud\nwater,3x fire,steam\n", "book.csv"),
    "behind": (OTHER + "water x2,earth,mud\nwater,fire*3,steam\n", "book.csv"),
    "in brackets": (OTHER + "water (2),earth,mud\nwater,fire (x3),steam\n", "book.csv"),
    "in sums": ("2 water + earth = mud\nwater + 3 fire = steam\n", "book.txt"),
    "in a cell": ("Result,Recipe\nmud,2 water + earth\nsteam,water + x3 fire\n", "book.csv"),
    "in JSON": (
        json.dumps({"mud": [["2 water", "earth"]], "steam": [["water", "3 fire"]]}),
        "book.json",
    ),
}


@pytest.mark.parametrize("case", NUMBERS)
def test_numbers_of_pieces_in_many_cells_are_refused(put, case):
    with pytest.raises(RecipeFileError, match="holds a number of pieces"):
        read_book(put(*NUMBERS[case]))


KEPT = {
    "our own table": OWN + "2 water,earth,mud\nwater,3 fire,steam\n",
    "a game of merging": OWN + "axe (1),axe (1),axe (2)\naxe (2),axe (2),axe (3)\n",
    "names with numbers": OTHER + "3 Musketeers,fire,ash\n7 Up,water,soda\n",
    "years": OTHER + "1990 car,fire,wreck\n2000 car,water,boat\n",
    "a few cells": OTHER + "2 water,earth,mud\n" + "".join(f"a,b{i},c{i}\n" for i in range(9)),
    "names": OTHER + "H2,O2,H2O\nR2 D2,C-3,2001\n",
}


@pytest.mark.parametrize("case", KEPT)
def test_other_numbers_are_parts_of_labels(put, case):
    book = read_book(put(KEPT[case]))
    rows = [tuple(line.split(",")) for line in KEPT[case].splitlines()[1:]]
    assert {tuple(recipe) for recipe in book.recipes} == {
        (*sorted(row[:2]), row[2]) for row in rows
    }
    assert book.reading.counts_dropped == 0


def test_a_number_beside_the_label_without_it_is_named(put):
    rows = "2 water,earth,mud\nwater,fire,steam\n" + "".join(f"a,b{i},c{i}\n" for i in range(9))
    for header in (OWN, OTHER):
        path = put(header + rows)
        says = "1 label with numbers, such as '2 water' beside the label without it"
        assert says in read_book(path).reading.line()


@pytest.mark.parametrize("header", [OWN, OTHER])
@pytest.mark.parametrize("blank", ["\u00a0", "\u200b", "\u3000", "\u200f"])
def test_blanks_that_cannot_be_seen_are_left_out_and_counted(put, header, blank):
    reading_of = {}
    for name, rows in (
        ("book.csv", f"{header}water{blank},{blank}earth,mud\n"),
        ("book.json", json.dumps({"mud": [["water" + blank, blank + "earth"]]})),
    ):
        book = read_book(put(rows, name))
        assert [tuple(recipe) for recipe in book.recipes] == [MUD]
        reading_of[name] = book.reading
    assert [reading.trimmed for reading in reading_of.values()] == [2, 2]
    assert "2 cells without blanks that cannot be seen" in reading_of["book.csv"].line()


def test_a_cell_of_blanks_that_cannot_be_seen_is_a_fault(put):
    path = put(OTHER + "water,earth,mud\nwater,\u200b,steam\n")
    found = [f for f in check_book(path).findings if f.kind == "label"]
    assert [f.lines for f in found] == [(3,)]


def test_labels_that_stand_for_nothing_are_named(put):
    line = read_book(put(OWN + "NA,earth,Nothing\n")).reading.line()
    assert "'NA', 'Nothing' kept as entities" in line


@pytest.mark.parametrize(
    ("cell", "says"),
    [(", wall, ", "the label '' is blank"), ("[stone, wall]x, [lava]", "leave its brackets out")],
)
def test_a_cell_without_brackets_is_not_refused_for_them(put, cell, says):
    path = put(f"ingredients;result\nwater, earth;mud\n{cell};house\n")
    first_finding, *_ = check_book(path, delimiter=";").findings
    assert says in first_finding.message
