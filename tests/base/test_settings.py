"""What a setting may be: whole numbers that are whole, sizes that a machine can hold."""

from contextlib import suppress
from decimal import Decimal
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from wordcraft_kg import ComplExConfig, ImpalaConfig, LinkModelConfig, PolicyConfig
from wordcraft_kg.base import (
    MAX_DIM,
    MAX_SIZE,
    ConfigError,
    check_memory,
    listening,
    number_in,
    positive,
    reason,
    registry,
    settings,
    stage,
    steps,
    whole,
)
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.base.settings import MOST, memory


@pytest.mark.parametrize(
    "value", [1.5, 1.0, "1", True, None, [1], np.float64(2), Decimal(1), 2**63, -1]
)
def test_what_is_no_whole_number_in_its_range_is_refused(value):
    with pytest.raises(
        ConfigError,
        match=r"`seed` .*: expected a whole number, 0 (or more|to 9223372036854775807)\.",
    ):
        whole("seed", value, 0)


@pytest.mark.parametrize("value", [0, MOST, np.int32(7)])
def test_whole_numbers_of_any_type_are_taken(value):
    assert whole("seed", value, 0) == value


@pytest.mark.parametrize("value", [float("nan"), -0.1, 1.1, "0.5", True, None])
def test_what_is_no_number_in_its_range_is_refused(value):
    with pytest.raises(ConfigError, match=r"`discount` .*: expected 0 to 1"):
        number_in("discount", value, 0, 1, "0 to 1")


@pytest.mark.parametrize("value", [2, 0.5, np.float32(0.5), np.int64(2)])
def test_positive_numbers_of_any_type_are_taken(value):
    assert positive("lr", value) == value


@pytest.mark.parametrize("value", [True, np.True_, 0, -1, float("nan"), 1e39, "2", Decimal(1)])
def test_what_is_no_positive_number_of_32_bits_is_refused(value):
    with pytest.raises(ConfigError, match=r"`lr` .*: expected a number above 0"):
        positive("lr", value)


LIMITS = {
    ComplExConfig: {"dim": MAX_DIM, "batch_size": MAX_SIZE, "threads": 1_024},
    LinkModelConfig: {"negatives": MAX_SIZE},
    PolicyConfig: {"key_size": MAX_DIM, "value_size": MAX_DIM},
    ImpalaConfig: {
        "unroll": MAX_SIZE,
        "batch_size": MAX_SIZE,
        "policy_lag": MAX_SIZE,
        "threads": 1_024,
    },
}


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, limits in LIMITS.items() for name in limits]
)
def test_a_size_has_a_limit(kind, name):
    largest = LIMITS[kind][name]
    assert getattr(kind(**{name: largest}), name) == largest
    with pytest.raises(
        ConfigError, match=rf"`{name}` {largest + 1}: expected a whole number, \d to {largest}\."
    ):
        kind(**{name: largest + 1})


def test_a_size_beyond_the_machines_memory_is_refused_with_its_cost():
    check_memory("dim", 4, "the vectors", memory())
    with pytest.raises(
        ConfigError, match=r"`dim` 4,000: the vectors would take [\d,.]+ GiB, and [\d,.]+ GiB"
    ):
        check_memory("dim", 4_000, "the vectors", memory() + 1)


def test_the_reason_of_an_error_is_one_line_however_many_torch_wrote():
    told = 'Error(s) in loading state_dict:\n\tMissing key(s): "a".\n\tUnexpected key(s): "b". '
    assert reason(RuntimeError(told)) == (
        'RuntimeError: Error(s) in loading state_dict: Missing key(s): "a". Unexpected key(s): "b".'
    )
    assert reason(KeyError()) == "KeyError: no reason given"
    assert len(reason(ValueError("x" * 1_000))) < 330


def test_the_memory_of_a_container_counts(tmp_path, monkeypatch):
    physical = settings.memory()
    for text, expected in (("4294967296\n", 2**32), ("max\n", physical), (f"{2**62}", physical)):
        limit = tmp_path / "memory.max"
        limit.write_text(text)
        monkeypatch.setattr(settings, "_CONTAINER_LIMITS", (tmp_path / "nowhere", limit))
        assert settings.memory() == min(expected, physical)


def installed(monkeypatch, **things):
    """Pretend that packages with entry points are installed; a function stands for what loading
    does."""
    points = [
        SimpleNamespace(name=name, load=load, attr="" if name == "module" else name)
        for name, load in things.items()
    ]
    monkeypatch.setattr(
        registry, "entry_points", lambda group: points if group == "colours" else []
    )


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
    installed(monkeypatch, module=broken)
    assert colours["red"] == 1
    for _ in range(2):
        with pytest.raises(ImportError, match="broken"):
            colours["blue"]


def test_a_listener_hears_each_step_from_none_to_all():
    heard = []
    with listening(lambda *said: heard.append(said)):
        assert list(steps("ranking", "ab")) == ["a", "b"]
    assert heard == [("ranking", 0, 2), ("ranking", 1, 2), ("ranking", 2, 2)]


def test_a_stage_that_is_given_up_ends_all_the_same():
    heard = []

    def give_up():
        for _ in steps("outer", range(9)):
            raise ValueError

    with listening(lambda *said: heard.append(said)):
        with suppress(ValueError):
            give_up()
        for _ in steps("broken off", range(9)):
            break
    assert heard == [("outer", 0, 9), ("outer", 9, 9), ("broken off", 0, 9), ("broken off", 9, 9)]


def test_a_function_can_be_a_stage_and_is_one_at_each_call():
    @stage("drawing")
    def draw(number):
        return number + 1

    heard = []
    with listening(lambda *said: heard.append(said)):
        assert [draw(1), draw(2)] == [2, 3]
    assert heard == [("drawing", 0, 1), ("drawing", 1, 1)] * 2
