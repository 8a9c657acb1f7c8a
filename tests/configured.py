"""Settings that a command takes from a configuration file alone."""

import json
import tempfile
from pathlib import Path

FOLDER = tempfile.TemporaryDirectory()


def in_file(command, **settings):
    """Write settings into a configuration file; return the options that name it."""
    number = len(list(Path(FOLDER.name).iterdir()))
    path = Path(FOLDER.name) / f"{number}.toml"
    lines = [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
    path.write_text("\n".join([f"[{command}]", *lines, ""]))
    return ("--config", path)
