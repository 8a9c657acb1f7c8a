from types import ModuleType, SimpleNamespace

import pytest

from wordcraft_kg.base import extras
from wordcraft_kg.base.extras import Registry


def installed(monkeypatch, **things):
    """Pretend that packages with entry points are installed; a function stands for what loading
    does."""
    points = [SimpleNamespace(name=name, load=load) for name, load in things.items()]
    monkeypatch.setattr(extras, "entry_points", lambda group: points)


def test_an_entry_point_names_a_thing_or_a_module_that_adds_things(monkeypatch):
    colours = Registry("colours", {"red": 1})

    def module():
        colours["blue"] = 2
        return ModuleType("theirs")

    installed(monkeypatch, green=lambda: 3, module=module)
    assert dict(colours) == {"red": 1, "green": 3, "blue": 2}


def test_own_registrations_come_before_entry_points(monkeypatch):
    """What a program registers itself comes before an entry point of the name."""
    colours = Registry("colours")
    colours["green"] = 1
    installed(monkeypatch, green=lambda: 3)
    assert dict(colours) == {"green": 1}


def test_a_package_that_cannot_be_imported_is_told_each_time(monkeypatch):
    def broken():
        raise ImportError("broken")

    colours = Registry("colours", {"red": 1})
    installed(monkeypatch, broken=broken)
    assert colours["red"] == 1
    for _ in range(2):
        with pytest.raises(ImportError, match="broken"):
            colours["blue"]
