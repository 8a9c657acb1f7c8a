"""Recipes of Minecraft that mods write otherwise: read, or left out and counted with the reason."""

import json

import pytest
from book_shapes import zipped

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import read_book

TORCH = {"ingredients": ["stick", "coal"], "result": {"id": "torch"}}
ONE = {("coal", "stick", "torch")}
CHOICE = {("birch", "birch", "x"), ("birch", "oak", "x"), ("oak", "oak", "x")}
UNKNOWN = [{"type": "neoforge:compound", "children": []}]
KINDS = {
    "unknown ingredients": (
        {"ingredients": UNKNOWN * 2, "result": "x"},
        set(),
        "with an ingredient of an unknown kind",
        0,
    ),
    "one unknown choice": (
        {"ingredients": [["a", None], "b"], "result": "x"},
        set(),
        "with an ingredient of an unknown kind",
        0,
    ),
    "letter without a key": (
        {"pattern": ["ABC"], "key": {"A": "a", "B": "b"}, "result": "x"},
        set(),
        "with a damaged pattern",
        0,
    ),
    "key of the blank": (
        {"pattern": ["A B"], "key": {"A": "a", "B": "b", " ": "c"}, "result": "x"},
        set(),
        "with a damaged pattern",
        0,
    ),
    "several results": (
        {"ingredients": ["a", "b"], "results": [{"item": "x"}, {"item": "y"}]},
        set(),
        "with several results",
        0,
    ),
    "no result": (
        {"ingredients": ["a", "b"], "result": {"count": 2}},
        set(),
        "without ingredients or result",
        0,
    ),
    "one of several results": (
        {"ingredients": ["a", "b"], "results": [{"item": "x"}]},
        {("a", "b", "x")},
        "",
        0,
    ),
    "two cells, two choices": (
        {"pattern": ["PP"], "key": {"P": ["oak", "birch"]}, "result": "x"},
        CHOICE,
        "",
        0,
    ),
    "the choices in another order": (
        {"ingredients": [["oak", "birch"], ["birch", "oak"]], "result": "x"},
        CHOICE,
        "",
        0,
    ),
    "a part twice": (
        {"ingredients": ["plank", "plank", "stick"], "result": "x"},
        {("plank", "stick", "x")},
        "",
        1,
    ),
    "a number of a part": (
        {"ingredients": [{"item": "a", "count": 3}, {"item": "b"}], "result": "x"},
        {("a", "b", "x")},
        "",
        1,
    ),
    "a number next to the result": (
        {"ingredients": ["a", "b"], "result": "x", "count": 4},
        {("a", "b", "x")},
        "",
        1,
    ),
}


def pack(folder, recipe):
    path = folder / "pack" / "recipe"
    path.mkdir(parents=True)
    (path / "torch.json").write_text(json.dumps(TORCH))
    (path / "other.json").write_text(recipe if isinstance(recipe, str) else json.dumps(recipe))
    return folder / "pack"


@pytest.mark.parametrize("case", KINDS)
def test_each_file_is_read_or_counted(tmp_path, case):
    recipe, expected, reason, counts = KINDS[case]
    book = read_book(pack(tmp_path, recipe))
    assert {tuple(each) for each in book.recipes} == ONE | expected
    reading = book.reading
    assert reading.left_out == ({reason: 1} if reason else {})
    assert reading.counts_dropped == counts
    assert reading.rows == reading.kept + sum(reading.left_out.values())


def test_a_key_twice_is_refused(tmp_path):
    path = pack(tmp_path, '{"ingredients": ["a", "b"], "result": "x", "result": "y"}')
    with pytest.raises(RecipeFileError, match="the key 'result' occurs twice"):
        read_book(path)


def test_an_ordinary_book_in_a_folder_called_recipes_is_read(tmp_path):
    path = tmp_path / "book.zip"
    path.write_bytes(zipped({"recipes/book.json": '{"mud": [["water", "earth"]]}'}))
    assert read_book(path).recipes == (("earth", "water", "mud"),)


def test_tags_of_the_pack_are_choices_and_no_entities(tmp_path):
    data = {
        "data/demo/tags/items/planks.json": {"values": ["#demo:oaks", "demo:birch"]},
        "data/demo/tags/items/oaks.json": {"values": ["demo:oak", {"id": "demo:dark_oak"}]},
        "data/demo/tags/items/circle.json": {"values": ["#demo:circle"]},
        "data/demo/recipes/lamp.json": {
            "ingredients": [{"tag": "demo:planks"}, "demo:coal"],
            "result": "demo:lamp",
        },
        "data/demo/recipes/door.json": {
            "ingredients": [{"tag": "minecraft:logs"}, "demo:coal"],
            "result": "demo:door",
        },
    }
    path = tmp_path / "pack.zip"
    path.write_bytes(zipped({name: json.dumps(value) for name, value in data.items()}))
    book = read_book(path)
    made_of = {label for recipe in book.recipes for label in recipe[:2]}
    assert made_of == {"demo:coal", "demo:oak", "demo:dark_oak", "demo:birch", "#minecraft:logs"}
    assert "3 tags of the pack are choices" in book.reading.line()
