"""Charts of series: bars, curves, and estimates with their intervals."""

import math
from collections.abc import Collection, Mapping, Sequence
from html import escape
from typing import Any

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import ABOVE, COLOURS, LEFT, LETTER, LONGEST_NAME, WIDTH, Plot
from wordcraft_kg.reports.charts.scales import Estimate, amounts, estimate, round_ticks, shortened

DASHES = 4
HOVER_POINTS = 60

CurvePoint = tuple[float, float, float | None, float | None]
"""x, y, and the bounds of an interval of y, or None for both bounds."""


def grouped_bars(
    labels: Sequence[str], series: Mapping[Any, Sequence[float]], x_title: str, description: str
) -> Markup:
    """Draw shares (0 to 1) as grouped bars with a legend."""
    highest = max((max(values, default=0) for values in series.values()), default=0)
    ticks = round_ticks(0, highest)
    plot = Plot((0, max(len(labels), 1)), (0, ticks[-1]), description, top=ABOVE)
    plot.y_ticks(ticks, lambda value: f"{value:.3g}" if ticks[1] < 0.01 else f"{value:.0%}")
    width = 0.8 / max(len(series), 1)
    for number, (name, values) in enumerate(series.items()):
        for i, value in enumerate(values):
            x = i + 0.1 + number * width
            plot.rectangle(x, x + width * 0.94, 0, value, f"series-{number}", f"{name}, {labels[i]}: {value:.1%}")
    plot.x_labels([(i + 0.5, label) for i, label in enumerate(labels)])
    plot.titles(x_title, "")
    return plot.done(list(series))


def curves(
    series: Mapping[str, Sequence[CurvePoint]],
    x_title: str,
    y_title: str,
    description: str,
    *,
    percent: bool = False,
    dashed: Collection[str] | None = None,
    colours: Mapping[str, int] | None = None,
    labels: Mapping[str, str] | None = None,
) -> Markup:
    """Draw curves with bands of uncertainty, each labelled at its right end; the x-axis includes 0.

    Several seeds are drawn as a curve of their means and a band of their interval. A point with bounds whose neighbours
    have none gets a whisker, and a curve of a single point is a dot.

    Args:
        series: points by name, x ascending; a curve without points keeps its colour, but is not drawn.
        x_title: title under the x-axis, whose numbers are abbreviated (0.5M).
        y_title: title above the chart.
        description: text for readers who cannot see it.
        percent: y is a share, and its axis goes from 0 to 100 %; otherwise the axis is fitted to the data.
        dashed: names of the curves to be dashed, such as those of train tasks; the others are solid. By default each
            colour has its own pattern, so that curves differ without colour too; where colours come again, their
            patterns are others.
        colours: numbers of colours by name, for curves that share one; by default a curve's place in ``series``.
        labels: text at the end by name, for curves that share one; a curve without a text is not
            labelled, and all are thin. By default, each has its name.
    """
    texts = labels if labels is not None else {name: name for name in series}
    names = {name: shortened(texts[name], LONGEST_NAME) for name, points in series.items() if points and name in texts}
    everything = [point for points in series.values() for point in points]
    xs = [point[0] for point in everything]
    ys = [value for point in everything for value in point[1:] if value is not None]
    y_ticks = [i / 5 for i in range(6)] if percent else round_ticks(min(ys, default=0), max(ys, default=1))
    first, last = min(xs, default=0), max(xs, default=1)
    first = min(first, 0)
    last = last if last > first else first + 1
    room = round(20 + LETTER * max(map(len, names.values()), default=0))
    plot = Plot((first, last), (y_ticks[0], y_ticks[-1]), description, top=ABOVE, right=room)
    y_texts = [f"{value:.0%}" for value in y_ticks] if percent else amounts(y_ticks)
    plot.y_ticks(y_ticks, dict(zip(y_ticks, y_texts, strict=True)).__getitem__)
    x_ticks = [value for value in round_ticks(first, last) if first <= value <= last]
    plot.x_labels(list(zip(x_ticks, amounts(x_ticks), strict=True)))
    places = {name: (colours or {}).get(name, i) for i, name in enumerate(series)}
    number = {name: place % COLOURS for name, place in places.items()}
    for name, points in series.items():
        for run in _runs_with_bounds(points):
            plot.band(run, f"band series-{number[name]}", f"whisker series-{number[name]}")
    drawn = {name: points for name, points in series.items() if points}
    for name, points in drawn.items():
        dash = pattern(places[name]) if dashed is None else "dashed" if name in dashed else "dash-0"
        thin = "" if labels is None else " thin"
        plot.polyline([point[:2] for point in points], f"line series-{number[name]} {dash}{thin}", name)
    for name, points in drawn.items():
        style, radius = ("hit", 4.0) if len(points) > 1 else (f"dot series-{number[name]}", 3.6)
        every = math.ceil(len(points) / HOVER_POINTS)
        # Counted from the end, because the last point matters most.
        for x, y, low, high in points[::-1][::every][::-1]:
            plot.circle(x, y, radius, style, f"{name}, {x:,.10g}: {estimate((y, low, high), percent)}")
    ends = [(name, *series[name][-1][:2]) for name in names]
    plot.end_labels([(x, y, names[name], texts[name], f"series-{number[name]}") for name, x, y in ends])
    plot.titles(x_title, y_title)
    return plot.done()


