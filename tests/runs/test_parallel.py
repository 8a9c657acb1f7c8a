"""Jobs in processes of their own: light ones, which start in a moment."""

import multiprocessing
import os
import time
from dataclasses import dataclass

import pytest

from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.runs.parallel import train_in_processes


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


@pytest.mark.parametrize("workers", [1, 2])
def test_all_jobs_are_done_and_say_how_far_they_are(workers):
    noted = []
    train_in_processes(
        [Light(0), Light(1), Light(2)], workers, lambda *message: noted.append(message)
    )
    assert sorted(filter(None, noted)) == [(fold, epoch) for fold in range(3) for epoch in (1, 2)]


@pytest.mark.parametrize(
    ("how", "kind", "said"),
    [
        ("refuses", ConfigError, "`dim` 0"),
        ("raises", TrainingError, "the oven is broken"),
        ("is killed", TrainingError, "code -9"),
    ],
)
def test_an_error_and_the_death_of_a_process_are_told_and_end_the_others(how, kind, said):
    with pytest.raises(kind, match=said):
        train_in_processes([Light(0, how), Light(1, "takes long")], 2, lambda *_: None)
    assert not multiprocessing.active_children()


def test_an_interruption_ends_the_processes_at_once():
    def press(*message):
        if message:
            assert len(multiprocessing.active_children()) == 2
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_in_processes([Light(0, "takes long"), Light(1, "takes long")], 2, press)
    assert not multiprocessing.active_children()
