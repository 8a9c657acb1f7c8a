"""Layers of crafts, and the colours of groups."""

import itertools
import re
import xml.etree.ElementTree as ElementTree

from tests.apps.explorer.shown import view_of
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages.path import Path
from wordcraft_kg.graphs.folder import OpenedGraph, default_split
from wordcraft_kg.reports.charts import Made, colour_of, layered

HOSTILE = '<script>alert("x")</script>&'


def parsed(markup):
    return ElementTree.fromstring(markup)


def box_of(root):
    """The boxes by their labels, as left, top, right and bottom."""
    boxes = {}
    for link in root.iter("a"):
        x, y, width, height = (float(link.find("rect").get(name)) for name in ("x", "y", "width", "height"))
        boxes[link.find("text").text] = (x, y, x + width, y + height)
    return boxes


def made(label, layer, *of, **more):
    return Made(label, f"/path/{label}", layer, of, **more)


DIAMOND = [made("b", 1, "a", "a"), made("c", 2, "b", "a"), made("d", 2, "b", "b"), made("e", 3, "c", "d")]


def test_layers_stand_from_left_to_right_and_boxes_do_not_overlap(kitchen):
    explored = Explored(OpenedGraph(kitchen, default_split(kitchen), "kitchen"))
    for entity in kitchen.entities:
        steps = view_of(explored, Path(entity)).drawn
        things = [made(step.recipe.result, step.layer, *step.recipe[:2]) for step in steps]
        if not things:
            continue
        root = parsed(layered(things, kitchen.base, "way"))
        boxes = box_of(root)
        assert len(boxes) == len(things)
        for one, other in itertools.combinations(things, 2):
            a, b = boxes[one.label], boxes[other.label]
            if one.layer == other.layer:
                # Room for what is written under a box, too.
                assert abs(a[1] - b[1]) > 36
            else:
                left, right = (a, b) if one.layer < other.layer else (b, a)
                assert left[2] < right[0]
        width, height = map(float, root.get("viewBox").split()[2:])
        assert all(box[0] >= 0 and box[2] <= width and box[1] >= 0 and box[3] <= height - 20 for box in boxes.values())


def test_an_arrow_leads_from_each_thing_to_what_is_made_of_it():
    root = parsed(layered(DIAMOND, ["a"], "way"))
    boxes = box_of(root)
    arrows = {path.find("title").text: path.get("d") for path in root.iter("path")}
    assert set(arrows) == {"b → c", "b → d", "c → e", "d → e"}
    for title, path in arrows.items():
        start, end = title.split(" → ")
        begin = [float(number) for number in re.findall(r"-?[\d.]+", path)[:2]]
        assert begin == [boxes[start][2], (boxes[start][1] + boxes[start][3]) / 2]
        tip = [float(number) for number in re.findall(r"-?[\d.]+", path.split("l-6")[0])[-2:]]
        assert tip == [boxes[end][0], (boxes[end][1] + boxes[end][3]) / 2]


def test_an_arrow_passes_the_layers_between_beside_their_boxes():
    things = [made("b", 1, "a", "a"), made("c", 2, "b", "b"), made("d", 3, "c", "c"), made("e", 4, "d", "b")]
    root = parsed(layered(things, ["a"], "way"))
    boxes = box_of(root)
    path = next(path.get("d") for path in root.iter("path") if path.find("title").text == "b → e")
    passes = re.findall(r" ([\d.]+)H([\d.]+)", path)
    assert len(passes) == 2
    for (y, right), label in zip(passes, ("c", "d"), strict=True):
        assert float(right) == boxes[label][2]
        assert not boxes[label][1] - 5 <= float(y) <= boxes[label][3] + 5


def test_what_is_given_is_in_bold_under_the_craft_and_what_is_not_drawn_is_not():
    root = parsed(layered([made("d", 5, "a", "c")], ["a"], "way"))
    words = {span.text: span.get("class") for span in root.iter("tspan")}
    assert words == {"a": "given", "c": "made"}
    assert not list(root.iter("path"))
    assert "layer 5" in [text.text for text in root.iter("text")]


def test_long_labels_are_cut_with_a_tooltip_and_markup_stays_text():
    long = "a very long label of an entity that nobody would write"
    things = [made(long, 1, HOSTILE, "b", title=f"{long} = x"), made(HOSTILE, 2, long, long)]
    root = parsed(layered(things, ["b"], "<i>"))
    texts = [text.text for text in root.iter("text") if text.text]
    assert "a very long lab…" in texts
    assert [title.text for title in root.iter("title") if title.text == f"{long} = x"]
    assert not list(root.iter("script"))
    assert root.get("aria-label") == "<i>"


def test_a_thing_without_an_address_is_no_link():
    root = parsed(layered([Made("b", "", 1, ("a", "a"))], ["a"], "way"))
    assert not list(root.iter("a"))
    assert [text.text for text in root.iter("text")][1] == "b"


def test_groups_beyond_the_colours_and_none_are_grey():
    assert [colour_of(number) for number in (-1, 0, 7, 8)] == ["series-other", "series-0", "series-7", "series-other"]
