"""Whether what a command needs beyond the package's own dependencies is installed."""

from importlib.util import find_spec

from wordcraft_kg.errors import MissingExtraError

PACKAGES = {"explore": ("starlette", "uvicorn"), "mcp": ("mcp",)}
"""Packages by the extra that installs them."""


def check_extra(extra: str = "explore") -> None:
    """Check that the packages of an extra are there; the default serves pages.

    Raises:
        MissingExtraError: naming the extra that installs them.
    """
    missing = [name for name in PACKAGES[extra] if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} not installed: "
            f"pip install 'wordcraft-kg[{extra}]'"
        )
