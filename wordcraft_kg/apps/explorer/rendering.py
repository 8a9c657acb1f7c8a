"""Rendering pages from templates; the same for the server and for a static site."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import jinja2
import msgspec
from markupsafe import Markup

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, PageState
from wordcraft_kg.apps.explorer.pages import HOME, PAGES
from wordcraft_kg.base.wording import for_html
from wordcraft_kg.reports.agent_report import ACTIONS
from wordcraft_kg.reports.pages import Outline, make_environment


class Site:
    """Renders pages.

    Attributes:
        explored: content of the pages.
        address: returns the address of a page; empty where the site does not have it.
        file: returns the address of the site's own files, such as the style sheet, by file name.
        is_static: whether the site has no server, so that pages have no forms.
    """

    def __init__(
        self,
        explored: Explored,
        address: Addresses,
        file: Callable[[str], str],
        *,
        is_static: bool = False,
    ):
        """Take the content and address forms; the class describes the arguments."""
        self.explored = explored
        self.address = address
        self.file = file
        self.is_static = is_static

    @property
    def menu(self) -> list[tuple[Page[Any], str]]:
        """Pages in the menu with something to show, and their addresses."""
        pages = [page for page in PAGES.values() if page.title and page.is_there(self.explored)]
        entries = [(page, self.address(page, page.state())) for page in pages]
        # A static site lacks the pages that need a server.
        return [entry for entry in entries if entry[1]]

    def page(self, page: Page[Any], state: PageState) -> str:
        """Return a page as HTML.

        Raises:
            WordCraftKGError: if the settings ask for something that is not there, or a folder has
                changed.
        """
        view = page.view(self.explored, state)
        pictures = page.draw(view, state, self.address) if page.draw else {}
        return self._render(f"{page.name}.html.j2", page, state, view=view, pictures=pictures)

    def error(self, status: int, message: str, suggestions: Mapping[str, str] | None = None) -> str:
        """Return an error page.

        Args:
            status: HTTP status, such as 404.
            message: sentence about the problem; any text, since templates escape it.
            suggestions: addresses of pages that may have been meant, by label; None for none.

        Returns:
            the page as HTML.
        """
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
            # The chosen model stays chosen on the pages that follow.
            model = getattr(state, "model", "")
            settings = {"model": model} if model else {}
            return _anchor(link("entity", entity=label, **settings), label)

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
    """Return a link, or only its text where there is no address."""
    shown = for_html(text)
    # Markup.format escapes the address, for_html the text: both may hold labels from a stranger's
    # book.
    return Markup('<a href="{}">{}</a>').format(address, shown) if address else shown


@cache
def _environment(package: str) -> jinja2.Environment:
    # Charts look as in reports, and templates share their macros. The page's own package comes
    # first, so that a page from outside may replace a shared template; dict.fromkeys drops the
    # explorer's second mention.
    packages = dict.fromkeys(
        (package, HOME.package, "wordcraft_kg.apps.web", "wordcraft_kg.reports")
    )
    environment = make_environment(*packages)
    environment.globals["actions"] = ACTIONS
    return environment
