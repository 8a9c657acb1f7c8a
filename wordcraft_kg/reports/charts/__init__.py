"""Charts: Matplotlib figures that pages show as SVG, and drawings of our own as SVG strings.

Charts follow the page's light and dark colours without JavaScript, see
:mod:`~wordcraft_kg.reports.charts.palette`.
"""

from wordcraft_kg.reports.charts.chart import Chart, as_file, figure_of
from wordcraft_kg.reports.charts.layered import Made, layered
from wordcraft_kg.reports.charts.palette import COLOURS, colour_of
from wordcraft_kg.reports.charts.series import (
    CurvePoint,
    Estimate,
    curves,
    dots,
    intervals,
    log_reliability,
    scatter,
)

__all__ = [
    "COLOURS",
    "Chart",
    "CurvePoint",
    "Estimate",
    "Made",
    "as_file",
    "colour_of",
    "curves",
    "dots",
    "figure_of",
    "intervals",
    "layered",
    "log_reliability",
    "scatter",
]
