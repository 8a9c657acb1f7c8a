"""Run records: what they hold, what they keep quiet about, and what is verified with them; trackers of metrics."""

import getpass
import json
import os
import socket
import sys
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from helpers import lines_of, refuses, resume

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinkModelConfig,
    LinksConfig,
    PolicyConfig,
    TaskConfig,
    train_agent,
    train_links,
)
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    FeatureSpec,
    MissingExtraError,
    TrainingError,
    read_large_file,
    sha256_of,
)
from wordcraft_kg.base.artefacts import locked
from wordcraft_kg.runs.checkpoints import Checkpoints, train_in_processes
from wordcraft_kg.runs.record import (
    RunFiles,
    check_done,
    end_run,
    read_finished_run,
    read_run,
    start_run,
)
from wordcraft_kg.runs.trackers import TRACKERS


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "run"
    path.mkdir()
    return path


def finished(folder):
    (folder / "weights").write_bytes(b"abc")
    return end_run(folder, start_run(folder, "train-complex", seed=3), "done", ("weights",))


def test_a_run_is_on_record_while_it_runs(folder):
    run = start_run(folder, "train-complex", seed=3)
    assert read_run(folder) == run
    assert (run.kind, run.status, run.seed, run.ended, run.outputs) == (
        "train-complex",
        "running",
        3,
        None,
        {},
    )


def test_a_run_that_ended_has_the_hashes_of_its_outputs(folder):
    finished(folder)
    run = read_finished_run(folder, "a model", "weights")
    assert (run.status, run.outputs) == ("done", {"weights": sha256_of(folder / "weights")})
    assert run.started <= run.ended


def test_a_run_says_with_which_versions_it_was_made(folder):
    versions = start_run(folder, "train-complex").versions
    assert versions["python"] == ".".join(str(part) for part in sys.version_info[:3])
    assert {"wordcraft-kg", "torch", "pykeen", "numpy"} <= set(versions)


def test_a_record_of_an_earlier_version_is_read(folder):
    start_run(folder, "train-agent")
    values = json.loads((folder / "run.json").read_text())
    values |= {"git": {"commit": "0" * 40, "dirty": True}, "missing_words": ["zqx"]}
    (folder / "run.json").write_text(json.dumps(values))
    assert read_run(folder).git == values["git"]


def test_the_home_folder_in_arguments_becomes_a_tilde(folder, monkeypatch):
    monkeypatch.setenv("HOME", "/homes/somebody")
    arguments = [
        "/homes/somebody/bin/wordcraft-kg",
        "build",
        "/homes/somebody/graphs",
        "--out=/homes/somebody/m",
    ]
    monkeypatch.setattr(sys, "argv", arguments)
    assert start_run(folder, "train-complex").argv == (
        "wordcraft-kg",
        "build",
        "~/graphs",
        "--out=~/m",
    )


def test_no_host_or_user_name_goes_into_a_record(folder, monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "some-host-name")
    monkeypatch.setenv("HOSTNAME", "some-host-name")
    monkeypatch.setenv("USER", "some-user-name")
    monkeypatch.setenv("LOGNAME", "some-user-name")
    assert getpass.getuser() == "some-user-name"
    start_run(folder, "train-complex")
    text = (folder / "run.json").read_text()
    assert "some-host-name" not in text
    assert "some-user-name" not in text


@pytest.mark.parametrize("status", ["interrupted", "failed"])
def test_a_run_that_is_not_done_is_refused_with_its_status(folder, status):
    end_run(folder, start_run(folder, "train-complex"), status)
    with pytest.raises(ArtefactError, match=rf"{status}, not done.*Repeat the training command"):
        read_finished_run(folder, "a model", "model.bin")


def test_a_run_is_still_running_while_its_folder_is_locked_and_else_was_stopped(folder):
    def refused(says, read):
        with pytest.raises(ArtefactError, match=says):
            read()

    def finished():
        read_finished_run(folder, "a model", "model.bin")

    def weights():
        read_large_file(folder / "model.bin")

    with locked(folder):
        refused("still running, and has written nothing.*Wait", finished)
        run = start_run(folder, "train-complex")
        refused("still running .train-complex, since .*not done. Wait", finished)
        refused("has no checkpoint", Checkpoints(folder, "epoch", dict).load)
    refused("stopped, by a kill or a crash, not done. Repeat the training", finished)
    refused("model.bin is missing; the folder is incomplete", weights)
    end_run(folder, run, "done", [])
    check_done(folder, read_run(folder))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[]",
        b"{}",
        b'{"format": "something else 1"}',
        b"3",
        b"null",
        b'{"format": "\xff"}',
    ],
)
def test_something_else_than_a_run_record_is_refused(folder, text):
    (folder / "run.json").write_bytes(text)
    with pytest.raises(ArtefactError, match=r"run\.json"):
        read_run(folder)


