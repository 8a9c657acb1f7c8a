"""Charts for data series: curves, and estimates with intervals."""

import math
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

from wordcraft_kg.base.wording import for_terminal
from wordcraft_kg.reports.charts.chart import (
    COLOURS,
    HEIGHT,
    LIGHT,
    LIGHT_SERIES,
    SMALL,
    WIDTH,
    Chart,
    Labels,
    shortened,
    spread,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.ticker import PercentFormatter

CurvePoint = tuple[float, float, float | None, float | None]
"""x, y, and interval bounds for y, or None for both bounds."""
Estimate = tuple[float, float | None, float | None]
"""A value with the lower and the upper bound of its interval; None for both without an interval."""
ReliabilityPoint = tuple[float, float, float, float, int]
"""Probability, observed share, lower and upper bound of the share, and number of triples."""
_Dashes = tuple[float, tuple[float, ...]]
_DASHES: tuple[_Dashes, ...] = ((0, ()), (0, (7, 3)), (0, (2, 2)), (0, (8, 3, 2, 3)))
"""Patterns of lines by series, in points, each after its offset."""
_DASHED: _Dashes = (0, (5, 3))
_MARKERS = "os^D"
"""Shapes of markers by series."""
_MARKER_SIZE = 7
"""Diameter of a marker in points."""
_WHISKER = 1.5
"""Width of an interval's line."""
_MARGINS = 60
"""Height of the titles and tick labels of a chart, in points."""
_LINE_HEIGHT = 14
"""Least distance between the names of two curves, in points."""
_ROW = 26
"""Height of a row of :func:`intervals`, in points."""
_LETTER = 6.6
_SMALL_LETTER = 5.7
"""Mean widths of letters, of usual and of small size, in points."""
_LONGEST_NAME = 32
"""Most letters of a name."""
_FEWEST_LETTERS = 6
"""Letters on a line of a category's label that is never shorter."""
_MOST_LINES = 3
"""Most lines of a category's label below an axis."""
_MOST_BOUNDS = 100
"""Most points at an edge of a band: more look the same, and make the page large."""


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
) -> Chart:
    """Draw curves with uncertainty bands and names at their ends; the x-axis includes 0.

    A curve of a single point is a dot with a whisker. An empty curve keeps its colour.

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
    texts = {name: name for name in series} if labels is None else labels
    # Empty curves count, so that the same name has the same colour in several charts.
    numbers = {name: number for number, name in enumerate(series)}
    numbers.update(colours or {})

    def draw(axes: "Axes") -> None:
        ends = []
        for name, points in series.items():
            if not points:
                continue
            number = numbers[name]
            x, y, low, high = points[-1]
            if len(points) == 1:
                _draw_estimate(axes, (x, None, None), (y, low, high), number, "o")
            else:
                _draw_band(axes, points, number)
                axes.plot(
                    [point[0] for point in points],
                    [point[1] for point in points],
                    color=_colour(number),
                    linestyle=_dashes_of(name, number, dashed),
                    linewidth=2 if labels is None else 1.2,
                )
            if name in texts:
                ends.append((x, y, texts[name], _colour(number)))
        if percent:
            _share_axis(axes, 1)
        steps = [point[0] for point in chain.from_iterable(series.values())]
        _step_axis(axes, steps)
        _name_ends(axes, ends)
        _write_titles(axes, x_title, y_title)

    return Chart(description, draw)


def dots(
    labels: Sequence[str],
    series: Mapping[str, Sequence[Estimate | None]],
    x_title: str,
    y_title: str,
    description: str,
) -> Chart:
    """Draw shares with whiskers by category, those of several series side by side.

    Args:
        labels: names of the categories.
        series: a share for each category, or None, by the series' name. A series without shares is
            not drawn, but keeps its colour and place.
        x_title: title of the x-axis.
        y_title: title of the y-axis.
        description: text alternative for people who do not see the chart.
    """
    # All series of a category lie within 80 % of its width, around its middle.
    gap = min(0.15, 0.8 / max(len(series), 1))
    centre = (len(series) - 1) / 2
    num_places = max(len(labels), 1)

    def draw(axes: "Axes") -> None:
        markers = {}
        for number, (name, shares) in enumerate(series.items()):
            offset = (number - centre) * gap
            for place, share in enumerate(shares):
                if share is not None:
                    x = place + offset
                    markers[name] = _draw_estimate(axes, (x, None, None), share, number)
        # Half of the chart's width may be names of series.
        letters = int(WIDTH / 2 / num_places / _LETTER)
        axes.set_xticks(range(len(labels)), [_in_lines(label, letters) for label in labels])
        axes.set_xlim(-0.5, num_places - 0.5)
        _share_axis(axes, 1)
        names = [_clean(name) for name in markers]
        axes.legend(markers.values(), names, loc="upper left", bbox_to_anchor=(1, 1))
        _write_titles(axes, x_title, y_title)

    return Chart(description, draw)


def scatter(
    series: Mapping[str, Sequence[tuple[str, Estimate, Estimate]]],
    x_title: str,
    y_title: str,
    description: str,
    *,
    level: tuple[str, float] | None = None,
) -> Chart:
    """Draw points with whiskers in x and y, and each series' name to the right of its last point.

    Args:
        series: points (label, x, y) by the series' name; y is a share. A label is shown once,
            where there is room.
        x_title: title of the x-axis.
        y_title: title of the y-axis.
        description: text alternative for people who do not see the chart.
        level: name and share of a dashed horizontal line, or None.
    """

    def draw(axes: "Axes") -> None:
        ends = []
        for number, (name, points) in enumerate(series.items()):
            for _, x, y in points:
                _draw_estimate(axes, x, y, number)
            if points:
                _, x, y = max(points, key=lambda point: point[1][0])
                ends.append((x[0], y[0], name, _colour(number)))
        if level is not None:
            name, share = level
            axes.axhline(share, color=LIGHT["soft"], linestyle="--", linewidth=1)
            ends.append((axes.get_xlim()[1], share, name, LIGHT["soft"]))
        _share_axis(axes, axes.get_ylim()[1])
        _label_points(axes, series.values())
        _name_ends(axes, ends)
        _write_titles(axes, x_title, y_title)

    return Chart(description, draw)


def intervals(
    rows: Sequence[tuple[str, Estimate]],
    x_title: str,
    description: str,
    *,
    reference: float | None = None,
    percent: bool = False,
) -> Chart:
    """Draw estimates with whiskers, one in a row, with the value at the right.

    Args:
        rows: name and estimate of each row.
        x_title: title of the x-axis.
        description: text alternative for people who do not see the chart.
        reference: value of a dashed vertical line, or None.
        percent: the estimates are shares, shown as percentages.
    """
    form = ".1%" if percent else ".3f"

    def draw(axes: "Axes") -> None:
        beside = axes.get_yaxis_transform()
        for number, (_, value) in enumerate(rows):
            _draw_estimate(axes, value, (number, None, None), number)
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
    ticks = [10.0**power for power in range(decade, 1)]
    tick_labels = [f"{tick:.10g}" for tick in ticks]

    def draw(axes: "Axes") -> None:
        axes.set(xscale="log", yscale="log", xlim=(lowest, 1), ylim=(lowest, 1))
        axes.set_xticks(ticks, tick_labels, minor=False)
        axes.set_yticks(ticks, tick_labels, minor=False)
        axes.minorticks_off()
        axes.plot([lowest, 1], [lowest, 1], color=LIGHT["soft"], linestyle="--", linewidth=1)
        markers = {}
        for number, (name, points) in enumerate(series.items()):
            marks = []
            for point in points:
                x, share, low, high = (max(value, lowest) for value in point[:4])
                marks.append((x, share))
                marker = _draw_estimate(axes, (x, None, None), (share, low, high), number)
                markers[name] = marker
            xs = [x for x, _ in marks]
            shares = [share for _, share in marks]
            axes.plot(xs, shares, color=_colour(number))
        names = [_clean(name) for name in markers]
        axes.legend(markers.values(), names, loc="upper left")
        _write_titles(axes, "probability", "share of true triples")

    return Chart(description, draw)


def _in_lines(label: str, letters: int) -> str:
    """Return a label on at most ``_MOST_LINES`` lines of at most so many letters."""
    # Of many categories each has less room than a word; their labels may touch.
    width = max(letters, _FEWEST_LETTERS)
    lines = textwrap.wrap(for_terminal(label), width, max_lines=_MOST_LINES, placeholder=" …")
    return "\n".join(lines)


def _clean(name: str, letters: int = _LONGEST_NAME) -> str:
    """Return a name that fits a chart, in which nothing is hidden."""
    return shortened(for_terminal(name), letters)


def _write_titles(axes: "Axes", x_title: str, y_title: str = "") -> None:
    """Write the title of x below the axes, and that of y above the upper left corner."""
    axes.set_xlabel(for_terminal(x_title))
    axes.set_title(for_terminal(y_title))


def _colour(number: int) -> str:
    """Return a data series' colour; colours repeat after the last."""
    return LIGHT_SERIES[number % COLOURS]


