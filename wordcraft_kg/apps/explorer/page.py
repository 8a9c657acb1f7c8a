"""Pages, their addresses, and long lists."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar, get_origin
from urllib.parse import quote, urlencode

import msgspec

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.settings import nearest


class PageState(Record):
    """Base class for page settings: str, int, bool, Literal or tuple[str, ...] fields with defaults."""


S = TypeVar("S", bound=PageState)
Addresses = Callable[["Page[Any]", PageState], str]
"""Returns the address of a page, or an empty text where there is none."""


@dataclass(frozen=True)
class Page(Generic[S]):
    """A kind of page, such as the entity page. Functions take the opened folders (``Explored``) and settings.

    Attributes:
        name: first address segment, and template name.
        view: returns the shown values as a record. An UnknownEntityError becomes a page "not found", other input
            errors a page with the message.
        title: name in the menu; empty for pages outside the menu.
        subject: setting in the second address segment, as in ``/entity/paper``.
        draw: returns a view's pictures, as server-side SVG, by their names in the template.
        exported: returns settings for each file in a static site; by default a single file with default settings.
        questions: returns examples of questions that the page answers, with settings; also in a static site.
        is_there: returns a true value if the page has content.
        is_live: returns whether the view may change, so that the page must not be cached.
        package: package with the template, in the folder ``templates``.
    """

    name: str
    state: type[S]
    view: Callable[[Explored, S], Record]
    title: str = ""
    subject: str = ""
    draw: Callable[[Any, S, Addresses], Mapping[str, Any]] | None = None
    exported: Callable[[Explored], Iterable[S]] | None = None
    questions: Callable[[Explored], Iterable[tuple[str, S]]] = lambda _: ()
    is_there: Callable[[Explored], object] = lambda _: True
    is_live: Callable[[Explored, S], bool] = lambda *_: False
    package: str = "wordcraft_kg.apps.explorer"

    def states(self, explored: Explored) -> Iterable[S]:
        """Return settings for each file that this page has in a static site."""
        if not self.is_there(explored):
            return []
        usual: Iterable[S] = [] if self.subject else [self.state()]
        states = usual if self.exported is None else self.exported(explored)
        return [*states, *(state for _, state in self.questions(explored))]

    def address(self, state: S) -> str:
        """Return the path and query for page settings, without defaults."""
        path = f"/{self.name}"
        query: list[tuple[str, str]] = []
        for field in _fields(self.state):
            value = getattr(state, field.name)
            # Browsers resolve dots, some servers slashes, and proxies may decode percent signs twice.
            if (
                field.name == self.subject
                and value.strip(".")
                and not set(value) & {"/", "\\", "%"}
            ):
                path += f"/{quote(value, safe='')}"
            elif value != field.default:
                query += [
                    (field.name, _written(one))
                    for one in (value if isinstance(value, tuple) else (value,))
                ]
        return f"{path}?{urlencode(query)}" if query else path

    def read(self, subject: str, query: Iterable[tuple[str, str]]) -> S:
        """Return settings from a decoded second path segment and a query (ConfigError); empty means the default."""
        fields = {field.name: field for field in _fields(self.state)}
        given: dict[str, Any] = {self.subject: subject} if self.subject and subject else {}
        for name, value in query:
            if name not in fields:
                expected = (
                    f"expected {', '.join(fields)}" if fields else "this page has no settings"
                )
                raise ConfigError(
                    f"unknown page setting '{_cut(name)}'; {expected}.{nearest(name[:50], fields)}"
                )
            if get_origin(fields[name].type) is tuple:
                given.setdefault(name, []).append(value)
            elif value and given.setdefault(name, value) != value:
                raise ConfigError(
                    f"'{name}' is given twice: '{_cut(given[name])}' and '{_cut(value)}'."
                )
        try:
            return msgspec.convert(given, self.state, strict=False)
        except msgspec.ValidationError as error:
            raise ConfigError(f"Invalid address: {str(error).replace('`', chr(39))}.") from None


@cache
def _fields(state: type[PageState]) -> tuple[msgspec.structs.FieldInfo, ...]:
    return msgspec.structs.fields(state)


def _written(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _cut(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."


class Paging(Record):
    """A page in a long list: first row (0 without rows), last row, row count, page number, and page count."""

    first: Count
    last: Count
    total: Count
    page: Count
    pages: Count

    @property
    def rows(self) -> slice:
        """The slice with the rows on this page."""
        return slice(max(self.first - 1, 0), self.last)


def paging(total: int, page: int, size: int) -> Paging:
    """Return a page with ``size`` rows; a missing page is a ConfigError."""
    pages = max(-(-total // size), 1)
    if not 1 <= page <= pages:
        raise ConfigError(
            f"`page` {page}: there {'is 1 page' if pages == 1 else f'are {pages:,} pages'}."
        )
    first = (page - 1) * size + 1
    return Paging(min(first, total), min(first + size - 1, total), total, page, pages)
