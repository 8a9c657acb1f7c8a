"""Charts: Matplotlib figures that pages show as SVG, and series drawn as charts.

Charts follow the page's light and dark colours without JavaScript. The first half of the file has
the frame of every chart, its colours, its labels and its SVG; then follow the kinds of charts:
curves, estimates with intervals, points. Matplotlib is imported when the first chart is drawn,
because importing it takes half a second.
"""

import io
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from wordcraft_kg.base.wording import for_html, for_terminal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure
    from matplotlib.ticker import PercentFormatter

OKABE_ITO = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
LIGHT_SERIES = (*OKABE_ITO, "#1b1f24", "#7f3c00")
DARK_SERIES = ("#4d9aff", *OKABE_ITO[1:], "#e6edf3", "#f0e442")
"""Colours on a dark page, where the blue of Okabe and Ito would be too dark for lines."""
COLOURS = len(LIGHT_SERIES)
LIGHT = {
    **{f"s{number}": colour for number, colour in enumerate(LIGHT_SERIES)},
    "ink": "#1b1f24",
    "soft": "#59636e",
    "line": "#d1d9e0",
    "other": "#8c959f",
    "page": "#ffffff",
}
DARK = {
    **{f"s{number}": colour for number, colour in enumerate(DARK_SERIES)},
    "ink": "#e6edf3",
    "soft": "#9da7b1",
    "line": "#3d444d",
    "other": "#6e7681",
    "page": "#0d1117",
}
"""Colours by the names of the style sheet: series, text, quiet text, lines, rest, page."""


def dark_rules() -> str:
    """Return CSS rules that give the elements of class ``chart`` the colours of a dark page.

    A chart has the colours of a white page as attributes, which every program shows; rules of a
    style sheet take precedence over attributes.
    """
    rules = []
    for name, colour in LIGHT.items():
        if DARK[name] == colour:
            continue
        for attribute in ("fill", "stroke"):
            rules.append(f'.chart [{attribute}="{colour}"] {{ {attribute}: {DARK[name]}; }}')
    return "\n".join(rules)


WIDTH = 460
HEIGHT = 250
"""Size of a chart in points, which are pixels in SVG; pages scale it."""
_POINTS = 72
"""Points in an inch, Matplotlib's unit of a figure's size."""
SMALL = 9.5
"""Size of small letters, in points."""
_STYLE: dict[str, Any] = {
    # Axes end at ticks.
    "axes.autolimit_mode": "round_numbers",
    "axes.axisbelow": True,
    "axes.edgecolor": LIGHT["line"],
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.labelcolor": LIGHT["ink"],
    "axes.labelsize": 11,
    "axes.spines.bottom": False,
    "axes.spines.left": False,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": LIGHT["soft"],
    "axes.titlelocation": "left",
    "axes.titlesize": SMALL,
    "axes.xmargin": 0,
    "axes.ymargin": 0,
    "font.size": 11,
    "grid.color": LIGHT["line"],
    "legend.frameon": False,
    "lines.linewidth": 2,
    # Texts stay texts, which readers can search and copy.
    "svg.fonttype": "none",
    "text.color": LIGHT["ink"],
    # A label may hold dollar signs, which are no formula.
    "text.parse_math": False,
    "xtick.bottom": False,
    "xtick.color": LIGHT["ink"],
    "xtick.labelsize": 11,
    "xtick.major.pad": 7,
    "ytick.left": False,
    "ytick.color": LIGHT["ink"],
    "ytick.labelsize": 11,
    "ytick.major.pad": 5,
}
_DRAWING = RLock()
"""Held while a chart is drawn: Matplotlib's settings belong to the whole process."""
_TAG = re.compile(r"<[^<>]+>")
"""A tag of SVG: Matplotlib escapes angle brackets in texts and attributes."""
_STYLED = re.compile(r' style="([^"]*)"')
_RULE = re.compile(r"([a-z-]+): ([^;]+)(?:; )?")
_UNUSED = re.compile(r' (?:id|clip-path)="[^"]*"|(?<=\.\d\d)\d+')
"""Names, which would repeat in a page; clipping of what lies inside the axes anyway; digits beyond
a hundredth of a pixel."""


