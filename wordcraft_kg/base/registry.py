"""Registries: named objects, such as model kinds, that apps and other packages can extend."""

from collections.abc import Iterator, MutableMapping
from importlib.metadata import entry_points
from types import ModuleType
from typing import TypeVar

T = TypeVar("T")


class Registry(MutableMapping[str, T]):
    """A mapping from names to objects. A module adds an object with ``registry[name] = thing``.

    Installed packages add objects by an entry-point group. An entry point names an object, or a
    module that registers objects on import. Entry points are loaded when an unknown name is looked
    up, or all names are listed: built-in names cost no imports.

    Example:
        >>> colours = Registry("example.colours", {"red": 0xFF0000})
        >>> colours["blue"] = 0x0000FF
        >>> sorted(colours)
        ['blue', 'red']
    """

    def __init__(self, group: str, own: dict[str, T] | None = None):
        """Create a registry with the built-in objects ``own``, extended by an entry-point group."""
        self._group = group
        self._known = dict(own or {})
        self._is_complete = False

    def __getitem__(self, name: str) -> T:
        # A known name needs no entry points, whose imports may take seconds.
        if name not in self._known:
            self._complete()
        return self._known[name]

    def __setitem__(self, name: str, thing: T) -> None:
        self._known[name] = thing

    def __delitem__(self, name: str) -> None:
        del self._known[name]

    def __iter__(self) -> Iterator[str]:
        self._complete()
        return iter(self._known)

    def __len__(self) -> int:
        self._complete()
        return len(self._known)

    def _complete(self) -> None:
        """Load the entry points once; an object that a program has registered takes precedence."""
        if self._is_complete:
            return
        # By name, because the order of installed packages differs between machines.
        for point in sorted(entry_points(group=self._group), key=lambda point: point.name):
            thing = point.load()
            if not isinstance(thing, ModuleType):
                self._known.setdefault(point.name, thing)
        # Not before: other threads wait for the imports, and a failure is not forgotten.
        self._is_complete = True
