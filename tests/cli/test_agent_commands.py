"""The commands of agents as a user runs them: output, exit codes and bad input."""

import json
import shutil
from pathlib import Path

import pytest

from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.cli.progress import Progress, Stages

SMALL = ("--steps", 1_600, "--batch-size", 16, "--eval-every", 800, "--checkpoint-every", 800, "--quiet")


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A folder with a graph, a scorer of its partial graph, an unguided and a guided run."""
    from wordcraft_kg.cli import main

    home = tmp_path_factory.mktemp("world")
    train = ("train-agent", home / "graph", *SMALL, "--distractors", 2)
    commands: tuple[tuple[object, ...], ...] = (
        ("build-graph", "kitchen", "--out", home / "graph"),
        ("train-complex", home / "graph", "--dim", 8, "--epochs", 5, "--out", home / "scorer", "--quiet"),
        (*train, "--out", home / "plain-0"),
        (*train, "--seed", 1, "--out", home / "plain-1"),
        (*train, "--scorer", home / "scorer", "--out", home / "guided"),
    )
    commands += ((*train, "--max-attempts", 3, "--seed", 5, "--out", home / "many"),)
    for command in commands:
        assert main([str(argument) for argument in command]) == 0
    return home


def test_train_agent_prints_what_the_documentation_promises(printed, world, tmp_path):
    found = printed("train-agent", world / "graph", *SMALL, "--out", tmp_path / "run")
    assert {"out", "steps", "seconds", "steps_per_second", "success"} <= found.keys()
    assert found["steps"] == 1_600
    assert found["success"].keys() == {"train", "test"}
    assert all(0 <= value <= 1 for value in found["success"].values())
    assert Path(found["report"]).is_file()


def test_evaluate_agent_prints_what_the_documentation_promises(printed, world):
    found = printed("evaluate-agent", world / "guided", "--distractors", "1,3", "--draws", 2)
    assert found["part"] == "test"
    assert found["checkpoint"] == "final"
    assert found["success"].keys() == {"1", "3"}
    for figures in found["success"].values():
        assert {"mean", "ci_low", "ci_high", "tasks", "draws"} <= figures.keys()
        assert figures["ci_low"] <= figures["mean"] <= figures["ci_high"]
        assert figures["draws"] == 2
    assert all(sum(shares.values()) == pytest.approx(1) for shares in found["outcomes"].values())


def test_the_figures_of_a_training_are_those_of_its_evaluation(printed, world):
    recorded = json.loads((world / "guided/evaluation.json").read_text())
    for part in ("train", "test"):
        found = printed("evaluate-agent", world / "guided", "--part", part)
        assert found["success"]["2"] == recorded["success"][part]
        assert found["outcomes"]["2"] == recorded["outcomes"][part]


def test_the_oracle_makes_every_goal_and_chance_few(printed, world):
    oracle = printed("evaluate-agent", world / "plain-0", "--agent", "oracle")
    chance = printed("evaluate-agent", world / "plain-0", "--agent", "random")
    assert oracle["success"]["2"]["mean"] == 1.0
    assert chance["success"]["2"]["mean"] < 0.3


def test_kg_only_plays_the_run_s_scorer_and_needs_one(refused, run, world):
    assert run("evaluate-agent", world / "guided", "--agent", "kg-only").code == 0
    refused("evaluate-agent", world / "plain-0", "--agent", "kg-only", says="trained without a scorer")


def test_explain_splits_every_logit_into_what_the_sources_contributed(printed, world):
    found = printed("explain", world / "guided", "--episodes", 4)
    assert len(found["episodes"]) == 4
    steps = [step for episode in found["episodes"] for step in episode["steps"]]
    assert {step["held"] is None for step in steps} == {True, False}
    for step in steps:
        assert step["lambdas"].keys() == {"alpha", "u", "v"}
        assert sum(slot["probability"] for slot in step["slots"]) == pytest.approx(1, abs=1e-9)
        best = max(step["slots"], key=lambda slot: slot["logit"])
        assert best["entity"] == step["picked"]
        for slot in step["slots"]:
            assert sum(slot["contributions"].values()) == pytest.approx(slot["logit"], abs=1e-6)
            for name, value in slot["sources"].items():
                assert slot["contributions"][name] == pytest.approx(value * step["lambdas"][name], abs=1e-9)
            if step["held"] is None:
                assert slot["sources"]["u"] == 0


def test_explained_episodes_end_as_the_evaluation_says(printed, world):
    rows = [json.loads(line) for line in (world / "plain-0/episodes.jsonl").read_text().splitlines()]
    tests = {(row["goal"], tuple(row["start"])): row["endings"][0] for row in rows if row["part"] == "test"}
    found = printed("explain", world / "plain-0", "--episodes", 12)["episodes"]
    assert len(found) == 12
    for episode in found:
        ending = tests[episode["goal"], tuple(episode["start"])]
        assert (episode["outcome"] == "goal") == (ending == "goal")


def test_explain_plays_the_goal_it_is_asked_for(printed, run, world):
    goal = printed("explain", world / "plain-0", "--episodes", 1)["episodes"][0]["goal"]
    found = printed("explain", world / "plain-0", "--goal", goal, "--episodes", 3)["episodes"]
    assert [episode["goal"] for episode in found] == [goal] * 3
    text = run("explain", world / "guided", "--goal", goal).out
    assert f"make {goal}" in text
    assert "λv·v" in text


def test_compare_agents_counts_runs_that_differ_in_the_seed_as_one_agent(printed, refused, world, tmp_path):
    runs = (world / "plain-0", world / "plain-1", world / "guided")
    found = printed("compare", *runs, "--out", tmp_path / "report", "--draws", 2)
    assert found["agents"].keys() == {"plain", "guided"}
    assert found["agents"]["plain"]["seeds"] == [0, 1]
    assert (tmp_path / "report/index.html").is_file()
    refused("compare", *runs, "--out", tmp_path / "report", says="--force")


def test_a_report_that_was_not_written_any_more_is_written_by_the_same_command(run, world, tmp_path):
    shutil.copytree(world / "plain-0", tmp_path / "run", ignore=shutil.ignore_patterns("report"))
    done = run("train-agent", world / "graph", *SMALL, "--distractors", 2, "--out", tmp_path / "run")
    assert done.code == 0, done.err
    assert (tmp_path / "run/report/index.html").is_file()


def test_more_episodes_than_tasks_are_as_many_as_there_are(printed, world):
    found = printed("explain", world / "plain-0", "--episodes", 5_000)["episodes"]
    tasks = json.loads((world / "plain-0/evaluation.json").read_text())["success"]["test"]["tasks"]
    assert len(found) == tasks


def test_the_same_command_goes_on_with_an_agent(printed, refused, run, world, tmp_path, monkeypatch):
    step = Impala.update

    def interrupted(self):
        step(self)
        if self.update_number == 30:
            raise KeyboardInterrupt

    command = ("train-agent", world / "graph", *SMALL, "--out", tmp_path / "run")
    with monkeypatch.context() as patch:
        patch.setattr(Impala, "update", interrupted)
        stopped = run(*command)
    assert stopped.code == 130
    assert f"is saved in '{tmp_path / 'run'}'. The same command goes on" in stopped.err
    assert run("evaluate-agent", tmp_path / "run").out.startswith("run, step 800")
    refused(*command, "--unroll", 5, says="--unroll")
    assert printed(*command)["steps"] == 1_600
    refused(*command, kind="OutputExistsError")


def test_settings_come_from_a_toml_file_and_the_command_line_goes_first(printed, run, world, tmp_path):
    config = tmp_path / "settings.toml"
    config.write_text("[train-agent]\nsteps = 640\nbatch_size = 16\ndistractors = 3\n")
    found = printed("train-agent", world / "graph", "--config", config, "--distractors", 1, "--out", tmp_path / "run")
    assert (found["steps"], found["distractors"]) == (640, 1)
    config.write_text("[train-agent]\nlearning_rat = 1.0\n")
    refused = run("train-agent", world / "graph", "--config", config, "--out", tmp_path / "other")
    assert refused.code != 0
    assert "learning" in refused.err
    assert not (tmp_path / "other").exists()


def test_a_run_s_own_settings_reproduce_it(run, world, tmp_path):
    config = (world / "guided/config.toml").read_text()
    assert 'scorer = "../scorer"' in config
    done = run("train-agent", "--config", world / "guided/config.toml", "--out", tmp_path / "again", "--quiet")
    assert done.code == 0, done.err
    assert (tmp_path / "again/policy.safetensors").read_bytes() == (world / "guided/policy.safetensors").read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--distractors", 500), "expected at most"),
        (("--distractors", -1), "--distractors -1"),
        (("--unroll", 0), "--unroll 0: expected a whole number, 1 or more"),
        (("--learning-rate", "nan"), "--learning-rate nan"),
        (("--discount", 1.5), "--discount 1.5: expected 0 to 1"),
        (("--use", "u"), "give a --scorer too"),
        (("--kg-only",), "give a --scorer too"),
        (("--mixing", "softmax"), "--mixing says how to use a scorer"),
        (("--seed", 2**64), "--seed 18446744073709551616"),
        (("--learning-rate", "1e300"), "--learning-rate 1e+300"),
        (("--features", "glov"), "Did you mean 'glove'"),
        (("--device", "cuda:77"), "Use cpu"),
        (("--device", "abacus"), "expected cpu or cuda"),
        (("--scorer", "nowhere"), "does not exist"),
        (("--depth", 9), "expected a whole number, 1 to 5"),
    ],
)
def test_bad_input_is_a_clear_error_and_leaves_nothing(refused, world, tmp_path, options, message):
    refused("train-agent", world / "graph", *SMALL, *options, "--out", tmp_path / "run", says=message)
    assert not (tmp_path / "run").exists()


def test_agents_train_with_8_distractors_unless_told_otherwise(printed, world, tmp_path):
    assert (
        printed("train-agent", world / "graph", "--steps", 96, "--batch-size", 8, "--out", tmp_path / "run")[
            "distractors"
        ]
        == 8
    )
    shown = printed("tasks", "kitchen")["shown"]
    assert {len(task["distractors"]) for task in shown} == {8}


@pytest.mark.slow
def test_a_book_too_small_for_8_distractors_says_what_to_give_and_then_trains(printed, refused, run, tmp_path):
    book = tmp_path / "small.csv"
    pairs = [(a, b) for a in "abcd" for b in "abcd" if a < b]
    rows = [f"{a},{b},{'uvwx'[i % 4]}" for i, (a, b) in enumerate(pairs)]
    book.write_text("\n".join(["ingredient_a,ingredient_b,result", *rows]) + "\n")
    train = ("train-agent", book, *SMALL, "--features", "one-hot", "--out", tmp_path / "run")
    refused(*train, says="expected at most 5.")
    assert not (tmp_path / "run").exists()
    done = run(*train, "--distractors", 5)
    assert done.code == 0, done.err
    assert printed("compare", tmp_path / "run", "--draws", 1, "--episodes", 0, "--out", tmp_path / "report")["agents"][
        "run"
    ]["success"].keys() == {"1", "5"}


def test_a_scorer_of_another_graph_is_refused(refused, world, tmp_path):
    options = (*SMALL, "--scorer", world / "scorer", "--out", tmp_path / "run")
    refused("train-agent", "paper-examples", *options, kind="GraphMismatchError")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (("evaluate-agent", "{world}/nothing"), "is neither a file nor"),
        (("evaluate-agent", "{world}/scorer"), "written by train-complex; expected a run of train-agent"),
        (("evaluate-agent", "{world}/plain-0", "--draws", 0), "--draws 0"),
        (("evaluate-agent", "{world}/plain-0", "--distractors", "many"), "--distractors 'many'"),
        (("evaluate-agent", "{world}/plain-0", "--graph", "paper-examples"), "was trained on graph"),
        (("evaluate-agent", "{world}/plain-0", "--part", "valid"), "valid"),
        (("evaluate-links", "{world}/plain-0"), "written by train-agent; expected a model"),
        (("explain", "{world}/plain-0", "--goal", "spaceship"), "no entity 'spaceship'"),
        (("explain", "{world}/plain-0", "--episodes", 0), "--episodes 0"),
        (("compare", "{world}/plain-0", "{world}/many"), "plays with max_attempts"),
        (("compare",), "needs run folders"),
        (("compare", "{world}/plain-0", "{world}/plain-0"), "the same agent with the same seed"),
        (("compare", "{world}/plain-0", "{world}/scorer"), "cannot be compared"),
        (("compare", "{world}/plain-0", "--resamples", 3), "--resamples is for link predictors"),
        (("compare", "{world}/scorer", "{world}/scorer", "--draws", 3), "--draws is for agents"),
        (("compare", "{world}/scorer"), "two link predictors or more"),
        (("evaluate-agent", "{world}/plain-0", "--depth", 2), "--depth is for scripted players"),
        (("evaluate-agent", "{world}/graph", "--agent", "oracle"), "--agent is for the run of an agent"),
        (("books", "--cache", "--fetch", "little-alchemy-2"), "cannot be combined"),
        (("train-links",), "needs a graph"),
        (("train-links", "kitchen", "--trust-pickle"), "add --from-pykeen"),
        (("train-links", "kitchen", "--from-pykeen", "x", "--dim", 3), "--dim is for models that are trained"),
    ],
)
def test_bad_input_to_the_other_commands_is_a_clear_error(refused, world, command, message):
    refused(*(str(argument).replace("{world}", str(world)) for argument in command), says=message)


@pytest.mark.parametrize(
    ("command", "stage"),
    [
        (("evaluate-agent", "{world}/plain-0", "--draws", 3), "playing: 2 of 3"),
        (("explain", "{world}/plain-0", "--episodes", 2), "explaining: 1 of 2"),
        (("compare", "{world}/plain-0", "--out", "{out}"), "evaluating agents: 1 of 3"),
    ],
)
def test_judging_agents_names_its_stages(run, world, tmp_path, monkeypatch, command, stage):
    monkeypatch.setattr(Progress, "INTERVAL", 0.0)
    monkeypatch.setattr(Stages, "INTERVAL", 0.0)
    parts = (str(part).replace("{world}", str(world)).replace("{out}", str(tmp_path / "out")) for part in command)
    outcome = run(*parts)
    assert outcome.code == 0
    assert stage in outcome.err.splitlines()


@pytest.mark.parametrize("depth", [2, 3])
def test_agents_with_another_task_weighting_are_compared_only_where_it_does_not_decide_which_tasks_there_are(
    run, world, tmp_path, depth
):
    small = ("--steps", 64, "--batch-size", 8, "--eval-every", 0, "--quiet", "--depth", depth, "--distractors", 1)
    runs = [tmp_path / "task", tmp_path / "goal"]
    for folder in runs:
        options = ("--task-weighting", folder.name, "--out", folder)
        assert run("train-agent", world / "graph", *small, *options).code == 0
    options = ("--draws", 1, "--episodes", 0, "--distractors", 1, "--part", "train", "--out", tmp_path / "report")
    done = run("compare", *runs, *options)
    if depth == 2:  # all tasks are enumerated
        assert done.code == 0, done.err
    else:
        assert done.code == 1
        assert "'goal' plays with task_weighting goal and 'task' with task" in done.err
        assert not (tmp_path / "report").exists()


@pytest.mark.parametrize("name", ["policy.safetensors", "constants.safetensors", "evaluation.json"])
def test_a_damaged_file_of_a_finished_run_is_named(refused, world, tmp_path, name):
    shutil.copytree(world / "plain-0", tmp_path / "run")
    path = tmp_path / "run" / name
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(data)
    refused("evaluate-agent", tmp_path / "run", "--graph", world / "graph", says=f"{name} is damaged")


def test_an_mlp_is_judged_with_the_tables_it_was_made_for(refused, run, world, tmp_path):
    options = ("--policy", "mlp", "--distractors", 2, "--out", tmp_path / "mlp")
    assert run("train-agent", world / "graph", *SMALL, *options).code == 0
    assert run("evaluate-agent", tmp_path / "mlp").code == 0
    refused("evaluate-agent", tmp_path / "mlp", "--distractors", 5, says="this mlp was made for")
    refused("compare", tmp_path / "mlp", "--distractors", "3,5", "--out", tmp_path / "report", says="an mlp plays with")
    assert run("compare", tmp_path / "mlp", "--distractors", "2,3", "--out", tmp_path / "report").code == 0


@pytest.mark.parametrize(
    "options",
    [
        ("--features", "one-hot"),
        ("--features", "random", "--pooling", "max"),
        ("--features", "learned", "--embedding-size", 8),
        ("--features", "shuffled:glove"),
        ("--value-readout", "logits", "--policy-lag", 1, "--unroll", 3, "--momentum", 0.5),
        ("--depth", 2, "--max-attempts", 3, "--reward", "official", "--task-weighting", "goal"),
        ("--distractor-weighting", "uniform", "--distractor-policy", "no_shortcut", "--ambiguity", "last"),
        ("--scorer", "{scorer}", "--kg-only", "--use", "v", "--scale", "ranks", "--mixing", "softmax"),
        ("--scorer", "{scorer}", "--use", "u", "--scale", "log-softmax", "--self-edges", "drop"),
        ("--scorer", "{scorer}", "--scale", "none", "--self-edges", "keep"),
    ],
)
def test_every_choice_of_the_help_trains_and_is_judged(run, world, tmp_path, options):
    chosen = [str(option).replace("{scorer}", str(world / "scorer")) for option in options]
    small = ("--steps", 96, "--batch-size", 8, "--eval-every", 0, "--quiet")
    done = run("train-agent", world / "graph", *small, *chosen, "--out", tmp_path / "run")
    assert done.code == 0, done.err
    assert run("explain", tmp_path / "run", "--episodes", 1).code == 0
