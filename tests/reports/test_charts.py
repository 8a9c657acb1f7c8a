"""Charts as inline SVG and pictures as inline PNG: they parse, hold their data, and survive awkward data."""

import base64
import re
import struct
import xml.etree.ElementTree as ET
import zlib

import numpy as np
import pytest

from wordcraft_kg.reports import charts

LABEL = "<b>&\"'</b>"


def parse(svg: str) -> ET.Element:
    assert svg.startswith("<svg")
    return ET.fromstring(svg)


def decode(image: str) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (palette indices) and palette of an inline 8-bit palette PNG, with its checksums verified."""
    data = base64.b64decode(re.search(r'src="data:image/png;base64,([^"]+)"', image)[1])
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, position = {}, 8
    while position < len(data):
        (length,) = struct.unpack(">I", data[position : position + 4])
        kind, body = data[position + 4 : position + 8], data[position + 8 : position + 8 + length]
        (crc,) = struct.unpack(">I", data[position + 8 + length : position + 12 + length])
        assert crc == zlib.crc32(kind + body)
        chunks[kind] = body
        position += 12 + length
    assert list(chunks) == [b"IHDR", b"PLTE", b"IDAT", b"IEND"]
    width, height, depth, colour, *_ = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert (depth, colour) == (8, 3)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), dtype=np.uint8).reshape(height, width + 1)
    assert not rows[:, 0].any()
    return rows[:, 1:], np.frombuffer(chunks[b"PLTE"], dtype=np.uint8).reshape(-1, 3)


CHARTS = {
    "bars": lambda label: charts.grouped_bars([label, "b"], {label: [0.5, 0.1], "two": [0.2, 0.3]}, label, label),
    "lines": lambda label: charts.lines({label: [(1, 2.0), (2, 1.0)], "two": [(1, 1), (2, 3)]}, label, label, label),
    "reliability": lambda label: charts.reliability([(0.1, 0.2, 5), (0.3, 0.3, 5)], label),
    "points": lambda label: charts.labelled_points(
        np.array([[0.0, 1.0], [2.0, 3.0]]), [label, "b"], [0, 9], [0, 1], label
    ),
}


@pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS)
def test_a_chart_is_well_formed_and_escapes_its_labels(chart):
    root = parse(chart(LABEL))
    assert root.get("aria-label") == LABEL
    assert root.get("role") == "img"
    assert root.find(".//b") is None


@pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS)
def test_a_chart_is_safe_to_put_into_a_page_as_it_is(chart):
    from markupsafe import Markup

    assert isinstance(chart("plain"), Markup)


def test_bars_are_as_high_as_their_values():
    root = parse(charts.grouped_bars(["a", "b"], {"one": [0.8, 0.4], "two": [0.2, 0.0]}, "", ""))
    bars = {
        bar.find("title").text: float(bar.get("height")) for bar in root.iter("rect") if bar.find("title") is not None
    }
    assert list(bars) == ["one, a: 80.0%", "one, b: 40.0%", "two, a: 20.0%", "two, b: 0.0%"]
    heights = np.array(list(bars.values()))
    np.testing.assert_allclose(heights / heights[0], [1, 0.5, 0.25, 0], atol=0.005)


def test_bars_stay_inside_the_picture():
    root = parse(charts.grouped_bars([str(i) for i in range(9)], {"one": np.linspace(0, 1, 9).tolist()}, "x", "d"))
    for bar in root.iter("rect"):
        x, y, width, height = (float(bar.get(name)) for name in ("x", "y", "width", "height"))
        assert 0 <= x <= x + width <= charts.WIDTH
        assert 0 <= y <= y + height <= charts.HEIGHT


@pytest.mark.parametrize("values", [[0.0, 0.0], [1.0, 1.0], [1e-9, 0.0]])
def test_bars_of_extreme_shares_are_drawn(values: list[float]):
    root = parse(charts.grouped_bars(["a", "b"], {"one": values}, "", ""))
    assert all(float(bar.get("height")) >= 0 for bar in root.iter("rect"))


def test_a_line_goes_through_its_points():
    root = parse(charts.lines({"one": [(1, 0.0), (2, 1.0), (3, 0.5)]}, "x", "y", "d"))
    (line,) = root.iter("polyline")
    points = np.array([[float(number) for number in pair.split(",")] for pair in line.get("points").split()])
    np.testing.assert_allclose(np.diff(points[:, 0]), np.diff(points[:, 0])[0], atol=0.2)
    rise = points[0, 1] - points[:, 1]
    assert rise[1] > 0
    assert rise[2] == pytest.approx(rise[1] / 2, abs=0.2)


@pytest.mark.parametrize("points", [[(1, 2.0)], [(1, 0.0), (2, 0.0)], [(5, -3.0), (5, 4.0)], []])
def test_a_line_of_few_or_equal_points_is_drawn(points):
    root = parse(charts.lines({"one": points}, "x", "y", "d"))
    assert "nan" not in ET.tostring(root, encoding="unicode")


def test_only_several_curves_have_a_legend():
    one, two = (parse(charts.lines({name: [(1, 1), (2, 2)] for name in names}, "", "", "")) for names in ("a", "ab"))
    assert "a" not in [text.text for text in one.iter("text")]
    assert {"a", "b"} <= {text.text for text in two.iter("text")}


@pytest.mark.parametrize("points", [[], [(0.0, 0.0, 3)], [(1.0, 1.0, 3)], [(0.02, 0.4, 1), (0.9, 0.0, 1)]])
def test_a_reliability_chart_holds_its_points_and_the_diagonal(points):
    root = parse(charts.reliability(points, "d"))
    assert len(list(root.iter("circle"))) == len(points)
    assert [line.get("class") for line in root.iter("polyline")].count("diagonal") == 1
    for circle in root.iter("circle"):
        assert 0 <= float(circle.get("cx")) <= charts.WIDTH
        assert 0 <= float(circle.get("cy")) <= charts.HEIGHT


def test_a_map_knows_all_entities_and_their_groups():
    points = np.random.default_rng(0).normal(size=(6, 2))
    root = parse(charts.labelled_points(points, list("abcdef"), [0, 1, 2, 7, 8, 9], range(6), "d"))
    assert [title.text for title in root.iter("title")] == list("abcdef")
    assert [c.get("class") for c in root.iter("circle")] == [f"group-{i}" for i in (0, 1, 2, 7, 0, 1)]


def test_a_map_sets_labels_in_the_order_given_where_there_is_room():
    points = np.array([[0.0, 0.0], [0.001, 0.001], [1.0, 1.0], [0.5, 0.5]])
    for order, expected in (([1, 0, 2, 3], ["b", "c", "d"]), ([0, 1, 3], ["a", "d"])):
        root = parse(charts.labelled_points(points, list("abcd"), [0] * 4, order, "d"))
        assert [text.text for text in root.iter("text")] == expected


def test_a_map_of_equal_points_is_drawn():
    root = parse(charts.labelled_points(np.ones((3, 2)), list("abc"), [0, 0, 0], [], "d"))
    assert len({(c.get("cx"), c.get("cy")) for c in root.iter("circle")}) == 1


def test_a_matrix_is_an_image_with_the_marked_cells_red_and_the_rest_by_rank():
    values = np.array([[0.0, 5.0, 1e9], [1.0, 2.0, -1e9], [3.0, 4.0, 6.0]])
    marked = np.eye(3, dtype=bool)
    pixels, palette = decode(charts.matrix_image(values, marked, "d"))
    assert len(palette) == 49
    np.testing.assert_array_equal(pixels == 48, marked)
    assert palette[48][0] > 2 * palette[48][1:].max()
    free = ~marked
    assert pixels[free].tolist() == [int(np.sum(values < value)) * 48 // values.size for value in values[free]]
    brightness = palette[:48].astype(int).sum(axis=1)
    assert (np.diff(brightness) > 0).all()


@pytest.mark.parametrize("entities", [1, 7, 350, 351, 700, 701])
def test_a_large_matrix_is_averaged_into_blocks(entities: int):
    values = np.arange(entities**2, dtype=float).reshape(entities, entities)
    marked = np.zeros_like(values, dtype=bool)
    marked[-1, -1] = True
    pixels, _ = decode(charts.matrix_image(values, marked, "d"))
    step = -(-entities // 350)
    assert pixels.shape == (-(-entities // step),) * 2
    assert pixels[-1, -1] == 48
    assert (pixels == 48).sum() == 1


def test_blocks_at_the_edge_of_a_matrix_are_averaged_not_summed():
    # 3 entities in blocks of 2: the last row and column of blocks hold fewer cells of the same constant background.
    values = np.full((3, 3), 2.0)
    values[0, 0] = 1.0
    pixels, _ = decode(charts.matrix_image(values, np.zeros((3, 3), dtype=bool), "d", size=2))
    assert pixels.shape == (2, 2)
    assert pixels[0, 0] == pixels.min()


def test_the_description_of_a_matrix_is_escaped():
    image = charts.matrix_image(np.zeros((2, 2)), np.zeros((2, 2), dtype=bool), LABEL)
    assert "<b>" not in image
    assert "&lt;b&gt;&amp;&#34;" in image


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(0, 1), (1e-4, 1e-4), (0.011, 0.02), (0.2, 0.2), (0.21, 0.4), (0.45, 0.5), (0.7, 0.8), (0.81, 1), (3, 4)],
)
def test_axes_end_at_a_round_number(value: float, rounded: float):
    assert charts._round_up(value) == pytest.approx(rounded)
