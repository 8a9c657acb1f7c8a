"""Files that two readings fit: refused with what was seen, never read as a wrong graph.

Each case was once read in silence.
"""

import pytest

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import read_book
from wordcraft_kg.graphs.book_check import check_book

CHAIN = {"ingredients": "chain"}
OWN = "ingredient_a,ingredient_b,result\n"
MACHINES = "".join(
    f"ore{i},{machine},{made}\n"
    for i in range(20)
    for machine, made in (("crusher", "dust"), ("crusher", "slag"), ("mill", "flour"))
)
TABLES = {
    "sums in columns": (
        "Item,Recipe 1,Recipe 2\nmud,water + earth,rain + dirt\n",
        "'water . earth' may be a recipe of its own",
    ),
    "lists in columns": (
        'Result,Ingredients 1,Ingredients 2\nmud,"water, earth","rain, dirt"\n',
        "'water, earth' may be a recipe of its own",
    ),
    "a sum in a column": (
        "in1,in2,out\nwater,earth,mud\nwater + rain,sand,clay\nfire,mud,brick\n",
        "line 3: 'water . rain' may be several things or one",
    ),
    "a third ingredient": ("a,b,c,result\ncoal,rope,stick,torch\n", "are 3 ingredients of 'torch'"),
    "numbers left over": (
        "Item 1,Item 2,Similarity\nwater,earth,0.83\nfire,sand,0.5\n",
        "Similarity",
    ),
    "a name left over": (
        "Mod,Ingredient 1,Ingredient 2\nvanilla,stick,coal\nquark,stick,iron\n",
        "column 1 .'Mod'. is not named as results",
    ),
    "results of numbers": (
        "a,b,result\nwater,earth,12\nfire,sand,13\n",
        "column 3 .'result'. holds only numbers",
    ),
    "machines without a header": (MACHINES, "do not tell which column is the result"),
    "merged cells": ("in1,in2,out\nwater,earth,mud\n,fire,steam\n", "line 3: ',fire,steam' has a"),
    "a total": ("in1,in2,out\nwater,earth,mud\nTotal,,1\n", "line 3: 'Total' alone is rather"),
    "recipes between breaks": (
        "| Result | Recipe |\n|---|---|\n| mud | water + earth<br>rain + dirt |\n",
        "'<br>' between them",
    ),
    "missing": ("in1,in2,out\nice,NA,water\n", "line 2: 'NA' may be a missing value"),
    "missing result": ("a,b,result\nwater,fire,NULL\n", "line 2: 'NULL' may be a missing value"),
    "dashes": ("| a | b | result |\n|---|---|---|\n| - | - | - |\n", "line 3: '-' may be"),
    "and": ("Result,Ingredients\nmud,water and earth\n", "' and ' in cells such as"),
    "slash": ("Ingredients,Result\nwater/earth,mud\n", "'/' in cells such as"),
    "a recipe in two rows": (
        "id,ingredient,result\n1,water,mud\n1,earth,mud\n",
        "they may be one recipe or several",
    ),
    "another joiner": ("Ingredients,Result\na+b,c\nx & y,z\n", "could be parted|may be one"),
    "or": ("Result,Ingredients\nmud,water + earth or rain + dirt\n", "'or' between them"),
    "formula in our own table": (OWN + "=SUM(A2),b,c\n", "line 2: '=SUM.A2.' is a spreadsheet's"),
}


@pytest.fixture
def put(tmp_path):
    def put(content, name="book.csv"):
        path = tmp_path / name
        path.write_text(content)
        return path

    return put


def assert_refused(path, says, **options):
    with pytest.raises(RecipeFileError, match=says):
        read_book(path, **options)
    assert not check_book(path, **options).passed


@pytest.mark.parametrize("case", TABLES)
def test_a_table_with_two_readings_is_refused(put, case):
    text, says = TABLES[case]
    assert_refused(put(text), says)
    if "3 ingredients" not in says:
        assert_refused(put(text), says, **CHAIN)


READ_TABLES = {
    "Markdown, aligned": ("| a | b | result |\n|:--|:-:|-:|\n| water | earth | mud |\n", {}),
    "Markdown with links": (
        "| a | b | result |\n|---|---|---|\n| [water](/w) | **earth** | **[mud](/m)** |\n",
        {},
    ),
    "typographic quotes": ("a,b,result\n“water”,«earth»,„mud“\n", {}),
    "Chinese": ("材料1,材料2,结果\nwater,earth,mud\n", {}),
    "Polish": ("Składnik 1;Składnik 2;Wynik\nwater;earth;mud\n", {}),
    "comments of code": ("// mine\na,b,result\nwater,earth,mud\n", {}),
    "Markdown without a frame": ("a | b | result\n--- | --- | ---\nwater | earth | mud\n", {}),
    "Org": ("| a | b | result |\n|---+---+---|\n| water | earth | mud |\n", {}),
    "the recipe's name": ("Recipe,Ingredient 1,Ingredient 2,Result\nR1,water,earth,mud\n", CHAIN),
    "no-break space": ("in1,in2,out\nwater\u00a0,earth,mud\n", {}),
    "Nothing": ("a,b,result\nWater,Fire,Nothing\nWind,Earth,Nothing\nwater,earth,mud\n", {}),
}


