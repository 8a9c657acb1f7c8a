"""All pages, by the first segment of their addresses."""

from typing import Any

from wordcraft_kg.explorer.page import Page
from wordcraft_kg.explorer.pages import entities, home, map, path

HOME: Page[Any] = home.PAGE
PAGES: dict[str, Page[Any]] = {page.name: page for page in (HOME, entities.PAGE, map.PAGE, path.PAGE)}
"""In the order of the menu."""
