"""The run folder of an agent: what it holds, what interrupts it, and that a resumed run ends with the same bits."""

import errno
import json
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from going_on import go_on

from wordcraft_kg.agents import training
from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.training import _warn_of_self_pairs, train_agent
from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    MissingExtraError,
    TrainingError,
)
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph, write_graph_folder
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.folder import load_policy
from wordcraft_kg.models.scorers.config import SelfEdges

SMALL = ImpalaConfig(steps=1_600, batch_size=8, unroll=2, log_every=160, eval_every=800, checkpoint_every=320)


@pytest.fixture(scope="module")
def opened() -> OpenedGraph:
    return open_graph("kitchen")


def config_of(trainer: ImpalaConfig = SMALL, **changes: Any) -> AgentConfig:
    parts = {"graph": "kitchen", "scorer": None, "tasks": TaskConfig(distractors=3), "policy": PolicyConfig()}
    return AgentConfig(**{**parts, **changes}, trainer=trainer)


def interrupt_at(monkeypatch: pytest.MonkeyPatch, update: int, error: type[BaseException] | None = None) -> None:
    """Send Ctrl-C, or raise an error, when an update is done."""
    step = Impala.update

    def wrapped(self: Impala) -> None:
        step(self)
        if self.update_number == update:
            if error is not None:
                raise error
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Impala, "update", wrapped)


def metrics_of(folder: Path) -> list[dict[str, Any]]:
    """The lines of metrics without what depends on the clock."""
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [{key: row[key] for key in row if key not in ("seconds", "steps_per_second")} for row in rows]


def test_a_run_folder_holds_what_its_description_says(opened: OpenedGraph, tmp_path: Path) -> None:
    trained = train_agent(config_of(), tmp_path / "run")
    names = {path.name for path in trained.folder.iterdir()}
    assert names == {
        "README.md",
        "config.toml",
        "constants.safetensors",
        "episodes.jsonl",
        "evaluation.json",
        "metrics.jsonl",
        "policy.json",
        "policy.safetensors",
        "run.json",
    }
    run = json.loads((trained.folder / "run.json").read_text())
    assert (run["kind"], run["status"], run["seed"]) == ("train-agent", "done", 0)
    assert run["inputs"]["graph"] == opened.graph.hash
    assert run["inputs"]["split"] == opened.split.hash
    assert all(sha256_of(trained.folder / name) == value for name, value in run["outputs"].items())
    assert trained.summary.steps == trained.step == 1_600
    rows = metrics_of(trained.folder)
    assert [row["step"] for row in rows] == [0, *range(160, 1_601, 160)]
    assert [row["step"] for row in rows if "test_success" in row] == [0, 800, 1_600]
    assert {"success", "return", "loss", "entropy", "ratio_mean", "train_success"} <= rows[-1].keys()
    assert rows[-1]["ratio_mean"] == pytest.approx(1, abs=1e-5)


def test_the_last_point_of_the_curve_is_the_final_figure(opened: OpenedGraph, tmp_path: Path) -> None:
    trained = train_agent(config_of(), tmp_path / "run")
    assert metrics_of(trained.folder)[-1]["test_success"] == trained.summary.success["test"].mean


def test_episodes_say_how_every_draw_of_every_task_ended(opened: OpenedGraph, tmp_path: Path) -> None:
    trained = train_agent(config_of(), tmp_path / "run")
    rows = [json.loads(line) for line in (trained.folder / "episodes.jsonl").read_text().splitlines()]
    for part in ("train", "test"):
        found = [row for row in rows if row["part"] == part]
        assert len(found) == trained.summary.success[part].tasks
        won = np.mean([[ending == "goal" for ending in row["endings"]] for row in found])
        assert won == pytest.approx(trained.summary.success[part].mean)


def test_the_differing_settings_are_those_that_were_changed(opened: OpenedGraph, tmp_path: Path) -> None:
    config = config_of(policy=PolicyConfig(key_size=20))
    trained = train_agent(config, tmp_path / "run")
    changed = {"graph", "distractors", "key_size", "steps", "batch_size", "log_every", "eval_every", "checkpoint_every"}
    assert config.differing().keys() == changed
    assert AgentConfig.read(trained.folder) == config


def test_a_policy_is_loaded_from_its_folder_alone(opened: OpenedGraph, tmp_path: Path) -> None:
    trained = train_agent(config_of(), tmp_path / "run")
    agent = open_agent(trained.folder)
    alone = trained.folder.rename(tmp_path / "elsewhere")
    (alone / "config.toml").unlink()  # the graph and the scorer are named there only
    policy = load_policy(alone)
    state = torch.tensor([3]), torch.tensor([80]), torch.tensor([[1, 2, 80]])
    torch.testing.assert_close(policy(*state), agent.policy(*state), rtol=0, atol=0)
    assert policy(*state).logits[0, 2] == -torch.inf


