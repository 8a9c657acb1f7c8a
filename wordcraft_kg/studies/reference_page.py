"""Figures to compare with, as one self-contained HTML page."""

from wordcraft_kg.reports.pages import render_page
from wordcraft_kg.studies.references import ReferenceTable


def reference_page(view: ReferenceTable) -> str:
    """Return the page of a table."""
    return render_page("wordcraft_kg.studies/reference_page.html.j2", report=view)
