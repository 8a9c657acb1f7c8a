"""Where the figures of a training also go, and what shows how far it is."""

import json
import os
import sys
import time
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
from helpers import refuses, resume

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    train_agent,
    train_links,
)
from wordcraft_kg.base.errors import ConfigError, MissingExtraError, TrainingError
from wordcraft_kg.runs.checkpoints import train_in_processes
from wordcraft_kg.runs.record import read_run
from wordcraft_kg.runs.trackers import TRACKERS

LINKS = LinksConfig("kitchen", ComplExConfig(dim=4, epochs=3, n3=0.1, checkpoint_every=1, folds=0))

AGENT = AgentConfig(
    "kitchen",
    trainer=ImpalaConfig(
        steps=1_600, batch_size=16, log_every=400, eval_every=800, checkpoint_every=400
    ),
)


class Notes:
    """Writes down all that it is told."""

    def __init__(self):
        self.rows: list[tuple[int, dict[str, float]]] = []
        self.ended: list[str] = []

    def log(self, step, values):
        assert not self.ended
        self.rows.append((step, dict(values)))

    def close(self, status):
        self.ended.append(status)


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_tracker_of_ones_own_gets_each_line_of_an_agents_metrics(tmp_path):
    notes = Notes()
    train_agent(AGENT, tmp_path / "run", trackers=[notes])
    expected = lines(tmp_path / "run/metrics.jsonl")
    assert [step for step, _ in notes.rows] == [row["step"] for row in expected]
    for (_, values), row in zip(notes.rows, expected, strict=True):
        assert values == {
            name: value for name, value in row.items() if name != "step" and value is not None
        }
    assert notes.ended == ["done"]
    assert {"success", "test_success", "train_success"} <= notes.rows[-1][1].keys()


def test_a_tracker_learns_that_a_run_has_failed(tmp_path):
    class Broken(Notes):
        def log(self, step, values):
            raise RuntimeError("no such luck")

    before, broken = Notes(), Broken()
    with pytest.raises(RuntimeError, match="no such luck"):
        train_links(LINKS, tmp_path / "model", trackers=[before, broken])
    assert (before.ended, broken.ended, len(before.rows)) == (["failed"], ["failed"], 1)
    assert read_run(tmp_path / "model").status == "failed"
    assert not resume(tmp_path / "model").interrupted  # the epoch is safe


def test_trackers_do_not_change_what_is_trained(tmp_path):
    for name, trackers in (("with", [Notes()]), ("without", [])):
        train_links(LINKS, tmp_path / name, trackers=trackers)
    one, other = (
        read_run(tmp_path / name).outputs["model.safetensors"] for name in ("with", "without")
    )
    assert one == other


def test_an_unknown_tracker_is_an_error_with_the_nearest_names(tmp_path):
    with refuses("trackers"):
        train_links(LINKS, tmp_path / "model", trackers=["tensorbord"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", TRACKERS)
@pytest.mark.parametrize("train", [train_links, train_agent])
def test_a_missing_library_names_the_extra(train, name, tmp_path, monkeypatch):
    """A missing library is an error that names the extra and leaves nothing."""
    monkeypatch.setitem(sys.modules, TRACKERS[name].library, None)
    with pytest.raises(MissingExtraError, match=rf"pip install '{name}>="):
        train(LINKS if train is train_links else AGENT, tmp_path / "run", trackers=[name])
    assert not list(tmp_path.iterdir())


def test_wandb_gets_settings_and_metrics_offline(tmp_path, monkeypatch):
    """Wandb gets settings and figures offline and nothing of the machine."""
    begun = []
    rows = []
    ended = []

    def init(**options):
        begun.append(options)
        return SimpleNamespace(
            log=lambda values, step: rows.append((step, values)),
            finish=lambda exit_code: ended.append(exit_code),
        )

    stand_in = SimpleNamespace(Settings=lambda **settings: settings, init=init)
    monkeypatch.setitem(sys.modules, "wandb", stand_in)
    notes = Notes()
    train_links(LINKS, tmp_path / "model", trackers=["wandb", notes])
    assert read_run(tmp_path / "model").trackers == ("wandb",)
    assert rows == notes.rows
    assert ended == [0]
    (options,) = begun
    assert options["config"] == LinksConfig.read(tmp_path / "model").values()
    settings = options["settings"]
    assert (settings["mode"], settings["root_dir"]) == ("offline", str(tmp_path / "model"))
    assert (settings["host"], settings["username"], settings["x_disable_meta"]) == ("", "", True)


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
