"""Checks for optional dependencies, which are installed as extras: ``pip install 'wordcraft-kg[mcp]'``."""

from collections.abc import Sequence
from importlib.util import find_spec

from wordcraft_kg.base.errors import MissingExtraError

PACKAGES = {"explore": ("starlette", "uvicorn"), "mcp": ("mcp",), "elicit": ("openai",)}
"""Import names: the packages that each extra installs."""


def check_extra(extra: str) -> None:
    """Check that all packages of an extra are installed, without importing the packages.

    Raises:
        MissingExtraError: if a package is missing; the message names the extra to install.
    """
    missing = [name for name in PACKAGES[extra] if find_spec(name) is None]
    if missing:
        raise missing_extra(extra, missing)


def missing_extra(extra: str, names: Sequence[str]) -> MissingExtraError:
    """Return the error for missing packages ``names``; the message has the pip command that installs ``extra``."""
    are = "is" if len(names) == 1 else "are"
    return MissingExtraError(f"{' and '.join(names)} {are} not installed: pip install 'wordcraft-kg[{extra}]'")
