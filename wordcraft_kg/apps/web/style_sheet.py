"""The style sheet of all pages in a browser, those of studies too."""

from wordcraft_kg.reports.pages import make_environment


def style_sheet() -> str:
    """Return that of reports, and what pages of a site have besides."""
    environment = make_environment("wordcraft_kg.apps.web", "wordcraft_kg.reports")
    return environment.get_template("explorer.css.j2").render()
