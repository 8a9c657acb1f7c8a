"""What a setting may be: whole numbers that are whole, sizes that a machine can hold."""

from decimal import Decimal

import numpy as np
import pytest

from wordcraft_kg import ComplExConfig, ImpalaConfig, LinkModelConfig, PolicyConfig
from wordcraft_kg.base import settings
from wordcraft_kg.base.errors import ConfigError, reason
from wordcraft_kg.base.settings import (
    MAX_DIM,
    MAX_SIZE,
    MOST,
    check_memory,
    memory,
    number_in,
    positive,
    whole,
)


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


def test_the_memory_of_a_container_and_the_addresses_in_use_are_counted(tmp_path, monkeypatch):
    resource = pytest.importorskip("resource")
    physical = settings.memory()
    for text, expected in (("4294967296\n", 2**32), ("max\n", physical), (f"{2**62}", physical)):
        limit = tmp_path / "memory.max"
        limit.write_text(text)
        monkeypatch.setattr(settings, "_CONTAINER_LIMITS", (tmp_path / "nowhere", limit))
        assert settings.memory() == min(expected, physical)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (2**40, 2**40))
    monkeypatch.setattr(settings, "_address_space", lambda: 2**40 - 2**20)
    assert settings.memory() == 2**20
