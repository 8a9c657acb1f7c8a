"""Long lists, page by page."""

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record


class Paging(Record):
    """A page of rows: numbers of the first (0 without rows) and last row, all rows, this page, and all pages."""

    first: Count
    last: Count
    total: Count
    page: Count
    pages: Count

    @property
    def rows(self) -> slice:
        """The rows of the page."""
        return slice(max(self.first - 1, 0), self.last)


def paging(total: int, page: int, size: int) -> Paging:
    """Return a page of ``size`` rows; a missing page is a ConfigError.

    Example:
        >>> paging(45, 2, 20)
        Paging(first=21, last=40, total=45, page=2, pages=3)
    """
    pages = max(-(-total // size), 1)
    if not 1 <= page <= pages:
        raise ConfigError(f"`page` {page}: there {'is 1 page' if pages == 1 else f'are {pages:,} pages'}.")
    first = (page - 1) * size + 1
    return Paging(min(first, total), min(first + size - 1, total), total, page, pages)
