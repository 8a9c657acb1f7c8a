"""Rendering pages from the package's templates."""

from functools import cache
from typing import Any

import jinja2


def render_page(template: str, **values: Any) -> str:
    """Return a page; labels and names are escaped, and a value that the template misses is an error."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("wordcraft_kg.reports"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
