"""Applications on top of the core.

The core imports none of them, and none imports another; they share ``web``.

An app adds to the core by entry points (``pyproject.toml``), as any other distribution may:
commands (``wordcraft_kg.commands``), kinds of trained models (``wordcraft_kg.models``), pages of
the explorer (``wordcraft_kg.pages``), sources and players.
"""
