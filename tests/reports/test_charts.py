"""Charts as inline SVG and pictures as inline PNG: they parse, hold their data, and survive awkward
data."""

import itertools
import re
import xml.etree.ElementTree as ET
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from markupsafe import Markup

from tests.apps.explorer.shown import view_of
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.pages.path import PathState
from wordcraft_kg.graphs.folder import OpenedGraph, default_split
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.agent_pictures import contribution_bar
from wordcraft_kg.reports.charts import Made, colour_of, layered
from wordcraft_kg.reports.charts.plot import BOTTOM, COLOURS, DARK, HEIGHT, LIGHT, WIDTH
from wordcraft_kg.reports.charts.standalone import resolved
from wordcraft_kg.reports.pages import chart_style

LABEL = "<b>&\"'</b>"


def parse(svg):
    assert svg.startswith("<svg")
    assert "nan" not in svg
    return ET.fromstring(svg)


def drawn(series, percent=True, **options):
    """Curves without titles."""
    return parse(charts.curves(series, "", "", "", percent=percent, **options))


CHARTS = {
    "curves": lambda label: charts.curves(
        {label: [(0, 1.0, 0.5, 2.0), (2, 1.0, None, None)], "two": [(1, 1, 0, 2)]},
        label,
        label,
        label,
        dashed=[label],
    ),
    "dots": lambda label: charts.dots(
        [label, "b"],
        {label: [(0.5, 0.4, 0.6), None], "two": [(0.5, None, None)] * 2},
        label,
        label,
        label,
    ),
    "scatter": lambda label: charts.scatter(
        {label: [(label, (0.1, 0.05, 0.2), (0.5, 0.4, 0.6))]},
        label,
        label,
        label,
        level=(label, 0.3),
    ),
    "log_reliability": lambda label: charts.log_reliability(
        {label: [(0.1, 0.2, 0.1, 0.3, 5)]}, label
    ),
}


@pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS)
@pytest.mark.parametrize("label", [LABEL, "plain"])
def test_a_chart_is_well_formed_escapes_its_labels_and_is_safe_in_a_page(chart, label):
    root = parse(svg := chart(label))
    assert isinstance(svg, Markup)
    assert (root.get("aria-label"), root.get("role")) == (label, "img")
    assert root.find(".//b") is None


def points_of(element):
    return np.array(
        [[float(number) for number in pair.split(",")] for pair in element.get("points").split()]
    )


def of_class(root, name):
    return [element for element in root.iter() if name in element.get("class", "").split()]


def titles_of(elements):
    return [element.find("title").text for element in elements]


def numbers_of(element, *names):
    return [float(element.get(name)) for name in names]


def colours(elements, prefix="series-"):
    return [
        next(name for name in element.get("class").split() if name.startswith(prefix))
        for element in elements
    ]


def dashes(elements):
    return colours(elements, "dash")


def of_text(root, style):
    return [text for text in root.iter("text") if text.get("class", "").startswith(style)]


def end_labels(root):
    return {text.text: tuple(numbers_of(text, "x", "y")) for text in of_text(root, "series-")}


def texts_of(root):
    return [text.text for text in root.iter("text")]


def straight(end, last=3e6):
    """A curve from 0.3 to an end, of seven points with an interval of ±0.05."""
    values = [(last * i / 6, 0.3 + (end - 0.3) * i / 6) for i in range(7)]
    return [(x, y, y - 0.05, y + 0.05) for x, y in values]


def test_a_curve_has_a_line_a_band_a_name_and_points_to_hover_over():
    root = parse(
        charts.curves(
            {"one": straight(0.9), "two": straight(0.6)}, "steps", "success", "d", percent=True
        )
    )
    lines, bands = of_class(root, "line"), of_class(root, "band")
    assert len(set(colours(lines))) == len(set(dashes(lines))) == 2
    assert colours(bands) == colours(lines)
    assert titles_of(lines) == ["one", "two"]
    assert list(end_labels(root)) == ["one", "two"]
    assert len(of_class(root, "hit")) == 14
    assert titles_of(of_class(root, "hit"))[6] == "one, 3,000,000: 90.0% [85.0%, 95.0%]"
    assert {"steps", "success"} <= set(texts_of(root))
    assert not list(root.iter("rect"))


