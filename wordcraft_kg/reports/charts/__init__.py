"""Small charts as inline SVG strings, which follow the page's light and dark colours and need no JavaScript.

Colours (``series-0``, ``series-1``, ..., ``series-other``) and dashes (``dash-0`` to ``dash-3``, ``dashed``) are CSS
classes that the page's style sheet defines from :mod:`~wordcraft_kg.reports.charts.plot`.
"""

from wordcraft_kg.reports.charts.layered import Made, layered
from wordcraft_kg.reports.charts.pictures import (
    Dot,
    Region,
    colour_of,
    contribution_bar,
    labelled_points,
    matrix_image,
    world,
)
from wordcraft_kg.reports.charts.plot import COLOURS, CurvePoint
from wordcraft_kg.reports.charts.series import (
    curves,
    dots,
    grouped_bars,
    intervals,
    log_reliability,
    profiles,
    reliability,
    scatter,
)
from wordcraft_kg.reports.charts.standalone import figure

__all__ = [
    "COLOURS",
    "CurvePoint",
    "Dot",
    "Made",
    "Region",
    "colour_of",
    "contribution_bar",
    "curves",
    "dots",
    "figure",
    "grouped_bars",
    "intervals",
    "labelled_points",
    "layered",
    "log_reliability",
    "matrix_image",
    "profiles",
    "reliability",
    "scatter",
    "world",
]