@dataclass(frozen=True)
class Chart:
    """A chart, drawn when it is shown.

    Templates show it as inline SVG in the page's colours.

    Attributes:
        description: text alternative for people who do not see the chart.
        draw: draws the chart on axes of Matplotlib.
        height: height in points; the width is :data:`WIDTH`.
    """

    description: str
    draw: "Callable[[Axes], None]"
    height: int = HEIGHT

    def figure(self) -> "Figure":
        """Return the chart as a figure of Matplotlib, to change it or to save it for a paper."""
        return figure_of([("", self)])

    def __html__(self) -> Markup:
        """Return the chart as SVG to place in a page, which defines its dark colours."""
        with _drawing():
            figure = self.figure()
            content = _content_of(figure)
        return Markup(
            '<svg viewBox="0 0 {} {}" class="chart" role="img" aria-label="{}" '
            'stroke-linejoin="round">{}</svg>'
        ).format(WIDTH, self.height, for_html(self.description), content)


def figure_of(panels: Sequence[tuple[str, Chart]], title: str = "") -> "Figure":
    """Return charts as one figure of Matplotlib, two in a row.

    Args:
        panels: caption (or empty) and chart of each panel, at least one.
        title: title of the figure, or empty.
    """
    with _drawing():
        from matplotlib.figure import Figure

        num_columns = min(len(panels), 2)
        num_rows = math.ceil(len(panels) / num_columns)
        height = max(chart.height for _, chart in panels)
        size = (num_columns * WIDTH / _POINTS, num_rows * height / _POINTS)
        figure = Figure(figsize=size, dpi=_POINTS, layout="constrained")
        grid = figure.subfigures(num_rows, num_columns, squeeze=False)
        for subfigure, (caption, chart) in zip(grid.flat, panels, strict=False):
            if caption:
                subfigure.suptitle(for_terminal(caption), x=0.02, ha="left", fontsize="medium")
            chart.draw(subfigure.subplots())
        if title:
            figure.suptitle(for_terminal(title), x=0.01, ha="left", fontsize="large")
    return figure


def as_file(panels: Sequence[tuple[str, Chart]], title: str) -> str:
    """Return charts as the text of an SVG file with a title.

    A browser shows the file in the reader's colour scheme; other programs show it on white.
    """
    with _drawing():
        figure = figure_of(panels, title)
        content = _content_of(figure)
    width, height = (round(inches * _POINTS) for inches in figure.get_size_inches())
    dark = Markup(f"@media screen and (prefers-color-scheme: dark) {{\n{dark_rules()}\n}}")
    svg = Markup(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        'height="{height}" class="chart" role="img" font-family="Helvetica, Arial, '
        '&#39;Liberation Sans&#39;, &#39;DejaVu Sans&#39;, sans-serif" stroke-linejoin="round">'
        "<title>{title}</title><style>{dark}</style>"
        '<rect width="{width}" height="{height}" fill="{page}"/>{content}</svg>\n'
    )
    values = {"title": for_html(title), "dark": dark, "page": LIGHT["page"], "content": content}
    return str(svg.format(width=width, height=height, **values))


@contextmanager
def _drawing() -> Iterator[None]:
    """Draw with the settings of charts, whatever the user's settings of Matplotlib are."""
    from matplotlib import style

    with _DRAWING, style.context(["default", _STYLE]), warnings.catch_warnings():
        # The reader's browser has the letters that Matplotlib's font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def as_pdf(panels: Sequence[tuple[str, Chart]], title: str = "") -> bytes:
    """Return charts as a PDF file, for LaTeX; equal charts give equal bytes."""
    file = io.BytesIO()
    with _drawing():
        figure_of(panels, title).savefig(file, format="pdf", metadata={"CreationDate": None})
    return file.getvalue()


def _content_of(figure: "Figure") -> Markup:
    """Return the elements of a figure as SVG, for a root element of our own.

    Styles become attributes, which a page's security policy admits and its style sheet overrides.
    """
    file = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(file, format="svg", transparent=True, metadata=nothing)
    text = file.getvalue()
    begin = text.index('<g id="figure_1"')
    end = text.rindex("</g>") + len("</g>")
    content = text[begin:end]
    return Markup(_TAG.sub(_with_attributes, content))


def _with_attributes(tag: re.Match[str]) -> str:
    """Return a tag with its style as attributes, short numbers, and nothing unused."""
    styled = _STYLED.sub(_attributes, tag[0])
    return _UNUSED.sub("", styled)


def _attributes(style: re.Match[str]) -> str:
    """Return rules of CSS as attributes of SVG."""
    rules = _RULE.findall(style[1])
    # The page has its own letters, and shows them in the size that Matplotlib has measured.
    return "".join(f' {name}="{value}"' for name, value in rules if name != "font-family")