def test_a_curve_goes_up_with_its_values_and_its_band_lies_around_it():
    root = drawn({"one": straight(0.9)})
    line, band = points_of(of_class(root, "line")[0]), points_of(of_class(root, "band")[0])
    assert (np.diff(line[:, 0]) > 0).all()
    assert (np.diff(line[:, 1]) < 0).all()
    upper, lower = band[:7], band[7:][::-1]
    np.testing.assert_array_equal(upper[:, 0], line[:, 0])
    np.testing.assert_array_equal(lower[:, 0], line[:, 0])
    np.testing.assert_allclose(line[:, 1] - upper[:, 1], lower[:, 1] - line[:, 1], atol=0.15)
    # A twentieth of the axis, which is five grid lines high.
    grid = [float(element.get("y1")) for element in of_class(root, "grid")]
    assert line[0, 1] - upper[0, 1] == pytest.approx((grid[0] - grid[-1]) / 20, abs=0.15)


def test_the_axis_of_shares_goes_from_0_to_100_percent():
    """The axis of shares goes from 0 to 100 percent and the other one with the data."""
    for percent, expected in (
        (True, "0% 20% 40% 60% 80% 100%"),
        (False, "0.2 0.3 0.4 0.5 0.6 0.7"),
    ):
        assert texts_of(drawn({"one": straight(0.6)}, percent))[:6] == expected.split()


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        (2e6, "0 0.5M 1M 1.5M 2M"),
        (4.9e4, "0 10k 20k 30k 40k"),
        (900, "0 200 400 600 800"),
        (7, "0 2 4 6"),
        (2e9, "0 0.5B 1B 1.5B 2B"),
    ],
)
def test_steps_are_written_in_readable_units(last, expected):
    middles = [
        text
        for text in drawn({"one": straight(0.6, last)}).iter("text")
        if text.get("text-anchor") == "middle"
    ]
    assert [text.text for text in middles][:-1] == expected.split()


def test_the_axis_of_steps_holds_0():
    root = drawn({"one": [(500, 1, None, None), (1000, 2, None, None)]}, percent=False)
    first, last = points_of(of_class(root, "line")[0])[:, 0]
    assert first - numbers_of(root.find(".//text[.='0']"), "x")[0] == pytest.approx(
        last - first, abs=0.2
    )


def test_a_band_needs_bounds_and_a_lone_interval_is_a_whisker():
    """A band is only where there are bounds and a lone interval is a whisker."""
    bounds = [
        (0.1, 0.3),
        (0.1, 0.3),
        (None, None),
        (0.1, 0.3),
        (None, None),
        (0.1, 0.3),
        (0.1, 0.3),
        (0.1, 0.3),
    ]
    root = drawn({"one": [(i, 0.2, *pair) for i, pair in enumerate(bounds)]}, percent=False)
    assert [len(points_of(band)) for band in of_class(root, "band")] == [4, 6]
    assert len(of_class(root, "whisker")) == 1
    assert len(points_of(of_class(root, "line")[0])) == 8
    assert titles_of(of_class(root, "hit"))[1:3] == ["one, 1: 0.2 [0.1, 0.3]", "one, 2: 0.2"]


MIXED_ENDS = [[0.51, 0.5, 0.9, 0.52, 0.49], [0.3, 0.36, 0.42, 0.48, 0.54, 0.5]]


