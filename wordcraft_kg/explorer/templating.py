"""How templates become pages: the same rules for the explorer and for studies."""

import jinja2

from wordcraft_kg.reports.charts import palette


def make_environment(*packages: str) -> jinja2.Environment:
    """Return what renders the templates of packages; those that come first take precedence.

    Whatever a label holds stays text, and a name that a template misspells is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package) for package in packages]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.globals["palette"] = palette
    environment.filters["thousands"] = lambda number: f"{number:,}"
    return environment


def style_sheet() -> str:
    """Return the style sheet of all pages: that of reports, and what pages of a site have besides."""
    environment = make_environment("wordcraft_kg.explorer", "wordcraft_kg.reports")
    return environment.get_template("explorer.css.j2").render()
