"""Expecting errors by their class and the setting that they refuse; their texts are in
`test_error_texts.py`."""

from contextlib import contextmanager

import pytest

from wordcraft_kg.base.errors import ConfigError


@contextmanager
def refuses(setting, error=ConfigError):
    """Expect an error of exactly this class about this setting."""
    with pytest.raises(error) as raised:
        yield
    assert (raised.value.kind, raised.value.setting) == (error.__name__, setting)