@pytest.mark.parametrize(
    "ends",
    [[0.5], [0.5, 0.5], [0.0, 0.0, 0.0, 0.01], [1.0, 1.0, 0.99, 1.0, 1.0], [0.5] * 14, *MIXED_ENDS],
)
def test_names_of_curves_do_not_overlap_and_keep_the_order_of_the_ends(ends):
    names = [f"curve {i}" for i in range(len(ends))]
    root = drawn(dict(zip(names, map(straight, ends), strict=True)))
    labels = end_labels(root)
    assert list(labels) == names
    heights = sorted(y for _, y in labels.values())
    assert np.diff(heights).min(initial=99) >= 11  # the height of the text
    for a, b in itertools.combinations(range(len(ends)), 2):
        if ends[a] > ends[b]:
            assert labels[names[a]][1] < labels[names[b]][1]
    assert all(0 < y < HEIGHT - BOTTOM + 5 for y in heights)


def test_names_stand_at_line_ends_or_are_tied_to_them():
    """Names that fit stand at their ends and others are tied to them by a line."""
    apart = drawn({"a": straight(0.9), "b": straight(0.5)})
    ends = [points_of(line)[-1] for line in of_class(apart, "line")]
    for (x, y), end in zip(end_labels(apart).values(), ends, strict=True):
        assert y == pytest.approx(end[1], abs=6)
        assert x > end[0]
    assert not of_class(apart, "leader")
    assert len(of_class(drawn({"a": straight(0.5), "b": straight(0.5)}), "leader")) == 2
    early = drawn({"a": straight(0.9), "b": straight(0.5, 1e6)})
    (leader,) = of_class(early, "leader")
    end = points_of(of_class(early, "line")[1])[-1]
    assert numbers_of(leader, "x1", "y1") == pytest.approx(end, abs=4)


def test_long_names_have_room_and_very_long_ones_are_cut():
    long, longer = "random embeddings, dim 50", "random embeddings of 50 dimensions, 8 distractors"
    root = drawn({"a": straight(0.9), long: straight(0.7), longer: straight(0.5)}, percent=False)
    labels = end_labels(root)
    assert list(labels) == ["a", long, "random embeddings of 50 dimensi…"]
    for text, (x, _) in labels.items():
        assert x + 6 * len(text) <= WIDTH
    assert of_text(root, "series-2")[0].find("title").text == longer
    assert of_class(root, "hit")[-1].find("title").text.startswith(longer)
    assert points_of(of_class(root, "line")[0])[-1, 0] < labels["a"][0]
    assert all(float(grid.get("x2")) < labels["a"][0] for grid in of_class(root, "grid"))


def test_a_curve_of_one_point_is_a_dot_with_a_whisker():
    """A curve of a single point is a dot with a whisker and one of two a line."""
    root = drawn({"one": [(5e5, 0.5, 0.4, 0.7)]})
    (dot,) = of_class(root, "dot")
    assert dot.find("title").text == "one, 500,000: 50.0% [40.0%, 70.0%]"
    (whisker,) = of_class(root, "whisker")
    x, top, bottom = numbers_of(whisker, "x1", "y2", "y1")
    assert x == float(whisker.get("x2")) == float(dot.get("cx"))
    assert top < float(dot.get("cy")) < bottom
    assert not of_class(root, "band")
    of_two = drawn({"one": straight(0.5)[:2]}, percent=False)
    assert len(points_of(of_class(of_two, "line")[0])) == len(of_class(of_two, "hit")) == 2
    assert not of_class(of_two, "dot")


def test_a_curve_without_points_is_left_out_and_keeps_its_colour():
    root = drawn({"none": [], "one": straight(0.9)})
    both = drawn({"none": straight(0.5), "one": straight(0.9)})
    assert colours(of_class(root, "line")) == colours(of_class(both, "line"))[1:]
    assert list(end_labels(root)) == ["one"]


FEW = [
    {},
    {"one": []},
    {"one": [(0, 0.0, None, None)]},
    {"one": [(5, -3.0, -3.0, -3.0)]},
    {"one": [(1, 0.5, 0.5, 0.5), (2, 0.5, 0.5, 0.5)]},
    {"one": [(-4, 0.1, None, None), (-2, 0.3, None, None)]},
]
NO_ESTIMATE = (0.0, None, None)