@pytest.mark.parametrize(
    ("name", "data"),
    [*(("weights", data) for data in (b"", b"ab", b"abd", b"abcd")), ("other", b"abc")],
)
def test_bytes_that_differ_or_that_the_record_does_not_know_are_refused(folder, name, data):
    files = RunFiles(folder, finished(folder))
    assert files.bytes("weights") == b"abc"
    (folder / name).write_bytes(data)
    with pytest.raises(ArtefactError, match=f"{name} is damaged"):
        files.bytes(name)


@pytest.mark.parametrize(
    ("written", "checked_out", "is_read"),
    [
        (b'{\n"a": 1\n}\n', b'{\r\n"a": 1\r\n}\r\n', True),
        (b"a\r\nb\n", b"a\r\nb\n", True),  # unchanged, so it is as it was written
        (b"a\nb\n", b"a\r\nB\r\n", False),
        (b"a\nb\n", b"a\r\nb\r\n\r\n", False),
        (b"a\nb\n", b"a\rb\r", False),
    ],
)
def test_a_text_with_the_line_ends_of_windows_is_read_as_it_was_written(
    folder, written, checked_out, is_read
):
    (folder / "weights").write_bytes(written)
    run = end_run(folder, start_run(folder, "train-complex", seed=3), "done", ("weights",))
    (folder / "weights").write_bytes(checked_out)
    files = RunFiles(folder, run)
    if is_read:
        assert files.bytes("weights") == written
    else:
        with pytest.raises(ArtefactError, match="weights is damaged"):
            files.bytes("weights")


@pytest.fixture
def folder_of_config_file(tmp_path, monkeypatch):
    """A run's folder, ``runs/mine`` of the working folder."""
    monkeypatch.chdir(tmp_path)
    path = Path("runs/mine")
    path.mkdir(parents=True)
    return path


def written(features, folder_of_config_file):
    AgentConfig("kitchen", policy=PolicyConfig(features=features)).write(folder_of_config_file)
    return AgentConfig.read(folder_of_config_file).policy.features


@pytest.mark.parametrize("name", ["glove", "one-hot", "random", "shuffled:glove"])
def test_a_name_of_features_stays_though_a_file_is_called_so(folder_of_config_file, name):
    Path(name.removeprefix("shuffled:")).write_text("a file of mine")
    assert written(name, folder_of_config_file) == name
    assert f'features = "{name}"\n' in (folder_of_config_file / "config.toml").read_text()


@pytest.mark.parametrize("spec", ["vectors.txt", "shuffled:vectors.txt", "./glove"])
def test_a_file_of_features_is_found_from_the_run_s_folder(folder_of_config_file, spec):
    path = spec.removeprefix("shuffled:")
    Path(path).write_text("water 1.0\n")
    assert (
        written(spec, folder_of_config_file) == spec.replace("./", "")
        or written(spec, folder_of_config_file) == spec
    )
    assert f"../../{Path(path).name}" in (folder_of_config_file / "config.toml").read_text()


@pytest.mark.parametrize(
    ("text", "source", "is_path"),
    [
        ("glove", "glove", False),
        ("shuffled:shuffled:random", "random", False),
        ("./glove", "./glove", True),
        ("shuffled:vec.txt", "vec.txt", True),
        ("shuffled:", "", True),
    ],
)
def test_a_spec_of_features_is_a_name_or_a_path(text, source, is_path):
    spec = FeatureSpec.parse(text)
    assert (spec.source, spec.is_path, str(spec)) == (source, is_path, text)


@pytest.mark.parametrize(
    "config",
    [
        LinksConfig("kitchen"),
        LinksConfig("kitchen", ComplExConfig(n3=1e-17, init_scale=0.1 + 0.2, learning_rate=1 / 3)),
        LinksConfig(
            'a graph with "quotes" and ⚗', LinkModelConfig(model="tucker", loop="symmetric")
        ),
        AgentConfig("kitchen"),
        AgentConfig(
            "kitchen",
            "models/x",
            TaskConfig(max_attempts=3),
            PolicyConfig(kg_only=True),
            ImpalaConfig(seed=7),
        ),
    ],
    ids=lambda config: type(config).__name__,
)
def test_what_is_written_is_read_back(folder_of_config_file, config):
    config.write(folder_of_config_file)
    assert type(config).read(folder_of_config_file) == config


