"""The life cycle of run folders of both kinds: lock, replacement, failure, full disk, damaged checkpoints."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import plain_run
import pytest

from wordcraft_kg.agents.agent_folder import AGENTS
from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.training import train_agent
from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import ArtefactError, ConfigError, OutputExistsError
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.training import LinksTraining, train_links
from wordcraft_kg.runs.checkpoints import Checkpoints
from wordcraft_kg.runs.folder import RunKind, new_run, resumed_run
from wordcraft_kg.runs.record import read_run

Progress = Callable[[int, int, dict[str, float]], None]


class Links:
    """A small training of a link predictor: 6 epochs, a checkpoint after each."""

    kind: RunKind[Any] = LinksTraining.kind
    weights = "model.safetensors"
    numbers = (1, 2, 3, 4, 5, 6)

    def train(self, out: Path, *, seed: int = 0, force: bool = False, progress: Progress | None = None) -> Any:
        settings = ComplExConfig(dim=4, epochs=6, n3=0.1, folds=0, checkpoint_every=1, seed=seed)
        return train_links(LinksConfig("kitchen", settings), out, force=force, progress=progress)


class Agent:
    """A small training of an agent: 6 times 64 steps, a checkpoint after each."""

    kind: RunKind[Any] = AGENTS
    weights = "policy.safetensors"
    numbers = (64, 128, 192, 256, 320, 384)

    def train(self, out: Path, *, seed: int = 0, force: bool = False, progress: Progress | None = None) -> Any:
        every = {"log_every": 64, "eval_every": 0, "checkpoint_every": 64}
        trainer = ImpalaConfig(steps=384, batch_size=16, unroll=2, seed=seed, **every)
        config = AgentConfig("kitchen", tasks=TaskConfig(distractors=1), trainer=trainer)
        return train_agent(config, out, force=force, progress=progress)


Trainer = Links | Agent


@pytest.fixture(params=[Links(), Agent()], ids=["links", "agent"], scope="module")
def trainer(request: pytest.FixtureRequest) -> Trainer:
    return request.param


@pytest.fixture(scope="module")
def whole(trainer: Trainer, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Hash of the weights of an undisturbed run."""
    return sha256_of(trainer.train(tmp_path_factory.mktemp("whole") / "run").folder / trainer.weights)


def after(number: int, act: Callable[[], object]) -> Progress:
    """A progress callback that does something when so many epochs or steps are done."""

    def progress(done: int, total: int, figures: dict[str, float]) -> None:
        if done == number:
            act()

    return progress


def ctrl_c(times: int = 1) -> None:
    for _ in range(times):
        signal.raise_signal(signal.SIGINT)


def fail() -> None:
    raise RuntimeError("no more")


def interrupted(trainer: Trainer, out: Path, **options: Any) -> Path:
    """A run that was stopped in its middle."""
    assert trainer.train(out, progress=after(trainer.numbers[2], ctrl_c), **options).interrupted
    return out


def test_a_finished_run_has_results_instead_of_checkpoints(trainer: Trainer, tmp_path: Path) -> None:
    folder = trainer.train(tmp_path / "run").folder
    run = read_run(folder)
    assert (run.status, run.kind in trainer.kind.commands) == ("done", True)
    assert {trainer.weights, "config.toml", "README.md"} <= {path.name for path in folder.iterdir()}
    assert not (folder / "checkpoints").exists()
    assert run.inputs["config.toml"] == sha256_of(folder / "config.toml")
    assert all(sha256_of(folder / name) == value for name, value in run.outputs.items())
    with pytest.raises(ArtefactError, match="is finished"), resumed_run(folder, trainer.kind):
        pass


def test_a_run_is_on_record_in_its_own_folder_from_the_start(trainer: Trainer, tmp_path: Path) -> None:
    seen = []
    trainer.train(tmp_path / "run", progress=after(trainer.numbers[0], lambda: seen.append(read_run(tmp_path / "run"))))
    assert [run.status for run in seen] == ["running"]
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_ctrl_c_keeps_two_checkpoints_and_resume_ends_with_the_bits_of_an_undisturbed_run(
    trainer: Trainer, tmp_path: Path, whole: str
) -> None:
    folder = interrupted(trainer, tmp_path / "run")
    assert read_run(folder).status == "interrupted"
    assert len(trainer.kind.checkpoints(folder).records()) == 2
    resumed = trainer.train(folder)
    assert sha256_of(resumed.folder / trainer.weights) == whole
    assert len(read_run(folder).resumed) == 1


