"""Long lists, page by page."""

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record


class Paging(Record):
    """The rows of a page: the numbers of the first (0 if there are none) and last row and of the page, and totals."""

    first: Count
    last: Count
    total: Count
    page: Count
    pages: Count

    @property
    def rows(self) -> slice:
        """The rows of the page, among all."""
        return slice(max(self.first - 1, 0), self.last)


def paging(total: int, page: int, size: int) -> Paging:
    """Return the rows of a page with ``size`` rows.

    Raises:
        ConfigError: if there is no such page.

    Example:
        >>> paging(45, 2, 20)
        Paging(first=21, last=40, total=45, page=2, pages=3)
    """
    pages = max(-(-total // size), 1)
    if not 1 <= page <= pages:
        raise ConfigError(f"`page` {page}: there {'is 1 page' if pages == 1 else f'are {pages:,} pages'}.")
    first = (page - 1) * size + 1
    return Paging(min(first, total), min(first + size - 1, total), total, page, pages)