@pytest.mark.parametrize(
    ("root", "style", "expected"),
    [
        *((drawn(series, percent), "grid", 2) for series in FEW for percent in (True, False)),
        *(
            (
                parse(charts.dots(labels, series, "", "", "d")),
                "dot",
                len(series) + len(labels) * len(series),
            )
            for labels, series in (
                ([], {}),
                ([], {"a": []}),
                (["x"], {}),
                (["x"], {"a": [NO_ESTIMATE]}),
            )
        ),
        *(
            (parse(charts.intervals(rows, "x", "d", reference=0.0)), "dot", len(rows))
            for rows in (
                [],
                [("a", (0.0, 0.0, 0.0))],
                [("a", (-0.1, -0.3, 0.2)), ("a", NO_ESTIMATE)],
            )
        ),
    ],
)
def test_charts_of_few_equal_or_negative_values_are_drawn(root, style, expected):
    found = len(of_class(root, style))
    assert found >= expected if style == "grid" else found == expected


def test_dashes_can_mean_something_and_colours_and_labels_can_be_shared():
    seeds = {f"agent, seed {seed}": straight(0.5 + seed / 10) for seed in range(3)}
    root = drawn(seeds, colours=dict.fromkeys(seeds, 1), labels={"agent, seed 0": "agent"})
    assert list(end_labels(root)) == ["agent"]
    assert titles_of(of_class(root, "line")) == list(seeds)
    assert set(dashes(of_class(root, "line"))) == {"dash-1"}
    curves = {name: straight(0.5) for name in ("a train", "a", "b train", "b")}
    root = drawn(
        curves, dashed={"a train", "b train"}, colours={"a train": 0, "a": 0, "b train": 9, "b": 1}
    )
    lines = of_class(root, "line")
    train, test, other_train, other_test = dashes(lines)
    assert train == other_train != test == other_test
    a, also_a, b, also_b = colours(lines)
    assert a == also_a != b == also_b
    assert colours(of_text(root, "series-")) == colours(of_class(root, "band")) == colours(lines)


def test_a_long_curve_has_all_its_points_but_not_all_to_hover_over():
    root = drawn({"one": [(i, i / 2000, None, None) for i in range(1001)]}, percent=False)
    assert len(points_of(of_class(root, "line")[0])) == 1001
    titles = titles_of(of_class(root, "hit"))
    assert 40 <= len(titles) <= 60
    assert titles[0] == "one, 14: 0.007"
    assert titles[-1] == "one, 1,000: 0.5"


def estimates(*shares):
    return [(share, share - 0.1, share + 0.05) for share in shares]


def test_dots_stand_in_categories_with_whiskers():
    """Dots stand in their categories side by side with whiskers and a legend."""
    labels = ["0", "1–2", "3+"]
    root = parse(
        charts.dots(
            labels, {"a": estimates(0.2, 0.5, 0.9), "b": estimates(0.3, 0.3, 0.3)}, "x", "y", "d"
        )
    )
    dots, whiskers = of_class(root, "dot"), of_class(root, "whisker")
    drawn = (
        [f"a, {label}" for label in labels] + ["a"] + [f"b, {label}" for label in labels] + ["b"]
    )
    assert [title.split(":")[0] for title in titles_of(dots)] == drawn
    assert titles_of(dots)[0] == "a, 0: 20.0% [10.0%, 25.0%]"
    a, b = colours(whiskers)[::3]
    assert colours(whiskers) == [a] * 3 + [b] * 3
    assert a != b
    xs = np.array([float(whisker.get("x1")) for whisker in whiskers]).reshape(2, 3)
    assert (np.diff(xs, axis=1) > 0).all()
    middles = [float(text.get("x")) for text in root.iter("text") if text.text in labels]
    np.testing.assert_allclose(xs.mean(axis=0), middles, atol=0.11)
    assert (xs[0] < xs[1]).all()
    assert (xs[1, :-1] < xs[0, 1:]).all()
    ends = np.array([numbers_of(whisker, "y1", "y2") for whisker in whiskers])
    assert (ends[:, 0] > ends[:, 1]).all()
    np.testing.assert_allclose(np.diff(ends), np.diff(ends)[:1].repeat(6, 0), atol=0.21)
    circles = [numbers_of(dot, "cx", "cy") for dot in dots[:3]]
    np.testing.assert_array_equal([x for x, _ in circles], xs[0])
    assert circles[0][1] > circles[1][1] > circles[2][1]
    assert {"x", "y", "a", "b"} <= set(texts_of(root))


