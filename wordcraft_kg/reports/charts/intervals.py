"""Estimates with their intervals, one below the other."""

from collections.abc import Sequence
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import COLOURS, LINE_HEIGHT, WIDTH
from wordcraft_kg.reports.charts.scales import Estimate, estimate, round_ticks, shortened

LETTER, LONGEST_NAME, ROW = 6.3, 26, 24
TOP, RIGHT, BOTTOM = 8, 14, 40


def intervals(
    rows: Sequence[tuple[str, Estimate]], x_title: str, description: str, *, reference: float | None = None
) -> Markup:
    """Draw values with the whiskers of their intervals, a row for each, the axis fitted to them.

    Args:
        rows: names, cut where they are long but complete in the tooltip, and values with their bounds.
        x_title: title under the axis.
        description: text for readers who cannot see it.
        reference: value to mark with a dashed line, which the axis includes.
    """
    names = [shortened(name, LONGEST_NAME) for name, _ in rows]
    left = round(16 + LETTER * max(map(len, names), default=0))
    bottom = TOP + ROW * len(rows)
    values = [number for _, bounds in rows for number in (*bounds, reference) if number is not None]
    ticks = round_ticks(min(values, default=0), max(values, default=1))

    def x(value: float) -> float:
        return round(left + (value - ticks[0]) / (ticks[-1] - ticks[0]) * (WIDTH - left - RIGHT), 1)

    opening = f'<svg viewBox="0 0 {WIDTH} {bottom + BOTTOM}" role="img" aria-label="{escape(description)}">'
    parts = [opening]
    for tick in ticks:
        parts.append(f'<line x1="{x(tick)}" x2="{x(tick)}" y1="{TOP}" y2="{bottom}" class="grid"/>')
        parts.append(f'<text x="{x(tick)}" y="{bottom + LINE_HEIGHT}" text-anchor="middle">{tick:.10g}</text>')
    if reference is not None:
        at = x(reference)
        parts.append(f'<polyline points="{at},{TOP} {at},{bottom}" class="diagonal"/>')
    for number, (short, (name, value)) in enumerate(zip(names, rows, strict=True)):
        y, (centre, low, high) = TOP + ROW * (number + 0.5), value
        title, style = f"<title>{escape(name)}: {estimate(value, False)}</title>", f"series-{number % COLOURS}"
        parts.append(f'<text x="{left - 8}" y="{y + 4}" text-anchor="end">{escape(short)}{title}</text>')
        if low is not None and high is not None:
            parts.append(f'<line x1="{x(low)}" x2="{x(high)}" y1="{y}" y2="{y}" class="whisker {style}"/>')
        parts.append(f'<circle cx="{x(centre)}" cy="{y}" r="3.8" class="dot {style}">{title}</circle>')
    middle = (left + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{bottom + 32}" text-anchor="middle">{escape(x_title)}</text></svg>')
    return Markup("".join(parts))