# --- series ---------------------------------------------------------------------------------------


CurvePoint = tuple[float, float, float | None, float | None]
"""x, y, and interval bounds for y, or None for both bounds."""
Estimate = tuple[float, float | None, float | None]
"""A value with the lower and the upper bound of its interval; None for both without an interval."""
ReliabilityPoint = tuple[float, float, float, float, int]
"""Probability, observed share, lower and upper bound of the share, and number of triples."""
_MARKERS = "os^D"
"""Shapes of markers by series."""
_MARKER_SIZE = 7
"""Diameter of a marker in points."""
_WHISKER = 1.5
"""Width of an interval's line."""
_MARGINS = 60
"""Height of the titles and tick labels of a chart, in points."""
_LINE = 19
"""Height of a line of a legend, in points."""
_ROW = 26
"""Height of a row of :func:`intervals`, in points."""
_LONGEST_NAME = 32
"""Most letters of a name."""


@dataclass(frozen=True)
class ChartCurve:
    """A curve of a chart.

    Attributes:
        label: name in the legend; empty for one of several curves of which another has the label.
        points: its points, from left to right.
        number: number of its colour, so that the same thing has the same colour in several charts.
        is_dashed: whether its line is dashed.
    """

    label: str
    points: Sequence[CurvePoint]
    number: int
    is_dashed: bool = False


def curves(
    drawn: Sequence[ChartCurve],
    x_title: str,
    y_title: str,
    description: str,
    *,
    percent: bool = False,
    width: float = 2,
) -> Chart:
    """Draw curves with uncertainty bands; the x-axis begins at 0.

    A curve of a single point is a dot with a whisker.

    Args:
        drawn: the curves.
        x_title: title of the x-axis.
        y_title: title of the y-axis.
        description: text alternative for people who do not see the chart.
        percent: y is a share, on an axis from 0 to 100 %; otherwise the axis fits the data.
        width: width of the lines, in points.
    """

    def draw(axes: "Axes") -> None:
        from matplotlib.ticker import EngFormatter

        lines = []
        names = []
        for curve in drawn:
            # NaN for None, which interrupts the band.
            xs, ys, lows, highs = np.array(curve.points, dtype=float).reshape(-1, 4).T
            colour = _colour(curve.number)
            axes.fill_between(xs, lows, highs, facecolor=colour, alpha=0.16, edgecolor="none")
            dashes = "--" if curve.is_dashed else "-"
            (line,) = axes.plot(xs, ys, color=colour, linestyle=dashes, linewidth=width)
            if len(curve.points) == 1:
                x, y, low, high = curve.points[0]
                _draw_estimate(axes, (x, None, None), (y, low, high), curve.number, "o")
            if curve.label:
                lines.append(line)
                names.append(_clean(curve.label))
        if percent:
            axes.set_ylim(0, 1)
            axes.yaxis.set_major_formatter(_percent())
        # Of a curve that has only begun, the axis would show thousandths of a step.
        axes.set_xlim(0, max(1, axes.get_xlim()[1]))
        axes.locator_params("x", nbins=5, integer=True)
        # Thousands (k) and millions (M) of steps.
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.legend(lines, names, loc="upper left", bbox_to_anchor=(1, 1))
        _write_titles(axes, x_title, y_title)

    # A legend of many names needs more room than the axes.
    num_names = sum(bool(curve.label) for curve in drawn)
    return Chart(description, draw, max(HEIGHT, _LINE * num_names + _MARGINS))