def pattern(place: int) -> str:
    """Return the dashes of a curve by its place."""
    return f"dash-{(place + place // COLOURS) % DASHES}"


def dots(
    labels: Sequence[str],
    series: Mapping[str, Sequence[Estimate | None]],
    x_title: str,
    y_title: str,
    description: str,
) -> Markup:
    """Draw shares (0 to 1) with the whiskers of their intervals, side by side in each category, legend on the right.

    Series differ in colour and in shape; one without any share keeps its own, but is not drawn.

    Args:
        labels: names of the categories; cut where they would overlap.
        series: by name, a share and its interval for each category, or None.
        x_title: title under the x-axis.
        y_title: title above the chart.
        description: text for readers who cannot see it.
    """
    names = {name: shortened(name, LONGEST_NAME) for name, values in series.items() if not values or any(values)}
    room = round(30 + LETTER * max(map(len, names.values()), default=0))
    plot = Plot((0, max(len(labels), 1)), (0, 1), description, top=ABOVE, right=room)
    plot.y_ticks([i / 5 for i in range(6)], lambda value: f"{value:.0%}")
    letters = int((plot.x(1) - plot.x(0)) / LETTER)
    plot.x_labels([(i + 0.5, shortened(label, letters)) for i, label in enumerate(labels)])
    gap = min(0.15, 0.8 / max(len(series), 1))
    for number, (name, values) in enumerate(series.items()):
        for i, (label, value) in enumerate(zip(labels, values, strict=True)):
            if value is not None:
                x = i + 0.5 + (number - (len(series) - 1) / 2) * gap
                share, low, high = value
                if low is not None and high is not None:
                    plot.whisker(x, low, high, f"whisker series-{number % COLOURS}")
                plot.marker(plot.x(x), plot.y(share), number, f"{name}, {label}: {estimate(value, True)}")
        if name in names:
            left, y = WIDTH - room + 14, plot.top + 6 + 16 * list(names).index(name)
            plot.marker(left, y, number, name)
            plot.parts.append(f'<text x="{left + 9}" y="{y + 4}">{escape(names[name])}</text>')
    plot.titles(x_title, y_title)
    return plot.done()


def reliability(points: Sequence[tuple[float, float, int]], description: str) -> Markup:
    """Draw accuracy against confidence, axes fitted to the data, with the diagonal of perfect calibration."""
    ticks = round_ticks(0, max((max(x, y) for x, y, _ in points), default=1.0))
    top = ticks[-1]
    plot = Plot((0, top), (0, top), description, top=ABOVE)
    plot.y_ticks(ticks, lambda value: f"{value:.3g}")
    plot.x_labels([(value, f"{value:.3g}") for value in ticks])
    plot.polyline([(0, 0), (top, top)], "diagonal")
    plot.polyline([(x, y) for x, y, _ in points], "line series-0")
    for x, y, count in points:
        plot.circle(x, y, 4, "series-0", f"confidence {x:.3f}, right {y:.3f}, {count} queries")
    plot.titles("confidence of the best candidate", "share that is right")
    return plot.done()


def log_reliability(series: Mapping[str, Sequence[tuple[float, float, float, float, int]]], description: str) -> Markup:
    """Draw observed shares against probabilities, both on logarithmic axes, with the diagonal of perfect agreement.

    Args:
        series: by name, points of probability, observed share, both bounds of its interval, and number. A share of 0 is
            drawn at the lower end of the axis.
        description: text for readers who cannot see it.
    """
    points = [point for values in series.values() for point in values]
    positive = [value for x, y, *_ in points for value in (x, y) if value > 0]
    lowest = min(math.floor(math.log10(max(min(positive, default=0.1), 1e-6))), -1)

    def place(value: float) -> float:
        return math.log10(max(value, 10.0**lowest))

    plot = Plot((lowest, 0), (lowest, 0), description, top=ABOVE, left=LEFT + 8)
    ticks = range(lowest, 1)
    plot.y_ticks(ticks, lambda value: f"{10.0**value:.10g}")
    plot.x_labels([(value, f"{10.0**value:.10g}") for value in ticks])
    plot.polyline([(lowest, lowest), (0, 0)], "diagonal")
    for number, (name, values) in enumerate(series.items()):
        plot.polyline([(place(x), place(y)) for x, y, *_ in values], f"line series-{number % COLOURS}")
        for x, y, low, high, count in values:
            plot.whisker(place(x), place(low), place(high), f"whisker series-{number % COLOURS}")
            title = f"{name}: probability {x:.2g}, true {y:.2g} [{low:.2g}, {high:.2g}], {count:,} triples"
            plot.marker(plot.x(place(x)), plot.y(place(y)), number, title)
    plot.titles("probability", "")
    return plot.done(list(series))


def _runs_with_bounds(points: Sequence[CurvePoint]) -> list[list[tuple[float, float, float]]]:
    """Return the runs of consecutive points that have bounds, as (x, low, high)."""
    runs: list[list[tuple[float, float, float]]] = [[]]
    for x, _, low, high in points:
        if low is not None and high is not None:
            runs[-1].append((x, low, high))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]
