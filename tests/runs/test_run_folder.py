"""The life cycle of run folders of both kinds: lock, replacement, failure, full disk, damaged
checkpoints."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from typing import Any

import numpy as np
import plain_run
import pytest
from helpers import in_file

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    TaskConfig,
    train_agent,
    train_links,
)
from wordcraft_kg.agents.agent_folder import AGENTS
from wordcraft_kg.base import ArtefactError, OutputExistsError, sha256_of
from wordcraft_kg.models.links.link_training import LinksTraining
from wordcraft_kg.runs import run_folder as folder_module
from wordcraft_kg.runs.checkpoints import Checkpoints
from wordcraft_kg.runs.record import read_run
from wordcraft_kg.runs.run_folder import RunKind, made_folder, new_run, resumed_run


class Links:
    """A small training of a link predictor: 6 epochs, a checkpoint after each."""

    kind: RunKind[Any] = LinksTraining.kind
    weights = "model.safetensors"
    numbers = (1, 2, 3, 4, 5, 6)

    def train(self, out, *, seed=0, force=False, progress=None):
        settings = ComplExConfig(dim=4, epochs=6, n3=0.1, folds=0, checkpoint_every=1, seed=seed)
        return train_links(LinksConfig("kitchen", settings), out, force=force, progress=progress)


class Agent:
    """A small training of an agent: 6 times 64 steps, a checkpoint after each."""

    kind: RunKind[Any] = AGENTS
    weights = "policy.safetensors"
    numbers = (64, 128, 192, 256, 320, 384)

    def train(self, out, *, seed=0, force=False, progress=None):
        every = {"log_every": 64, "eval_every": 0, "checkpoint_every": 64}
        trainer = ImpalaConfig(steps=384, batch_size=16, unroll=2, seed=seed, **every)
        config = AgentConfig("kitchen", tasks=TaskConfig(distractors=1), trainer=trainer)
        return train_agent(config, out, force=force, progress=progress)


def learned(folder):
    """The hashes of a run's outputs that hold no time of the training, and the figures that are no
    speed."""
    outputs = read_run(folder).outputs
    weights = {name: value for name, value in outputs.items() if name.endswith(".safetensors")}
    lines = [
        json.loads(line)
        for path in folder.glob("*.jsonl")
        for line in path.read_text().splitlines()
    ]
    return {**weights, "": [{key: row[key] for key in row if "second" not in key} for row in lines]}


@pytest.fixture(params=[Links(), Agent()], ids=["links", "agent"], scope="module")
def trainer(request):
    return request.param


agent_slow = pytest.mark.parametrize(
    "trainer",
    [Links(), pytest.param(Agent(), marks=pytest.mark.slow)],
    ids=["links", "agent"],
    indirect=True,
    scope="module",
)
"""For properties of the run folder that both trainers reach by the same lines: agents train longer."""


@pytest.fixture(scope="module")
def whole(trainer, tmp_path_factory):
    """The results of an undisturbed run."""
    return learned(trainer.train(tmp_path_factory.mktemp("whole") / "run").folder)


def after(number, act):
    """A progress callback that does something when so many epochs or steps are done."""

    def progress(done, total, figures):
        if done == number:
            act()

    return progress


def ctrl_c(times=1):
    for _ in range(times):
        signal.raise_signal(signal.SIGINT)


def fail():
    raise RuntimeError("no more")


def interrupted(trainer, out, number=None, **options):
    """A run that was stopped in its middle, or after a number."""
    number = number or trainer.numbers[2]
    with pytest.raises(KeyboardInterrupt, match="Repeat the command"):
        trainer.train(out, progress=after(number, ctrl_c), **options)
    assert read_run(out).status == "interrupted"
    return out


@agent_slow
def test_a_finished_run_has_results_instead_of_checkpoints(trainer, tmp_path):
    folder = trainer.train(tmp_path / "run").folder
    run = read_run(folder)
    assert (run.status, run.kind in trainer.kind.commands) == ("done", True)
    assert {trainer.weights, "config.toml", "README.md"} <= {path.name for path in folder.iterdir()}
    assert not (folder / "checkpoints").exists()
    assert run.inputs["config.toml"] == sha256_of(folder / "config.toml")
    assert all(sha256_of(folder / name) == value for name, value in run.outputs.items())
    with pytest.raises(ArtefactError, match="is finished"), resumed_run(folder, trainer.kind):
        pass


def test_a_run_is_on_record_in_its_own_folder_from_the_start(trainer, tmp_path):
    seen = []
    trainer.train(
        tmp_path / "run",
        progress=after(trainer.numbers[0], lambda: seen.append(read_run(tmp_path / "run"))),
    )
    assert [run.status for run in seen] == ["running"]
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@agent_slow
def test_a_second_ctrl_c_acts_at_once_and_says_what_is_saved(trainer, tmp_path, whole):
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(
        KeyboardInterrupt, match=rf"{trainer.kind.unit} \d+ is saved.*Repeat the command"
    ):
        trainer.train(tmp_path / "run", progress=after(trainer.numbers[3], lambda: ctrl_c(2)))
    assert signal.getsignal(signal.SIGINT) is handler
    assert read_run(tmp_path / "run").status == "interrupted"
    assert learned(trainer.train(tmp_path / "run").folder) == whole


def test_a_run_interrupted_twice_ends_with_the_same_bits(trainer, tmp_path, whole):
    """A run interrupted more than once keeps two checkpoints and ends with the bits of an undisturbed one."""
    for number in trainer.numbers[:4:2]:
        interrupted(trainer, tmp_path / "run", number)
    assert len(trainer.kind.checkpoints(tmp_path / "run").records()) == 2
    assert learned(trainer.train(tmp_path / "run").folder) == whole
    assert len(read_run(tmp_path / "run").resumed) == 2


@agent_slow
def test_nobody_else_trains_in_a_folder_in_use(trainer, tmp_path, whole):
    tried = []

    def meddle():
        for attempt in (trainer.train, lambda folder: trainer.train(folder, force=True)):
            with pytest.raises(ArtefactError, match="being trained by another process"):
                attempt(tmp_path / "run")
            tried.append(attempt)

    trained = trainer.train(tmp_path / "run", progress=after(trainer.numbers[2], meddle))
    assert len(tried) == 2
    assert learned(trained.folder) == whole


@agent_slow
def test_an_error_is_on_record_and_the_run_can_go_on(trainer, tmp_path, whole):
    with pytest.raises(RuntimeError, match="no more"):
        trainer.train(tmp_path / "run", progress=after(trainer.numbers[3], fail))
    assert read_run(tmp_path / "run").status == "failed"
    assert learned(trainer.train(tmp_path / "run").folder) == whole


def disk_full(monkeypatch, number):
    """Let the checkpoint of a number, and all later ones, find no space."""
    save = Checkpoints.save

    def full(self, at, *arguments):
        if at >= number:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        save(self, at, *arguments)

    monkeypatch.setattr(Checkpoints, "save", full)


def test_a_full_disk_loses_nothing_that_was_safe(trainer, tmp_path, whole, monkeypatch):
    last, full = trainer.numbers[2:4]
    with monkeypatch.context() as patch:
        disk_full(patch, full)
        with pytest.raises(
            ArtefactError,
            match=rf"No space left.*{trainer.kind.unit} {last} is safe.*repeat the command",
        ):
            trainer.train(tmp_path / "run")
    assert learned(trainer.train(tmp_path / "run").folder) == whole


@agent_slow
@pytest.mark.parametrize(
    "what",
    [
        "tensors",
        "another kind",
        *(pytest.param(what, marks=pytest.mark.slow) for what in ("record", "missing")),
    ],
)
def test_a_damaged_checkpoint_falls_back_to_the_one_before_and_says_so(
    trainer, tmp_path, whole, caplog, what
):
    folder = interrupted(trainer, tmp_path / "run")
    last, before = trainer.kind.checkpoints(folder).records().values()
    tensors = last.with_suffix(".safetensors")
    if what == "tensors":
        data = bytearray(tensors.read_bytes())
        data[-5] ^= 1
        tensors.write_bytes(data)
    elif what == "missing":
        tensors.unlink()
    else:
        last.write_text("{" if what == "record" else '{"sha256": "0", "progress": 5}')
    resumed = trainer.train(folder)
    assert before.stem in caplog.text
    assert learned(resumed.folder) == whole


def test_a_run_without_a_whole_checkpoint_is_an_error_that_changes_nothing(trainer, tmp_path):
    folder = interrupted(trainer, tmp_path / "run")
    for path in (folder / "checkpoints").glob("*.safetensors"):
        path.write_bytes(b"nothing")
    with pytest.raises(ArtefactError, match=r"all checkpoints .* are damaged"):
        trainer.train(folder)
    assert read_run(folder).status == "interrupted"


@agent_slow
def test_a_run_that_goes_on_with_another_torch_says_so(trainer, tmp_path, caplog):
    folder = interrupted(trainer, tmp_path / "run")
    run = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(
        json.dumps({**run, "versions": {**run["versions"], "torch": "0.1"}})
    )
    trainer.train(folder)
    assert "began with torch 0.1" in caplog.text


def test_settings_that_were_changed_by_hand_are_refused(trainer, tmp_path):
    folder = interrupted(trainer, tmp_path / "run")
    path = folder / "config.toml"
    path.write_text(path.read_text().replace("learning_rate = 0", "learning_rate = 1"))
    with pytest.raises(ArtefactError, match=r"config\.toml is damaged or was changed"):
        trainer.train(folder)


def test_a_run_of_one_kind_does_not_go_on_as_the_other(tmp_path):
    for one, other in ((Agent(), Links()), (Links(), Agent())):
        folder = interrupted(one, tmp_path / one.kind.name)
        with pytest.raises(OutputExistsError, match="`force`"):
            other.train(folder)


# --- killed before the first checkpoint -----------------------------------------------------------


def kill(moment, folder):
    """Begin a run in a process that is killed at a moment."""
    command = [sys.executable, plain_run.__file__, moment, str(folder)]
    assert subprocess.run(command, check=False, timeout=120).returncode == -signal.SIGKILL
    return folder


@pytest.fixture
def killed(tmp_path):
    """A finished run whose replacement was killed before its first checkpoint."""
    plain_run.train(tmp_path / "run", "the first")
    kill("before the first checkpoint", tmp_path / "run")
    assert not (tmp_path / "run" / "result").exists()
    return tmp_path / "run"


def resume_killed(folder):
    with resumed_run(folder, plain_run.PLAIN) as run:
        run.checkpoints.load()


@pytest.mark.parametrize(
    ("act", "error", "result"),
    [
        pytest.param(
            lambda folder: plain_run.train(folder, "", force=True),
            "no more",
            "the first",
            marks=pytest.mark.slow,
        ),
        (lambda folder: plain_run.train(folder, "the third", force=True), None, "the third"),
        pytest.param(resume_killed, "no checkpoint yet", "the first", marks=pytest.mark.slow),
    ],
    ids=["the next one fails", "the next one ends", "resumed without a checkpoint"],
)
def test_what_a_killed_run_was_to_replace_comes_back(killed, act, error, result):
    """What a killed run was to replace comes back unless it is replaced after all."""
    with pytest.raises((RuntimeError, ArtefactError), match=error) if error else nullcontext():
        act(killed)
    assert (killed / "result").read_text() == result
    assert [path.name for path in killed.parent.iterdir()] == ["run"]


BEGINNINGS = [
    pytest.param("before the first file", marks=pytest.mark.slow),
    "while the first file is written",
]


@agent_slow
@pytest.mark.parametrize("moment", BEGINNINGS)
def test_a_trainer_starts_again_before_the_first_record(trainer, tmp_path, whole, moment):
    """A trainer starts again where it was killed before the first record."""
    folder = kill(moment, tmp_path / "run")
    assert not (folder / "run.json").exists()
    assert learned(trainer.train(folder).folder) == whole
    assert [path.name for path in tmp_path.glob("**/.*")] == []


def test_a_run_that_begins_is_left_alone_by_others(tmp_path):
    with new_run(tmp_path / "run", AGENTS):
        for force in (False, True):
            with pytest.raises(ArtefactError, match="by another process"):
                plain_run.train(tmp_path / "run", "mine", force=force)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [".search.json.a1b2c3d4.wordcraft-kg", ".mine.json"])
def test_only_temporary_files_of_a_killed_process_make_way_for_a_new_run(tmp_path, name):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).touch()
    with nullcontext() if name.endswith("wordcraft-kg") else pytest.raises(OutputExistsError):
        plain_run.train(tmp_path / "run", "mine")
        assert not (tmp_path / "run" / name).exists()


def test_a_first_run_that_fails_leaves_nothing_not_even_the_folders_above(tmp_path):
    with pytest.raises(RuntimeError, match="no more"):
        plain_run.train(tmp_path / "runs" / "mine" / "run", "")
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_another_process_has_finished_meanwhile_stays(tmp_path, monkeypatch):
    def made(folder):
        """Let another process train before the check under the lock."""
        monkeypatch.undo()
        plain_run.train(tmp_path / "run", "the first")
        return made_folder(folder)

    monkeypatch.setattr(folder_module, "made_folder", made)
    with pytest.raises(OutputExistsError, match="exists"):
        plain_run.train(tmp_path / "run", "the second")
    assert (tmp_path / "run/result").read_text() == "the first"


# --- killed at any moment -------------------------------------------------------------------------


COMMAND = "import sys; from wordcraft_kg.cli import main; sys.exit(main(sys.argv[1:]))"
LONG = {
    "train-complex": ("--epochs", 60, "--folds", 2, *in_file("train-complex", checkpoint_every=5)),
    "train-agent": ("--steps", 100_000, *in_file("train-agent", checkpoint_every=5_000)),
}


def start(*arguments):
    command = [sys.executable, "-c", COMMAND, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


@pytest.mark.slow
@pytest.mark.parametrize("command", LONG)
def test_a_run_killed_at_random_ends_with_the_same_bits(tmp_path, command):
    """A process may also be killed when its work is done."""
    rng, whole, folder = np.random.default_rng(0), tmp_path / "whole", tmp_path / "killed"
    began = time.monotonic()
    assert start(command, "kitchen", *LONG[command], "--out", whole).wait() == 0
    duration = time.monotonic() - began
    for _ in range(4):
        process = start(command, "kitchen", *LONG[command], "--out", folder)
        with suppress(subprocess.TimeoutExpired):
            process.wait(duration * rng.uniform(0.4, 0.9))
        process.kill()
        process.wait()
    last = start(command, "kitchen", *LONG[command], "--out", folder)
    _, said = last.communicate()
    assert last.returncode == 0 or f"'{folder}' exists" in said.decode()
    assert learned(folder) == learned(whole)
    assert {path.name for path in folder.iterdir()} == {path.name for path in whole.iterdir()}


def test_a_training_through_a_link_fills_its_target_at_the_end(tmp_path):
    """A training through a link fills the folder at its end and the link stays."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    plain_run.train(tmp_path / "out", "first")
    plain_run.train(tmp_path / "out", "second", force=True)
    with pytest.raises(RuntimeError, match="no more"):
        plain_run.train(tmp_path / "out", "", force=True)
    assert (tmp_path / "disk" / "result").read_text() == "second"
    assert os.readlink(tmp_path / "out") == "disk"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "out"]


def test_a_training_into_a_dead_link_is_refused(tmp_path):
    """A training into a link that leads nowhere is refused before it begins."""
    (tmp_path / "out").symlink_to("missing")
    with pytest.raises(OutputExistsError, match=r"out' is a link to '.*missing', which does not"):
        plain_run.train(tmp_path / "out", "x")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
