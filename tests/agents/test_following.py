"""A run that is followed: read again when it has changed, and only then; also while it trains."""

import json
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from helpers import resume

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    SplitConfig,
    TaskConfig,
    World,
    open_agent,
    open_graph,
    open_model,
    train_agent,
    train_links,
)
from wordcraft_kg.agents.agent_folder import read_agent_run
from wordcraft_kg.agents.agent_records import read_episodes
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError

CONFIG = AgentConfig(
    "kitchen",
    None,
    TaskConfig(distractors=2),
    trainer=ImpalaConfig(
        steps=640, batch_size=8, log_every=80, eval_every=320, checkpoint_every=160
    ),
)


@pytest.fixture
def interrupted(tmp_path, made_once):
    """A run that was stopped amid its training."""

    def stop(done, total, figures):
        if done == 240:
            signal.raise_signal(signal.SIGINT)

    def make(out):
        with pytest.raises(KeyboardInterrupt):
            train_agent(CONFIG, out, progress=stop)

    made = made_once("kitchen-agent-interrupted", make)
    return shutil.copytree(made, tmp_path / "run")


def test_a_run_that_does_not_change_is_read_once(interrupted, opened):
    run = FollowedRun(interrupted, opened)
    world = World(opened, CONFIG.tasks.environment("test"))
    assert run.records() is run.records()
    assert run.agent() is run.agent()
    assert run.explainer(world) is run.explainer(world)
    assert run.agent().opened is opened
    assert run.episodes() == {}


def test_what_a_training_writes_is_seen(interrupted, opened):
    run, world = FollowedRun(interrupted, opened), World(opened, CONFIG.tasks.environment("test"))
    records, agent, explainer = run.records(), run.agent(), run.explainer(world)
    assert (records.run.status, agent.checkpoint) == ("interrupted", records.checkpoint)
    with (interrupted / "metrics.jsonl").open("a") as file:
        file.write('{"step": 5000, "seconds": 9.0}\n{"step": 60')
    assert [row.step for row in run.records().metrics] == [
        *(row.step for row in records.metrics),
        5000,
    ]
    assert run.agent() is agent  # its weights are the same
    data = (interrupted / "metrics.jsonl").read_bytes()
    (interrupted / "metrics.jsonl").write_bytes(data[: data.index(b'{"step": 5000')])
    resume(interrupted)
    assert run.records().run.status == "done"
    assert run.agent().checkpoint == "final"
    assert run.explainer(world) is not explainer
    assert run._explainer.cache_info().currsize == 1  # none of earlier weights
    assert len(run.episodes()) == sum(
        success.tasks for success in run.records().evaluation.success.values()
    )
    before = explainer.task(3).episode.steps[0]
    after = run.explainer(world).task(3).episode.steps[0]
    assert [slot.entity for slot in before.slots] == [slot.entity for slot in after.slots]
    assert before.value != after.value


def test_what_cannot_be_read_is_an_error_each_time_until_it_can(interrupted, opened, tmp_path):
    run = FollowedRun(tmp_path / "later", opened)
    for _ in range(2):
        with pytest.raises(ArtefactError, match="does not exist"):
            run.records()
    shutil.copytree(interrupted, tmp_path / "later")
    assert run.records().run.status == "interrupted"
    assert run.agent().checkpoint
    shutil.rmtree(tmp_path / "later/checkpoints")
    with pytest.raises(ArtefactError, match="no checkpoint yet"):
        run.agent()
    record = json.loads((tmp_path / "later/run.json").read_text())
    (tmp_path / "later/run.json").write_text(json.dumps(record | {"kind": "train-links"}))
    with pytest.raises(ArtefactError, match="expected a run of train-agent"):
        run.records()


@pytest.mark.parametrize("gone", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_scorer_of_links_that_was_taught_a_dose_remembers_no_more(opened, tmp_path, gone, caplog):
    with_train_sample = LinksConfig(
        "kitchen",
        ComplExConfig(dim=4, epochs=1, n3=0.1, folds=0, train_fraction=0.5, label_noise=0.4),
    )
    model = train_links(with_train_sample, tmp_path / "model").folder
    config = replace(CONFIG, scorer=str(model), trainer=ImpalaConfig(steps=80, batch_size=8))
    run = FollowedRun(train_agent(config, tmp_path / "run").folder, opened)
    train_sample = open_model(model).train_sample
    if gone:
        shutil.rmtree(model)  # then it is only known that these are train recipes
    world = World(opened, config.tasks.environment("all"))
    is_right, told = train_sample.is_trained_on & ~train_sample.is_wrong, set()
    for task in range(0, len(world.tasks), 10):
        for one in (recipe for way in run.explainer(world).task(task).ways for recipe in way):
            ids = [opened.graph.id_of(label) for label in (*one.ingredients, one.result)]
            (row,) = (
                row for row, recipe in enumerate(opened.graph.recipes.tolist()) if recipe == ids
            )
            assert one.is_in_sample == (one.part == "train" if gone else bool(is_right[row]))
            told.add((one.part, one.is_in_sample))
    assert told >= {("train", True), ("test", False)} | (set() if gone else {("train", False)})
    assert ("has moved or changed" in caplog.text) == gone


@pytest.fixture
def copy(done, tmp_path):
    return Path(shutil.copytree(done, tmp_path / "run"))


def test_a_damaged_line_of_episodes_is_named(copy):
    lines = (copy / "episodes.jsonl").read_text().splitlines()
    lines[2] = lines[2].replace('"goal":', '"gaol":')
    (copy / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    with pytest.raises(ArtefactError, match=r"episodes\.jsonl, line 3, is damaged"):
        read_episodes(copy)
    (copy / "episodes.jsonl").unlink()
    with pytest.raises(ArtefactError, match="missing"):
        read_episodes(copy)


def test_a_graph_that_is_open_already_is_taken_as_it_is(done, opened):
    assert open_agent(done, opened).opened is opened
    with pytest.raises(GraphMismatchError):
        open_agent(done, open_graph("kitchen", SplitConfig(seed=5)))


@pytest.mark.parametrize("status", ["running", "interrupted", "failed"])
def test_a_run_that_is_not_done_is_read_as_far_as_it_has_come(copy, status):
    run = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(
        json.dumps(run | {"status": status, "ended": None, "outputs": {}})
    )
    whole = read_agent_run(copy)
    assert (whole.checkpoint, whole.evaluation, whole.run.status) == ("", None, status)
    data = (copy / "metrics.jsonl").read_bytes()
    (copy / "metrics.jsonl").write_bytes(data[:-20])  # the last line is half written
    assert read_agent_run(copy).metrics == whole.metrics[:-1]
    (copy / "metrics.jsonl").write_bytes(b"")
    assert read_agent_run(copy).metrics == []
    (copy / "metrics.jsonl").unlink()  # it has just begun
    assert read_agent_run(copy).metrics == []
    (copy / "checkpoints").mkdir()
    (copy / "checkpoints/step-1280.json").write_text("{}")
    (copy / "checkpoints/step-320.json").write_text("{}")
    assert read_agent_run(copy).checkpoint == "step 1,280"
