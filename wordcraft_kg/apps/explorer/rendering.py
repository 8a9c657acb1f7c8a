"""Rendering pages from templates."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import jinja2
import msgspec
from markupsafe import Markup

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, PageState
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.base.escaping import for_html
from wordcraft_kg.reports.agent_pictures import ACTIONS
from wordcraft_kg.reports.pages import Outline, make_environment

QUESTIONS = 5


class Site:
    """Renders pages, without forms if ``is_static``; ``address`` is empty for missing pages, ``file`` is for files."""

    def __init__(
        self,
        explored: Explored,
        address: Addresses,
        file: Callable[[str], str],
        *,
        is_static: bool = False,
    ):
        """Take a subject and address forms."""
        self.explored, self.address, self.file, self.is_static = explored, address, file, is_static

    @property
    def menu(self) -> list[tuple[Page[Any], str]]:
        """Pages in the menu with something to show, and their addresses."""
        pages = [page for page in PAGES.values() if page.title and page.is_there(self.explored)]
        return [(page, address) for page in pages if (address := self.address(page, page.state()))]

    @property
    def questions(self) -> list[tuple[str, str]]:
        """Example questions with the addresses of pages that answer them: first agents, then models and the graph."""
        pages = [page for page in reversed(PAGES.values()) if page.is_there(self.explored)]
        links = (
            (text, self.address(page, state))
            for page in pages
            for text, state in page.questions(self.explored)
        )
        return [question for question in links if question[1]][:QUESTIONS]

    def page(self, page: Page[Any], state: PageState) -> str:
        """Return a page as HTML; errors from the view are raised."""
        view = page.view(self.explored, state)
        pictures = page.draw(view, state, self.address) if page.draw else {}
        return self._render(f"{page.name}.html.j2", page, state, view=view, pictures=pictures)

    def error(self, status: int, message: str, suggestions: Mapping[str, str] | None = None) -> str:
        """Return an error page, with suggested addresses by label."""
        values = {"status": status, "message": message, "suggestions": suggestions or {}}
        return self._render("error.html.j2", None, None, **values)

    def _render(
        self, template: str, page: Page[Any] | None, state: PageState | None, **values: Any
    ) -> str:
        outline = Outline()

        def link(name: str, **fields: Any) -> str:
            return self.address(PAGES[name], PAGES[name].state(**fields))

        def here(**changes: Any) -> str:
            assert page is not None
            assert state is not None
            return self.address(page, msgspec.structs.replace(state, **changes))

        def entity(label: str) -> Markup:
            model = getattr(state, "model", "")
            return _anchor(
                link("entity", entity=label, **({"model": model} if model else {})), label
            )

        shown = {
            "site": self,
            "page": page,
            "state": state,
            "outline": outline,
            "heading": outline.heading,
        }
        functions = {
            "term": outline.term,
            "link": link,
            "here": here,
            "entity": entity,
            "a": _anchor,
        }
        environment = _environment(HOME.package if page is None else page.package)
        return environment.get_template(template).render(**shown, **functions, **values)


def _anchor(address: str, text: str) -> Markup:
    return (
        Markup('<a href="{}">{}</a>').format(address, for_html(text)) if address else for_html(text)
    )


@cache
def _environment(package: str) -> jinja2.Environment:
    # Charts look as in reports, and templates share their macros.
    packages = dict.fromkeys(
        (package, HOME.package, "wordcraft_kg.apps.web", "wordcraft_kg.reports")
    )
    environment = make_environment(*packages)
    environment.globals["actions"] = ACTIONS
    return environment
