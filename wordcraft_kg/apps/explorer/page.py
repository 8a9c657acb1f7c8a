"""Pages, their addresses, and long lists."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar, get_origin
from urllib.parse import quote, urlencode

import msgspec

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.base import ConfigError, Count, Record, nearest


class PageState(Record):
    """Base class for page settings.

    Fields are of type str, int, bool, Literal or tuple[str, ...], and have defaults.
    """


S = TypeVar("S", bound=PageState)
Addresses = Callable[["Page[Any]", PageState], str]
"""Returns the address of a page, or an empty text where there is none."""


@dataclass(frozen=True)
class Page(Generic[S]):
    """A kind of page, such as the entity page.

    Functions take the opened folders (``Explored``) and settings.

    Attributes:
        name: first address segment, and template name.
        state: class of the settings; each field is a query parameter of the address.
        view: returns the shown values as a record. An UnknownEntityError becomes a page "not
            found", other input errors a page with the message.
        title: name in the menu; empty for pages outside the menu.
        subject: setting in the second address segment, as in ``/entity/paper``; empty for none.
        exported: returns settings for each file in a static site; by default a single file with
            default settings, and none for a page with a subject.
        is_there: returns a true value if the page has content.
        package: package with the template, in the folder ``templates``.
    """

    name: str
    state: type[S]
    view: Callable[[Explored, S], Record]
    title: str = ""
    subject: str = ""
    exported: Callable[[Explored], Iterable[S]] | None = None
    is_there: Callable[[Explored], object] = lambda _: True
    package: str = "wordcraft_kg.apps.explorer"

    def states(self, explored: Explored) -> Iterable[S]:
        """Return settings for each file of this page in a static site; settings may repeat."""
        if not self.is_there(explored):
            return []
        if self.exported is not None:
            return self.exported(explored)
        # The plain address of a page with a subject has no subject to show.
        return [] if self.subject else [self.state()]

    def address(self, state: S) -> str:
        """Return the path and query for page settings, without defaults."""
        path = f"/{self.name}"
        query: list[tuple[str, str]] = []
        for field in _fields(self.state):
            value = getattr(state, field.name)
            if field.name == self.subject and _fits_path(value):
                path += f"/{quote(value, safe='')}"
            elif value != field.default:
                # A tuple is one parameter given several times.
                values = value if isinstance(value, tuple) else (value,)
                query += [(field.name, _written(part)) for part in values]
        return f"{path}?{urlencode(query)}" if query else path

    def read(self, subject: str, query: Iterable[tuple[str, str]]) -> S:
        """Return the settings of an address.

        Args:
            subject: decoded second path segment; may be empty.
            query: decoded names and values of the query. An empty value, which forms send for an
                empty field, means the default.

        Raises:
            ConfigError: if a name is unknown, a value has another type, or two values are given for
                a setting.
        """
        fields = {field.name: field for field in _fields(self.state)}
        settings: dict[str, Any] = {}
        if self.subject and subject:
            settings[self.subject] = subject
        for name, value in query:
            if name not in fields:
                expected = f"expected {', '.join(fields)}" if fields else "this page has none"
                # The search for the nearest name takes time by the length of the text.
                raise ConfigError(
                    f"unknown page setting '{name}'; {expected}.{nearest(name[:50], fields)}"
                )
            if get_origin(fields[name].type) is tuple:
                settings.setdefault(name, []).append(value)
                continue
            # An address may repeat a value, such as the subject of its path: equal values are one.
            if value and settings.setdefault(name, value) != value:
                raise ConfigError(f"'{name}' is given twice: '{settings[name]}' and '{value}'.")
        try:
            # All values are texts: strict=False reads numbers and booleans from them.
            return msgspec.convert(settings, self.state, strict=False)
        except msgspec.ValidationError as error:
            # Messages of msgspec quote with backticks, ours with apostrophes.
            message = str(error).replace("`", "'")
            raise ConfigError(f"Invalid address: {message}.") from None


@cache
def _fields(state: type[PageState]) -> tuple[msgspec.structs.FieldInfo, ...]:
    # Kept, because a page asks for them once for each of its links.
    return msgspec.structs.fields(state)


def _fits_path(value: str) -> bool:
    """Return whether a label can be a path segment.

    Browsers resolve dots as folders, some servers split at slashes, and proxies may decode percent
    signs twice. Other labels go to the query.
    """
    return bool(value.strip(".")) and not set(value) & {"/", "\\", "%"}


def _written(value: Any) -> str:
    # Booleans as in JSON, which the reader expects.
    return str(value).lower() if isinstance(value, bool) else str(value)


class Paging(Record):
    """A page in a long list.

    Attributes:
        first: number of the first row on the page, from 1; 0 without rows.
        last: number of the last row on the page.
        total: row count of the whole list.
        page: page number, from 1.
        pages: page count, at least 1.
    """

    first: Count
    last: Count
    total: Count
    page: Count
    pages: Count

    @property
    def rows(self) -> slice:
        """The slice with the rows on this page."""
        return slice(max(self.first - 1, 0), self.last)


def num_pages(total: int, size: int) -> int:
    """Return how many pages of ``size`` rows a list fills; 0 for an empty list."""
    return math.ceil(total / size)


def paging(total: int, page: int, size: int) -> Paging:
    """Return a page of a long list.

    Args:
        total: row count of the list.
        page: page number, from 1.
        size: rows on a page.

    Returns:
        the page; ``paging(45, 2, 20)`` has the rows 21 to 40 of 45, on page 2 of 3.

    Raises:
        ConfigError: if the list has no such page.
    """
    # An empty list has a page, too, which tells that nothing was found.
    pages = max(num_pages(total, size), 1)
    if not 1 <= page <= pages:
        available = "is 1 page" if pages == 1 else f"are {pages:,} pages"
        raise ConfigError(f"`page` {page}: there {available}.")
    first = (page - 1) * size + 1
    return Paging(
        first=min(first, total),
        last=min(first + size - 1, total),
        total=total,
        page=page,
        pages=pages,
    )
