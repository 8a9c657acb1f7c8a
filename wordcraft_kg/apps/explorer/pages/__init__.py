"""All pages, by their first address segment.

Read ``entities`` first: pages with settings, a view, and a static form. ``runs``
also draws. A page is a :class:`~wordcraft_kg.apps.explorer.page.Page` in a module here,
an entry in :data:`CORE`, and a template of its name. Modules import ``page``, ``explored`` and
``predictor``, and other pages to link to them; no page imports the server. Other apps and
distributions add pages by entry points ``module:PAGE`` in the group ``wordcraft_kg.pages``.

Free to change without asking: texts, limits, and the look of a page. Names of pages and of their
settings stay, since they are addresses that people keep.
"""

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from wordcraft_kg.apps.explorer.page import Page
from wordcraft_kg.apps.explorer.pages import (
    entities,
    episode,
    home,
    link,
    path,
    runs,
    suggestions,
    tasks,
)
from wordcraft_kg.base.errors import ConfigError

GROUP = "wordcraft_kg.pages"
HOME: Page[Any] = home.PAGE
CORE: tuple[Page[Any], ...] = (
    HOME,
    entities.PAGE,
    entities.ENTITY,
    entities.RECIPES,
    path.PAGE,
    link.PAGE,
    link.PAIR,
    suggestions.PAGE,
    tasks.PAGE,
    episode.PAGE,
    runs.PAGE,
    runs.RUN,
)
"""Pages of this app, in the order of the menu: the graph first, then models, then agents."""


def pages_by_name(points: Iterable[EntryPoint]) -> dict[str, Page[Any]]:
    """Return own pages and pages from entry points.

    Raises:
        ConfigError: if two pages have the same name, and so the same addresses.
    """
    pages = {page.name: page for page in CORE}
    for point in points:
        page = point.load()
        # Two entry points may name the same page.
        if pages.setdefault(page.name, page) is not page:
            raise ConfigError(
                f"two pages have the name '{page.name}'; uninstall or rename that of {point.value}."
            )
    return pages


PAGES = pages_by_name(entry_points(group=GROUP))