def test_a_share_may_be_missing_or_have_no_interval():
    """A share may be missing or have no interval and a series without any keeps its colour."""
    root = parse(charts.dots(["x", "y"], {"a": [None, (0.5, None, None)]}, "", "", ""))
    assert titles_of(of_class(root, "dot")) == ["a, y: 50.0%", "a"]
    assert not of_class(root, "whisker")
    root = parse(charts.dots(["x"], {"a": [None], "b": estimates(0.5)}, "", "", ""))
    assert "a" not in texts_of(root)
    assert colours(of_class(root, "whisker")) == ["series-1"]


def test_dots_stay_apart_and_inside_the_picture_when_there_are_many():
    series = {f"a longer name {i}": [(1.0, 0.9, 1.0)] * 10 for i in range(8)}
    root = parse(charts.dots([str(i) for i in range(10)], series, "", "", ""))
    xs = np.array([float(whisker.get("x1")) for whisker in of_class(root, "whisker")]).reshape(
        8, 10
    )
    assert (np.diff(xs.T.ravel()) > 0).all()
    legend = [text for text in root.iter("text") if text.text in series]
    assert all(xs.max() + 5 < float(text.get("x")) <= WIDTH - 6 * len(text.text) for text in legend)
    heights = [float(text.get("y")) for text in legend]
    assert np.diff(heights).min() >= 12
    assert heights[-1] < HEIGHT


RELIABILITY = [
    [],
    [(0.001, 0.0, 0.0, 0.002, 900)],
    [(1.0, 1.0, 0.2, 1.0, 1)],
    [(1e-9, 1e-4, 0.0, 0.1, 3), (0.9, 0.0, 0.0, 0.5, 2)],
]


@pytest.mark.parametrize("points", RELIABILITY)
def test_a_reliability_chart_has_axes_and_a_diagonal(points):
    """A reliability chart keeps its points on the axes and has the diagonal."""
    root = parse(charts.log_reliability({"a": points, "b": []}, "d"))
    assert len(list(root.iter("circle"))) == len(points)
    assert [line.get("class") for line in root.iter("polyline")].count("diagonal") == 1
    for circle in root.iter("circle"):
        assert 0 <= float(circle.get("cx")) <= WIDTH
        assert 0 <= float(circle.get("cy")) <= HEIGHT
    for line in root.iter("line"):
        assert 0 <= float(line.get("y1")) <= HEIGHT
        assert 0 <= float(line.get("y2")) <= HEIGHT


def test_a_tenth_is_as_far_from_a_hundredth_as_from_one():
    root = parse(charts.log_reliability({"a": [(p, p, p, p, 1) for p in (0.01, 0.1, 1.0)]}, "d"))
    x, y = (
        np.array([float(circle.get(at)) for circle in root.iter("circle")]) for at in ("cx", "cy")
    )
    np.testing.assert_allclose(np.diff(x, 2), 0, atol=0.2)
    np.testing.assert_allclose(np.diff(y, 2), 0, atol=0.2)


def test_positive_contributions_go_right_and_negative_left():
    """Positive contributions go right of the middle and negative ones left."""
    numbers = {"alpha": 0, "u": 1, "v": 2}
    bar = contribution_bar({"alpha": 1.0, "u": -2.0, "v": 3.0}, 4.0, numbers)
    places = {
        rect.find("title").text: numbers_of(rect, "x", "width") for rect in parse(bar).iter("rect")
    }
    assert places == {"alpha: 1.00": [70, 17.5], "u: -2.00": [35, 35], "v: 3.00": [87.5, 52.5]}
    (alone,) = parse(contribution_bar({"v": 1.0}, 1.0, numbers)).iter("rect")
    assert alone.get("class") == "series-2", "the colour does not depend on the others"


