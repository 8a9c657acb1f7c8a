"""Small charts as inline SVG strings, which follow the page's light and dark colours and need no JavaScript.

Colours (``series-0``, ``series-1``, ...) and the dashes of :func:`curves` (``dash-0`` to ``dash-3``, ``dashed``) are
CSS classes that the page's style sheet defines.
"""

from wordcraft_kg.reports.charts.intervals import intervals
from wordcraft_kg.reports.charts.pictures import contribution_bar, labelled_points, matrix_image
from wordcraft_kg.reports.charts.series import curves, dots, grouped_bars, lines, reliability

__all__ = [
    "contribution_bar",
    "curves",
    "dots",
    "grouped_bars",
    "intervals",
    "labelled_points",
    "lines",
    "matrix_image",
    "reliability",
]
