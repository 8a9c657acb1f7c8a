"""Charts as Matplotlib figures, and as SVG for pages and files; labels that do not overlap.

Matplotlib is imported when the first chart is drawn, because importing it takes half a second.
"""

import io
import math
import re
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from wordcraft_kg.base.wording import for_html, for_terminal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def colour_of(number: int) -> str:
    """Return the CSS colour class for a group number.

    Negative numbers and numbers beyond the palette are grey.
    """
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"


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


def element(name: str, /, *inside: object, **attributes: object) -> Markup:
    """Return an element of SVG.

    Args:
        name: name of the element.
        inside: texts and elements in it; texts are escaped, elements (Markup) are not. Without
            any, the element is a single tag.
        attributes: values by name, in the order of the tag. A name's underscores stand for
            hyphens, and the one in ``class_`` for nothing.

    Example:
        >>> print(element("text", "a < b", text_anchor="end", class_="small"))
        <text text-anchor="end" class="small">a &lt; b</text>
    """
    opening = "<" + name
    for key, value in attributes.items():
        attribute = key.rstrip("_").replace("_", "-")
        opening += f' {attribute}="{for_html(value)}"'
    if not inside:
        return Markup(opening + "/>")
    content = "".join(map(for_html, inside))
    return Markup(f"{opening}>{content}</{name}>")


def titled(title: str) -> Markup:
    """Return a tooltip, the element ``title``; nothing for an empty title."""
    return element("title", title) if title else Markup()


def shortened(text: str, letters: int) -> str:
    """Shorten a text to a number of letters, with an ellipsis."""
    if len(text) <= letters:
        return text
    # Room for the ellipsis, but never less than the first letter.
    num_letters = max(letters - 1, 1)
    return text[:num_letters].rstrip() + "…"


def spread(
    wanted: Sequence[float],
    gap: float,
    low: float,
    high: float,
) -> list[float]:
    """Return the positions closest to the wanted ones that keep a distance from each other.

    The positions have the order of the wanted ones and the least sum of squared moves, by pooling
    adjacent violators.

    Args:
        wanted: N positions, in any order; ties keep their order.
        gap: least distance between two positions; it shrinks if the bounds are too narrow for N.
        low: least position.
        high: greatest position.

    Returns:
        N positions, each for the wanted position of the same index.

    Source: Barlow et al. 1972, "Statistical inference under order restrictions", for the pooling.
    """
    if not wanted:
        return []
    from scipy.optimize import isotonic_regression

    num_gaps = len(wanted) - 1
    gap = min(gap, (high - low) / max(num_gaps, 1))
    order = np.argsort(wanted, kind="stable")
    # Without the gaps of the lower ranks, positions only must not decrease: isotonic regression.
    gaps = gap * np.arange(len(wanted))
    pooled = isotonic_regression(np.asarray(wanted)[order] - gaps).x
    places = np.empty(len(wanted))
    # Bounds without the gaps; the lower one stays as it is.
    places[order] = np.clip(pooled, low, high - num_gaps * gap) + gaps
    positions: list[float] = places.tolist()
    return positions


class Labels:
    """The space taken by texts in a chart, so that later texts do not overlap earlier ones.

    Args:
        line: height of a line of text, in pixels.
    """

    def __init__(self, line: float):
        self._line = line
        # Texts as (left, right, y) by row of one line height: only three rows can overlap a text.
        self._taken = defaultdict[int, list[tuple[float, float, float]]](list)

    def take(self, left: float, right: float, y: float) -> bool:
        """Reserve space for a text, in pixels.

        Args:
            left: left end of the text.
            right: right end.
            y: height of the base line.

        Returns:
            False if the space is taken; then nothing is reserved.
        """
        row = int(y // self._line)
        for near in (row - 1, row, row + 1):
            for start, end, at in self._taken[near]:
                is_beside = left > end or right < start
                is_apart = abs(y - at) >= self._line
                if not (is_beside or is_apart):
                    return False
        self._taken[row].append((left, right, y))
        return True


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
    # Dashes have lengths in points, whatever the width of the line.
    "lines.scale_dashes": False,
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
        return element(
            "svg",
            content,
            viewBox=f"0 0 {WIDTH} {self.height}",
            class_="chart",
            role="img",
            aria_label=self.description,
            stroke_linejoin="round",
        )


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
        heights = []
        for row in range(num_rows):
            in_row = panels[row * num_columns : (row + 1) * num_columns]
            heights.append(max(chart.height for _, chart in in_row))
        size = (num_columns * WIDTH / _POINTS, sum(heights) / _POINTS)
        figure = Figure(figsize=size, dpi=_POINTS, layout="constrained")
        grid = figure.subfigures(num_rows, num_columns, squeeze=False, height_ratios=heights)
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
    page = element("rect", width=width, height=height, fill=LIGHT["page"])
    svg = element(
        "svg",
        element("title", title),
        element("style", dark),
        page,
        content,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width} {height}",
        width=width,
        height=height,
        class_="chart",
        role="img",
        font_family="Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif",
        stroke_linejoin="round",
    )
    return f"{svg}\n"


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
    attributes = ""
    for name, value in _RULE.findall(style[1]):
        # The page has its own letters, and shows them in the size that Matplotlib has measured.
        if name != "font-family":
            attributes += f' {name}="{value}"'
    return attributes
