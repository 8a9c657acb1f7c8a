"""Charts for data series: curves, and estimates with intervals. ``description`` is a chart's text alternative."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import (
    BOTTOM,
    COLOURS,
    LEFT,
    LETTER,
    SMALL_LETTER,
    TOP,
    WIDTH,
    CurvePoint,
    Plot,
    room_for,
    short,
    style_of,
)
from wordcraft_kg.reports.charts.scales import (
    Estimate,
    Labels,
    amounts,
    estimate,
    round_ticks,
    shortened,
)

_DASHES = 4
_ROW = 26
_FIFTHS = [i / 5 for i in range(6)]


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
    """Draw curves with uncertainty bands and a label at the right end; the x-axis includes 0.

    An isolated point with bounds has a whisker, and a single-point curve is a dot. With ``percent``, y is a share on an
    axis from 0 to 100 %; otherwise the axis fits the data. ``dashed`` names dashed curves (default: a pattern for each
    colour), ``colours`` has colour numbers by name (default: the position in ``series``), and ``labels`` has end labels
    by name, for thin curves from several seeds (default: each curve's name). An empty curve keeps its colour.
    """
    texts = labels if labels is not None else {name: name for name in series}
    drawn = {name: points for name, points in series.items() if points}
    named = {name: texts[name] for name in drawn if name in texts}
    plot = _plot_of_curves(drawn, room_for(named.values()), description, percent)
    places = {name: (colours or {}).get(name, i) for i, name in enumerate(series)}
    for name, points in drawn.items():
        plot.bands(points, places[name])
    for name, points in drawn.items():
        dash = f"dash-{(places[name] + places[name] // COLOURS) % _DASHES}"
        if dashed is not None:
            dash = "dashed" if name in dashed else "dash-0"
        plot.polyline(
            points, f"line {style_of(places[name])} {dash}{' thin' * (labels is not None)}", name
        )
    for name, points in drawn.items():
        plot.hover_points(name, points, places[name], percent)
    plot.end_labels(
        [(*drawn[name][-1][:2], text, style_of(places[name])) for name, text in named.items()]
    )
    plot.titles(x_title, y_title)
    return plot.done()


def _plot_of_curves(
    series: Mapping[str, Sequence[CurvePoint]], room: int, description: str, percent: bool
) -> Plot:
    xs = [point[0] for points in series.values() for point in points]
    ys = [
        value
        for points in series.values()
        for point in points
        for value in point[1:]
        if value is not None
    ]
    y_ticks = _FIFTHS if percent else round_ticks(min(ys, default=0), max(ys, default=1))
    first, last = min([0, *xs]), max(xs, default=1)
    last = last if last > first else first + 1
    plot = Plot((first, last), (y_ticks[0], y_ticks[-1]), description, right=room)
    plot.y_axis(y_ticks, _shares(y_ticks) if percent else amounts(y_ticks))
    x_ticks = [value for value in round_ticks(first, last) if first <= value <= last]
    plot.x_axis(x_ticks, amounts(x_ticks))
    return plot


def dots(
    labels: Sequence[str],
    series: Mapping[str, Sequence[Estimate | None]],
    x_title: str,
    y_title: str,
    description: str,
) -> Markup:
    """Draw shares with whiskers by category (``labels``), side by side; a series without shares is not drawn."""
    names = [name for name, values in series.items() if not values or any(values)]
    room = room_for(names, 30)
    plot = Plot((0, max(len(labels), 1)), (0, 1), description, right=room)
    plot.y_axis(_FIFTHS, _shares(_FIFTHS))
    letters = int((plot.x(1) - plot.x(0)) / LETTER)
    plot.x_axis(
        [i + 0.5 for i in range(len(labels))], [shortened(label, letters) for label in labels]
    )
    gap = min(0.15, 0.8 / max(len(series), 1))
    for number, (name, values) in enumerate(series.items()):
        for i, (label, value) in enumerate(zip(labels, values, strict=True)):
            if value is not None:
                x = i + 0.5 + (number - (len(series) - 1) / 2) * gap
                plot.whiskers((x, None, None), value, number)
                plot.marker(
                    plot.x(x), plot.y(value[0]), number, f"{name}, {label}: {estimate(value, True)}"
                )
        if name in names:
            left, y = WIDTH - room + 14, plot.top + 6 + 16 * names.index(name)
            plot.marker(left, y, number, name)
            plot.text(left + 9, y + 4, short(name))
    plot.titles(x_title, y_title)
    return plot.done()


def scatter(
    series: Mapping[str, Sequence[tuple[str, Estimate, Estimate]]],
    x_title: str,
    y_title: str,
    description: str,
    *,
    level: tuple[str, float] | None = None,
) -> Markup:
    """Draw points with whiskers in x and y, and each series' name to the right of its last point.

    ``series`` has by name points (label, x, y) with y a share; labels are shown once, where they fit. ``level`` is the
    name and share of a dashed horizontal line.
    """
    drawn = {
        name: sorted(points, key=lambda point: point[1][0])
        for name, points in series.items()
        if points
    }
    everything = list(chain.from_iterable(drawn.values()))
    xs, ys = _values(x for _, x, _ in everything), _values(y for *_, y in everything)
    lines = [level] if level else []
    ticks = round_ticks(min(xs, default=0), max(xs, default=1))
    y_ticks = round_ticks(0, max([*ys, *(share for _, share in lines)], default=1))
    right, room = ticks[-1], room_for([*drawn, *(name for name, _ in lines)])
    plot = Plot((ticks[0], right), (0, y_ticks[-1]), description, right=room)
    plot.y_axis(y_ticks, _shares(y_ticks))
    plot.x_axis(ticks, [f"{value:.3g}" for value in ticks])
    for name, share in lines:
        plot.polyline([(ticks[0], share), (right, share)], "diagonal", f"{name}: {share:.1%}")
    taken, named = Labels(10.05), set[str]()
    ends = [(right, share, name, "") for name, share in lines]
    for number, name in enumerate(series):
        points = drawn.get(name, [])
        for _, x, y in points:
            plot.whiskers(x, y, number)
        for label, x, y in points:
            title = f"{name}, {label}: {estimate(y, True)} at {estimate(x, False)}"
            plot.marker(plot.x(x[0]), plot.y(y[0]), number, title)
            _label_point(plot, taken, named, label, x[0], y, below=number % 2 == 1)
        ends += [(x[0], y[0], name, style_of(number)) for _, x, y in points[-1:]]
    plot.end_labels(ends)
    plot.titles(x_title, y_title)
    return plot.done()


def _values(estimates: Iterable[Estimate]) -> list[float]:
    return [value for estimate in estimates for value in estimate if value is not None]


def _label_point(
    plot: Plot, taken: Labels, named: set[str], label: str, x: float, y: Estimate, *, below: bool
) -> None:
    ends = [plot.y(value) for value in _values([y])]
    left, half, line = (
        plot.x(x),
        SMALL_LETTER * len(label) / 2,
        max(ends) + 12 if below else min(ends) - 5,
    )
    if label not in named and taken.take(left - half, left + half, line):
        named.add(label)
        plot.text(left, line, label, "small", "middle")


def intervals(
    rows: Sequence[tuple[str, Estimate]],
    x_title: str,
    description: str,
    *,
    reference: float | None = None,
    percent: bool = False,
) -> Markup:
    """Draw estimates (shares if ``percent``) with whiskers, one per row, and a dashed line at ``reference``."""
    ends = [end for _, row in rows for end in (*row, reference) if end is not None]
    ticks = round_ticks(min(ends, default=0), max(ends, default=1))
    left, height = room_for((name for name, _ in rows), 12), TOP + _ROW * len(rows) + BOTTOM
    y_range = (max(len(rows), 1), 0)
    plot = Plot(
        (ticks[0], ticks[-1]), y_range, description, top=TOP, right=56, left=left, height=height
    )
    plot.x_axis(
        ticks, [f"{value:.0%}" if percent else f"{value:.3g}" for value in ticks], grid=True
    )
    if reference is not None:
        plot.polyline([(reference, 0), (reference, len(rows))], "diagonal")
    for number, (name, value) in enumerate(rows):
        y = plot.y(number + 0.5)
        plot.whiskers(value, (number + 0.5, None, None), number)
        plot.marker(plot.x(value[0]), y, number, f"{name}: {estimate(value, percent)}")
        plot.text(left - 8, y + 4, short(name), anchor="end")
        plot.text(WIDTH - 44, y + 4, f"{value[0]:.1%}" if percent else f"{value[0]:.3f}")
    plot.titles(x_title)
    return plot.done()


def log_reliability(
    series: Mapping[str, Sequence[tuple[float, float, float, float, int]]], description: str
) -> Markup:
    """Draw observed shares against probabilities on logarithmic axes, with a diagonal for perfect calibration.

    ``series`` has by name points: probability, observed share, interval bounds and triple count. A share of 0 is drawn
    at the lower end of the axis.
    """
    points = [point for values in series.values() for point in values]
    positive = [value for x, y, *_ in points for value in (x, y) if value > 0]
    lowest = min(math.floor(math.log10(max(min(positive, default=0.1), 1e-6))), -1)

    def place(value: float) -> float:
        return math.log10(max(value, 10.0**lowest))

    plot = Plot((lowest, 0), (lowest, 0), description, left=LEFT + 8)
    ticks = range(lowest, 1)
    texts = [f"{10.0**value:.10g}" for value in ticks]
    plot.y_axis(ticks, texts)
    plot.x_axis(ticks, texts)
    plot.polyline([(lowest, lowest), (0, 0)], "diagonal")
    for number, (name, values) in enumerate(series.items()):
        plot.polyline([(place(x), place(y)) for x, y, *_ in values], f"line {style_of(number)}")
        for x, y, low, high, count in values:
            plot.whiskers((place(x), None, None), (place(y), place(low), place(high)), number)
            title = f"{name}: probability {x:.2g}, true {y:.2g} [{low:.2g}, {high:.2g}], {count:,} triples"
            plot.marker(plot.x(place(x)), plot.y(place(y)), number, title)
    plot.titles("probability")
    return plot.done(list(series))


def _shares(ticks: Sequence[float]) -> list[str]:
    return [f"{value:.3g}" if ticks[1] < 0.01 else f"{value:.0%}" for value in ticks]