def test_intervals_are_drawn_in_rows_on_one_axis_with_the_reference():
    rows = [("one", (-0.1, -0.2, 0.1)), ("two", (0.4, 0.3, 0.5)), ("three", (0.25, None, None))]
    root = parse(charts.intervals(rows, "MRR", "description", reference=0.0))
    dots, whiskers = (
        of_class(root, "dot"),
        [points_of(whisker) for whisker in of_class(root, "whisker")],
    )
    assert titles_of(dots) == ["one: -0.1 [-0.2, 0.1]", "two: 0.4 [0.3, 0.5]", "three: 0.25"]
    per_unit = (whiskers[0][1, 0] - whiskers[0][0, 0]) / 0.3
    one = float(dots[0].get("cx"))
    assert [*whiskers[0][:, 0], *whiskers[1][:, 0]] == pytest.approx(
        [one + per_unit * offset for offset in (-0.1, 0.2, 0.4, 0.6)], abs=0.2
    )
    (reference,) = of_class(root, "diagonal")
    np.testing.assert_allclose(points_of(reference)[:, 0], one + 0.1 * per_unit, atol=0.2)
    heights = [whisker[:, 1].tolist() for whisker in whiskers]
    assert heights[0] == [float(dots[0].get("cy"))] * 2
    assert heights[0][0] < heights[1][0] == heights[1][1] < points_of(dots[2])[:, 1].min()
    assert {"-0.100", "0.400", "0.250", "MRR"} <= set(texts_of(root))
    of_shares = parse(charts.intervals([("a", (0.5, None, None))], "", "", percent=True))
    assert "50.0%" in texts_of(of_shares)
    assert not of_class(of_shares, "diagonal")


CHART = charts.log_reliability({}, "")


def test_a_figure_has_its_panels_side_by_side_and_escapes_its_texts():
    root = parse(charts.figure(LABEL, [(LABEL, CHART)] * 3, "svg text { fill: red; }"))
    assert root.get("aria-label") == LABEL
    assert [child.text for child in root if child.tag.endswith("text")] == [LABEL] * 4
    panels = [child for child in root if child.tag.endswith("svg")]
    places = [(float(panel.get("x", "")), float(panel.get("y", ""))) for panel in panels]
    assert places[0][1] == places[1][1] < places[2][1]
    assert places[0][0] == places[2][0] < places[1][0]
    _, _, width, height = map(float, root.get("viewBox", "").split())
    for panel, (x, y) in zip(panels, places, strict=True):
        assert x + float(panel.get("width", "")) <= width
        assert y + float(panel.get("height", "")) <= height


def test_a_figure_holds_its_own_style_without_what_only_browsers_know():
    svg = charts.figure("Title", [("", CHART)], chart_style())
    assert all(known in svg for known in (".line.series-0", "#0072b2"))
    assert not any(unknown in svg for unknown in ("var(", "color-mix", "{{"))


def test_mixed_colours_are_a_browsers_without_hover_points():
    """Mixed colours are those of a browser and there are no points to hover over."""
    assert resolved("fill: color-mix(in srgb, var(--s0) 50%, #000000);") == "fill: #003959;"
    chart = charts.curves({"a": straight(0.5)}, "", "", "")
    assert ['class="hit"' in svg for svg in (chart, charts.figure("", [("", chart)], ""))] == [
        True,
        False,
    ]


