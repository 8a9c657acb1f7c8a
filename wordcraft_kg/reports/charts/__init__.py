"""Small charts as SVG strings to place in pages.

Charts follow the page's light and dark colours without JavaScript.

Colours (``series-0``, ``series-1``, ..., ``series-other``) and dashes (``dash-0`` to ``dash-3``,
``dashed``) are CSS classes that the page's style sheet defines from
:mod:`~wordcraft_kg.reports.charts.plot`.
"""

from wordcraft_kg.reports.charts.found import Found as Found
from wordcraft_kg.reports.charts.found import found_map as found_map
from wordcraft_kg.reports.charts.layered import Made as Made
from wordcraft_kg.reports.charts.layered import layered as layered
from wordcraft_kg.reports.charts.plot import COLOURS as COLOURS
from wordcraft_kg.reports.charts.plot import CurvePoint as CurvePoint
from wordcraft_kg.reports.charts.plot import colour_of as colour_of
from wordcraft_kg.reports.charts.scales import Estimate as Estimate
from wordcraft_kg.reports.charts.series import curves as curves
from wordcraft_kg.reports.charts.series import dots as dots
from wordcraft_kg.reports.charts.series import intervals as intervals
from wordcraft_kg.reports.charts.series import log_reliability as log_reliability
from wordcraft_kg.reports.charts.series import scatter as scatter
from wordcraft_kg.reports.charts.standalone import figure as figure
