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

ReliabilityPoint = tuple[float, float, float, float, int]
"""Probability, observed share, lower and upper bound of the share, and number of triples."""
_DASHES = 4
"""Patterns of dashes in the style sheet."""
_ROW = 26
"""Height of a row of :func:`intervals`, in pixels."""
_FIFTHS = [i / 5 for i in range(6)]
"""Ticks of an axis for shares, from 0 to 1."""
_LABEL_HEIGHT = 10.05
"""Line height of small labels beside points, in pixels."""
_MARKER = 4.0
"""Half of a marker's width and height, in pixels."""


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
    # Empty curves count, so that the same name has the same colour in several charts.
    numbers = {name: number for number, name in enumerate(series)}
    if colours is not None:
        numbers |= colours
    # Layers from the back to the front: bands hide no line, and tooltips are reached first.
    for name, points in drawn.items():
        plot.bands(points, numbers[name])
    for name, points in drawn.items():
        number = numbers[name]
        dash = _dash_of(name, number, dashed)
        style = f"line {style_of(number)} {dash}"
        if labels is not None:
            style += " thin"
        plot.polyline(points, style, name)
    for name, points in drawn.items():
        plot.hover_points(name, points, numbers[name], percent)
    ends = []
    for name, text in named.items():
        x, y, *_ = drawn[name][-1]
        ends.append((x, y, text, style_of(numbers[name])))
    plot.end_labels(ends)
    plot.titles(x_title, y_title)
    return plot.done()


def _dash_of(name: str, number: int, dashed: Collection[str] | None) -> str:
    """Return the CSS class of a curve's dashes."""
    if dashed is None:
        # The shift by a pattern with each round of the colours tells apart two curves of a colour.
        rounds = number // COLOURS
        return f"dash-{(number + rounds) % _DASHES}"
    if name in dashed:
        return "dashed"
    return "dash-0"


def _plot_of_curves(
    series: Mapping[str, Sequence[CurvePoint]], room: int, description: str, percent: bool
) -> Plot:
    points = list(chain.from_iterable(series.values()))
    xs = [point[0] for point in points]
    ys = _values(point[1:] for point in points)
    if percent:
        y_ticks = _FIFTHS
        y_texts = _shares(y_ticks)
    else:
        lowest = min(ys, default=0)
        highest = max(ys, default=1)
        y_ticks = round_ticks(lowest, highest)
        y_texts = amounts(y_ticks)
    first = min([0, *xs])
    last = max(xs, default=1)
    if last <= first:  # a single point at 0: any range will do
        last = first + 1
    y_range = (y_ticks[0], y_ticks[-1])
    plot = Plot((first, last), y_range, description, right=room)
    plot.y_axis(y_ticks, y_texts)
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
    # Without categories, all series are in the legend.
    names = [name for name, values in series.items() if any(values) or not values]
    room = room_for(names, 30)
    # Each category is one unit wide; without categories, an empty chart still needs a width.
    x_range = (0, max(len(labels), 1))
    plot = Plot(x_range, (0, 1), description, right=room)
    plot.y_axis(_FIFTHS, _shares(_FIFTHS))
    middles = [i + 0.5 for i in range(len(labels))]
    width = plot.x(1) - plot.x(0)
    letters = int(width / LETTER)
    plot.x_axis(middles, [shortened(label, letters) for label in labels])
    # All series of a category lie within 80 % of its width, around its middle.
    gap = min(0.15, 0.8 / max(len(series), 1))
    centre = (len(series) - 1) / 2
    for number, (name, values) in enumerate(series.items()):
        offset = (number - centre) * gap
        for middle, label, value in zip(middles, labels, values, strict=True):
            if value is None:
                continue
            x = middle + offset
            share, _, _ = value
            plot.whiskers((x, None, None), value, number)
            title = f"{name}, {label}: {estimate(value, True)}"
            plot.marker(x, share, number, title)
        if name in names:
            # The legend, to the right of the axes: a line of 16 pixels for each drawn series.
            left = WIDTH - room + 14
            row = names.index(name)
            y = plot.top + 6 + 16 * row
            plot.marker_at(left, y, number, name)
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
    drawn = {name: sorted(points, key=_x_of) for name, points in series.items() if points}
    everything = list(chain.from_iterable(drawn.values()))
    xs = _values(x for _, x, _ in everything)
    shares = _values(y for _, _, y in everything)
    names = list(drawn)
    if level is not None:
        level_name, level_share = level
        names.append(level_name)
        shares.append(level_share)
    lowest = min(xs, default=0)
    highest = max(xs, default=1)
    ticks = round_ticks(lowest, highest)
    y_ticks = round_ticks(0, max(shares, default=1))
    left = ticks[0]
    right = ticks[-1]
    y_range = (0, y_ticks[-1])
    plot = Plot((left, right), y_range, description, right=room_for(names))
    plot.y_axis(y_ticks, _shares(y_ticks))
    plot.x_axis(ticks, [f"{value:.3g}" for value in ticks])
    ends = []
    if level is not None:
        ends_of_line = [(left, level_share), (right, level_share)]
        plot.polyline(ends_of_line, "diagonal", f"{level_name}: {level_share:.1%}")
        ends.append((right, level_share, level_name, ""))
    taken = Labels(_LABEL_HEIGHT)
    named: set[str] = set()
    # Whiskers first, below the markers of all series.
    for number, name in enumerate(series):
        for _, x, y in drawn.get(name, []):
            plot.whiskers(x, y, number)
    everywhere = [_space_of(plot, x, y) for _, x, y in everything]
    for number, name in enumerate(series):
        points = drawn.get(name, [])
        # Labels of every second series lie below the points, so that those of two series overlap
        # less.
        is_below = number % 2 == 1
        for label, x, y in points:
            across = estimate(x, False)
            up = estimate(y, True)
            title = f"{name}, {label}: {up} at {across}"
            plot.marker(x[0], y[0], number, title)
            if label not in named and _label_point(
                plot, taken, everywhere, label, x[0], y, below=is_below
            ):
                named.add(label)
        if points:
            _, x, y = points[-1]
            ends.append((x[0], y[0], name, style_of(number)))
    plot.end_labels(ends)
    plot.titles(x_title, y_title)
    return plot.done()


