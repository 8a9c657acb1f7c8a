"""Axes with linear scales, and the SVG elements drawn between them."""

from collections.abc import Callable, Sequence
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.scales import spread

WIDTH, HEIGHT = 460, 250
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 12, 42
LINE_HEIGHT = 13
LETTER = 6.3
"""Width of a letter in the charts' 11 px text."""
LONGEST_NAME = 28
"""Letters of a name; longer ones are cut, but complete in the tooltip."""
ABOVE = 28
"""Margin above the axes that has room for a title or a legend."""


class Plot:
    """Axes with linear scales, collecting SVG elements; ``top``, ``right`` and ``left`` are margins."""

    def __init__(
        self,
        x_range: tuple[float, float],
        y_range: tuple[float, float],
        description: str,
        *,
        top: int = TOP,
        right: int = RIGHT,
        left: int = LEFT,
        height: int = HEIGHT,
    ):
        """Take the values at the ends of both axes, and a description for readers who cannot see the chart."""
        self.x_range, self.y_range, self.description = x_range, y_range, description
        self.top, self.right, self.left, self.height = top, right, left, height
        self.parts: list[str] = []

    def x(self, value: float) -> float:
        """Return the place of a value, in pixels from the left."""
        low, high = self.x_range
        return round(self.left + (value - low) / (high - low) * (WIDTH - self.left - self.right), 1)

    def y(self, value: float) -> float:
        """Return the place of a value, in pixels from the top."""
        low, high = self.y_range
        return round(self.height - BOTTOM - (value - low) / (high - low) * (self.height - self.top - BOTTOM), 1)

    def y_ticks(self, values: Sequence[float], text: Callable[[float], str]) -> None:
        """Draw grid lines at values, labelled beside the y-axis."""
        for value in values:
            y = self.y(value)
            self.parts.append(f'<line x1="{self.left}" x2="{WIDTH - self.right}" y1="{y}" y2="{y}" class="grid"/>')
            self.parts.append(f'<text x="{self.left - 5}" y="{y + 4}" text-anchor="end">{text(value)}</text>')

    def x_ticks(self, values: Sequence[float], text: Callable[[float], str]) -> None:
        """Draw upright grid lines at values, labelled below."""
        for value in values:
            self.parts.append(
                f'<line x1="{self.x(value)}" x2="{self.x(value)}" y1="{self.top}" y2="{self.height - BOTTOM}" '
                'class="grid"/>'
            )
        self.x_labels([(value, text(value)) for value in values])

    def x_labels(self, labels: Sequence[tuple[float, str]]) -> None:
        """Write texts under the x-axis."""
        style = "small" if len(labels) > 6 else "tick"
        for value, label in labels:
            y = self.height - BOTTOM + 15
            self.parts.append(
                f'<text x="{self.x(value)}" y="{y}" text-anchor="middle" class="{style}">{escape(label)}</text>'
            )

    def rectangle(self, left: float, right: float, low: float, high: float, style: str, title: str) -> None:
        """Draw a bar with a tooltip."""
        x, y = self.x(left), self.y(high)
        self.parts.append(
            f'<rect x="{x}" y="{y}" width="{self.x(right) - x:.1f}" height="{self.y(low) - y:.1f}" class="{style}">'
            f"<title>{escape(title)}</title></rect>"
        )

    def polyline(self, points: Sequence[tuple[float, float]], style: str, title: str = "") -> None:
        """Draw a line through points."""
        path = " ".join(f"{self.x(x)},{self.y(y)}" for x, y in points)
        inside = f"><title>{escape(title)}</title></polyline>" if title else "/>"
        self.parts.append(f'<polyline points="{path}" class="{style}"{inside}')

    def band(self, bounds: Sequence[tuple[float, float, float]], style: str, single: str) -> None:
        """Fill the area between bounds (x, low, high); for a single x, draw a whisker of the style ``single``."""
        if len(bounds) == 1:
            self.whisker(*bounds[0], single)
            return
        around = [(x, high) for x, _, high in bounds] + [(x, low) for x, low, _ in reversed(bounds)]
        path = " ".join(f"{self.x(x)},{self.y(y)}" for x, y in around)
        self.parts.append(f'<polygon points="{path}" class="{style}"/>')

    def whisker(self, x: float, low: float, high: float, style: str) -> None:
        """Draw a line from ``low`` to ``high``."""
        at = self.x(x)
        self.parts.append(f'<line x1="{at}" x2="{at}" y1="{self.y(low)}" y2="{self.y(high)}" class="{style}"/>')

    def marker(self, x: float, y: float, number: int, title: str) -> None:
        """Draw a circle, square, triangle or diamond at a place in pixels, by the number of the series."""
        style, inside = f"dot series-{number % COLOURS}", f"<title>{escape(title)}</title>"
        corners = (
            [],
            [(-3.2, -3.2), (3.2, -3.2), (3.2, 3.2), (-3.2, 3.2)],
            [(0, -4.2), (4, 3), (-4, 3)],
            [(0, -4.6), (4.2, 0), (0, 4.6), (-4.2, 0)],
        )[number % 4]
        path = " ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in corners)
        self.parts.append(
            f'<polygon points="{path}" class="{style}">{inside}</polygon>'
            if corners
            else f'<circle cx="{x}" cy="{y}" r="3.6" class="{style}">{inside}</circle>'
        )

    def end_labels(self, ends: Sequence[tuple[float, float, str, str, str]]) -> None:
        """Label the right ends (x, y, text, full name, style) of curves, with a thin line to labels that were moved."""
        places = spread([self.y(end[1]) for end in ends], LINE_HEIGHT, self.top, self.height - BOTTOM)
        edge = WIDTH - self.right
        for (x_value, y_value, text, name, style), place in zip(ends, places, strict=True):
            x, y = self.x(x_value), self.y(y_value)
            if abs(place - y) > 2 or edge - x > 2:
                self.parts.append(f'<line x1="{x + 2:.1f}" x2="{edge + 10}" y1="{y}" y2="{place:.1f}" class="leader"/>')
            inside = escape(text) + (f"<title>{escape(name)}</title>" if name != text else "")
            self.parts.append(f'<text x="{edge + 13}" y="{place + 4:.1f}" class="{style}">{inside}</text>')

    def circle(self, x: float, y: float, radius: float, style: str, title: str) -> None:
        """Draw a point with a tooltip."""
        self.parts.append(
            f'<circle cx="{self.x(x)}" cy="{self.y(y)}" r="{radius}" class="{style}">'
            f"<title>{escape(title)}</title></circle>"
        )

    def titles(self, x_title: str, y_title: str) -> None:
        """Write the titles of the axes, that of the upright one above it."""
        middle = (self.left + WIDTH - self.right) / 2
        self.parts.append(f'<text x="{middle}" y="{self.height - 6}" text-anchor="middle">{escape(x_title)}</text>')
        if y_title:
            self.parts.append(f'<text x="{self.left}" y="{self.top - 10}" class="small">{escape(y_title)}</text>')

    def done(self, legend: Sequence[str] = ()) -> Markup:
        """Return the chart, with a legend above it of names in the order of their colours."""
        x = float(self.left)
        for i, name in enumerate(legend):
            self.parts.append(f'<rect x="{x:g}" y="6" width="11" height="11" class="series-{i}"/>')
            self.parts.append(f'<text x="{x + 16:g}" y="16">{escape(name)}</text>')
            x += 32 + LETTER * len(name)
        opening = f'<svg viewBox="0 0 {WIDTH} {self.height}" role="img" aria-label="{escape(self.description)}">'
        return Markup("".join([opening, *self.parts, "</svg>"]))


OKABE_ITO = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
LIGHT = (*OKABE_ITO, "#1b1f24", "#7f3c00")
"""Colours on a white page."""
DARK = (*OKABE_ITO, "#e6edf3", "#f0e442")
"""Colours on a dark page."""
COLOURS = len(LIGHT)
