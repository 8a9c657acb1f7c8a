"""Registries: things by name, to which apps and other packages add their own."""

from collections.abc import Iterator, MutableMapping
from importlib.metadata import entry_points
from types import ModuleType
from typing import TypeVar

T = TypeVar("T")


class Registry(MutableMapping[str, T]):
    """Things by name. A module adds one with ``registry[name] = thing``.

    Installed packages add theirs by an entry-point group: an entry point names the thing itself, or a module that adds
    things as it is imported. They are loaded when a name is looked up that is not registered yet, or all are listed.

    Example:
        >>> colours = Registry("example.colours", {"red": 0xFF0000})
        >>> colours["blue"] = 0x0000FF
        >>> sorted(colours)
        ['blue', 'red']
    """

    def __init__(self, group: str, own: dict[str, T] | None = None):
        """Take the entry-point group and the things that need no entry point."""
        self._group, self._known = group, dict(own or {})
        self._is_complete = False

    def __getitem__(self, name: str) -> T:
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
        """Load the entry points of installed packages, once; what a program has registered itself stays."""
        if not self._is_complete:
            for point in sorted(entry_points(group=self._group), key=lambda point: point.name):
                thing = point.load()
                if not isinstance(thing, ModuleType):
                    self._known.setdefault(point.name, thing)
            self._is_complete = True  # not before: other threads wait for the imports, and a failure is not forgotten