POINTS = [(20, 0), (37, 2)]
OTHERS = [(update, lag) for update in (1, 20, 37, 99) for lag in (0, 2) if (update, lag) not in POINTS]


@pytest.mark.parametrize(
    ("update", "lag"), [*POINTS, *(pytest.param(*point, marks=pytest.mark.slow) for point in OTHERS)]
)
def test_a_run_stopped_by_ctrl_c_and_resumed_ends_with_the_same_bits(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, update: int, lag: int
) -> None:
    trainer = replace(SMALL, policy_lag=lag, unroll=3, steps=2_400)
    config = config_of(trainer, tasks=TaskConfig(depth=2, distractors=2))
    whole = train_agent(config, tmp_path / "whole")
    with monkeypatch.context() as patch:
        interrupt_at(patch, update)
        part = train_agent(config, tmp_path / "part")
    assert part.interrupted
    assert part.step == update * 24
    assert json.loads((part.folder / "run.json").read_text())["status"] == "interrupted"
    resumed = go_on(part.folder)
    assert not resumed.interrupted
    assert sha256_of(resumed.folder / "policy.safetensors") == sha256_of(whole.folder / "policy.safetensors")
    assert metrics_of(resumed.folder) == metrics_of(whole.folder)
    assert len(json.loads((resumed.folder / "run.json").read_text())["resumed"]) == 1


