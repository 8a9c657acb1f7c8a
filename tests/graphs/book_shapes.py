"""Recipe books in the shapes that people have, made from one small book."""

import gzip
import io
import json
import sqlite3
import zipfile
from dataclasses import dataclass, field

ROWS = (
    ("water", "earth", "mud"),
    ("mud", "fire", "brick"),
    ("brick", "brick", "wall"),
    ("water", "fire", "steam"),
    ("earth", "fire", "lava"),
    ("wall", "wall", "house"),
    ("water", "earth", "clay"),
)
MANY = (
    ("plank", "stick", "coal", "torch"),
    ("ore", "ingot"),
    ("ingot", "stick", "sword"),
)
"""Recipes of three, one and two ingredients."""


@dataclass
class Shape:
    """A file as it would be downloaded.

    ``files`` maps names to bytes; the first is the book, several are a folder. ``rows`` are the
    expected recipes; ``says`` a pattern of the refusal instead.
    """

    name: str
    files: dict
    rows: tuple = ROWS
    options: dict = field(default_factory=dict)
    says: str = ""


def table(
    rows=ROWS,
    header=("ingredient_a", "ingredient_b", "result"),
    delimiter=",",
    quote="",
    order=(0, 1, 2),
    end="\n",
):
    """Return a table as text."""
    lines = [] if header is None else [[header[i] for i in order]]
    lines += [[row[i] for i in order] for row in rows]
    return "".join(delimiter.join(f"{quote}{c}{quote}" for c in line) + end for line in lines)


