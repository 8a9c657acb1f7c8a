"""The commands of agents as a user runs them: output, exit codes and bad input."""

import shutil
from pathlib import Path

import pytest
from helpers import in_file
from quick import SMALL, same, succeed

from wordcraft_kg.base.artefacts import TEMPORARY


def moment(**settings):
    """Return the options of a training that takes a moment, with further settings of the file."""
    settings_file = in_file("train-agent", batch_size=8, **settings)
    return ("--steps", 96, "--eval-every", 0, "--quiet", *settings_file)


MOMENT = moment()


@pytest.fixture
def train(world, tmp_path):
    """Train on the world's graph into a new folder, and return it."""

    def train(*options, name="run"):
        succeed(("train-agent", world / "graph", *options, "--out", tmp_path / name))
        return tmp_path / name

    return train


def test_evaluate_agent_prints_what_the_documentation_promises(printed, world):
    values = printed(
        "evaluate-agent", world / "guided", "--distractors", "1,3", "--distractor-seeds", 2
    )
    assert (values["part"], values["checkpoint"]) == ("test", "final")
    assert values["success"].keys() == {"1", "3"}
    for figures in values["success"].values():
        assert figures["ci_low"] <= figures["mean"] <= figures["ci_high"]
        assert (figures["distractor_seeds"], figures["tasks"] > 0) == (2, True)
    assert all(sum(shares.values()) == pytest.approx(1) for shares in values["outcomes"].values())
    for gains in values["sources"].values():
        assert gains.keys() == {"combines (u)", "component (v)"}
    for amount, beside in values["against_scorer"].items():
        assert values["success"][amount]["mean"] >= beside["differs"] * beside["success"]
        assert beside["differs"] * (beside["success"] - beside["scorer_success"]) == pytest.approx(
            beside["gain"]
        )


def test_train_agent_prints_what_the_documentation_promises(printed, world, tmp_path):
    values = printed("train-agent", world / "graph", *MOMENT, "--out", tmp_path / "run")
    assert {"out", "seconds", "steps_per_second"} <= values.keys()
    assert (values["steps"], values["distractors"]) == (96, 8)
    assert values["success"].keys() == {"train", "test"}
    assert all(0 <= value <= 1 for value in values["success"].values())
    assert Path(values["report"]).is_file()


def test_explain_plays_the_goal_it_is_asked_for(printed, run, world):
    goal = printed("explain", world / "plain/seed-0", "--episodes", 1)["episodes"][0]["goal"]
    episodes = printed("explain", world / "plain/seed-0", "--goal", goal, "--episodes", 3)[
        "episodes"
    ]
    assert [episode["goal"] for episode in episodes] == [goal] * 3
    text = run("explain", world / "guided", "--goal", goal).out
    assert f"make {goal}" in text
    assert "λv·v" in text
    assert text.startswith("α  What the agent's own network gives")


def test_a_missing_report_is_written_by_the_same_command(world, tmp_path):
    """A report that was not written any more is written by the same command."""
    shutil.copytree(
        world / "plain/seed-0", tmp_path / "run", ignore=shutil.ignore_patterns("report")
    )
    (tmp_path / f"run/.report.killed{TEMPORARY}").mkdir()
    succeed(("train-agent", world / "graph", *SMALL, "--distractors", 2, "--out", tmp_path / "run"))
    left, expected = (
        {path.name for path in folder.iterdir()}
        for folder in (tmp_path / "run", world / "plain/seed-0")
    )
    assert left == expected
    assert (tmp_path / "run/report/index.html").is_file()


@pytest.mark.slow
def test_a_run_s_own_settings_reproduce_it(world, tmp_path):
    config = world / "guided/config.toml"
    assert 'scorer = "../scorer"' in config.read_text()
    succeed(("train-agent", "--config", config, "--out", tmp_path / "again", "--quiet"))
    assert same("policy.safetensors", tmp_path / "again", world / "guided")


SLOW_CHOICES = [
    ("--features one-hot", {"value_readout": "logits", "policy_lag": 1, "unroll": 4}),
    ("--features random --depth 2 --max-attempts 3 --reward official", {"pooling": "max"}),
    ("--features shuffled:glove", {"pays_held_out": True}),
    ("--scorer {scorer} --kg-only --use v --mixing softmax", {"scale": "ranks"}),
    ("--scorer {scorer} --use u", {"scale": "log-softmax", "self_edges": "drop"}),
    ("--scorer {scorer}", {"scale": "none", "self_edges": "keep"}),
]
OF_OLD = {
    "distractor_weighting": "uniform",
}


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ("--features random", OF_OLD),
        *(pytest.param(*choice, marks=pytest.mark.slow) for choice in SLOW_CHOICES),
    ],
)
def test_every_choice_of_the_settings_trains_and_is_judged(run, train, world, options, settings):
    words = options.format(scorer=world / "scorer").split()
    folder = train(*moment(**settings), *words)
    assert run("explain", folder, "--episodes", 1).code == 0


def test_scripted_players_are_evaluated_as_one_json_object_and_as_a_table(printed, run):
    command = (
        "evaluate-agent",
        "kitchen",
        "--distractors",
        "2",
        "--depth",
        "2",
        "--distractor-seeds",
        "1",
        "--limit",
        "20",
    )
    result = printed(*command)
    assert (result["part"], result["depth"], result["distractor_seeds"]) == ("test", 2, 1)
    assert {row["episodes"] for row in result["rows"]} == {result["tasks"]}
    assert result["intervals"] == "95 %, bootstrap over recipes"
    assert {row["distractors"] for row in result["rows"]} == {2}
    assert all(0 <= row["low"] <= row["success"] <= row["high"] <= 1 for row in result["rows"])
    shown = run(
        "evaluate-agent",
        "kitchen",
        *["--distractors", "1,4", "--distractor-seeds", "1", "--limit", "20"],
    ).out.splitlines()
    assert sum(row.startswith("recipe oracle") and "1.000    [" in row for row in shown) == 2


# Each depth-2 task of this book has one plan, so the text below can be read off the book.
BREWERY = (
    "# base: "
    "barley,water,yeast\ningredient_a,ingredient_b,result\nbarley,water,malt\nmalt,yeast,beer\n"
)


def test_tasks_are_printed_with_their_table_and_plans(run, home):
    (home / "brewery.csv").write_text(BREWERY, encoding="utf-8")
    outcome = run(
        "describe",
        home / "brewery.csv",
        "--tasks",
        "--depth",
        2,
        "--distractors",
        0,
        "--part",
        "all",
    )
    assert (outcome.code, outcome.err) == (0, "")
    heading, shown = outcome.out.split("\n\n")
    facts = {tuple(line.split()) for line in heading.splitlines()}
    assert {("graph", "brewery"), ("tasks", "1"), ("complete", "true")} <= facts
    goal, start, distractors, table, plan = shown.splitlines()
    assert (goal, start.split(maxsplit=1)[1]) == ("beer", "barley, water, yeast")
    assert sorted(table.replace(",", "").split()[1:]) == ["barley", "water", "yeast"]
    assert distractors.split() == ["distractors", "none"]
    assert plan.endswith("  barley + water -> malt; malt + yeast -> beer")


def test_the_order_is_seeded_and_a_lower_limit_shows_the_first(printed):
    command = ("describe", "kitchen", "--tasks", "--limit")
    values = printed(*command, 8)
    assert printed(*command, 8) == values
    assert printed(*command, 5)["shown"] == values["shown"][:5]
    assert printed(*command, 8, "--seed", 1)["shown"] != values["shown"]
