"""Render modes of the environments: ``ansi``, the state in words."""

from typing import Any

from wordcraft_kg.base.errors import ConfigError

METADATA: dict[str, Any] = {"render_modes": ["ansi"], "render_fps": 4}
"""Metadata for gymnasium."""


def check_mode(mode: str | None) -> None:
    """Check the name of a render mode; a ConfigError for an unknown mode."""
    if mode not in (None, "ansi"):
        raise ConfigError(f"`render_mode` {mode!r}: expected None or 'ansi'.")
