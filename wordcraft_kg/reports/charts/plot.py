"""Charts with linear axes: grid lines, curves, markers and labels as SVG elements; colours.

The first six colours are from Okabe and Ito 2008, "Color universal design", by contrast with a
white page. The seventh is the text colour; the eighth is brown on a white page and yellow on a dark
page. A test simulates deuteranopia and protanopia. Curves also differ in dashes, and markers in
shape.
"""

import math
from collections.abc import Iterable, Sequence

from markupsafe import Markup

from wordcraft_kg.reports.charts.scales import Estimate, estimate, shortened, spread
from wordcraft_kg.reports.charts.svg import element, titled

OKABE_ITO = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
LIGHT = (*OKABE_ITO, "#1b1f24", "#7f3c00")
DARK = ("#4d9aff", *OKABE_ITO[1:], "#e6edf3", "#f0e442")
"""Colours on a dark page, where the blue of Okabe and Ito would be too dark for lines."""
COLOURS = len(LIGHT)
WIDTH = 460
HEIGHT = 250
"""Size of a chart in pixels of its own coordinates; pages scale it."""
LEFT = 46
_RIGHT = 12
TOP = 12
BOTTOM = 42
"""Margins in pixels: the left one holds tick labels, the bottom one also the axis title."""
_LINE_HEIGHT = 13
LETTER = 6.3
SMALL_LETTER = 5.5
"""Mean letter widths in pixels, for usual (11 px) and small text."""
_LONGEST_NAME = 32
"""Most letters in a name; a shortened name's tooltip is complete."""
ABOVE = 28
"""Margin above the axes, for a title or a legend."""
_HOVER_POINTS = 60
"""Most points of a curve with a tooltip: more would overlap, and make the page large."""
_RADIUS = 3.6
"""Radius of a dot in pixels."""
_SQUARE = (
    (-3.2, -3.2),
    (3.2, -3.2),
    (3.2, 3.2),
    (-3.2, 3.2),
)
_TRIANGLE = (
    (0, -4.2),
    (4, 3),
    (-4, 3),
)
_DIAMOND = (
    (0, -4.6),
    (4.2, 0),
    (0, 4.6),
    (-4.2, 0),
)
"""Corners of markers around the point, in pixels; the areas are about that of a dot."""
_Corners = tuple[tuple[float, float], ...]
_CORNERS: tuple[_Corners, ...] = ((), _SQUARE, _TRIANGLE, _DIAMOND)
"""Shapes of the markers by series; a circle has no corners."""

_Ends = tuple[float | str, float | str]
"""Coordinates of a line in pixels, at its start and its end; a text is already formatted."""
CurvePoint = tuple[float, float, float | None, float | None]
"""x, y, and interval bounds for y, or None for both bounds."""


def style_of(number: int) -> str:
    """Return the CSS colour class for a data series' number; colours repeat after the last."""
    return f"series-{number % COLOURS}"


def colour_of(number: int) -> str:
    """Return the CSS colour class for a group number.

    Negative numbers and numbers beyond the palette are grey.
    """
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"


def short(name: str) -> str:
    """Return a name, shortened to fit a chart margin."""
    return shortened(name, _LONGEST_NAME)


def room_for(names: Iterable[str], extra: int = 20) -> int:
    """Return the margin in pixels that the longest of these names needs, plus ``extra`` pixels."""
    lengths = [len(short(name)) for name in names]
    letters = max(lengths, default=0)
    return round(extra + LETTER * letters)


