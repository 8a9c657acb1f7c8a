"""Several seeds of one training as a user runs them: folders, going on, and comparing."""

import json
import shutil
from pathlib import Path

import pytest

from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import read_seeds

SMALL = ("--steps", 1_600, "--batch-size", 16, "--eval-every", 0, "--checkpoint-every", 800, "--quiet")
TINY = ("--dim", 8, "--epochs", 4, "--folds", 0, "--quiet")


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """A folder with a graph, two seeds of a link predictor, and two seeds of an agent; read only."""
    from wordcraft_kg.cli import main

    home = tmp_path_factory.mktemp("seeds")
    for command in (
        ("build-graph", "kitchen", "--out", home / "graph"),
        ("train-complex", home / "graph", *TINY, "--seeds", "0,3", "--out", home / "links"),
        ("train-agent", home / "graph", *SMALL, "--seeds", "0-1", "--out", home / "plain"),
    ):
        assert main([str(argument) for argument in command]) == 0
    return home


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("text", "expected"),
    [("0-4", [0, 1, 2, 3, 4]), ("7", [7]), ("0,3,7", [0, 3, 7]), ("2-3, 0-2", [2, 3, 0, 1]), ("5-5,5", [5])],
)
def test_seeds_are_numbers_and_ranges_each_once(text, expected):
    assert read_seeds(text) == expected


@pytest.mark.parametrize("text", ["", "a", "4-0", "-1", "1-", "0,,1", "1.5", "0-1000", "0-999,2000", "9" * 30])
def test_what_is_no_list_of_seeds_is_refused(text):
    with pytest.raises(ConfigError, match=r"--seeds '.*': expected at most 1,000 seeds, such as"):
        read_seeds(text)


def test_each_seed_is_an_ordinary_run(run, seeds, tmp_path):
    assert sorted(path.name for path in (seeds / "plain").iterdir()) == ["seed-0", "seed-1"]
    run("train-agent", seeds / "graph", *SMALL, "--seed", 1, "--out", tmp_path / "single")
    weights = [(folder / "policy.safetensors").read_bytes() for folder in (seeds / "plain/seed-1", tmp_path / "single")]
    assert weights[0] == weights[1]
    assert (seeds / "plain/seed-1/report/index.html").is_file()
    assert run("evaluate-agent", seeds / "plain/seed-1", "--draws", 1).code == 0
    run("train-complex", seeds / "graph", *TINY, "--seed", 3, "--out", tmp_path / "model")
    weights = [(folder / "model.safetensors").read_bytes() for folder in (seeds / "links/seed-3", tmp_path / "model")]
    assert weights[0] == weights[1]


@pytest.mark.parametrize(
    ("command", "small", "name"), [("train-agent", SMALL, "plain"), ("train-complex", TINY, "links")]
)
def test_seeds_that_are_done_are_kept_and_others_are_added(printed, seeds, tmp_path, command, small, name):
    shutil.copytree(seeds / name, tmp_path / "seeds")
    before = contents(tmp_path / "seeds")
    values = printed(command, seeds / "graph", *small, "--seeds", "0,4", "--out", tmp_path / "seeds")
    assert values["out"] == str(tmp_path / "seeds")
    assert values["seeds"].keys() == {"0", "4"}
    assert all(Path(one["out"]).is_dir() for one in values["seeds"].values())
    after = contents(tmp_path / "seeds")
    assert {path: after[path] for path in before} == before
    assert (tmp_path / "seeds/seed-4/run.json").is_file()


def test_ctrl_c_leaves_the_rest_to_the_same_command(run, seeds, tmp_path, monkeypatch):
    step, updates = Impala.update, 0

    def interrupted(self):
        nonlocal updates
        updates += 1
        step(self)
        if updates == 80:  # in the second seed, which has its first checkpoint by then
            raise KeyboardInterrupt

    command = ("train-agent", seeds / "graph", *SMALL, "--seeds", "0-2", "--out", tmp_path / "plain")
    with monkeypatch.context() as patch:
        patch.setattr(Impala, "update", interrupted)
        stopped = run(*command)
    assert (stopped.code, stopped.out) == (130, "")
    assert stopped.err == "interrupted; 1 of 3 seeds are done, the same command goes on with the others\n"
    assert json.loads((tmp_path / "plain/seed-1/run.json").read_text())["status"] == "interrupted"
    assert not (tmp_path / "plain/seed-2").exists()
    assert run(*command).code == 0
    assert len(json.loads((tmp_path / "plain/seed-1/run.json").read_text())["resumed"]) == 1
    for seed in (0, 1):
        weights = [
            (folder / f"seed-{seed}/policy.safetensors").read_bytes()
            for folder in (tmp_path / "plain", seeds / "plain")
        ]
        assert weights[0] == weights[1]
    assert (tmp_path / "plain/seed-2/report/index.html").is_file()


