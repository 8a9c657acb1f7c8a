"""Jobs in processes of their own: light ones, which start in a moment."""

import multiprocessing
import os
import time
from dataclasses import dataclass

import pytest

from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.runs.parallel import Ended, Workers, train_in_processes


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
    assert sorted(filter(None, noted)) == [(fold, epoch) for fold in range(3) for epoch in (1, 2)]


@pytest.mark.parametrize(
    ("how", "kind", "said"),
    [
        pytest.param("refuses", ConfigError, "`dim` 0", marks=pytest.mark.slow),
        ("raises", TrainingError, "the oven is broken"),
        pytest.param("is killed", TrainingError, "code -9", marks=pytest.mark.slow),
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


def dies_where_it_should(job, note):
    """Die at the first attempt at job 1 and at every attempt at job 2; else return the process."""
    number, folder = job
    mark = folder / f"{number}"
    was_begun = mark.exists()
    mark.touch()
    note(number)
    if number == 2 or (number == 1 and not was_begun):
        os.kill(os.getpid(), 9)
    return os.getpid()


@pytest.mark.slow
def test_a_process_is_reused_and_a_job_is_begun_again_after_a_death(tmp_path):
    begun = []
    pool = Workers(1, dies_where_it_should, attempts=2, progress=begun.append)
    ended = {}
    try:
        for number in (0, 3, 1, 2):
            pool.start((number, tmp_path))
            assert pool.num_busy == pool.number == 1
            while pool.num_busy:
                for one in pool.wait(1.0):
                    ended[number] = one
    finally:
        pool.stop()
    assert ended[0].result == ended[3].result != ended[1].result
    assert ended[2] == Ended((2, tmp_path), None, -9)
    assert begun == [0, 3, 1, 1, 2, 2]
    assert not multiprocessing.active_children()
