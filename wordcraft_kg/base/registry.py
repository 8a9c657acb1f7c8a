"""Registries of named objects, and the plugins that extend them: a user's file, or a package.

A plugin is a Python file that registers an own policy, source, reward, split or player by the
decorators of :mod:`wordcraft_kg.plugins`. Only a user's word loads one: ``--plugin FILE`` or
:func:`load_plugin`. Runs record its name and hash, and ask for it when they are opened; nothing
that a stranger gives, such as a run folder or a configuration file, names a file to load.
"""

import hashlib
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from wordcraft_kg.base.artefacts import read_small_file
from wordcraft_kg.base.errors import ConfigError, NotRegisteredError, WordCraftKGError, reason
from wordcraft_kg.base.settings import nearest, refuse

T = TypeVar("T")
PLUGINS = "wordcraft_kg.plugins"
"""Group of entry points: modules of other packages that register by decorators."""
REMEDY = "Name the file that has it with --plugin (in Python load_plugin), or install its package."


@dataclass(frozen=True)
class Plugin:
    """A loaded plugin file.

    Attributes:
        name: name of the file.
        sha256: hash of the bytes that were run.
        path: absolute path, for processes that load it again.
    """

    name: str
    sha256: str
    path: Path


_LOADED: dict[Path, Plugin] = {}
_LOADING: ContextVar[Plugin | None] = ContextVar("loading", default=None)


class Registry(MutableMapping[str, T]):
    """A mapping from names to objects. A module adds an object with ``registry[name] = thing``.

    Installed packages add objects by entry points: of the group with an object's name, which is
    loaded when the object is looked up; or of a module, in this group or in :data:`PLUGINS`, which
    registers on import, and is loaded when an unknown name is looked up, or all names are listed.
    Built-in names cost no imports.

    Example:
        >>> colours = Registry("example.colours", {"red": 0xFF0000})
        >>> colours["blue"] = 0x0000FF
        >>> sorted(colours)
        ['blue', 'red']
    """

    def __init__(self, group: str, own: Mapping[str, T] | None = None):
        """Create a registry with the built-in objects ``own``, extended by an entry-point group."""
        self._group = group
        self._known = dict(own or {})
        self._plugins: dict[str, Plugin] = {}
        self._points: dict[str, EntryPoint] | None = None

    def __getitem__(self, name: str) -> T:
        # A known name needs no entry points, whose imports may take seconds.
        if name not in self._known and name in self._installed():
            self._known.setdefault(name, self._installed()[name].load())
        return self._known[name]

    def __setitem__(self, name: str, thing: T) -> None:
        plugin = _LOADING.get()
        if plugin is not None:
            # Another file, or the package, means something else by the name; a file that has
            # been corrected is loaded again.
            is_again = name in self._plugins and self._plugins[name].path == plugin.path
            if name in self._known and not is_again:
                raise ConfigError(
                    f"'{name}' in plugin '{plugin.name}' is registered already; choose another "
                    "name."
                )
            self._plugins[name] = plugin
        self._known[name] = thing

    def __delitem__(self, name: str) -> None:
        del self._known[name]
        self._plugins.pop(name, None)

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._installed()

    def __iter__(self) -> Iterator[str]:
        # First those of packages, whose modules register when they are loaded.
        installed = self._installed()
        return iter({**self._known, **installed})

    def __len__(self) -> int:
        return len(list(iter(self)))

    def _installed(self) -> Mapping[str, EntryPoint]:
        """Return the entry points of objects by name, not loaded; load those of modules once."""
        if self._points is None:
            # By name, because the order of installed packages differs between machines.
            points = sorted(entry_points(group=self._group), key=lambda point: point.name)
            for point in (*points, *entry_points(group=PLUGINS)):
                if not point.attr:
                    point.load()
            # Not before: a failure is not forgotten.
            self._points = {point.name: point for point in points if point.attr}
        return self._points

    def check(self, setting: str, name: Any, built_in: Iterable[str] = ()) -> None:
        """Check that a setting names a registered object.

        Args:
            setting: the setting, for the error.
            name: its value.
            built_in: further names that the setting may have.

        Raises:
            NotRegisteredError: if it does not; the message has the names, and where others may be.
            ConfigError: if it is no text.
        """
        built_in = tuple(built_in)
        if not isinstance(name, str):
            raise refuse(setting, name, "a name")
        if name not in built_in and name not in self:
            names = [*built_in, *self]
            message = refuse(setting, name, f"one of {', '.join(names)}", nearest(name, names))
            raise NotRegisteredError(f"{message} {REMEDY}")

    def plugins(self, *names: str) -> dict[str, str]:
        """Return the hashes of the plugin files of some objects, by file name, for a record."""
        files = [self._plugins[name] for name in names if name in self._plugins]
        return {plugin.name: plugin.sha256 for plugin in files}