@pytest.mark.parametrize("case", READ_TABLES)
def test_a_table_is_read_without_its_marks(put, case):
    text, options = READ_TABLES[case]
    book = read_book(put(text, "book.md"), **options)
    assert [tuple(recipe) for recipe in book.recipes] == [("earth", "water", "mud")]


def test_our_own_table_keeps_any_label_and_the_check_names_it(put):
    path = put(OWN + '"None","Nothing","water\u00a0"\n')
    book = read_book(path)
    assert set(book.entities) == {"None", "Nothing", "water\u00a0"}
    assert "'None', 'Nothing' kept as entities" in book.reading.line()
    assert {f.kind for f in check_book(path).findings} >= {"missing", "nothing", "space"}


LINES = "{0}water + earth {1} mud{2}\n{0}fire + water {1} steam{2}\n"
MARKS = [
    *[(mark, "=", "") for mark in ("1: ", "1 - ", "[1] ", "> ", ">> ", "· ", "☐ ", "✓ ", "- [x] ")],
    *[(mark, "=", "") for mark in ("+ ", "** ", "• 1. ", "2) ", "1.")],
    *[("", "=", mark) for mark in (";", "<br>", "\\", " ✅")],
    *[("", sign, "") for sign in ("-->", "==>", "--->", "~>", "—>", "⟶", "➡️", "⇨", ":")],
]


@pytest.mark.parametrize("mark", MARKS, ids=lambda mark: "".join(mark))
def test_signs_and_marks_of_lists_are_no_part_of_labels(put, mark):
    book = read_book(put(LINES.format(*mark), "book.txt"))
    assert set(book.entities) == {"water", "earth", "fire", "mud", "steam"}


UNKNOWN_MARKS = {
    "Step 1: ": ("Step 1: ", "=", "", "many lines begin as with 'Step 1:'"),
    "No. 1: ": ("No. 1: ", "=", "", "many lines begin"),
    "chat": ("[12:01] bot: ", "=", "", "many lines begin"),
    "recipe1)": ("recipe1) ", "=", "", "many lines begin"),
    "a pipe": ("| ", "=", "", "many lines begin"),
    "dashes": ("-- ", "=", "", "many lines begin as with '--'"),
    "full stop": ("", "=", ".", "many lines end as with '.'"),
    "in brackets": ("", "=", " (new!)", r"many lines end as with '\(new!\)'"),
    "note": ("", "=", " [1]", r"many lines end as with '\[1\]'"),
    "words": ("", "=", " - First Discovery!", "many lines end as with '- First Discovery!'"),
    "comment": ("", "=", " # first", "'mud # first' holds '#'"),
    "comment in code": ("", "=", " // c", "'mud // c' holds '//'"),
    "=~": ("", "=~", "", "'~ mud' holds '~'"),
    "≈": ("", "≈", "", "See docs/your-file.md"),
    "an arrow to the sum": ("", "<=", "", "line 1, whose arrow points at a sum"),
}


@pytest.mark.parametrize("case", UNKNOWN_MARKS)
def test_what_else_lines_begin_or_end_with_is_refused(put, case):
    *mark, says = UNKNOWN_MARKS[case]
    assert_refused(put(LINES.format(*mark), "book.txt"), says)


ONE_RECIPE = {
    "quotes": '"water + earth": "mud"\n',
    "quoted labels": "'water' + 'earth' = 'mud'\n",
    "links": "* [[water]] + [[earth]] = [[mud]]\n",
    "an arrow to the result": "mud <- water + earth\n",
    ":=": "mud := water + earth\n",
    "a base": "# base: water\n# Notes\nwater + earth = mud\n",
    "a nested bullet": "** water + earth = mud\n",
    "Nothing": "Water + Fire = Nothing\nWind + Earth = Nothing\n" + "water + earth = mud\n" * 3,
}


@pytest.mark.parametrize("case", ONE_RECIPE)
def test_lines_are_read_without_quotes_and_markup(put, case):
    book = read_book(put(ONE_RECIPE[case], "book.txt"))
    assert [tuple(recipe) for recipe in book.recipes] == [("earth", "water", "mud")]
    assert book.base == (("water",) if case == "a base" else None)