def _x_of(point: tuple[str, Estimate, Estimate]) -> float:
    _, (x, _, _), _ = point
    return x


def _values(estimates: Iterable[Sequence[float | None]]) -> list[float]:
    """Return the values and bounds of estimates in a list, without those that are None."""
    return [value for value in chain.from_iterable(estimates) if value is not None]


Box = tuple[float, float, float, float]
"""Left, right, top and bottom of a space, in pixels."""


def _space_of(plot: Plot, x: Estimate, y: Estimate) -> list[Box]:
    """Return the spaces of a point's marker, of its whiskers up and down, and of those across."""
    middle = plot.x(x[0])
    height = plot.y(y[0])
    # Heights are counted downwards: the lower end of the whiskers has the greatest.
    heights = [plot.y(value) for value in _values([y])]
    places = [plot.x(value) for value in _values([x])]
    return [
        (middle - _MARKER, middle + _MARKER, height - _MARKER, height + _MARKER),
        (middle, middle, min(heights), max(heights)),
        (min(places), max(places), height, height),
    ]


def _label_point(
    plot: Plot,
    taken: Labels,
    points: Sequence[Sequence[Box]],
    label: str,
    x: float,
    y: Estimate,
    *,
    below: bool,
) -> bool:
    """Write a point's label above or below its whiskers, where it covers no point and no label.

    Args:
        plot: the chart.
        taken: spaces of the labels so far.
        points: spaces of all points.
        label: the label.
        x: the point's place.
        y: its height, with the ends of its whiskers.
        below: try below first, otherwise above.

    Returns:
        Whether there was space; otherwise the label is left out, and stands in the tooltip alone.
    """
    heights = [plot.y(value) for value in _values([y])]
    base_lines = [min(heights) - 5, max(heights) + 12]
    middle = plot.x(x)
    half = SMALL_LETTER * len(label) / 2
    left, right = middle - half, middle + half
    for base_line in reversed(base_lines) if below else base_lines:
        # Small letters are some seven pixels high, above their base line.
        top = base_line - 7
        covers_point = any(
            left < end and right > start and top < bottom and base_line > upper
            for boxes in points
            for start, end, upper, bottom in boxes
        )
        if not covers_point and taken.take(left, right, base_line):
            plot.text(middle, base_line, label, "small", "middle")
            return True
    return False


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
    # Without rows, a reference alone would give the axis an odd range.
    ends = _values([*estimates, (reference,)]) if rows else []
    lowest = min(ends, default=0)
    highest = max(ends, default=1)
    ticks = round_ticks(lowest, highest)
    plot = Plot(
        (ticks[0], ticks[-1]),
        (max(len(rows), 1), 0),  # the first row is at the top
        description,
        top=TOP,
        right=56,
        left=room_for((name for name, _ in rows), 12),
        height=TOP + _ROW * len(rows) + BOTTOM,
    )
    tick_form = ".0%" if percent else ".3g"
    texts = [f"{value:{tick_form}}" for value in ticks]
    plot.x_axis(ticks, texts, grid=True)
    if reference is not None:
        ends_of_line = [(reference, 0), (reference, len(rows))]
        plot.polyline(ends_of_line, "diagonal")
    form = ".1%" if percent else ".3f"
    for number, (name, value) in enumerate(rows):
        # Each row is one unit high.
        middle = number + 0.5
        centre, _, _ = value
        plot.whiskers(value, (middle, None, None), number)
        plot.marker(centre, middle, number, f"{name}: {estimate(value, percent)}")
        base_line = plot.y(middle) + 4
        plot.text(plot.left - 8, base_line, short(name), anchor="end")
        plot.text(WIDTH - 44, base_line, f"{centre:{form}}")
    plot.titles(x_title)
    return plot.done()


