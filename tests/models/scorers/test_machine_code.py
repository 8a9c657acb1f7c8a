"""Machine code of compiled loops on the disk: kept, and made again where it is damaged."""

import importlib.util
import logging
import sys

import numba
import numpy as np
import pytest

from wordcraft_kg.models.scorers.neighbours import compiled as compiling

SOURCE = """
from wordcraft_kg.models.scorers.neighbours.compiled import compiled

@compiled
def doubled(values):
    for place in range(len(values)):
        values[place] *= 2

@compiled
def tripled(values):
    for place in range(len(values)):
        values[place] *= 3
"""


@pytest.fixture
def call(tmp_path, monkeypatch, caplog):
    """Import a loop anew, as a new process does, call it, and return its log and cache hits."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "loops.py"
    path.write_text(SOURCE)

    def call(*, has_second=False):
        compiling._say.cache_clear()
        caplog.clear()
        spec = importlib.util.spec_from_file_location("loops", path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "loops", module)
        spec.loader.exec_module(module)
        values = np.arange(3)
        module.doubled(values)
        assert values.tolist() == [0, 2, 4]
        if has_second:
            module.tripled(values)
            assert values.tolist() == [0, 6, 12]
        warnings = [row.message for row in caplog.records if row.levelno == logging.WARNING]
        return warnings, sum(module.doubled.stats.cache_hits.values())

    assert call() == ([], 0)
    assert call() == ([], 1)
    return call


def flipped(data):
    """Change a bit in the middle, where the machine code of a data file is."""
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        ("nbi", lambda data: b""),
        ("nbc", flipped),
        *(
            pytest.param(kind, damage, marks=pytest.mark.slow)
            for kind, damage in (
                ("nbi", flipped),
                ("nbi", lambda data: data[:-1]),
                ("nbc", lambda data: b""),
                ("nbc", lambda data: data[:-1]),
            )
        ),
    ],
)
def test_a_damaged_file_is_made_again_with_one_line(call, tmp_path, kind, damage):
    (path,) = (tmp_path / "cache").rglob(f"*.{kind}")
    path.write_bytes(damage(path.read_bytes()))
    (warning,), hits = call()
    assert "damaged machine code" in warning
    assert hits == 0
    assert call() == ([], 1)


def test_a_damaged_file_that_cannot_be_replaced_costs_time_only(call, tmp_path, monkeypatch):
    (path,) = (tmp_path / "cache").rglob("*.nbi")
    path.write_bytes(b"")

    def refused(*arguments):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(compiling._Files, "_save_index", refused)
    for _ in range(2):
        (warning,), hits = call()
        assert "damaged machine code" in warning
        assert hits == 0


def test_machine_code_of_another_loop_never_runs(call, tmp_path):
    """Both files are as they were written, but one lies in the place of the other."""
    call(has_second=True)
    paths = sorted((tmp_path / "cache").rglob("*.nbc"))
    paths[0].write_bytes(paths[1].read_bytes())
    (warning,), hits = call()
    assert "damaged machine code" in warning
    assert hits == 0
