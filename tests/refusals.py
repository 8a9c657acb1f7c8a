"""Expecting errors by their class and the setting that they refuse; their texts are in `test_error_texts.py`."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from wordcraft_kg.base.errors import ConfigError, WordCraftKGError


@contextmanager
def refuses(setting: str, error: type[WordCraftKGError] = ConfigError) -> Iterator[None]:
    """Expect an error of exactly this class about this setting."""
    with pytest.raises(error) as raised:
        yield
    assert (raised.value.kind, raised.value.setting) == (error.__name__, setting)