def _marker(number: int) -> str:
    """Return the shape of a data series' markers."""
    return _MARKERS[number % len(_MARKERS)]


def _dashes_of(name: str, number: int, dashed: Collection[str] | None) -> _Dashes:
    """Return the dashes of a curve."""
    if dashed is None:
        # The shift by a pattern with each round of the colours tells apart two curves of a colour.
        rounds = number // COLOURS
        return _DASHES[(number + rounds) % len(_DASHES)]
    return _DASHED if name in dashed else _DASHES[0]


def _draw_band(axes: "Axes", points: Sequence[CurvePoint], number: int) -> None:
    """Fill the area between the bounds of a curve; a point without bounds interrupts it."""
    every = math.ceil(len(points) / _MOST_BOUNDS)
    # Counted from the end, because the last point matters most.
    edge = points[::-1][::every]
    if all(low is None for _, _, low, _ in edge):
        return
    bounds = []
    for x, _, low, high in edge:
        has_bounds = low is not None and high is not None
        bounds.append((x, low, high) if has_bounds else (x, math.nan, math.nan))
    xs, lows, highs = zip(*bounds, strict=True)
    axes.fill_between(xs, lows, highs, facecolor=_colour(number), alpha=0.16, edgecolor="none")


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
        marker=marker or _marker(number),
        facecolor=colour,
        edgecolor="none",
        zorder=3,
        clip_on=False,
    )


