"""Small charts as inline SVG strings: they follow the page's light and dark colours and need no JavaScript.

Colours are CSS classes (``series-0``, ``series-1``, ...) that the page's style sheet defines, and so are the dashes of
:func:`curves` (``dash-0`` to ``dash-3``, ``dashed``).
"""

from wordcraft_kg.reports.charts.pictures import contribution_bar, labelled_points, matrix_image
from wordcraft_kg.reports.charts.series import curves, dots, grouped_bars, lines, reliability

__all__ = [
    "contribution_bar",
    "curves",
    "dots",
    "grouped_bars",
    "labelled_points",
    "lines",
    "matrix_image",
    "reliability",
]
