"""Pictures without axes: a contribution bar, and colours for groups."""

from collections.abc import Mapping
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import COLOURS


def contribution_bar(contributions: Mapping[str, float], scale: float, colours: Mapping[str, int]) -> Markup:
    """Draw a sum's terms by name as a bar: positive terms stacked to the right from the middle, negative to the left.

    Half the width is ``scale``; ``colours`` has colour numbers by name.
    """
    half, height = 70.0, 12
    ends = {True: half, False: half}
    parts = [f'<svg class="bar" viewBox="0 0 {2 * half:g} {height}" aria-hidden="true">']
    for name, value in contributions.items():
        width = min(abs(value) / scale, 1) * half if scale else 0.0
        is_positive = value >= 0
        left = ends[is_positive] if is_positive else ends[is_positive] - width
        ends[is_positive] = left + width if is_positive else left
        parts.append(
            f'<rect x="{left:.1f}" y="1" width="{width:.1f}" height="{height - 2}" class="series-{colours[name]}">'
            f"<title>{escape(name)}: {value:.2f}</title></rect>"
        )
    parts.append(f'<line x1="{half:g}" x2="{half:g}" y1="0" y2="{height}" class="grid"/></svg>')
    return Markup("".join(parts))


def colour_of(number: int) -> str:
    """Return the CSS colour class for a group number; negative numbers and numbers beyond the palette are grey."""
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"