def test_a_file_that_says_the_same_is_left_alone(folder_of_config_file):
    LinksConfig("kitchen").write(folder_of_config_file)
    before = (folder_of_config_file / "config.toml").stat().st_ino
    LinksConfig("kitchen").write(folder_of_config_file)
    assert (folder_of_config_file / "config.toml").stat().st_ino == before
    LinksConfig("everyday").write(folder_of_config_file)
    assert "everyday" in (folder_of_config_file / "config.toml").read_text()


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('seed = "7"', "seed"),
        ("steps = 1979-05-27", "steps"),
        ("threads = 1.5", "threads"),
        ("kg_only = 1", "kg_only"),
        ("discount = nan", "discount"),
        ("distractors = -1", "distractors"),
        ("graph = 3", "graph"),
        ("unheard = 1", "unheard"),
        ('kg_only = true\nmixing = "free"', "kg_only"),
    ],
)
def test_a_setting_of_another_type_or_out_of_range_is_named(folder_of_config_file, line, problem):
    graph = "" if line.startswith("graph") else 'graph = "kitchen"\n'
    (folder_of_config_file / "config.toml").write_text(f"[train-agent]\n{graph}{line}\n")
    with pytest.raises(ArtefactError, match=rf"config\.toml(: this| is damaged).*{problem}"):
        AgentConfig.read(folder_of_config_file)


@pytest.mark.parametrize(
    "policy",
    [
        PolicyConfig(use="u"),
        PolicyConfig(kg_only=True),
        PolicyConfig(scale="none"),
        PolicyConfig(self_edges="keep"),
    ],
    ids=str,
)
def test_settings_of_a_scorer_need_a_scorer(policy):
    with pytest.raises(ConfigError, match="give a `scorer` too"):
        AgentConfig("kitchen", policy=policy)
    # The recommended preset closes what is open: pairs, one attempt, and neither recipe nor plan in `use`.
    # Attention alone can do without its own scores.
    kind = "attention" if policy.kg_only else "pairs"
    closed = policy.closed(policy=kind, mixing="residual")
    assert AgentConfig("kitchen", "models/x", policy=policy).policy == closed


def test_runs_and_models_have_folders_of_their_own_names():
    assert LinksConfig("g").default_folder("everyday") == Path("models/everyday-partial")
    rotate = LinksConfig("g", LinkModelConfig(model="RotatE", kg="full"))
    assert rotate.default_folder("everyday") == Path("models/everyday-rotate-full")
    assert AgentConfig("g").default_folder("everyday") == Path("runs/everyday-no-kg")
    assert AgentConfig("g", "models/cx").default_folder("everyday") == Path("runs/everyday-cx")


def test_the_file_of_a_made_up_book_stays_found_from_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("book.csv").write_text("")
    Path("run").mkdir()
    AgentConfig("made-up-7:book.csv").write(Path("run"))
    assert AgentConfig.read(Path("run")).graph == "made-up-7:book.csv"
    Path("below").mkdir()
    monkeypatch.chdir("below")
    assert AgentConfig.read(Path("../run")).graph == "made-up-7:../book.csv"


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


def test_a_tracker_of_ones_own_gets_each_line_of_an_agents_metrics(tmp_path):
    notes = Notes()
    train_agent(AGENT, tmp_path / "run", trackers=[notes])
    expected = lines_of(tmp_path / "run/metrics.jsonl")
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
    assert resume(tmp_path / "model").metrics.epochs == 3  # the epoch is safe


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

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("wordcraft_kg.base.extras.version", missing)
    with pytest.raises(MissingExtraError, match=rf"pip install '{name}>="):
        train(LINKS if train is train_links else AGENT, tmp_path / "run", trackers=[name])
    assert not list(tmp_path.iterdir())


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
            # Longer than any load delays the end of the others.
            time.sleep(600)
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
    assert time.monotonic() - began < 300


def test_an_interruption_ends_the_processes_at_once():
    began = time.monotonic()
    looks = []

    def press():
        looks.append(1)
        if len(looks) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_in_processes([Light(0, "takes long"), Light(1, "takes long")], 2, press)
    assert time.monotonic() - began < 300