def test_a_scatter_has_whiskers_and_apart_labels():
    """A scatter has a whisker for each interval and labels that do not overlap."""
    points = [
        (f"share {i}", (i / 10, i / 10 - 0.01, i / 10 + 0.01), (0.5, 0.4, 0.6)) for i in range(1, 6)
    ]
    root = parse(
        charts.scatter(
            {"a": points, "b": [("x", (0.3, None, None), (0.5, None, None))]}, "", "", ""
        )
    )
    assert sum("whisker" in child.get("class", "") for child in root) == 2 * 5
    labels = [child for child in root if (child.text or "").startswith("share")]
    assert len(labels) >= 3
    ends = [(float(label.get("x", "")), len(label.text or "") * 5.5) for label in labels]
    assert all(
        left + width / 2 <= right - other / 2
        for (left, width), (right, other) in itertools.pairwise(ends)
    )


def test_labels_of_points_cover_no_point():
    """A label goes below where a point is above, and is left out where points are on both sides."""
    alone = (None, None)
    points = [
        ("free", (0.1, *alone), (0.5, *alone)),
        ("below", (0.5, *alone), (0.5, *alone)),
        ("at the left", (0.48, *alone), (0.55, *alone)),
        ("nowhere", (0.9, *alone), (0.5, *alone)),
        ("above it", (0.89, *alone), (0.55, *alone)),
        ("below it", (0.91, *alone), (0.45, *alone)),
    ]
    root = parse(charts.scatter({"a": points}, "", "", ""))
    labels = {child.text: float(child.get("y", "")) for child in root if child.text}
    assert {"free", "below"} < labels.keys()
    assert "nowhere" not in labels
    assert labels["below"] > labels["free"]


def luminance(colour):
    channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one, other):
    low, high = sorted(luminance(colour) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize(
    ("palette", "page", "least", "of_first"),
    [(LIGHT, "#ffffff", 2.2, 3), (DARK, "#0d1117", 4.5, 4.5)],
)
def test_all_series_stand_out_from_the_page_and_the_first_four_clearly(
    palette, page, least, of_first
):
    assert len(set(palette)) == COLOURS
    assert all(contrast(colour, page) > least for colour in palette)
    assert all(contrast(colour, page) > of_first for colour in palette[:4])


HOSTILE = '<script>alert("x")</script>&'


def parsed(markup):
    return ElementTree.fromstring(markup)


def box_of(root):
    """The boxes by their labels, as left, top, right and bottom."""
    boxes = {}
    for link in root.iter("a"):
        x, y, width, height = (
            float(link.find("rect").get(name)) for name in ("x", "y", "width", "height")
        )
        boxes[link.find("text").text] = (x, y, x + width, y + height)
    return boxes


def made(label, layer, *of, **more):
    return Made(label, f"/path/{label}", layer, of, **more)


DIAMOND = [
    made("b", 1, "a", "a"),
    made("c", 2, "b", "a"),
    made("d", 2, "b", "b"),
    made("e", 3, "c", "d"),
]


def test_layers_stand_from_left_to_right_and_boxes_do_not_overlap(kitchen):
    explored = Explored(OpenedGraph(kitchen, default_split(kitchen), "kitchen"))
    for entity in kitchen.entities:
        steps = view_of(explored, PathState(entity)).drawn
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
        assert all(
            box[0] >= 0 and box[2] <= width and box[1] >= 0 and box[3] <= height - 20
            for box in boxes.values()
        )


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
    things = [
        made("b", 1, "a", "a"),
        made("c", 2, "b", "b"),
        made("d", 3, "c", "c"),
        made("e", 4, "d", "b"),
    ]
    root = parsed(layered(things, ["a"], "way"))
    boxes = box_of(root)
    path = next(path.get("d") for path in root.iter("path") if path.find("title").text == "b → e")
    passes = re.findall(r" ([\d.]+)H([\d.]+)", path)
    assert len(passes) == 2
    for (y, right), label in zip(passes, ("c", "d"), strict=True):
        assert float(right) == boxes[label][2]
        assert not boxes[label][1] - 5 <= float(y) <= boxes[label][3] + 5


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
    assert [colour_of(number) for number in (-1, 0, 7, 8)] == [
        "series-other",
        "series-0",
        "series-7",
        "series-other",
    ]
