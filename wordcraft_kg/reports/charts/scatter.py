"""Two estimates of the same things against each other."""

from collections.abc import Mapping, Sequence
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import ABOVE, COLOURS, LETTER, LONGEST_NAME, Plot
from wordcraft_kg.reports.charts.scales import Estimate, estimate, round_ticks, shortened

SMALL_LETTER = 5.5
"""Width of a letter in the charts' small text."""


def scatter(
    series: Mapping[str, Sequence[tuple[str, Estimate, Estimate]]],
    x_title: str,
    y_title: str,
    description: str,
    *,
    level: tuple[str, float] | None = None,
) -> Markup:
    """Draw points with the whiskers of both their intervals; the name of a series stands right of its last point.

    Args:
        series: by name, points of label, x and y; y is a share. Labels stand above or below the points where they fit;
            one that points of several series share is there once.
        x_title: title under the x-axis, which fits the data.
        y_title: title above the chart, whose axis goes from 0 as far as the data.
        description: text for readers who cannot see it.
        level: name and share of a dashed horizontal line.
    """
    names = {name: shortened(name, LONGEST_NAME) for name, points in series.items() if points}
    xs = [value for points in series.values() for _, x, _ in points for value in x if value is not None]
    ticks = round_ticks(min(xs, default=0), max(xs, default=1))
    texts = [*names.values(), shortened(level[0], LONGEST_NAME)] if level else list(names.values())
    room = round(20 + LETTER * max(map(len, texts), default=0))
    ys = [value for points in series.values() for *_, y in points for value in y if value is not None]
    y_ticks = round_ticks(0, max([*ys, *(level or ())[1:]], default=1))
    plot = Plot((ticks[0], ticks[-1]), (0, y_ticks[-1]), description, top=ABOVE, right=room)
    plot.y_ticks(y_ticks, lambda value: f"{value:.3g}" if y_ticks[1] < 0.01 else f"{value:.0%}")
    plot.x_labels([(value, f"{value:.3g}") for value in ticks])
    ends = []
    if level:
        name, share = level
        plot.polyline([(ticks[0], share), (ticks[-1], share)], "diagonal", f"{name}: {share:.1%}")
        ends.append((ticks[-1], share, shortened(name, LONGEST_NAME), name, ""))
    taken: dict[str, tuple[float, float, float]] = {}
    for number, (name, unordered) in enumerate(series.items()):
        points = sorted(unordered, key=lambda point: point[1][0])
        colour = f"series-{number % COLOURS}"
        for _, x, y in points:
            if x[1] is not None and x[2] is not None:
                plot.polyline([(x[1], y[0]), (x[2], y[0])], f"whisker {colour}")
            if y[1] is not None and y[2] is not None:
                plot.whisker(x[0], y[1], y[2], f"whisker {colour}")
        for label, x, y in points:
            title = f"{name}, {label}: {estimate(y, True)} at {estimate(x, False)}"
            left, top = plot.x(x[0]), plot.y(y[0])
            plot.marker(left, top, number, title)
            # Outside of the whiskers, alternately above and below, where the points of the other series rarely are.
            low, high = plot.y(y[0] if y[1] is None else y[1]), plot.y(y[0] if y[2] is None else y[2])
            line = low + 12 if number % 2 else high - 5
            half = SMALL_LETTER * len(label) / 2
            others = taken.values()
            fits = all(left - half > right or left + half < start or abs(line - at) > 10 for start, right, at in others)
            if fits and label not in taken:
                taken[label] = (left - half, left + half, line)
                place = f'x="{left:.1f}" y="{line:.1f}" text-anchor="middle"'
                plot.parts.append(f'<text {place} class="small">{escape(label)}</text>')
        if points:
            _, x, y = points[-1]
            ends.append((x[0], y[0], names[name], name, colour))
    plot.end_labels(ends)
    plot.titles(x_title, y_title)
    return plot.done()
