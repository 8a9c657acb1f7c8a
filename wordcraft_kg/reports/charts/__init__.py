"""Charts: Matplotlib figures that pages show as SVG, and drawings of our own as SVG strings.

Charts follow the page's light and dark colours without JavaScript, see
:mod:`~wordcraft_kg.reports.charts.palette`.
"""

from wordcraft_kg.reports.charts.chart import Chart as Chart
from wordcraft_kg.reports.charts.chart import as_file as as_file
from wordcraft_kg.reports.charts.chart import figure_of as figure_of
from wordcraft_kg.reports.charts.found import Found as Found
from wordcraft_kg.reports.charts.found import found_map as found_map
from wordcraft_kg.reports.charts.layered import Made as Made
from wordcraft_kg.reports.charts.layered import layered as layered
from wordcraft_kg.reports.charts.palette import COLOURS as COLOURS
from wordcraft_kg.reports.charts.palette import colour_of as colour_of
from wordcraft_kg.reports.charts.series import CurvePoint as CurvePoint
from wordcraft_kg.reports.charts.series import Estimate as Estimate
from wordcraft_kg.reports.charts.series import curves as curves
from wordcraft_kg.reports.charts.series import dots as dots
from wordcraft_kg.reports.charts.series import intervals as intervals
from wordcraft_kg.reports.charts.series import log_reliability as log_reliability
from wordcraft_kg.reports.charts.series import scatter as scatter
