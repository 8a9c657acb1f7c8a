"""``config.toml``: all settings of a run in one table, named after the command that accepts it as ``--config``."""

import json
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.feature_spec import FeatureSpec
from wordcraft_kg.base.records import as_record

CONFIG_FILE = "config.toml"
T = TypeVar("T")


@dataclass(frozen=True)
class ConfigTable:
    """The content of a ``config.toml``, from which settings are taken part by part.

    Attributes:
        path: path of the file.
        command: name of the table.
        settings: those not taken yet, by name; paths are relative to the working folder.
    """

    path: Path
    command: str
    settings: dict[str, Any]

    def take(self, kind: type[T]) -> T:
        """Take the settings of a dataclass or record; those that are absent keep their defaults.

        Raises:
            ArtefactError: naming the setting that has the wrong type, is out of range, or is missing without a default.
        """
        names = [field.name for field in fields(kind)] if is_dataclass(kind) else kind.__struct_fields__  # type: ignore[attr-defined]
        return as_record({name: self.settings.pop(name) for name in names if name in self.settings}, kind, self.path)

    def close(self) -> None:
        """Check that all settings were taken.

        Raises:
            ArtefactError: naming a setting that was not.
        """
        if self.settings:
            raise ArtefactError(f"{self.path} is damaged: unknown setting '{next(iter(self.settings))}'.")


def write_config(folder: Path, command: str, settings: Mapping[str, Any], name: str = CONFIG_FILE) -> None:
    """Write settings by name, except those that are None; paths become relative to the folder, so both can be moved.

    A file that already has this content is left as it is.
    """

    def beside(path: str) -> str:
        return os.path.relpath(path, folder) if os.path.exists(path) else path

    lines = (f"{key} = {toml_value(value)}" for key, value in moved(settings, beside).items() if value is not None)
    text = "\n".join([f"[{command}]", *lines]) + "\n"
    path = folder / name
    if not path.is_file() or path.read_bytes() != text.encode():
        write_atomically(path, text, durable=True)


def read_config(folder: Path) -> ConfigTable:
    """Read the ``config.toml`` of a run's folder.

    Raises:
        ArtefactError: if it is missing, or not a TOML file with one table.
    """

    def from_here(path: str) -> str:
        return os.path.normpath(folder / path) if os.path.exists(folder / path) else path

    path = folder / CONFIG_FILE
    try:
        ((command, settings),) = tomllib.loads(read_small_file(path).decode()).items()
        return ConfigTable(path, command, moved(settings, from_here))
    except ArtefactError:
        raise
    except (ValueError, AttributeError, RecursionError) as error:
        raise ArtefactError(f"{path} is damaged ({error}). Train again, or restore a copy.") from None


def moved(settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return settings with the paths in them changed; :class:`FeatureSpec` decides whether features are a path."""
    found = dict(settings)
    for key in ("graph", "scorer", "features"):
        value = found.get(key)
        if not isinstance(value, str):
            continue
        if key != "features":
            found[key] = change(value)
        elif (spec := FeatureSpec.parse(value)).is_path:
            found[key] = spec.prefix + change(spec.source)
    return found


def toml_value(value: Any) -> str:
    """Write a string or a number as TOML, which agrees with JSON here unless characters are escaped as surrogates."""
    return json.dumps(value, ensure_ascii=False)
