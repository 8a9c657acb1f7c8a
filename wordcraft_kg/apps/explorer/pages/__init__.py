"""All pages, by the first segment of their addresses."""

from typing import Any

from wordcraft_kg.apps.explorer.page import Page
from wordcraft_kg.apps.explorer.pages import (
    compare,
    entities,
    entity,
    episode,
    home,
    link,
    map,
    pair,
    path,
    predictions,
    recipes,
    run,
    runs,
    tasks,
)

HOME: Page[Any] = home.PAGE
IN_ORDER = (home, entities, entity, recipes, map, path, predictions, link, compare, pair, tasks, episode, runs, run)
PAGES: dict[str, Page[Any]] = {module.PAGE.name: module.PAGE for module in IN_ORDER}
"""In the order of the menu."""
