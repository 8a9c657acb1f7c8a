"""``config.toml``: all settings of a run in one table, for the option ``--config``.

The file has resolved settings, defaults included, so a later version with other defaults repeats
the run. Paths are relative to the file, so that a folder may move together with its inputs.
"""

import json
import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, get_args, get_type_hints

from msgspec import defstruct
from msgspec.structs import asdict

from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    FeatureSpec,
    NotRegisteredError,
    as_record,
    read_small_file,
    write_atomically,
)
from wordcraft_kg.graphs.graph_folder import GraphLike
from wordcraft_kg.graphs.library import without_prefix

CONFIG_FILE = "config.toml"
T = TypeVar("T")


@dataclass(frozen=True)
class RunConfig:
    """Base class for all settings of a run (a training), as in ``config.toml``.

    Nested dataclasses are written into the same TOML table. In a union of dataclasses, the table
    name selects the dataclass with this ``command``.

    Attributes:
        commands: commands that accept the settings.
        graph: graph folder, recipe book file, known book name, or a graph. A run records the source
            of an opened graph: to open the run by name, that has to be the graph's folder.
    """

    commands: ClassVar[tuple[str, ...]]

    graph: GraphLike

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
        """Write the settings to ``config.toml`` in a folder, with paths relative to this folder.

        A file with the same content is left as it is.
        """

        def relative(path: str) -> str:
            prefix, path = without_prefix(path)
            return prefix + (os.path.relpath(path, folder) if os.path.exists(path) else path)

        # Strings, numbers, booleans and lists of these are the same in JSON and TOML.
        lines = [
            f"{key} = {json.dumps(value, ensure_ascii=False)}\n"
            for key, value in moved(self.values(), relative).items()
        ]
        # TOML forbids a bare DEL, which JSON leaves as it is.
        text = "".join([f"[{self.command}]\n", *lines]).replace("\x7f", "\\u007f")
        path = folder / CONFIG_FILE
        # A resumed run whose inputs lie where they lay keeps its file and the file's hash.
        if not path.is_file() or path.read_bytes() != text.encode():
            write_atomically(path, text, durable=True)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read ``config.toml`` in a run folder, with paths from the working folder.

        Raises:
            ArtefactError: if it is missing or damaged, belongs to another command, or has a wrong,
                missing or unknown setting.
        """

        def from_here(path: str) -> str:
            prefix, path = without_prefix(path)
            target = folder / path
            return prefix + (os.path.normpath(target) if os.path.exists(target) else path)

        path = folder / CONFIG_FILE
        content = read_small_file(path)
        try:
            ((command, table),) = tomllib.loads(content.decode()).items()
            settings = moved(table, from_here)
        except (ValueError, AttributeError, RecursionError) as error:
            raise ArtefactError(
                f"{path} is damaged ({error}). Train again, or restore a copy."
            ) from None
        if command not in cls.commands:
            expected = " or ".join(cls.commands)
            raise ArtefactError(
                f"{path} is damaged: expected the table [{expected}], found [{command}]."
            )
        config = _taken(cls, settings, command, path)
        # Each dataclass has taken its own settings; anything left is unknown to all of them.
        if settings:
            raise ArtefactError(
                f"{path}: this version has no setting '{next(iter(settings))}'. Train again, or "
                "open it with the version that wrote it."
            )
        return config


def _flat(settings: Any) -> dict[str, Any]:
    """Return the fields of a dataclass and of the dataclasses in it, by name."""
    values: dict[str, Any] = {}
    for field in fields(settings):
        value = getattr(settings, field.name)
        if is_dataclass(value):
            values |= _flat(value)
        else:
            values[_key(field.name)] = value
    return values


def _key(name: str) -> str:
    """Return the key of a field in TOML; a field named like a keyword of Python ends with "_"."""
    return name.removesuffix("_")


def _taken(
    kind: type[T],
    settings: dict[str, Any],
    command: str,
    path: Path,
) -> T:
    """Take the settings of a dataclass out of ``settings`` and return the dataclass."""
    hints = get_type_hints(kind)
    nested: dict[str, Any] = {}
    plain: list[tuple[Any, ...]] = []
    values: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        # A file names the graph.
        hint = str if field.name == "graph" else hints[field.name]
        groups = [
            kind_in_hint for kind_in_hint in (hint, *get_args(hint)) if is_dataclass(kind_in_hint)
        ]
        if groups:
            matching = [group for group in groups if getattr(group, "command", None) == command]
            group: Any = [*matching, *groups][0]
            nested[field.name] = _taken(group, settings, command, path)
            continue
        default = () if field.default is MISSING else (field.default,)
        plain.append((field.name, hint, *default))
        if _key(field.name) in settings:
            values[field.name] = settings.pop(_key(field.name))
    # A record of these fields checks their types, and only then the dataclass their values.
    record = as_record(values, defstruct(kind.__name__, plain, kw_only=True), path)
    try:
        return kind(**asdict(record), **nested)
    except NotRegisteredError as error:
        raise NotRegisteredError(f"'{path.parent}': {error}") from None
    except ConfigError as error:
        raise ArtefactError(f"{path} is damaged: {error} Train again, or restore a copy.") from None


def moved(settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return settings with a function applied to all paths.

    Paths are in ``graph``, ``scorer``, ``parts`` and ``with`` and, unless it is a reserved name, in
    ``features``. A value of another type, as in a damaged file, stays as it is.

    Args:
        settings: settings by name.
        change: returns the new path.
    """
    result = dict(settings)
    for key in ("graph", "scorer", "parts"):
        if isinstance(result.get(key), str):
            result[key] = change(result[key])
    sources = result.get("with")
    if isinstance(sources, list | tuple):
        result["with"] = [
            change(source) if isinstance(source, str) else source for source in sources
        ]
    features = result.get("features")
    if isinstance(features, str):
        spec = FeatureSpec.parse(features)
        if spec.is_path:
            result["features"] = spec.prefix + change(spec.source)
    return result
