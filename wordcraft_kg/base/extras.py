"""Checks for optional dependencies."""

from collections.abc import Sequence
from importlib.util import find_spec

from wordcraft_kg.base.errors import MissingExtraError

PACKAGES = {"explore": ("starlette", "uvicorn"), "mcp": ("mcp",), "elicit": ("openai",)}
"""Packages by extra."""


def check_extra(extra: str) -> None:
    """Check that an extra's packages are installed, without importing any.

    Raises:
        MissingExtraError: naming the extra to install.
    """
    missing = [name for name in PACKAGES[extra] if find_spec(name) is None]
    if missing:
        raise missing_extra(extra, missing)


def missing_extra(extra: str, names: Sequence[str]) -> MissingExtraError:
    """Return the error for missing packages, with the extra to install."""
    are = "is" if len(names) == 1 else "are"
    return MissingExtraError(f"{' and '.join(names)} {are} not installed: pip install 'wordcraft-kg[{extra}]'")
