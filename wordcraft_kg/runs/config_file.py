"""``config.toml``: all run settings in one table, which the training command accepts as ``--config``."""

import json
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, get_args, get_type_hints

from msgspec import defstruct
from msgspec.structs import asdict

from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.feature_spec import FeatureSpec
from wordcraft_kg.base.records import as_record
from wordcraft_kg.graphs.library import MADE_UP

CONFIG_FILE = "config.toml"
T = TypeVar("T")


@dataclass(frozen=True)
class RunConfig:
    """Base class for all settings of a run (a training), which are written to and read from ``config.toml``.

    Nested dataclasses are written into the same TOML table. In a union of dataclasses, the table name selects the
    dataclass with this ``command``.

    Attributes:
        commands: commands that accept the settings.
        graph: graph folder, recipe book file or known book name.
    """

    commands: ClassVar[tuple[str, ...]]

    graph: str

    @property
    def command(self) -> str:
        """The training command for these settings, which names the table in ``config.toml``."""
        return self.commands[0]

    def default_folder(self, graph_name: str) -> Path:
        """Return the default run folder, in this base class ``models/<graph name>-<command>``."""
        return Path("models") / f"{graph_name}-{self.command}"

    def values(self) -> dict[str, Any]:
        """Return all settings by option name, without None values."""
        return {name: value for name, value in _flat(self).items() if value is not None}

    def write(self, folder: Path) -> None:
        """Write the settings to ``config.toml`` in a folder, with paths relative to this folder."""
        write_config(folder, self.command, self.values())

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read ``config.toml``; ArtefactError if missing or damaged, or with a wrong or missing setting."""
        command, settings = read_config(folder)
        path = folder / CONFIG_FILE
        if command not in cls.commands:
            raise ArtefactError(
                f"{path} is damaged: expected the table [{' or '.join(cls.commands)}], found [{command}]."
            )
        config = _taken(cls, settings, command, path)
        if settings:
            raise ArtefactError(f"{path} is damaged: unknown setting '{next(iter(settings))}'.")
        return config


def _flat(settings: Any) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in ((field.name, getattr(settings, field.name)) for field in fields(settings)):
        # A name that is a keyword of Python ends with an underscore.
        values |= _flat(value) if is_dataclass(value) else {name.removesuffix("_"): value}
    return values


def _taken(kind: type[T], settings: dict[str, Any], command: str, path: Path) -> T:
    hints = get_type_hints(kind)
    plain, nested = [], dict[str, Any]()
    for field in fields(kind):  # type: ignore[arg-type]
        groups = [
            hint for hint in (hints[field.name], *get_args(hints[field.name])) if is_dataclass(hint)
        ]
        if groups:
            group = next(
                (group for group in groups if getattr(group, "command", None) == command), groups[0]
            )
            nested[field.name] = _taken(group, settings, command, path)  # type: ignore[arg-type]
        else:
            default = () if field.default is MISSING else (field.default,)
            plain.append((field.name, hints[field.name], *default))
    given = {
        name: settings.pop(key) for name, *_ in plain if (key := name.removesuffix("_")) in settings
    }
    taken = as_record(given, defstruct(kind.__name__, plain, kw_only=True), path)
    try:
        return kind(**asdict(taken), **nested)
    except ConfigError as error:
        raise ArtefactError(f"{path} is damaged: {error} Train again, or restore a copy.") from None


def write_config(folder: Path, command: str, settings: Mapping[str, Any]) -> None:
    """Write all set settings to ``config.toml`` as table ``[command]``, if new; paths are relative."""

    def relative(path: str) -> str:
        twin, path = _twin_of(path)
        return twin + (os.path.relpath(path, folder) if os.path.exists(path) else path)

    given = {key: value for key, value in moved(settings, relative).items() if value is not None}
    lines = (
        f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in given.items()
    )  # TOML, as JSON
    text = "\n".join([f"[{command}]", *lines]) + "\n"
    path = folder / CONFIG_FILE
    if not path.is_file() or path.read_bytes() != text.encode():
        write_atomically(path, text, durable=True)


def _twin_of(source: str) -> tuple[str, str]:
    """Split ``made-up:book.csv``, a book with invented words, into the prefix and the book; other paths have none."""
    made_up = MADE_UP.fullmatch(source)
    return (source[: made_up.start(2)], made_up[2]) if made_up else ("", source)


def read_config(folder: Path) -> tuple[str, dict[str, Any]]:
    """Read command (table name) and settings from ``config.toml``; ArtefactError if missing or damaged."""

    def from_here(path: str) -> str:
        twin, path = _twin_of(path)
        return twin + (os.path.normpath(folder / path) if os.path.exists(folder / path) else path)

    path = folder / CONFIG_FILE
    try:
        ((command, settings),) = tomllib.loads(read_small_file(path).decode()).items()
        return command, moved(settings, from_here)
    except ArtefactError:
        raise
    except (ValueError, AttributeError, RecursionError) as error:
        raise ArtefactError(
            f"{path} is damaged ({error}). Train again, or restore a copy."
        ) from None


def moved(settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return settings with a function applied to all paths: ``graph``, ``scorer``, ``with``, a file in ``features``."""
    result = dict(settings)
    if isinstance(sources := result.get("with"), list | tuple):
        result["with"] = [
            change(source) if isinstance(source, str) else source for source in sources
        ]
    for key in ("graph", "scorer", "features"):
        value = result.get(key)
        if not isinstance(value, str):
            continue
        if key != "features":
            result[key] = change(value)
        elif (spec := FeatureSpec.parse(value)).is_path:
            result[key] = spec.prefix + change(spec.source)
    return result
