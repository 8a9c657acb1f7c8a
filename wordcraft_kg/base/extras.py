"""Whether what needs more than the package's own dependencies is installed."""

from collections.abc import Sequence
from importlib.util import find_spec

from wordcraft_kg.base.errors import MissingExtraError

PACKAGES = {"explore": ("starlette", "uvicorn"), "mcp": ("mcp",), "opinions": ("openai",), "rdf": ("rdflib",)}
"""Packages by the extra that installs them."""


def check_extra(extra: str) -> None:
    """Check that the packages of an extra, one of :data:`PACKAGES`, are there; none of them is imported.

    Raises:
        MissingExtraError: naming the extra that installs them.
    """
    missing = [name for name in PACKAGES[extra] if find_spec(name) is None]
    if missing:
        raise missing_extra(extra, missing)


def missing_extra(extra: str, names: Sequence[str]) -> MissingExtraError:
    """Return the error that says what is not installed, and which extra installs it."""
    are = "is" if len(names) == 1 else "are"
    return MissingExtraError(f"{' and '.join(names)} {are} not installed: pip install 'wordcraft-kg[{extra}]'")