def test_an_interrupted_run_can_be_judged_at_its_checkpoint(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(monkeypatch, 30)
    part = train_agent(config_of(), tmp_path / "run")
    agent = open_agent(part.folder)
    assert agent.checkpoint == "step 480"
    with pytest.raises(ArtefactError, match=r"interrupted, not done.*Repeat"):
        load_policy(part.folder)


def test_metrics_after_the_checkpoint_are_cut_off_when_a_run_goes_on(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train_agent(config_of(), tmp_path / "whole")
    with monkeypatch.context() as patch:
        # As if the power had gone: the checkpoint of update 40 is there, the metrics of update 50 too.
        interrupt_at(patch, 55, RuntimeError)
        with pytest.raises(RuntimeError):
            train_agent(config_of(), tmp_path / "part")
    with (tmp_path / "part" / "metrics.jsonl").open("ab") as file:
        file.write(b'{"step": 88')
    go_on(tmp_path / "part")
    assert metrics_of(tmp_path / "part") == metrics_of(whole.folder)
    assert sha256_of(tmp_path / "part/policy.safetensors") == sha256_of(whole.folder / "policy.safetensors")


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_last_good_checkpoint(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collect = Impala._collect

    def poisoned(self: Impala, weights: Any) -> bool:
        is_cut = collect(self, weights)
        if self.update_number == 45:
            self._unroll.rewards[0, 0] = float("nan")
        return is_cut

    monkeypatch.setattr(Impala, "_collect", poisoned)
    with pytest.raises(TrainingError, match=r"update 46 \(environment steps 720 to 736\).*step 640 is safe"):
        train_agent(config_of(), tmp_path / "run")
    assert json.loads((tmp_path / "run/run.json").read_text())["status"] == "failed"
    agent = open_agent(tmp_path / "run")
    assert agent.checkpoint == "step 640"
    assert all(torch.isfinite(parameter).all() for parameter in agent.policy.parameters())


def test_a_disk_that_is_full_from_the_start_leaves_no_folder(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(training, "write_constants", full)
    with pytest.raises(OSError, match="No space left"):
        train_agent(config_of(), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_on_another_graph_is_refused(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(monkeypatch, 50)
    train_agent(config_of(), tmp_path / "run")
    with pytest.raises(ConfigError, match="another graph"):
        go_on(tmp_path / "run", graph="paper-examples")


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(opened: OpenedGraph, tmp_path: Path) -> None:
    hashes = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train_agent(config_of(replace(SMALL, seed=seed)), tmp_path / name)
        hashes.append(sha256_of(tmp_path / name / "policy.safetensors"))
    assert hashes[0] == hashes[1] != hashes[2]


def test_training_leaves_global_generators_and_thread_counts_as_they_were(opened: OpenedGraph, tmp_path: Path) -> None:
    torch.manual_seed(7)
    before = torch.get_rng_state(), np.random.get_state()[1].tolist(), torch.get_num_threads()  # noqa: NPY002
    train_agent(config_of(), tmp_path / "run")
    after = torch.get_rng_state(), np.random.get_state()[1].tolist(), torch.get_num_threads()  # noqa: NPY002
    assert torch.equal(before[0], after[0])
    assert before[1:] == after[1:]


def test_a_graph_that_holds_nothing_out_is_judged_on_train_tasks_only(tmp_path: Path) -> None:
    book = open_book("kitchen")
    write_graph_folder(tmp_path / "graph", book, make_split(RecipeGraph.from_book(book), SplitConfig("none")))
    trained = train_agent(config_of(graph=str(tmp_path / "graph")), tmp_path / "run")
    assert list(trained.summary.success) == ["train"]


def test_a_missing_tensorboard_is_a_clear_error_and_leaves_no_folder(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingExtraError, match="tensorboard"):
        train_agent(config_of(), tmp_path / "run", trackers=["tensorboard"])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["config.toml", "policy.json"])
def test_settings_that_were_changed_after_the_start_are_refused(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    interrupt_at(monkeypatch, 50)
    train_agent(config_of(), tmp_path / "run")
    path = tmp_path / "run" / name
    path.write_text(path.read_text().replace("free", "softmax"))
    for use in (open_agent, lambda folder: train_agent(config_of(), folder)):
        with pytest.raises(ArtefactError, match=f"{name} is damaged or was changed"):
            use(tmp_path / "run")


def test_tensorboard_gets_the_figures_of_the_metrics_and_goes_on_with_a_resumed_run(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[tuple[str, float, int]] = []
    begun: list[int | None] = []

    class Writer:
        def __init__(self, folder: str, purge_step: int | None):
            assert folder == str(tmp_path / "run/tensorboard")
            begun.append(purge_step)

        def add_scalar(self, name: str, value: float, step: int) -> None:
            written.append((name, value, step))

        def close(self) -> None:
            begun.append(-1)

    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", SimpleNamespace(SummaryWriter=Writer))
    with monkeypatch.context() as patch:
        interrupt_at(patch, 50)
        train_agent(config_of(), tmp_path / "run", trackers=["tensorboard"])
    go_on(tmp_path / "run")
    assert begun == [None, -1, 800, -1]
    for row in metrics_of(tmp_path / "run"):
        for name, value in row.items():
            assert name == "step" or value is None or (name, value, row["step"]) in written


def test_an_unknown_option_in_a_run_s_settings_is_named(opened: OpenedGraph, tmp_path: Path) -> None:
    train_agent(config_of(), tmp_path / "run")
    path = tmp_path / "run/config.toml"
    path.write_text(path.read_text() + "learning_rat = 1.0\n")
    with pytest.raises(ArtefactError, match="unknown setting 'learning_rat'"):
        AgentConfig.read(tmp_path / "run")


def test_a_run_that_fails_early_gives_back_the_one_that_it_was_to_replace(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_agent(config_of(), tmp_path / "run")
    before = sha256_of(tmp_path / "run/policy.safetensors")
    monkeypatch.setattr(torch, "compile", lambda *_, **__: (_ for _ in ()).throw(RuntimeError("no compiler")))
    with pytest.raises(ConfigError, match="no compiler"):
        train_agent(config_of(replace(SMALL, seed=1, compile=True)), tmp_path / "run", force=True)
    assert sha256_of(tmp_path / "run/policy.safetensors") == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_metrics_that_are_shorter_than_the_checkpoint_says_are_an_error(
    opened: OpenedGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(monkeypatch, 50)
    train_agent(config_of(), tmp_path / "run")
    (tmp_path / "run/metrics.jsonl").write_bytes(b"")
    with pytest.raises(ArtefactError, match=r"metrics\.jsonl is shorter"):
        go_on(tmp_path / "run")


def test_features_without_half_of_the_words_are_refused_before_anything_is_written(
    opened: OpenedGraph, tmp_path: Path
) -> None:
    words = tmp_path / "words.txt"
    words.write_text("".join(f"{label} 1.0 2.0\n" for label in opened.graph.entities[::2] if " " not in label))
    policy = PolicyConfig(features=str(words))
    with pytest.raises(ConfigError, match=r"allow.missing"):
        train_agent(config_of(policy=policy), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    trained = train_agent(config_of(policy=replace(policy, allow_missing=True)), tmp_path / "run")
    assert opened.graph.entities[1] in json.loads((trained.folder / "run.json").read_text())["missing_words"]


@pytest.mark.parametrize(
    ("pairs", "self_edges", "warns"),
    [
        ("a,a,c\nb,b,d\na,b,e\n", "observed", True),
        ("a,a,c\nb,b,d\na,b,e\n", "keep", False),
        ("a,b,c\n", "observed", False),
    ],
)
def test_a_book_of_self_pairs_is_warned_about_where_only_observed_self_edges_are_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, pairs: str, self_edges: SelfEdges, warns: bool
) -> None:
    book = tmp_path / "book.csv"
    book.write_text("ingredient_a,ingredient_b,result\n" + pairs, encoding="utf-8")
    config = config_of(scorer="models/mine", policy=PolicyConfig(self_edges=self_edges))
    _warn_of_self_pairs(open_graph(book).graph, config)
    assert ("67 % of the pairs of book combine a thing with itself" in caplog.text) == warns
