"""Estimates with their intervals, one below the other."""

from collections.abc import Sequence
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import BOTTOM, COLOURS, LETTER, LONGEST_NAME, TOP, WIDTH, Plot
from wordcraft_kg.reports.charts.scales import Estimate, estimate, round_ticks, shortened

ROW = 26


def intervals(
    rows: Sequence[tuple[str, Estimate]],
    x_title: str,
    description: str,
    *,
    reference: float | None = None,
    percent: bool = False,
) -> Markup:
    """Draw values with the whiskers of their intervals, a row for each with a shape of its own; the axis fits them.

    Args:
        rows: names, and values with their bounds.
        x_title: title under the axis.
        description: text for readers who cannot see it.
        reference: value to mark with a dashed line, which the axis includes.
        percent: the values are shares.
    """
    names = [shortened(name, LONGEST_NAME) for name, _ in rows]
    ends = [end for _, row in rows for end in (*row, reference) if end is not None]
    ticks = round_ticks(min(ends, default=0), max(ends, default=1))
    left, height = round(12 + LETTER * max(map(len, names), default=0)), TOP + ROW * len(rows) + BOTTOM
    plot = Plot((ticks[0], ticks[-1]), (max(len(rows), 1), 0), description, right=56, left=left, height=height)
    plot.x_ticks(ticks, lambda value: f"{value:.0%}" if percent else f"{value:.3g}")
    if reference is not None:
        plot.polyline([(reference, 0), (reference, len(rows))], "diagonal")
    for number, (short, (name, (value, low, high))) in enumerate(zip(names, rows, strict=True)):
        y = plot.y(number + 0.5)
        if low is not None and high is not None:
            plot.polyline([(low, number + 0.5), (high, number + 0.5)], f"whisker series-{number % COLOURS}")
        plot.marker(plot.x(value), y, number, f"{name}: {estimate((value, low, high), percent)}")
        plot.parts.append(f'<text x="{left - 8}" y="{y + 4}" text-anchor="end">{escape(short)}</text>')
        shown = f"{value:.1%}" if percent else f"{value:.3f}"
        plot.parts.append(f'<text x="{WIDTH - 44}" y="{y + 4}">{shown}</text>')
    plot.titles(x_title, "")
    return plot.done()