def test_a_seed_that_was_killed_at_once_begins_again_and_a_missing_report_is_written(run, seeds, tmp_path):
    shutil.copytree(seeds / "plain", tmp_path / "plain")
    shutil.rmtree(tmp_path / "plain/seed-0/report")
    killed = tmp_path / "plain/seed-1"
    record = json.loads((killed / "run.json").read_text())
    (killed / "run.json").write_text(json.dumps(record | {"status": "running", "ended": None, "outputs": {}}))
    done = run("train-agent", seeds / "graph", *SMALL, "--seeds", "0-1", "--out", tmp_path / "plain")
    assert done.code == 0, done.err
    assert (killed / "policy.safetensors").read_bytes() == (seeds / "plain/seed-1/policy.safetensors").read_bytes()
    assert (tmp_path / "plain/seed-0/report/index.html").is_file()


def test_a_seed_with_other_settings_or_data_is_not_taken_for_the_same(refused, run, seeds, tmp_path):
    def train(*options, graph=seeds / "graph"):
        return "train-agent", graph, *SMALL, *options, "--seeds", "0-1", "--out", seeds / "plain"

    before = contents(seeds / "plain")
    run("build-graph", "kitchen", "--seed", 1, "--out", tmp_path / "other")
    links = ("train-complex", seeds / "graph", *TINY, "--seeds", "0")
    for command, says in (
        (train("--entropy-cost", "0.1"), "was trained with --entropy-cost 0.01, and this command has 0.1"),
        (train("--max-attempts", 2), "--max-attempts None, and this command has 2"),
        (train("--scorer", seeds / "links/seed-0"), "another scorer"),
        (train(graph=tmp_path / "other"), "another split"),
        (train(graph="everyday"), "another graph"),
        ((*links, "--n3", "0.2", "--out", seeds / "links"), ["was trained with --n3 ", "this command has 0.2"]),
    ):
        refused(*command, says=says, kind="ConfigError")
    refused(*links, "--out", seeds / "plain", says="exists", kind="OutputExistsError")
    assert contents(seeds / "plain") == before
    assert run(*train(graph="kitchen")).code == 0  # the same graph and split by another name


def test_force_trains_all_seeds_again(run, seeds, tmp_path):
    shutil.copytree(seeds / "links", tmp_path / "links")
    command = ("train-complex", seeds / "graph", *TINY, "--n3", "0.2", "--seeds", "0,3", "--out", tmp_path / "links")
    assert run(*command, "--force").code == 0
    for seed in (0, 3):
        folders = (tmp_path / "links", seeds / "links")
        weights = [(folder / f"seed-{seed}/model.safetensors").read_bytes() for folder in folders]
        assert weights[0] != weights[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--seeds", "4-0"), "--seeds '4-0'"),
        (("--seeds", "0-1", "--seed", 3), "--seed 3 and --seeds 0-1: give one of them"),
        (("--seeds", "0,4294967296"), "--seed 4294967296"),
    ],
)
def test_wrong_seeds_are_refused_before_anything_is_trained(refused, tmp_path, options, message):
    refused("train-complex", "kitchen", *TINY, *options, "--out", tmp_path / "links", says=message, kind="ConfigError")
    assert list(tmp_path.iterdir()) == []


def test_a_single_run_is_not_taken_for_a_folder_of_seeds(refused, seeds):
    command = ("train-agent", seeds / "graph", *SMALL, "--seeds", "0-1", "--out", seeds / "plain/seed-0")
    refused(*command, says="is a single run", kind="OutputExistsError")


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("evaluate-agent", "{}"), "plain"),
        (("explain", "{}"), "plain"),
        (("evaluate-links", "{}"), "links"),
        (("score", "{}", "flour", "combinesWith"), "links"),
        (("train-agent", "kitchen", "--out", "{}/never", "--scorer", "{}"), "links"),
    ],
)
def test_where_one_run_is_needed_a_folder_of_seeds_is_refused_with_one_of_them(refused, seeds, command, name):
    message = refused(*(part.format(seeds / name) for part in command), kind="ArtefactError")
    assert f"holds a run for each of 2 seeds; give one, such as {seeds / name / 'seed-0'}." in message
    assert not (seeds / name / "never").exists()


def test_compare_agents_takes_a_folder_of_seeds_for_one_agent(refused, run, seeds, tmp_path):
    options = ("--draws", 1, "--episodes", 0, "--json")
    together = run("compare", seeds / "plain", *options, "--out", tmp_path / "together")
    assert together.code == 0, together.err
    agents = json.loads(together.out)["agents"]
    assert agents.keys() == {"plain"}
    assert agents["plain"]["runs"] == ["plain-seed-0", "plain-seed-1"]
    assert agents["plain"]["seeds"] == [0, 1]
    single = run("compare", seeds / "plain/seed-1", *options, "--out", tmp_path / "single")
    assert json.loads(single.out)["agents"].keys() == {"plain-seed-1"}
    refused("compare", seeds / "graph", "--out", tmp_path / "nothing", says="is a graph folder", kind="ArtefactError")
