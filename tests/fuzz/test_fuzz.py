"""A few of the cases that ``python -m tests.fuzz`` runs by the thousand; ``make
slow`` runs many."""

import pytest

from .__main__ import run_case
from .home import make_home
from .values import cases


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Artefacts of every kind, of which the cases spoil copies."""
    return make_home(tmp_path_factory.mktemp("sound"))


@pytest.fixture
def homeless(monkeypatch):
    """Let no command find files of this user."""
    monkeypatch.setenv("HOME", "/nowhere")


def assert_answered(part, numbers, home):
    problems = [problem for number in numbers for problem in run_case(part, number, home)]
    assert not problems, "\n".join(
        [*problems, "Again: python -m tests.fuzz --replay <what stands first in a line>"]
    )


def test_a_damaged_book_is_answered_with_a_sentence(homeless):
    # Books need no sound artefacts, which take most of the time of the other parts.
    assert_answered("books", range(5), home=None)


@pytest.mark.slow
@pytest.mark.parametrize(("part", "count"), [("books", 2_000), ("artefacts", 1_000)])
def test_damaged_files_are_answered_with_a_sentence(homeless, sound, part, count):
    assert_answered(part, range(count), sound)


@pytest.mark.slow
def test_an_odd_value_of_an_option_is_answered_with_a_sentence(homeless, sound):
    assert_answered("values", range(0, len(cases()), 4), sound)