def test_a_second_ctrl_c_says_what_is_saved(trainer: Trainer, tmp_path: Path, whole: str) -> None:
    with pytest.raises(KeyboardInterrupt, match=rf"{trainer.kind.unit} \d+ is saved.*same command goes on"):
        trainer.train(tmp_path / "run", progress=after(trainer.numbers[3], lambda: ctrl_c(2)))
    assert read_run(tmp_path / "run").status == "interrupted"
    assert sha256_of(trainer.train(tmp_path / "run").folder / trainer.weights) == whole


def test_nobody_else_trains_in_a_folder_in_use(trainer: Trainer, tmp_path: Path, whole: str) -> None:
    tried = []

    def meddle() -> None:
        for attempt in (trainer.train, lambda folder: trainer.train(folder, force=True)):
            with pytest.raises(ArtefactError, match="being trained by another process"):
                attempt(tmp_path / "run")
            tried.append(attempt)

    trained = trainer.train(tmp_path / "run", progress=after(trainer.numbers[2], meddle))
    assert len(tried) == 2
    assert sha256_of(trained.folder / trainer.weights) == whole


def test_an_error_is_on_record_and_the_run_can_go_on(trainer: Trainer, tmp_path: Path, whole: str) -> None:
    with pytest.raises(RuntimeError, match="no more"):
        trainer.train(tmp_path / "run", progress=after(trainer.numbers[3], fail))
    assert read_run(tmp_path / "run").status == "failed"
    assert sha256_of(trainer.train(tmp_path / "run").folder / trainer.weights) == whole


def test_an_existing_run_is_replaced_on_demand_only(trainer: Trainer, tmp_path: Path, whole: str) -> None:
    trainer.train(tmp_path / "run")
    with pytest.raises(OutputExistsError):
        trainer.train(tmp_path / "run", seed=1)
    assert sha256_of(tmp_path / "run" / trainer.weights) == whole
    trainer.train(tmp_path / "run", seed=1, force=True)
    assert sha256_of(tmp_path / "run" / trainer.weights) != whole
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_unfinished_run_is_kept_from_another_seed(trainer: Trainer, tmp_path: Path) -> None:
    folder = interrupted(trainer, tmp_path / "run")
    with pytest.raises(ConfigError, match="`seed` 0, and this command has 1"):
        trainer.train(folder, seed=1)
    assert read_run(folder).status == "interrupted"


