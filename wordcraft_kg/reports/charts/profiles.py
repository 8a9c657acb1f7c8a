"""Shares of trainings above each level of a figure."""

from collections.abc import Mapping, Sequence
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import (
    ABOVE,
    BOTTOM,
    COLOURS,
    HEIGHT,
    LETTER,
    LINE_HEIGHT,
    LONGEST_NAME,
    WIDTH,
    Plot,
)
from wordcraft_kg.reports.charts.scales import shortened
from wordcraft_kg.reports.charts.series import CurvePoint, pattern

SAMPLE = 22
"""Width of the piece of a curve that stands before its name."""


def profiles(series: Mapping[str, Sequence[CurvePoint]], x_title: str, y_title: str, description: str) -> Markup:
    """Draw falling curves of shares over levels from 0 to 1, with bands, and their names in the order of their areas.

    All curves end at 0, so names stand beside the chart with a piece of the curve, the best at the top.

    Args:
        series: by name, points of level, share and the bounds of its interval.
        x_title: title under the axis of levels.
        y_title: title above the chart.
        description: text for readers who cannot see it.
    """
    names = {name: shortened(name, LONGEST_NAME) for name in series}
    room = round(32 + SAMPLE + LETTER * max(map(len, names.values()), default=0))
    plot = Plot((0, 1), (0, 1), description, top=ABOVE, right=room)
    ticks = [i / 5 for i in range(6)]
    plot.y_ticks(ticks, lambda value: f"{value:.0%}")
    plot.x_labels([(tick, f"{tick:.0%}") for tick in ticks])
    for number, points in enumerate(series.values()):
        bounds = [(x, low, high) for x, _, low, high in points if low is not None and high is not None]
        if bounds:
            plot.band(bounds, f"band series-{number % COLOURS}", "")
    styles = {name: f"line series-{number % COLOURS} {pattern(number)}" for number, name in enumerate(series)}
    for name, points in series.items():
        plot.polyline([point[:2] for point in points], styles[name], name)
    gap = min(LINE_HEIGHT + 2.0, (HEIGHT - ABOVE - BOTTOM) / max(len(series), 1))
    by_area = sorted(series, key=lambda name: -sum(point[1] for point in series[name]))
    for place, name in enumerate(by_area):
        left, y = WIDTH - room + 14, round(ABOVE + 6 + gap * place, 1)
        plot.parts.append(f'<polyline points="{left},{y} {left + SAMPLE},{y}" class="{styles[name]}"/>')
        number = list(series).index(name) % COLOURS
        title = f"<title>{escape(name)}</title>{escape(names[name])}"
        plot.parts.append(f'<text x="{left + SAMPLE + 6}" y="{y + 4}" class="series-{number}">{title}</text>')
    plot.titles(x_title, y_title)
    return plot.done()