class Plot:
    """A chart with linear axes, built from SVG elements.

    Args:
        x_range: values at the left and the right end of the x-axis.
        y_range: values at the lower and the upper end of the y-axis; they may decrease.
        description: text alternative for people who do not see the chart.
        top: margin above the axes, in pixels.
        right: margin to the right.
        left: margin to the left.
        height: height of the whole chart in pixels.
    """

    def __init__(
        self,
        x_range: tuple[float, float],
        y_range: tuple[float, float],
        description: str,
        *,
        top: int = ABOVE,
        right: int = _RIGHT,
        left: int = LEFT,
        height: int = HEIGHT,
    ):
        self.x_range = x_range
        self.y_range = y_range
        self.description = description
        self.top = top
        self.right = right
        self.left = left
        self.height = height
        self.parts: list[Markup] = []

    def x(self, value: float) -> float:
        """Return a value's x-coordinate in pixels."""
        low, high = self.x_range
        share = (value - low) / (high - low)
        inner = WIDTH - self.left - self.right
        # A tenth of a pixel is not seen, and keeps the page small.
        return round(self.left + share * inner, 1)

    def y(self, value: float) -> float:
        """Return a value's y-coordinate in pixels, counted downwards as in SVG."""
        low, high = self.y_range
        share = (value - low) / (high - low)
        bottom = self.height - BOTTOM
        inner = self.height - self.top - BOTTOM
        return round(bottom - share * inner, 1)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        style: str = "",
        anchor: str = "",
        name: str = "",
    ) -> None:
        """Write a text.

        Args:
            x: coordinate of the anchor, in pixels.
            y: coordinate of the base line, in pixels.
            text: the text to show; it is escaped.
            style: CSS class, or empty.
            anchor: end of the text at ``x``: middle, end, or empty for its start.
            name: complete text, which becomes a tooltip if ``text`` is a shortened form.
        """
        attributes = {
            "x": f"{x:g}",
            "y": f"{y:.5g}",
        }
        if anchor:
            attributes["text_anchor"] = anchor
        if style:
            attributes["class_"] = style
        tooltip = name if name != text else ""
        self._add("text", text, titled(tooltip), **attributes)

    def _add(self, name: str, /, *inside: object, **attributes: object) -> None:
        """Add an element, see :func:`~wordcraft_kg.reports.charts.svg.element`."""
        self.parts.append(element(name, *inside, **attributes))

    def _line(self, x: _Ends, y: _Ends, style: str) -> None:
        """Draw a straight line between two points, x and y in pixels."""
        x1, x2 = x
        y1, y2 = y
        self._add("line", x1=x1, x2=x2, y1=y1, y2=y2, class_=style)

    def y_axis(self, ticks: Sequence[float], texts: Sequence[str]) -> None:
        """Draw horizontal grid lines with tick labels."""
        across = (self.left, WIDTH - self.right)
        # Texts end a little before the grid, and their base line is below the middle of a letter.
        text_end = self.left - 5
        for value, text in zip(ticks, texts, strict=True):
            y = self.y(value)
            self._line(across, (y, y), "grid")
            self.text(text_end, y + 4, text, anchor="end")

    def x_axis(self, ticks: Sequence[float], texts: Sequence[str], *, grid: bool = False) -> None:
        """Write tick labels below the chart.

        Args:
            ticks: values of the ticks.
            texts: label of each tick.
            grid: draw a vertical line at each tick.
        """
        bottom = self.height - BOTTOM
        down = (self.top, bottom)
        base_line = bottom + 15
        style = "small" if len(ticks) > 6 else "tick"
        for value, text in zip(ticks, texts, strict=True):
            x = self.x(value)
            if grid:
                self._line((x, x), down, "grid")
            self.text(x, base_line, text, style, "middle")

    def titles(self, x_title: str, y_title: str = "") -> None:
        """Write the axis titles.

        Args:
            x_title: title of the horizontal axis, below the middle of the chart.
            y_title: title of the vertical axis, above its upper end; empty for none.
        """
        right_end = WIDTH - self.right
        middle = (self.left + right_end) / 2
        below = self.height - 6
        self.text(middle, below, x_title, anchor="middle")
        if y_title:
            above = self.top - 10
            self.text(self.left, above, y_title, "small")

    def polyline(
        self,
        points: Iterable[Sequence[float | None]],
        style: str,
        title: str = "",
    ) -> None:
        """Draw a line.

        Args:
            points: (x, y, ...) in values of the axes; further elements are ignored.
            style: CSS classes.
            title: tooltip, or empty.
        """
        corners = []
        for x, y, *_ in points:
            corners.append((x or 0, y or 0))
        path = self._path(corners)
        tooltip = [titled(title)] if title else []
        self._add("polyline", *tooltip, points=path, class_=style)

    def _path(self, points: Iterable[tuple[float, float]]) -> str:
        """Return points in values of the axes as coordinates of SVG."""
        corners = []
        for x, y in points:
            across = self.x(x)
            down = self.y(y)
            corners.append(f"{across},{down}")
        return " ".join(corners)

    def bands(self, points: Sequence[CurvePoint], number: int) -> None:
        """Fill the area between the bounds of consecutive points in colour ``number``.

        A point without bounds interrupts the area; a point with bounds between two such points has
        a whisker.
        """
        style = f"band {style_of(number)}"
        for run in _runs_with_bounds(points):
            if len(run) == 1:
                ((x, low, high),) = run
                exact = (x, None, None)
                self.whiskers(exact, (low, low, high), number)
                continue
            # Around the area: along the upper bounds to the right, and back along the lower bounds.
            there = [(x, high) for x, _, high in run]
            back = [(x, low) for x, low, _ in reversed(run)]
            path = self._path([*there, *back])
            self._add("polygon", points=path, class_=style)

    def hover_points(
        self,
        name: str,
        points: Sequence[CurvePoint],
        number: int,
        percent: bool,
    ) -> None:
        """Add tooltips to a curve's points.

        Args:
            name: the curve's name, which begins each tooltip.
            points: the curve's points, at least one; of more than 60 only every n-th has a tooltip.
            number: colour of the dot that a curve with a single point becomes.
            percent: format y as a percentage.
        """
        is_curve = len(points) > 1
        style = "hit" if is_curve else f"dot {style_of(number)}"
        # The invisible points of a curve are a little larger, and easier to hit.
        radius = 4.0 if is_curve else _RADIUS
        every = math.ceil(len(points) / _HOVER_POINTS)
        # Every n-th point counted from the end, because the last point matters most.
        from_the_end = points[::-1]
        chosen = from_the_end[::every]
        for x, y, low, high in reversed(chosen):
            value = estimate((y, low, high), percent)
            title = f"{name}, {x:,.10g}: {value}"
            self.circle(x, y, radius, style, title)

    def circle(self, x: float, y: float, radius: float, style: str, title: str) -> None:
        """Draw a point.

        Args:
            x: value on the x-axis.
            y: value on the y-axis.
            radius: radius in pixels.
            style: CSS classes.
            title: tooltip.
        """
        across = self.x(x)
        down = self.y(y)
        self._dot(across, down, radius, style, title)

    def _dot(self, x: float, y: float, radius: float, style: str, title: str) -> None:
        """Draw a circle with a tooltip, x and y in pixels."""
        tooltip = titled(title)
        self._add("circle", tooltip, cx=x, cy=y, r=radius, class_=style)

    def whiskers(self, x: Estimate, y: Estimate, number: int) -> None:
        """Draw a point's intervals as lines (whiskers).

        Args:
            x: value on the x-axis, with bounds or with None for both.
            y: value on the y-axis, likewise.
            number: colour of the data series.
        """
        style = f"whisker {style_of(number)}"
        across, left, right = x
        up, low, high = y
        if left is not None and right is not None:
            ends = [(left, up), (right, up)]
            self.polyline(ends, style)
        if low is not None and high is not None:
            at = self.x(across)
            down = (self.y(low), self.y(high))
            self._line((at, at), down, style)

    def marker(self, x: float, y: float, number: int, title: str) -> None:
        """Draw a marker in the shape and colour of a data series.

        Args:
            x: value on the x-axis.
            y: value on the y-axis.
            number: number of the data series.
            title: tooltip.
        """
        across = self.x(x)
        down = self.y(y)
        self.marker_at(across, down, number, title)

    def marker_at(self, x: float, y: float, number: int, title: str) -> None:
        """Draw a marker as :meth:`marker` does, but around a point in pixels.

        Args:
            x: coordinate of the centre, in pixels.
            y: coordinate of the centre, in pixels.
            number: number of the data series.
            title: tooltip.
        """
        style = f"dot {style_of(number)}"
        shape = number % len(_CORNERS)
        corners = _CORNERS[shape]
        if not corners:
            self._dot(x, y, _RADIUS, style, title)
            return
        points = []
        for right, down in corners:
            points.append(f"{x + right:.1f},{y + down:.1f}")
        path = " ".join(points)
        self._add("polygon", titled(title), points=path, class_=style)

    def end_labels(self, ends: Sequence[tuple[float, float, str, str]]) -> None:
        """Label curves at their right ends (x, y, name, style).

        A thin line leads to a label that had to move.
        """
        heights = [self.y(y_value) for _, y_value, _, _ in ends]
        bottom = self.height - BOTTOM
        # Labels keep a line's height from each other, so some of them move away from their curve.
        places = spread(heights, _LINE_HEIGHT, self.top, bottom)
        edge = WIDTH - self.right
        for end, y, place in zip(ends, heights, places, strict=True):
            x_value, _, name, style = end
            x = self.x(x_value)
            # Two pixels: a shorter leader would look like a speck.
            has_moved = abs(place - y) > 2
            is_far = edge - x > 2
            if has_moved or is_far:
                across = (f"{x + 2:.1f}", edge + 10)
                down = (y, f"{place:.1f}")
                self._line(across, down, "leader")
            shown = short(name)
            base_line = place + 4
            self.text(edge + 13, base_line, shown, style, name=name)

    def done(self, legend: Sequence[str] = ()) -> Markup:
        """Return the chart as SVG.

        ``legend`` names the data series in the order of their colours.
        """
        x = float(self.left)
        for number, name in enumerate(legend):
            self._add(
                "rect",
                x=f"{x:g}",
                y=6,
                width=11,
                height=11,
                class_=f"series-{number}",
            )
            self.text(x + 16, 16, name)
            # The square with its space, the name, and the space before the next square.
            x += 32 + LETTER * len(name)
        return element(
            "svg",
            *self.parts,
            viewBox=f"0 0 {WIDTH} {self.height}",
            role="img",
            aria_label=self.description,
        )


def _runs_with_bounds(
    points: Iterable[CurvePoint],
) -> list[list[tuple[float, float, float]]]:
    """Return consecutive points with bounds as lists of (x, lower bound, upper bound)."""
    runs: list[list[tuple[float, float, float]]] = [[]]
    for x, _, low, high in points:
        if low is None or high is None:
            # The next point with bounds begins another run.
            runs.append([])
        else:
            runs[-1].append((x, low, high))
    return [run for run in runs if run]
