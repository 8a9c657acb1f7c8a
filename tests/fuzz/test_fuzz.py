"""A few of the cases that ``python -m tests.fuzz`` runs by the thousand; ``make slow`` runs many."""

from pathlib import Path

import pytest

from .__main__ import run_case
from .home import make_home
from .values import cases

SHORT = {"books": 25, "artefacts": 15, "values": 40}
LONG = {"books": 2_000, "artefacts": 1_000, "values": len(cases()) // 4}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Artefacts of every kind, of which the cases spoil copies."""
    return make_home(tmp_path_factory.mktemp("sound"))


def _numbers(part: str, count: int) -> list[int]:
    """Cases that are spread evenly; of the values there is an end."""
    total = len(cases()) if part == "values" else count
    return [number * total // count for number in range(count)]


@pytest.mark.parametrize("part", SHORT)
def test_bad_input_is_answered_with_a_sentence(sound: Path, part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _try(_numbers(part, SHORT[part]), part, sound, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("part", LONG)
def test_much_bad_input_is_answered_with_sentences(sound: Path, part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _try(_numbers(part, LONG[part]), part, sound, monkeypatch)


def _try(numbers: list[int], part: str, sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/nowhere")
    found = [problem for number in numbers for problem in run_case(part, number, sound)]
    assert not found, "\n".join([*found, "Again: python -m tests.fuzz --replay <what stands first in a line>"])


def test_every_option_that_takes_a_number_gets_at_least_20_values() -> None:
    given: dict[tuple[str, str], int] = {}
    for option, _, _ in cases():
        given[option.command, option.name] = given.get((option.command, option.name), 0) + option.is_number
    assert min(count for count in given.values() if count) >= 20
    assert sum(count > 0 for count in given.values()) > 60
