"""Whether what serves pages is installed."""

from importlib.util import find_spec

from wordcraft_kg.errors import MissingExtraError


def check_extra() -> None:
    """Check that Starlette and uvicorn are there.

    Raises:
        MissingExtraError: naming the extra that installs them.
    """
    missing = [name for name in ("starlette", "uvicorn") if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} not installed: "
            "pip install 'wordcraft-kg[explore]'"
        )
