"""Charts for data series: curves, and estimates with intervals."""

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
"""Patterns of dashes in the style sheet."""
_ROW = 26
"""Height of a row of :func:`intervals`, in pixels."""
_FIFTHS = [i / 5 for i in range(6)]
"""Ticks of an axis for shares, from 0 to 1."""
_LABEL_HEIGHT = 10.05
"""Line height of small labels beside points, in pixels."""


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

    An isolated point with bounds has a whisker, and a single-point curve is a dot. An empty curve
    keeps its colour.

    Args:
        series: points of each curve, by name.
        x_title: title of the x-axis.
        y_title: title of the y-axis.
        description: text alternative for people who do not see the chart.
        percent: y is a share, on an axis from 0 to 100 %; otherwise the axis fits the data.
        dashed: names of the dashed curves; None gives each colour a pattern of its own.
        colours: colour numbers by name; None takes the position in ``series``.
        labels: end labels by name, for thin curves from several seeds of which one has the label;
            None labels each curve with its name.
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
        style = f"line {style_of(places[name])} {dash}"
        if labels is not None:
            style += " thin"
        plot.polyline(points, style, name)
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
    points = list(chain.from_iterable(series.values()))
    xs = [point[0] for point in points]
    ys = _values(point[1:] for point in points)
    y_ticks = _FIFTHS if percent else round_ticks(min(ys, default=0), max(ys, default=1))
    first = min([0, *xs])
    last = max(xs, default=1)
    if last <= first:  # a single point at 0: any range will do
        last = first + 1
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
    """Draw shares with whiskers by category, those of several series side by side.

    Args:
        labels: names of the categories.
        series: a share for each category, or None, by the series' name. A series without shares is
            not drawn, but keeps its colour and place.
        x_title: title of the x-axis.
        y_title: title of the y-axis.
        description: text alternative for people who do not see the chart.
    """
    names = [name for name, values in series.items() if not values or any(values)]
    room = room_for(names, 30)
    plot = Plot((0, max(len(labels), 1)), (0, 1), description, right=room)
    plot.y_axis(_FIFTHS, _shares(_FIFTHS))
    letters = int((plot.x(1) - plot.x(0)) / LETTER)
    plot.x_axis(
        [i + 0.5 for i in range(len(labels))], [shortened(label, letters) for label in labels]
    )
    # All series of a category lie within 80 % of its width, around its middle.
    gap = min(0.15, 0.8 / max(len(series), 1))
    for number, (name, values) in enumerate(series.items()):
        offset = (number - (len(series) - 1) / 2) * gap
        for i, (label, value) in enumerate(zip(labels, values, strict=True)):
            if value is not None:
                x = i + 0.5 + offset
                plot.whiskers((x, None, None), value, number)
                title = f"{name}, {label}: {estimate(value, True)}"
                plot.marker(plot.x(x), plot.y(value[0]), number, title)
        if name in names:
            left = WIDTH - room + 14
            y = plot.top + 6 + 16 * names.index(name)
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

    Args:
        series: points (label, x, y) by the series' name; y is a share. A label is shown once, where
            it fits.
        x_title: title of the x-axis.
        y_title: title of the y-axis.
        description: text alternative for people who do not see the chart.
        level: name and share of a dashed horizontal line, or None.
    """
    drawn = {
        name: sorted(points, key=lambda point: point[1][0])
        for name, points in series.items()
        if points
    }
    everything = list(chain.from_iterable(drawn.values()))
    xs = _values(x for _, x, _ in everything)
    ys = _values(y for _, _, y in everything)
    lines = [level] if level else []
    ticks = round_ticks(min(xs, default=0), max(xs, default=1))
    y_ticks = round_ticks(0, max([*ys, *(share for _, share in lines)], default=1))
    right = ticks[-1]
    room = room_for([*drawn, *(name for name, _ in lines)])
    plot = Plot((ticks[0], right), (0, y_ticks[-1]), description, right=room)
    plot.y_axis(y_ticks, _shares(y_ticks))
    plot.x_axis(ticks, [f"{value:.3g}" for value in ticks])
    for name, share in lines:
        plot.polyline([(ticks[0], share), (right, share)], "diagonal", f"{name}: {share:.1%}")
    taken = Labels(_LABEL_HEIGHT)
    named: set[str] = set()
    ends = [(right, share, name, "") for name, share in lines]
    for number, name in enumerate(series):
        points = drawn.get(name, [])
        for _, x, y in points:
            plot.whiskers(x, y, number)
        for label, x, y in points:
            title = f"{name}, {label}: {estimate(y, True)} at {estimate(x, False)}"
            plot.marker(plot.x(x[0]), plot.y(y[0]), number, title)
            # Labels of every second series lie below the points, so that those of two series
            # overlap less.
            _label_point(plot, taken, named, label, x[0], y, below=number % 2 == 1)
        ends += [(x[0], y[0], name, style_of(number)) for _, x, y in points[-1:]]
    plot.end_labels(ends)
    plot.titles(x_title, y_title)
    return plot.done()


def _values(estimates: Iterable[Sequence[float | None]]) -> list[float]:
    """Return the values and bounds of estimates in a list, without those that are None."""
    return [value for value in chain.from_iterable(estimates) if value is not None]


def _label_point(
    plot: Plot, taken: Labels, named: set[str], label: str, x: float, y: Estimate, *, below: bool
) -> None:
    """Write a point's label above or below its whiskers.

    A label that has been written, and a label without space, are left out.
    """
    ends = [plot.y(value) for value in _values([y])]
    middle = plot.x(x)
    half = SMALL_LETTER * len(label) / 2
    line = max(ends) + 12 if below else min(ends) - 5
    if label not in named and taken.take(middle - half, middle + half, line):
        named.add(label)
        plot.text(middle, line, label, "small", "middle")


def intervals(
    rows: Sequence[tuple[str, Estimate]],
    x_title: str,
    description: str,
    *,
    reference: float | None = None,
    percent: bool = False,
) -> Markup:
    """Draw estimates with whiskers, one in a row, with the value at the right.

    Args:
        rows: name and estimate of each row.
        x_title: title of the x-axis.
        description: text alternative for people who do not see the chart.
        reference: value of a dashed vertical line, or None.
        percent: the estimates are shares, shown as percentages.
    """
    estimates = [value for _, value in rows]
    ends = _values([*estimates, (reference,)] if rows else [])
    ticks = round_ticks(min(ends, default=0), max(ends, default=1))
    plot = Plot(
        (ticks[0], ticks[-1]),
        (max(len(rows), 1), 0),  # the first row is at the top
        description,
        top=TOP,
        right=56,
        left=room_for((name for name, _ in rows), 12),
        height=TOP + _ROW * len(rows) + BOTTOM,
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
        plot.text(plot.left - 8, y + 4, short(name), anchor="end")
        plot.text(WIDTH - 44, y + 4, f"{value[0]:.1%}" if percent else f"{value[0]:.3f}")
    plot.titles(x_title)
    return plot.done()


def log_reliability(
    series: Mapping[str, Sequence[tuple[float, float, float, float, int]]], description: str
) -> Markup:
    """Draw observed shares against probabilities on logarithmic axes.

    A diagonal shows perfect calibration.

    Args:
        series: points (probability, observed share, lower bound, upper bound, number of triples) by
            the series' name. A share of 0 is drawn at the lower end of the axis.
        description: text alternative for people who do not see the chart.
    """
    points = chain.from_iterable(series.values())
    coordinates = chain.from_iterable((x, y) for x, y, *_ in points)
    least = min((value for value in coordinates if value > 0), default=0.1)
    # The axis has a decade at least, and ends at a millionth: below, a share from some thousand
    # triples means nothing.
    lowest = min(math.floor(math.log10(max(least, 1e-6))), -1)

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
            true = f"true {y:.2g} [{low:.2g}, {high:.2g}]"
            title = f"{name}: probability {x:.2g}, {true}, {count:,} triples"
            plot.marker(plot.x(place(x)), plot.y(place(y)), number, title)
    plot.titles("probability")
    return plot.done(list(series))


def _shares(ticks: Sequence[float]) -> list[str]:
    """Format ticks as percentages, or as numbers if the steps are below one per cent."""
    return [f"{value:.3g}" if ticks[1] < 0.01 else f"{value:.0%}" for value in ticks]
