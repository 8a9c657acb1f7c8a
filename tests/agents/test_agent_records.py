"""The records of a run: of one that is done, that trains at this moment, or that has not got far."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from msgspec.json import encode
from safetensors.torch import load, save

from wordcraft_kg import PolicyConfig, SplitConfig, WordCraftConfig, World, load_scorer, open_agent, open_graph
from wordcraft_kg.agents.agent_folder import read_agent_run
from wordcraft_kg.agents.records import read_episodes
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.models.policies.folder import make_policy, read_policy, write_constants


@pytest.fixture
def copy(done, tmp_path):
    return Path(shutil.copytree(done, tmp_path / "run"))


def test_a_line_of_episodes_says_how_each_draw_of_a_task_ended(done):
    found, summary = read_episodes(done), read_agent_run(done).evaluation
    for part, success in summary.success.items():
        tasks = [task for task in found if task.part == part]
        assert len(tasks) == success.tasks
        assert sum(task.success for task in tasks) / len(tasks) == pytest.approx(success.mean)
        for task in tasks:
            assert task.success == task.terminations.count("goal") / success.distractor_seeds
            assert len(task.actions) == success.distractor_seeds
    lines = (done / "episodes.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [json.loads(encode(task)) for task in found]
    assert list(json.loads(lines[0])) == ["part", "goal", "start", "success", "terminations", "actions"]


def test_a_damaged_line_of_episodes_is_named(copy):
    lines = (copy / "episodes.jsonl").read_text().splitlines()
    lines[2] = lines[2].replace('"goal":', '"gaol":')
    (copy / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    with pytest.raises(ArtefactError, match=r"episodes\.jsonl, line 3, is damaged"):
        read_episodes(copy)
    (copy / "episodes.jsonl").unlink()
    with pytest.raises(ArtefactError, match="missing"):
        read_episodes(copy)


def test_the_records_of_a_run_are_those_of_its_agent(done):
    run, agent = read_agent_run(done), open_agent(done)
    for name in ("name", "checkpoint", "config", "run", "metrics", "evaluation", "provenance"):
        assert getattr(run, name) == getattr(agent, name)
    assert run.checkpoint == "final"


def test_a_graph_that_is_open_already_is_taken_as_it_is(done, opened):
    assert open_agent(done, opened).opened is opened
    with pytest.raises(GraphMismatchError):
        open_agent(done, open_graph("kitchen", SplitConfig(seed=5)))


@pytest.mark.parametrize("status", ["running", "interrupted", "failed"])
def test_a_run_that_is_not_done_is_read_as_far_as_it_has_come(copy, status):
    run = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(run | {"status": status, "ended": None, "outputs": {}}))
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


def test_constants_of_another_type_or_shape_are_damage(recipes_folder, tmp_path):
    world = World("kitchen", WordCraftConfig(num_distractors=1))
    scorer = load_scorer(recipes_folder)
    config = PolicyConfig(use="u,v,w", self_edges="keep")
    policy, _ = make_policy(config, world.graph, 5, scorer=scorer, tasks=world.tasks)
    write_constants(tmp_path, policy)
    constants, parameters = load((tmp_path / "constants.safetensors").read_bytes()), dict(policy.named_parameters())
    read_policy(tmp_path, save(constants), parameters)
    names = [name for name in constants if name.startswith("sources.")]
    assert len(names) == 17  # u, v and w with their folds
    for name in names:
        others = [torch.ones(2, 2, dtype=torch.bool), constants[name].to(torch.int8)]
        if "fold" not in name:  # the number of recipes is that of the tasks
            others.append(constants[name][:-1].clone())
        for other in others:
            with pytest.raises(ArtefactError, match="do not make a policy"):
                read_policy(tmp_path, save(constants | {name: other}), parameters)
