"""Charts parse, hold their data, survive awkward data, and are safe in a page; own drawings, too."""

import xml.etree.ElementTree as ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from markupsafe import Markup, escape

from wordcraft_kg.reports import charts
from wordcraft_kg.reports.charts import COLOURS, DARK_SERIES, LIGHT_SERIES, ChartCurve

LABEL = "<b>&\"'$x$</b>\u202e"
NO_ESTIMATE = (0.0, None, None)


def parse(chart):
    """Return the root of a chart as it stands in a page."""
    return ElementTree.fromstring(escape(chart))


def axes_of(chart):
    """Return the axes of a chart as a user gets them."""
    (axes,) = chart.figure().get_axes()
    return axes


def texts_of(root):
    return [text.text for text in root.iter("text")]


def straight(end, last=3e6):
    """A curve from 0.3 to an end, of seven points with an interval of ±0.05."""
    values = [(last * i / 6, 0.3 + (end - 0.3) * i / 6) for i in range(7)]
    return [(x, y, y - 0.05, y + 0.05) for x, y in values]


def drawn(series, percent=True, **options):
    """Curves without titles."""
    lines = [
        ChartCurve(name, points, number) for number, (name, points) in enumerate(series.items())
    ]
    return charts.curves(lines, "", "", "", percent=percent, **options)


def lines_of(axes):
    """Return the points of each line that is no marker."""
    lines = [line.get_xydata() for line in axes.get_lines()]
    return [points for points in lines if len(points) > 1]


CHARTS = {
    "curves": lambda label: charts.curves(
        [
            ChartCurve(label, [(0, 1.0, 0.5, 2.0), (2, 1.0, None, None)], 0, is_dashed=True),
            ChartCurve("_two", [(1, 1, 0, 2)], 1),
        ],
        label,
        label,
        label,
    ),
    "intervals": lambda label: charts.intervals(
        [(label, (0.5, 0.4, 0.6)), ("_two", NO_ESTIMATE)], label, label
    ),
    "log_reliability": lambda label: charts.log_reliability(
        {label: [(0.1, 0.2, 0.1, 0.3, 5)], "_two": [(0.1, 0.2, 0.1, 0.3, 5)]}, label
    ),
}


@pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS)
def test_a_chart_escapes_its_labels_and_is_safe_in_a_page(chart):
    """No markup, no direction mark and no formula comes from a label; a policy admits the page."""
    svg = escape(chart(LABEL))
    root = ElementTree.fromstring(svg)
    assert isinstance(svg, Markup)
    assert (root.get("aria-label"), root.get("role")) == (
        LABEL.replace("\u202e", "<U+202E>"),
        "img",
    )
    shown = texts_of(root)
    assert LABEL.replace("\u202e", "<U+202E>") in shown
    assert "_two" in shown, "Matplotlib hides names that begin so"
    assert root.find(".//b") is None
    assert not any(word in svg for word in ("\u202e", "style", "http", "nan", "href", " id="))
    assert len(svg) < 20_000


@pytest.mark.parametrize("chart", CHARTS.values(), ids=CHARTS)
def test_a_chart_has_the_same_bytes_whatever_the_settings_of_matplotlib(chart):
    with mpl.rc_context({"lines.linewidth": 9, "svg.fonttype": "path", "font.size": 30}):
        other = escape(chart("a"))
    assert escape(chart("a")) == other


def test_a_curve_goes_through_its_values_and_its_band_lies_around_it():
    axes = axes_of(drawn({"one": straight(0.9)}))
    points = np.array(straight(0.9))
    (line,) = lines_of(axes)
    np.testing.assert_array_equal(line, points[:, :2])
    (band,) = axes.collections
    np.testing.assert_allclose(band.get_datalim(axes.transData).intervaly, [0.25, 0.95])


FEW = [
    {},
    {"one": []},
    {"one": [(0, 0.0, None, None)]},
    {"one": [(5, -3.0, -3.0, -3.0)]},
    {"one": [(1, 0.5, 0.5, 0.5), (2, 0.5, 0.5, 0.5)]},
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "chart",
    [
        *(drawn(series, percent=False) for series in FEW),
        drawn({}),
        charts.intervals([], "x", "d", reference=0.0),
        charts.intervals([("🔥", (0.0, 0.0, 0.0))], "x", "d"),
        charts.intervals([("a", (-0.1, -0.3, 0.2)), ("a", NO_ESTIMATE)], "x", "d", reference=0.0),
        charts.log_reliability({}, "d"),
    ],
)
def test_charts_of_few_equal_or_negative_values_are_drawn_without_a_warning(chart):
    assert "nan" not in escape(chart)


def test_intervals_are_drawn_in_rows_from_the_top_with_their_values():
    rows = [("one", (-0.1, -0.2, 0.1)), ("two", (0.4, 0.3, 0.5)), ("three", (0.25, None, None))]
    axes = axes_of(charts.intervals(rows, "MRR", "description", reference=0.0))
    one, two, reference = lines_of(axes)
    assert (one.tolist(), two.tolist()) == ([[-0.2, 0], [0.1, 0]], [[0.3, 1], [0.5, 1]])
    assert reference[:, 0].tolist() == [0, 0]
    assert axes.yaxis_inverted()
    assert [text.get_text() for text in axes.texts] == ["-0.100", "0.400", "0.250"]
    of_shares = axes_of(charts.intervals([("a", (0.5, None, None))], "", "", percent=True))
    assert [text.get_text() for text in of_shares.texts] == ["50.0%"]


def test_a_share_of_0_stands_at_the_end_of_the_logarithmic_axes():
    points = [(1e-9, 1e-4, 0.0, 0.1, 3), (0.9, 0.0, 0.0, 0.5, 2)]
    axes = axes_of(charts.log_reliability({"a": points}, "d"))
    assert axes.get_xlim() == axes.get_ylim() == (1e-6, 1)
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert lines_of(axes)[-1].tolist() == [[1e-6, 1e-4], [0.9, 1e-6]]


def luminance(colour):
    channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one, other):
    low, high = sorted(luminance(colour) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize(
    ("palette", "page", "least", "of_first"),
    [(LIGHT_SERIES, "#ffffff", 2.2, 3), (DARK_SERIES, "#0d1117", 4.5, 4.5)],
)
def test_all_series_stand_out_from_the_page_and_the_first_four_clearly(
    palette, page, least, of_first
):
    assert len(set(palette)) == COLOURS
    assert all(contrast(colour, page) > least for colour in palette)
    assert all(contrast(colour, page) > of_first for colour in palette[:4])