def disk_full(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Let the checkpoint of a number, and all later ones, find no space."""
    save = Checkpoints.save

    def full(self: Checkpoints[Any], at: int, *arguments: Any) -> None:
        if at >= number:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        save(self, at, *arguments)

    monkeypatch.setattr(Checkpoints, "save", full)


def test_a_replaced_run_comes_back_if_the_new_one_leaves_nothing(
    trainer: Trainer, tmp_path: Path, whole: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer.train(tmp_path / "run")
    disk_full(monkeypatch, 0)
    with pytest.raises(OSError, match="No space"):
        trainer.train(tmp_path / "run", seed=1, force=True)
    assert sha256_of(tmp_path / "run" / trainer.weights) == whole
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_full_disk_loses_nothing_that_was_safe(
    trainer: Trainer, tmp_path: Path, whole: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    last, full = trainer.numbers[2:4]
    with monkeypatch.context() as patch:
        disk_full(patch, full)
        with pytest.raises(ArtefactError, match=rf"No space left.*{trainer.kind.unit} {last} is safe.*same command"):
            trainer.train(tmp_path / "run")
    assert sha256_of(trainer.train(tmp_path / "run").folder / trainer.weights) == whole


@pytest.mark.parametrize("what", ["tensors", "record", "missing", "another kind"])
def test_a_damaged_checkpoint_falls_back_to_the_one_before_and_says_so(
    trainer: Trainer, tmp_path: Path, whole: str, caplog: pytest.LogCaptureFixture, what: str
) -> None:
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
    assert sha256_of(resumed.folder / trainer.weights) == whole


def test_a_run_without_a_whole_checkpoint_is_an_error_that_changes_nothing(trainer: Trainer, tmp_path: Path) -> None:
    folder = interrupted(trainer, tmp_path / "run")
    for path in (folder / "checkpoints").glob("*.safetensors"):
        path.write_bytes(b"nothing")
    with pytest.raises(ArtefactError, match=r"all checkpoints .* are damaged"):
        trainer.train(folder)
    assert read_run(folder).status == "interrupted"


def test_a_run_that_goes_on_with_another_torch_says_so(
    trainer: Trainer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = interrupted(trainer, tmp_path / "run")
    run = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**run, "versions": {**run["versions"], "torch": "0.1"}}))
    trainer.train(folder)
    assert "began with torch 0.1" in caplog.text


def test_settings_that_were_changed_by_hand_are_refused(trainer: Trainer, tmp_path: Path) -> None:
    folder = interrupted(trainer, tmp_path / "run")
    path = folder / "config.toml"
    path.write_text(path.read_text().replace("learning_rate = 0", "learning_rate = 1"))
    with pytest.raises(ArtefactError, match=r"config\.toml is damaged or was changed"):
        trainer.train(folder)


def test_a_run_of_one_kind_does_not_go_on_as_the_other(tmp_path: Path) -> None:
    for one, other in ((Agent(), Links()), (Links(), Agent())):
        folder = interrupted(one, tmp_path / one.kind.name)
        with pytest.raises(OutputExistsError, match="`force`"):
            other.train(folder)


# --- killed before the first checkpoint ------------------------------------------------------------------------------


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A finished run whose replacement was killed before its first checkpoint."""
    plain_run.train(tmp_path / "run", "the first")
    command = [sys.executable, plain_run.__file__, str(tmp_path / "run")]
    assert subprocess.run(command, check=False, timeout=120).returncode == -signal.SIGKILL
    assert not (tmp_path / "run" / "result").exists()
    return tmp_path / "run"


def test_what_a_killed_run_was_to_replace_comes_back_with_the_next_failure(killed: Path) -> None:
    with pytest.raises(RuntimeError, match="no more"):
        plain_run.train(killed, "", force=True)
    assert (killed / "result").read_text() == "the first"
    assert [path.name for path in killed.parent.iterdir()] == ["run"]


def test_what_a_killed_run_was_to_replace_goes_when_it_is_replaced_after_all(killed: Path) -> None:
    plain_run.train(killed, "the third", force=True)
    assert (killed / "result").read_text() == "the third"
    assert [path.name for path in killed.parent.iterdir()] == ["run"]


def test_resuming_a_killed_run_without_a_checkpoint_brings_back_what_it_was_to_replace(killed: Path) -> None:
    with pytest.raises(ArtefactError, match="no checkpoint yet"), resumed_run(killed, plain_run.PLAIN) as run:
        run.checkpoints.load()
    assert (killed / "result").read_text() == "the first"
    assert [path.name for path in killed.parent.iterdir()] == ["run"]


def test_a_first_run_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no more"):
        plain_run.train(tmp_path / "run", "")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.tex").write_text("everything")
    with pytest.raises(OutputExistsError), new_run(tmp_path / "mine", AGENTS, force=True):
        pass
    assert (tmp_path / "mine/thesis.tex").read_text() == "everything"


# --- killed at any moment --------------------------------------------------------------------------------------------

COMMAND = "import sys; from wordcraft_kg.cli import main; sys.exit(main(sys.argv[1:]))"


def start(*arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", COMMAND, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.mark.slow
def test_a_model_whose_training_was_killed_at_10_random_moments_has_the_bits_of_an_undisturbed_one(
    tmp_path: Path,
) -> None:
    options = ("--epochs", 300, "--dim", 32, "--checkpoint-every", 5)
    assert start("train-complex", "everyday", *options, "--out", tmp_path / "whole").wait() == 0
    rng, folder = np.random.default_rng(0), tmp_path / "killed"
    process = start("train-complex", "everyday", *options, "--out", folder)
    kills = 0
    while kills < 10:
        while not any((folder / "checkpoints").glob("*.json")):
            assert process.poll() is None, "the run ended before it was killed"
            time.sleep(0.01)
        time.sleep(rng.uniform(3, 6))  # importing takes most of it
        if process.poll() is not None:
            break
        process.kill()
        process.wait()
        kills += 1
        process = start("train-complex", "everyday", *options, "--out", folder)
    assert process.wait() == 0
    assert kills >= 3
    assert sha256_of(folder / "model.safetensors") == sha256_of(tmp_path / "whole" / "model.safetensors")