def zipped(files):
    """Return a zip archive of names and texts or bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def by_result(rows=ROWS):
    made = {}
    for *parts, result in rows:
        made.setdefault(result, []).append(parts)
    return made


def wide(rows=ROWS, columns=4):
    return "".join(",".join(row) + "," * (columns - len(row)) + "\n" for row in rows)


def database():
    connection = sqlite3.connect(":memory:")
    connection.execute("create table recipes (a, b, result)")
    connection.executemany("insert into recipes values (?, ?, ?)", ROWS)
    return connection.serialize()


BASES = ("water", "earth", "fire")
NAMES = sorted({label for row in ROWS for label in row})
CRAFT = ("Water", "Fire", "Wind", "Earth", "Mud", "Nothing", "Brick, red")
CRAFT_ROWS = ((0, 3, 4), (4, 1, 6), (0, 1, 5), (2, 2, 5))
CRAFT_EXPECTED = (("Earth", "Water", "Mud"), ("Fire", "Mud", "Brick, red"))
SHAPED = {
    "type": "minecraft:crafting_shaped",
    "pattern": ["CP", " S"],
    "key": {"C": {"item": "coal"}, "P": {"item": "plank"}, "S": {"item": "stick"}},
    "result": {"item": "torch", "count": 4},
}
SMELTED = {"type": "minecraft:smelting", "ingredient": {"item": "ore"}, "result": "ingot"}
SHAPELESS = {
    "type": "minecraft:crafting_shapeless",
    "ingredients": [{"item": "ingot"}, "stick"],
    "result": {"id": "sword"},
}
SPECIAL = {"type": "minecraft:crafting_special_bookcloning"}


def packed(folder):
    data = {"torch": SHAPED, "ingot": SMELTED, "sword": SHAPELESS, "cloning": SPECIAL}
    files = {f"{folder}/{name}.json": json.dumps(value) for name, value in data.items()}
    return {**files, "pack.mcmeta": "{}", "data/m/tags/item/wool.json": '{"values": ["a"]}'}


def _json(value):
    return json.dumps(value, ensure_ascii=False).encode()


def _shapes():
    def of(name, file, content, rows=ROWS, says="", **options):
        data = content.encode() if isinstance(content, str) else content
        return Shape(name, {file: data}, rows, options, says)

    extra = "id,ingredient_a,emoji,ingredient_b,result,count\n" + "".join(
        f"{i},{a},🔥,{b},{c},1\n" for i, (a, b, c) in enumerate(ROWS)
    )
    accents = tuple(tuple(cell.replace("e", "é") for cell in row) for row in ROWS)
    lines = "".join(f"{a} + {b} = {c}\n" for a, b, c in ROWS)
    several = "water + earth = mud, clay\n" + "".join(
        f"{a} + {b} = {c}\n" for a, b, c in ROWS[1:-1]
    )
    saved_items = [
        {"id": i, "text": name, "emoji": "x", "recipes": [r[:2] for r in CRAFT_ROWS if r[2] == i]}
        for i, name in enumerate(CRAFT)
    ]
    old_save = {
        "elements": [{"text": name, "emoji": "x", "discovered": False} for name in CRAFT],
        "recipes": {
            CRAFT[r]: [[{"text": CRAFT[a], "emoji": "x"}, {"text": CRAFT[b], "emoji": "x"}]]
            for a, b, r in CRAFT_ROWS
        },
    }
    nested = {}
    for a, b, c in ROWS:
        nested.setdefault(a, {}).setdefault(b, []).append(c)
    for partners in nested.values():
        for other, made in partners.items():
            partners[other] = made[0] if len(made) == 1 else made
    factorio = [
        {
            "name": "torch",
            "ingredients": [{"name": n, "amount": 2} for n in MANY[0][:3]],
            "results": [{"name": "torch", "amount": 4}],
        },
        {
            "name": "ingot",
            "ingredients": [{"name": "ore", "amount": 1}],
            "results": [{"name": "ingot"}],
        },
        {
            "name": "sword",
            "ingredients": [{"name": "ingot", "amount": 2}, {"name": "stick", "amount": 1}],
            "results": [{"name": "sword"}],
        },
    ]
    satisfactory = {
        f"Recipe_{i}": {
            "ingredients": [{"item": p, "amount": 3} for p in parts],
            "products": [{"item": made, "amount": 1}],
            "time": 4,
        }
        for i, (*parts, made) in enumerate(MANY)
    }
    return [
        of("commas", "b.csv", table()),
        of("quoted", "b.csv", table(quote='"')),
        of("capitals", "b.csv", table(header=("Ingredient_A", "Ingredient_B", "Result"))),
        of("renamed", "b.csv", table(header=("react1", "react2", "products"))),
        of("items", "b.csv", table(header=("First item", "Second item", "Makes"))),
        of("camel case", "b.csv", table(header=("inputOne", "inputTwo", "outputName"))),
        of("result first", "b.csv", table(order=(2, 0, 1))),
        of("result in the middle", "b.csv", table(order=(0, 2, 1))),
        of("semicolons", "b.csv", table(delimiter=";")),
        of("tabs in csv", "b.csv", table(delimiter="\t")),
        of("tabs in txt", "b.txt", table(delimiter="\t")),
        of("tabs without ending", "recipes", table(delimiter="\t")),
        of("pipes", "b.csv", table(delimiter="|")),
        of("extra columns", "b.csv", extra),
        of(
            "fourth column Source",
            "b.csv",
            "ingredient_a,ingredient_b,result,Source\n"
            + "".join(f"{a},{b},{c},wiki\n" for a, b, c in ROWS),
        ),
        of("trailing comma", "b.csv", table().replace("\n", ",\n")),
        of("blank first line", "b.csv", "\n" + table()),
        of("sep", "b.csv", "sep=;\n" + table(delimiter=";")),
        of(
            "R write.csv",
            "b.csv",
            '"","a","b","result"\n'
            + "".join(f'"{i}","{a}","{b}","{c}"\n' for i, (a, b, c) in enumerate(ROWS, 1)),
        ),
        of(
            "pandas index",
            "b.csv",
            ",ingredient1,ingredient2,result\n"
            + "".join(f"{i},{a},{b},{c}\n" for i, (a, b, c) in enumerate(ROWS)),
        ),
        of("no header", "b.csv", table(header=None), columns=["1", "2", "3"]),
        of("UTF-16", "b.csv", table(delimiter="\t").encode("utf-16")),
        of("BOM and CRLF", "b.csv", ("\ufeff" + table(end="\r\n")).encode()),
        of("cp1252", "b.csv", table(accents).encode("cp1252"), accents, encoding="cp1252"),
        of(
            "named columns",
            "b.csv",
            table(header=("foo", "bar", "baz")),
            columns=["foo", "bar", "baz"],
        ),
        of(
            "sum in a column",
            "b.csv",
            "Recipe;Result\n" + "".join(f"{a} + {b};{c}\n" for a, b, c in ROWS),
        ),
        of(
            "two results",
            "b.csv",
            "in1,in2,out1,out2\nwater,earth,mud,clay\n"
            + "".join(f"{a},{b},{c},\n" for a, b, c in ROWS[1:-1]),
        ),
        of("lines", "b.txt", lines),
        of("lines in csv", "b.csv", lines),
        of("several results", "b.txt", several),
        of("by result", "b.json", _json(by_result())),
        of("by result, null for base", "b.json", _json({**dict.fromkeys(BASES), **by_result()})),
        of(
            "name and recipes",
            "b.json",
            _json([{"name": n, "recipes": by_result().get(n, [])} for n in NAMES]),
        ),
        of(
            "canBeMadeWith",
            "b.json",
            _json([{"name": n, "canBeMadeWith": by_result().get(n), "canMake": []} for n in NAMES]),
        ),
        of(
            "combinations",
            "b.json",
            _json(
                {
                    "elements": [
                        {"id": n, "combinations": [" + ".join(p) for p in by_result().get(n, [])]}
                        for n in NAMES
                    ]
                }
            ),
        ),
        of("two keys", "b.json", _json(nested)),
        of(
            "objects like rows",
            "b.json",
            _json([{"ingredient1": a, "ingredient2": b, "result": c} for a, b, c in ROWS]),
        ),
        of("list of lists", "b.json", _json(ROWS), columns=["[][0]", "[][1]", "[][2]"]),
        of(
            "JSON lines",
            "b.jsonl",
            "".join(json.dumps({"first": a, "second": b, "result": c}) + "\n" for a, b, c in ROWS),
        ),
        of("own JSON", "b.json", _json({"entities": NAMES, "recipes": ROWS})),
        of(
            "the paper's JSON",
            "b.json",
            _json({"entities": {n: {"recipes": by_result().get(n, [])} for n in NAMES}}),
        ),
        of(
            "ic",
            "save.ic",
            gzip.compress(_json({"name": "Save", "version": "1.0", "items": saved_items})),
            CRAFT_EXPECTED,
        ),
        of("old save", "infinitecraft.json", _json(old_save), CRAFT_EXPECTED),
        of(
            "dump by index",
            "recipes.json",
            _json({"items": CRAFT, "recipes": CRAFT_ROWS}),
            CRAFT_EXPECTED,
        ),
        of(
            "items by name",
            "b.json",
            _json(
                {
                    "items": {
                        n: {"emoji": "x", "recipes": ["+".join(p) for p in by_result().get(n, [])]}
                        for n in NAMES
                    }
                }
            ),
        ),
        of("gzip", "b.csv.gz", gzip.compress(table().encode())),
        of("zip", "b.zip", zipped({"recipes.csv": table(), "README.txt": "a + b = c"})),
        Shape(
            "Minecraft folder",
            {k: v.encode() for k, v in packed("data/m/recipe").items()},
            MANY,
            {},
        ),
        of("Minecraft zip", "mod.jar", zipped(packed("data/mod/recipes")), MANY),
        of("Factorio", "b.json", _json(factorio), MANY),
        of("Satisfactory", "b.json", _json(satisfactory), MANY),
        of(
            "Terraria",
            "b.csv",
            "Result,Ingredient 1,Amount 1,Ingredient 2,Amount 2,Ingredient 3,Amount 3\n"
            "torch,plank,1,stick,2,coal,9\ningot,ore,3,,,,\nsword,ingot,1,stick,1,,\n",
            MANY,
        ),
        of(
            "many in a cell",
            "b.csv",
            'name,ingredients\ntorch,"plank, stick, coal"\ningot,ore\nsword,"ingot, stick"\n',
            MANY,
        ),
        of(
            "reactions",
            "b.txt",
            "plank + stick + coal -> torch\nore + ore -> ingot\ningot + stick -> sword\n",
            MANY,
        ),
        # Refused, with what is missing.
        of("single quotes", "b.csv", table(quote="'"), says="holds single quotes"),
        of("SQLite", "b.db", database(), says="an SQLite database; export"),
        of(
            "items only",
            "b.json",
            _json([{"name": n, "description": "a thing"} for n in NAMES]),
            says=r"no documented words .*'\[\]\.name', '\[\]\.description'",
        ),
        of(
            "weights",
            "b.csv",
            "a,b,weight\n" + "".join(f"{a},{b},0.5\n" for a, b, _ in ROWS),
            says="weight.*result",
        ),
        of(
            "potions by effects",
            "b.json",
            _json([{"name": n, "effects": ["heal", "poison"]} for n in NAMES]),
            says=r"'\[\]\.effects'",
        ),
        of(
            "no header, no columns",
            "b.csv",
            table(header=None),
            says="'water', 'earth', 'mud'. Name the ingredients .* by numbers",
        ),
        of("labels only", "b.txt", "water\nearth\nfire\n", says="1 column"),
        of(
            "spreadsheet",
            "b.csv",
            zipped({"[Content_Types].xml": "", "xl/sheet.xml": ""}),
            says="a spreadsheet",
        ),
        of(
            "two books in a zip",
            "b.zip",
            zipped({"a.csv": table(), "b.csv": table()}),
            says="2 files that may be recipe books",
        ),
    ]


SHAPES = _shapes()