def intervals(
    rows: Sequence[tuple[str, Estimate]],
    x_title: str,
    description: str,
    *,
    reference: float | None = None,
    percent: bool = False,
    numbers: Sequence[int] = (),
) -> Chart:
    """Draw estimates with whiskers, one in a row, with the value at the right.

    Args:
        rows: name and estimate of each row.
        x_title: title of the x-axis.
        description: text alternative for people who do not see the chart.
        reference: value of a dashed vertical line, or None.
        percent: the estimates are shares, shown as percentages.
        numbers: number of each row's colour, so that the same thing has the same colour in several
            rows and charts; empty gives each row its own.
    """
    form = ".1%" if percent else ".3f"

    def draw(axes: "Axes") -> None:
        beside = axes.get_yaxis_transform()
        for number, (_, value) in enumerate(rows):
            colour = numbers[number] if numbers else number
            _draw_estimate(axes, value, (number, None, None), colour)
            axes.text(1.03, number, f"{value[0]:{form}}", transform=beside, va="center")
        if reference is not None:
            axes.axvline(reference, color=LIGHT["soft"], linestyle="--", linewidth=1)
        axes.set_yticks(range(len(rows)), [_clean(name) for name, _ in rows])
        # The first row is at the top.
        axes.set_ylim(max(len(rows), 1) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        axes.grid(axis="x")
        if percent:
            axes.xaxis.set_major_formatter(_percent())
        _write_titles(axes, x_title)

    return Chart(description, draw, _ROW * len(rows) + _MARGINS)


def log_reliability(
    series: Mapping[str, Sequence[ReliabilityPoint]],
    description: str,
) -> Chart:
    """Draw observed shares against probabilities on logarithmic axes.

    A diagonal shows perfect calibration.

    Args:
        series: points by the series' name. A share of 0 is drawn at the lower end of the axis.
        description: text alternative for people who do not see the chart.
    """
    values = [value for point in chain.from_iterable(series.values()) for value in point[:2]]
    # Zeros have no logarithm.
    smallest = min((value for value in values if value > 0), default=0.1)
    # The axis has a decade at least, and ends at a millionth: below, a share from some thousand
    # triples means nothing.
    decade = min(math.floor(math.log10(max(smallest, 1e-6))), -1)
    lowest = 10.0**decade

    def draw(axes: "Axes") -> None:
        axes.set(xscale="log", yscale="log", xlim=(lowest, 1), ylim=(lowest, 1))
        axes.xaxis.set_major_formatter("{x:.10g}")
        axes.yaxis.set_major_formatter("{x:.10g}")
        axes.minorticks_off()
        axes.plot([lowest, 1], [lowest, 1], color=LIGHT["soft"], linestyle="--", linewidth=1)
        markers = {}
        for number, (name, points) in enumerate(series.items()):
            marks = np.maximum([point[:4] for point in points], lowest)
            for x, *estimate in marks.tolist():
                markers[name] = _draw_estimate(axes, (x, None, None), tuple(estimate), number)
            axes.plot(marks[:, 0], marks[:, 1], color=_colour(number))
        names = [_clean(name) for name in markers]
        axes.legend(markers.values(), names, loc="upper left")
        _write_titles(axes, "probability", "share of true triples")

    return Chart(description, draw)


def _clean(name: str) -> str:
    """Return a name that fits a chart, in which nothing is hidden."""
    text = for_terminal(name)
    if len(text) <= _LONGEST_NAME:
        return text
    return text[: _LONGEST_NAME - 1].rstrip() + "…"


def _write_titles(axes: "Axes", x_title: str, y_title: str = "") -> None:
    """Write the title of x below the axes, and that of y above the upper left corner."""
    axes.set_xlabel(for_terminal(x_title))
    axes.set_title(for_terminal(y_title))


def _colour(number: int) -> str:
    """Return a data series' colour; colours repeat after the last."""
    return LIGHT_SERIES[number % COLOURS]


def _draw_estimate(
    axes: "Axes", x: Estimate, y: Estimate, number: int, marker: str = ""
) -> "PathCollection":
    """Draw a point with its intervals, and return its marker.

    Args:
        axes: axes to draw on.
        x: value on the x-axis, with bounds or with None for both.
        y: value on the y-axis, likewise.
        number: number of the data series, for colour and marker.
        marker: shape of the marker; empty for that of the series.
    """
    colour = _colour(number)
    across, left, right = x
    up, low, high = y
    # Estimates at the end of an axis are drawn whole.
    look: dict[str, Any] = {"color": colour, "linewidth": _WHISKER, "clip_on": False}
    if left is not None and right is not None:
        axes.plot([left, right], [up, up], **look)
    if low is not None and high is not None:
        axes.plot([across, across], [low, high], **look)
    # A marker of a line, or one with an edge, would be a named element and a link to it.
    return axes.scatter(
        [across],
        [up],
        _MARKER_SIZE**2,
        marker=marker or _MARKERS[number % len(_MARKERS)],
        facecolor=colour,
        edgecolor="none",
        zorder=3,
        clip_on=False,
    )


def _percent() -> "PercentFormatter":
    """Return a format of shares as percentages."""
    from matplotlib.ticker import PercentFormatter

    return PercentFormatter(1)
