"""The page of a table that compares players, as ``wordcraft-kg reference --out`` writes it."""

from wordcraft_kg.evaluation.reference_table import ReferenceTable
from wordcraft_kg.reports.pages import render_page


def reference_page(view: ReferenceTable) -> str:
    """Render a comparison table as an HTML page."""
    return render_page("reference_page.html.j2", report=view)
