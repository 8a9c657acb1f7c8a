"""Registries of named objects, and the plugins that extend them: a user's file, or a package.

A plugin is a Python file that registers an own policy, source, reward, split or player by the
decorators of :mod:`wordcraft_kg.plugins`. Only a user's word loads one: ``--plugin FILE`` or
:func:`load_plugin`. Runs record its name and hash, and ask for it when they are opened; nothing
that a stranger gives, such as a run folder or a configuration file, names a file to load.
"""

import hashlib
import re
import shlex
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


# Also a name in lists with commas, and of a module of torch.
_NAME = re.compile(r"\w[\w +-]*")
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

    def __init__(
        self, group: str, own: Mapping[str, T] | None = None, reserved: Iterable[str] = ()
    ):
        """Create a registry.

        Args:
            group: the entry-point group that extends it.
            own: built-in objects, whose names nothing may take.
            reserved: names of built-in objects elsewhere, which nothing may take either.
        """
        self._group = group
        self._known = dict(own or {})
        self._reserved = (*reserved, *self._known)
        self._plugins: dict[str, Plugin] = {}
        self._points: dict[str, EntryPoint] | None = None

    def __getitem__(self, name: str) -> T:
        # A known name needs no entry points, whose imports may take seconds.
        if name not in self._known and name in self._installed():
            self._known.setdefault(name, self._installed()[name].load())
        return self._known[name]

    def __setitem__(self, name: str, thing: T) -> None:
        if name in self._reserved:
            raise ConfigError(f"'{name}' is built in; choose another name.")
        plugin = _LOADING.get()
        if plugin is not None:
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise ConfigError(
                    f"plugin '{plugin.name}' registers {name!r}; expected a name of letters, "
                    "digits, blanks and the signs _, + and -."
                )
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
                    _import(point)
            # Not before: a failure is not forgotten.
            self._points = {point.name: point for point in points if point.attr}
        return self._points

    def check(self, setting: str, name: Any) -> None:
        """Check that a setting names a registered object, or one with a reserved name.

        Args:
            setting: the setting, for the error.
            name: its value.

        Raises:
            NotRegisteredError: if it does not; the message has the names, and where others may be.
            ConfigError: if it is no text.
        """
        if not isinstance(name, str):
            raise refuse(setting, name, "a name")
        if name not in self._reserved and name not in self:
            names = [*dict.fromkeys((*self._reserved, *self))]
            message = refuse(setting, name, f"one of {', '.join(names)}", nearest(name, names))
            raise NotRegisteredError(f"{message} {REMEDY}")

    def plugins(self, *names: str) -> dict[str, str]:
        """Return the hashes of the plugin files of some objects, by file name, for a record."""
        files = [self._plugins[name] for name in names if name in self._plugins]
        return {plugin.name: plugin.sha256 for plugin in files}


def _import(point: EntryPoint) -> None:
    """Import the module of a package that registers on import."""
    try:
        point.load()
    except ConfigError as error:
        package = point.dist.name if point.dist else point.value
        raise ConfigError(f"the package '{package}': {error} Correct or uninstall it.") from error


def load_plugin(path: str | Path) -> Plugin:
    """Run a Python file that registers own parts; once, however often it is named.

    Args:
        path: a file of your own, or one that you have read: it is run like any program.

    Returns:
        The plugin.

    Raises:
        ConfigError: if there is no such file, it cannot be run, or its name or one in it is taken
            already.
        ArtefactError: if it is too large.

    Example:
        >>> lines = ("from wordcraft_kg.plugins import reward", "@reward('double')")
        >>> with open("ideas.py", "w") as file:
        ...     print(*lines, "def _(_, __, step): return 2 * step.reward", sep=chr(10), file=file)
        >>> load_plugin("ideas.py").name, TaskConfig(reward="double").reward
        ('ideas.py', 'double')
    """
    file = Path(path)
    if not file.is_file():
        # An option without a value gives an empty path, which as a Path would be "."
        raise ConfigError(f"plugin '{path}': no such file; expected a Python file.")
    content = read_small_file(file)
    plugin = Plugin(file.name, hashlib.sha256(content).hexdigest(), file.resolve())
    if _LOADED.get(plugin.path) == plugin:
        return plugin
    for loaded in _LOADED.values():
        if loaded.name == plugin.name and loaded.path != plugin.path:
            raise ConfigError(
                f"plugin '{path}': '{loaded.path}' is loaded, too, and records name plugins by "
                "file name. Rename one of them."
            )
    module = ModuleType(f"{PLUGINS}.{plugin.sha256[:16]}")
    module.__file__ = str(plugin.path)
    # Dataclasses look for their module there.
    sys.modules[module.__name__] = module
    token = _LOADING.set(plugin)
    try:
        # The very bytes that the hash is of.
        exec(compile(content, str(plugin.path), "exec"), vars(module))
    except WordCraftKGError:
        raise
    except (Exception, SystemExit) as error:
        raise plugin_error(error, plugin) from error
    finally:
        _LOADING.reset(token)
    _LOADED[plugin.path] = plugin
    return plugin


def plugin_error(error: BaseException, plugin: Plugin) -> ConfigError:
    """Return an error in a plugin's code as one with its line, for the author."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(plugin.path)]
    place = f", line {lines[-1]}" if lines else ""
    return ConfigError(
        f"plugin '{plugin.name}'{place} cannot be run ({reason(error)}). Correct the file."
    )


def loaded_plugins() -> tuple[Plugin, ...]:
    """Return the plugins that this process has loaded, so that its workers load them too."""
    return tuple(_LOADED.values())


def load_again(plugins: Iterable[Plugin]) -> None:
    """Load another process' plugins, as it has loaded them.

    Raises:
        ConfigError: if a file was changed since: its hash is a part of the addresses of results.
    """
    for plugin in plugins:
        if load_plugin(plugin.path) != plugin:
            raise ConfigError(
                f"plugin '{plugin.path}' was changed while the study ran. Repeat the command."
            )


def check_plugins(needed: Mapping[str, str], folder: Path) -> None:
    """Check that the plugins of a run are loaded, as they were when it was made.

    Args:
        needed: hashes by file name, from the run's record.
        folder: the run folder, for the error.

    Raises:
        NotRegisteredError: if one is missing, or another file of its name is loaded.
    """
    loaded = {plugin.name: plugin.sha256 for plugin in _LOADED.values()}
    missing = {name: needed[name] for name in needed if needed[name] not in loaded.values()}
    if missing:
        files = " and ".join(
            f"'{name}' with SHA-256 {sha256} (found: {loaded.get(name, 'none of this name')})"
            for name, sha256 in missing.items()
        )
        options = shlex.join(word for name in missing for word in ("--plugin", name))
        raise NotRegisteredError(
            f"'{folder}' needs the plugin {files}. No plugin is loaded by itself: read what you "
            f"name, and add {options} (in Python load_plugin)."
        )
