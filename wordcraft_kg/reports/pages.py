"""Rendering pages from the package's templates."""

from typing import Any

import jinja2


def render_page(template: str, **values: Any) -> str:
    """Return a page; labels and names are escaped, and a value that the template misses is an error."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("wordcraft_kg.reports"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template).render(**values)