def _percent() -> "PercentFormatter":
    """Return a format of shares as percentages."""
    from matplotlib.ticker import PercentFormatter

    return PercentFormatter(1)


def _share_axis(axes: "Axes", highest: float) -> None:
    """Show y as percentages, from 0."""
    axes.set_ylim(0, highest)
    axes.yaxis.set_major_formatter(_percent())


def _step_axis(axes: "Axes", steps: Sequence[float]) -> None:
    """Show x from 0, in thousands (k) and millions (M) where it is large."""
    from matplotlib.ticker import EngFormatter, MaxNLocator

    first = min(chain([0], steps))
    last = max(chain([first], steps))
    # A single point at 0: any range will do.
    axes.set_xlim(first, last if last > first else first + 1)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=True))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))


def _label_points(axes: "Axes", series: Iterable[Sequence[tuple[str, Estimate, Estimate]]]) -> None:
    """Label points above or below their whiskers, where the label covers no point and no label."""
    room = Labels(SMALL)
    # Places before the layout, which moves the axes only a little.
    place = axes.transData.transform
    points = []
    for number, labelled in enumerate(series):
        # Labels of every second series lie below the points: those of two series overlap less.
        sides = (-1, 1) if number % 2 else (1, -1)
        for label, (x, *_), (y, low, high) in labelled:
            across, up = place((x, y))
            room.take(across - 4, across + 4, up)
            ends = {-1: y if low is None else low, 1: y if high is None else high}
            points.append((label, x, ends, sides))
    labels: set[str] = set()
    for label, x, ends, sides in points:
        half = _SMALL_LETTER * len(label) / 2
        for side in sides:
            across, end = place((x, ends[side]))
            # Ten points from the whisker to the middle of the text: a line of small letters.
            middle = end + 10 * side
            if label not in labels and room.take(across - half, across + half, middle):
                labels.add(label)
                axes.annotate(
                    _clean(label),
                    (x, ends[side]),
                    (0, 10 * side),
                    textcoords="offset points",
                    ha="center",
                    va="center",
                    fontsize=SMALL,
                    color=LIGHT["soft"],
                )


def _name_ends(axes: "Axes", ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Write the names of curves (x, y, name, colour) at their right ends, a line apart.

    A thin line of the curve's colour leads to its name.
    """
    low, high = axes.get_ylim()
    gap = _LINE_HEIGHT * (high - low) / (HEIGHT - _MARGINS)
    heights = spread([y for _, y, _, _ in ends], gap, low, high)
    for (x, y, name, colour), height in zip(ends, heights, strict=True):
        axes.annotate(
            _clean(name),
            (x, y),
            (1.05, height),
            textcoords=axes.get_yaxis_transform(),
            va="center",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": colour,
                "linewidth": 1,
                "relpos": (0, 0.5),
                "shrinkA": 2,
                "shrinkB": 0,
            },
        )
