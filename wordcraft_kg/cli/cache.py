"""``wordcraft-kg cache``."""

from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Flag, Output, aligned

if TYPE_CHECKING:
    from wordcraft_kg.cli.cache_view import CacheView

EXAMPLES = ("wordcraft-kg cache", "wordcraft-kg cache --clear")


def cache(*, clear: Flag = False, output: Output = Output()) -> None:
    """List what is kept outside the folders that commands are given, and clear it on request.

    Args:
        clear: remove the fetched books, the word vectors and the answers of language models; PyKEEN's folder is left
            alone.
    """
    from wordcraft_kg.base.cache import clear_cache
    from wordcraft_kg.cli.cache_view import view_cache

    if clear:
        clear_cache()
    view = view_cache(cleared=clear)
    output.result(view, _text(view))


def _text(view: "CacheView") -> list[str]:
    from rich.filesize import decimal

    rows = (
        (found.holds, f"{found.files:,} file{'s' * (found.files != 1)}, {decimal(found.bytes)}  {found.path}")
        for found in view.folders
    )
    return [*aligned(rows), *(["cleared all but PyKEEN's"] if view.cleared else [])]
