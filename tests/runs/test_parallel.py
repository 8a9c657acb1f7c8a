"""Jobs in processes of their own: light ones, which start in a moment."""

import os
import time
from dataclasses import dataclass

import pytest

from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.runs.checkpoints import train_in_processes


@dataclass(frozen=True)
class Light:
    """A job that comes to an end in a way of its own."""

    fold: int
    how: str = "works"

    def train(self, after):
        after(1)
        if self.how == "is killed":
            os.kill(os.getpid(), 9)
        if self.how == "takes long":
            time.sleep(60)
        if self.how != "works":
            raise (
                ConfigError("`dim` 0")
                if self.how == "refuses"
                else ValueError("the oven is broken")
            )
        after(2)


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_all_jobs_are_done_and_say_how_far_they_are(workers):
    noted = []
    train_in_processes(
        [Light(0), Light(1), Light(2)], workers, lambda *message: noted.append(message)
    )
    assert sorted(filter(None, noted)) == [(fold, 2) for fold in range(3)]


@pytest.mark.parametrize(
    ("how", "kind", "said"),
    [
        pytest.param("refuses", ConfigError, "`dim` 0", marks=pytest.mark.slow),
        ("raises", TrainingError, "the oven is broken"),
        pytest.param(
            "is killed", TrainingError, "a process that trained folds ended", marks=pytest.mark.slow
        ),
    ],
)
def test_an_error_and_the_death_of_a_process_are_told_and_end_the_others(how, kind, said):
    began = time.monotonic()
    with pytest.raises(kind, match=said):
        train_in_processes([Light(0, how), Light(1, "takes long")], 2, lambda *_: None)
    assert time.monotonic() - began < 30


def test_an_interruption_ends_the_processes_at_once():
    began = time.monotonic()
    looks = []

    def press():
        looks.append(1)
        if len(looks) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_in_processes([Light(0, "takes long"), Light(1, "takes long")], 2, press)
    assert time.monotonic() - began < 30
