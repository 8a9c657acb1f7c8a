"""A few of the cases that ``python -m tests.fuzz`` runs by the thousand; ``make
slow`` runs many."""

import pytest

from .__main__ import run_case
from .archives import problems_of_archive
from .folders import make_folders, problems_of
from .home import make_home
from .values import cases

SHORT = {"books": 3, "artefacts": 2, "values": 8}
LONG = {"books": 2_000, "artefacts": 1_000, "values": len(cases()) // 4}
COUNTS = [
    *SHORT.items(),
    *(pytest.param(part, count, marks=pytest.mark.slow) for part, count in LONG.items()),
]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Artefacts of every kind, of which the cases spoil copies."""
    return make_home(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize(("part", "count"), COUNTS)
def test_bad_input_is_answered_with_a_sentence(sound, part, count, monkeypatch):
    monkeypatch.setenv("HOME", "/nowhere")
    total = (
        len(cases()) if part == "values" else count
    )  # of the values there is an end: take some of all kinds
    problems = [
        problem for i in range(count) for problem in run_case(part, i * total // count, sound)
    ]
    assert not problems, "\n".join(
        [*problems, "Again: python -m tests.fuzz --replay <what stands first in a line>"]
    )


@pytest.mark.slow
def test_spoilt_tensors_and_records_are_refused_or_serve(tmp_path):
    problems, refused = problems_of(make_folders(tmp_path), 0, 2_000)
    assert not problems, "\n".join(problems)
    assert refused > 1_000


@pytest.mark.parametrize("count", [40, pytest.param(10_000, marks=pytest.mark.slow)])
def test_spoilt_archives_are_refused_or_read(count):
    problems = [problem for number in range(count) for problem in problems_of_archive(number)]
    assert not problems, "\n".join(problems)