def load_plugin(path: str | Path) -> Plugin:
    """Run a Python file that registers own parts; once, however often it is named.

    Args:
        path: a file of your own, or one that you have read: it is run like any program.

    Returns:
        The plugin.

    Raises:
        ConfigError: if there is no such file, it cannot be run, or a name in it is registered
            already.
        ArtefactError: if it is too large.

    Example:
        >>> lines = ("from wordcraft_kg.plugins import reward", "@reward('double')")
        >>> with open("ideas.py", "w") as file:
        ...     print(*lines, "def _(_, __, step): return 2 * step.reward", sep=chr(10), file=file)
        >>> load_plugin("ideas.py").name, TaskConfig(reward="double").reward
        ('ideas.py', 'double')
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"plugin '{path}': no such file; expected a Python file.")
    content = read_small_file(path)
    plugin = Plugin(path.name, hashlib.sha256(content).hexdigest(), path.resolve())
    if _LOADED.get(plugin.path) == plugin:
        return plugin
    module = ModuleType(f"{PLUGINS}.{plugin.sha256[:16]}")
    module.__file__ = str(plugin.path)
    # Dataclasses look for their module there.
    sys.modules[module.__name__] = module
    token = _LOADING.set(plugin)
    try:
        # The very bytes that the hash is of.
        exec(compile(content, str(path), "exec"), vars(module))
    except WordCraftKGError:
        raise
    except Exception as error:
        lines = [
            f", line {frame.lineno}"
            for frame in traceback.extract_tb(error.__traceback__)
            if frame.filename == str(path)
        ]
        raise ConfigError(
            f"plugin '{path}'{''.join(lines[-1:])} cannot be run ({reason(error)}). Correct the "
            "file."
        ) from error
    finally:
        _LOADING.reset(token)
    _LOADED[plugin.path] = plugin
    return plugin


def loaded_plugins() -> tuple[Plugin, ...]:
    """Return the plugins that this process has loaded, so that its workers load them too."""
    return tuple(_LOADED.values())


def check_plugins(needed: Mapping[str, str], folder: Path) -> None:
    """Check that the plugins of a run are loaded, as they were when it was made.

    Args:
        needed: hashes by file name, from the run's record.
        folder: the run folder, for the error.

    Raises:
        NotRegisteredError: if one is missing, or another file of its name is loaded.
    """
    loaded = {plugin.sha256: plugin.name for plugin in _LOADED.values()}
    for name, sha256 in needed.items():
        if sha256 in loaded:
            continue
        hashes = [digest for digest, file_name in loaded.items() if file_name == name]
        if hashes:
            raise NotRegisteredError(
                f"'{folder}' was made with another plugin '{name}': expected SHA-256 {sha256}, "
                f"found {hashes[0]}. Restore that file, or train again with this one."
            )
        raise NotRegisteredError(
            f"'{folder}' needs the plugin '{name}' with SHA-256 {sha256}. No plugin is loaded by "
            f"itself: read the file, and name it by --plugin {name} (in Python load_plugin)."
        )
