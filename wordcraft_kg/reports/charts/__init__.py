"""Charts: Matplotlib figures that pages show as SVG.

Charts follow the page's light and dark colours without JavaScript, see
:mod:`~wordcraft_kg.reports.charts.chart`.
"""

from wordcraft_kg.reports.charts.chart import COLOURS, Chart, as_file, as_pdf, colour_of, figure_of
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
    "as_file",
    "as_pdf",
    "colour_of",
    "curves",
    "dots",
    "figure_of",
    "intervals",
    "log_reliability",
    "scatter",
]
