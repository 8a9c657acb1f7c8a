"""What is said where Inspect AI is needed and not installed."""

from wordcraft_kg.errors import MissingExtraError


def missing_inspect() -> MissingExtraError:
    """Return the error that names the extra which installs Inspect AI."""
    return MissingExtraError("Inspect AI is not installed: pip install 'wordcraft-kg[inspect]'")