WRONG_LINES = {
    "two names of a link": ("[[a]] + [[b]] = c\n[[W|w]] + [[e]] = [[m]]\n", r"\[\["),
    "a quote left over": ('"water" + earth = "mud" x\n', "holds '\"'"),
    "or": ("mud = water + earth or rain + dirt\n", "'or' between them"),
    "semicolons": ("mud = water + earth; rain + dirt\n", "';' between them"),
    "a slash": ("fire + water = steam\nwater + earth = mud / clay\n", "holds '/'"),
    "two signs": ("fire + water = steam\nwater + earth = mud = clay\n", "or several"),
    "a comment or a label": ("#water + earth = mud\n", "may be a comment or a label"),
}


@pytest.mark.parametrize("case", WRONG_LINES)
def test_lines_with_two_readings_are_refused(put, case):
    text, says = WRONG_LINES[case]
    assert_refused(put(text, "book.txt"), says, **CHAIN)


def test_lines_with_several_results_may_be_saved_as_csv(put):
    book = read_book(put("water + earth = mud, clay\nfire + water = steam, cloud\n"))
    assert {recipe.result for recipe in book.recipes} == {"mud", "clay", "steam", "cloud"}
    assert_refused(put("a + b = c\n"), "Leave `columns` out", columns=["1", "2"])


FEW_LINES = {
    "wide signs": "water ＋ earth ＝ mud\n",
    "arrows of HTML": "water + earth -&gt; mud\n",
    "fences and headings": "```\nBasics:\n[First]\nwater + earth = mud\n```\n",
}


@pytest.mark.parametrize("case", FEW_LINES)
def test_lines_of_other_keyboards_and_pages_are_read(put, case):
    book = read_book(put(FEW_LINES[case], "book.txt"))
    assert [tuple(recipe) for recipe in book.recipes] == [("earth", "water", "mud")]


def test_emoji_that_all_labels_have_are_part_of_them(put):
    rows = [("💧", "🌍", "🟤"), ("🔥 fire", "💧 water", "♨ steam"), ("🌍 a", "🔥 b", "🌋 c")]
    path = put("".join(f"{a} + {b} = {c}\n" for a, b, c in rows), "book.txt")
    assert {tuple(recipe) for recipe in read_book(path).recipes} == {
        (*sorted(row[:2]), row[2]) for row in rows
    }


def test_a_list_of_two_results_names_both(put):
    path = put('[["in 1", "in 2", "out 1", "out 2"], ["water", "earth", "mud", "clay"]]', "b.json")
    assert "in 1 + in 2 = out 1, out 2" in read_book(path).reading.line()


def test_tags_are_labels(put):
    book = read_book(put("#minecraft:planks + stick = axe\noak + stick = shovel\n", "book.txt"))
    assert "#minecraft:planks" in book.entities


HALVES = {
    "a chain and a label": (
        "a,b,c,result\ncoal,rope,stick,torch\nx,y,,coal + rope + …\n",
        "other rows become chains",
    ),
    "a label and a chain": (
        "a,b,c,result\ncoal,rope,,coal + rope + …\ncoal,rope,stick,torch\n",
        "other rows become chains",
    ),
    "of other parts": (OWN + "x,y,coal + rope + …\n", "is not that of 'x' and 'y'"),
    "only half-products": (OWN + "coal,rope,coal + rope + …\n", "no recipe"),
    "too long": (
        f"a,b,c,result\n{'x' * 600},{'y' * 600},z,torch\n",
        "half-product of 2 ingredients has a label of 1,2",
    ),
    "too many": (
        "Ingredients,Result\n" + "+".join(f"i{i}" for i in range(1_001)) + ",x\n",
        "1,001 ingredients",
    ),
}


@pytest.mark.parametrize("case", HALVES)
def test_half_products_are_those_of_chains(put, case):
    text, says = HALVES[case]
    assert_refused(put(text), says, **CHAIN)


def test_several_pieces_of_one_thing_are_no_single_ingredient(put):
    path = put("wood + wood + wood = log\nore = ingot\nore + log = x\n", "book.txt")
    book = read_book(path, single_ingredient="furnace", **CHAIN)
    assert ("wood", "wood", "log") in book.recipes
    assert ("furnace", "ore", "ingot") in book.recipes


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("<html><table><tr><td>a</td></tr></table></html>", "HTML"),
        ("<recipes><recipe/></recipes>", "XML"),
        ("mud:\n  - [water, earth]\n", "YAML"),
        ('[mud]\nparts = ["water", "earth"]\n', "TOML"),
        ("INSERT INTO recipes VALUES ('a', 'b', 'c');\n", "SQL"),
        (" a | b\n---+---\n c | d\n", "a table that a database printed"),
        ('{| class="wikitable"\n! a !! b\n|}\n', "MediaWiki"),
    ],
)
def test_a_refusal_names_the_format(put, text, seen):
    assert_refused(put(text, "book.txt"), f"{seen}, which is not read")