def log_reliability(
    series: Mapping[str, Sequence[ReliabilityPoint]],
    description: str,
) -> Markup:
    """Draw observed shares against probabilities on logarithmic axes.

    A diagonal shows perfect calibration.

    Args:
        series: points by the series' name. A share of 0 is drawn at the lower end of the axis.
        description: text alternative for people who do not see the chart.
    """
    shown_values = []
    for probability, share, *_ in chain.from_iterable(series.values()):
        shown_values += [probability, share]
    # Zeros have no logarithm.
    positive = [value for value in shown_values if value > 0]
    least = min(positive, default=0.1)
    # The axis has a decade at least, and ends at a millionth: below, a share from some thousand
    # triples means nothing.
    least = max(least, 1e-6)
    decade = math.floor(math.log10(least))
    lowest = min(decade, -1)

    def place(value: float) -> float:
        # A share of 0 has no logarithm, and is drawn at the end.
        shown = max(value, 10.0**lowest)
        return math.log10(shown)

    plot = Plot((lowest, 0), (lowest, 0), description, left=LEFT + 8)
    ticks = range(lowest, 1)
    texts = [f"{10.0**value:.10g}" for value in ticks]
    plot.y_axis(ticks, texts)
    plot.x_axis(ticks, texts)
    plot.polyline([(lowest, lowest), (0, 0)], "diagonal")
    for number, (name, values) in enumerate(series.items()):
        line = [(place(x), place(y)) for x, y, *_ in values]
        plot.polyline(line, f"line {style_of(number)}")
        for x, y, low, high, count in values:
            across = place(x)
            up = place(y)
            interval = (up, place(low), place(high))
            # A probability is given, not estimated: it has no interval.
            plot.whiskers((across, None, None), interval, number)
            # Text has the values themselves, not their logarithms.
            true = f"true {y:.2g} [{low:.2g}, {high:.2g}]"
            title = f"{name}: probability {x:.2g}, {true}, {count:,} triples"
            plot.marker(across, up, number, title)
    plot.titles("probability")
    return plot.done(list(series))


def _shares(ticks: Sequence[float]) -> list[str]:
    """Format ticks as percentages, or as numbers if the steps are below one per cent."""
    form = ".3g" if ticks[1] < 0.01 else ".0%"
    return [f"{value:{form}}" for value in ticks]
