"""The command as a whole: the estimate, the model folder, and players and agents that use it."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from stand_in import answers_from

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.players import knowledge_player, pair_player, play_all
from wordcraft_kg.apps.elicitation.prompts import TEMPLATE_HASH
from wordcraft_kg.apps.elicitation.records import ElicitationView
from wordcraft_kg.apps.elicitation.scorer import ElicitedScorer
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.runs.record import read_run


@pytest.fixture
def view_of(ask):
    """Run the command, and return the view that it prints."""

    def view(*options: object) -> ElicitationView:
        outcome = ask("--json", "--quiet", *options)
        assert outcome.code == 0, outcome.err
        return msgspec.json.decode(outcome.out, type=ElicitationView)

    return view


@pytest.fixture
def succeed(run):
    """Run a command that must succeed."""

    def succeed(*command: object):
        outcome = run(*command, "--quiet")
        assert outcome.code == 0, (command, outcome.err)
        return outcome

    return succeed


def test_without_yes_the_command_estimates_and_sends_nothing(view_of, ask, stand_in, opened):
    view = view_of()
    estimate = view.estimate
    goals = opened.graph.num_entities
    assert (estimate.goals, estimate.prompts, estimate.stored, estimate.to_send) == (goals, 8, 0, 8)
    assert (view.out, view.metrics) == (None, None)
    assert "nothing was sent; add --yes" in ask().out
    assert not stand_in.bodies
    assert not Path("models").exists()
    view_of("--yes")
    sent = sum(len(message["content"]) for body in stand_in.bodies for message in body["messages"])
    assert estimate.tokens_in == pytest.approx(sent / 4, rel=0.01)


def test_elicited_recipes_from_a_perfect_table_make_perfect_players(view_of, opened):
    metrics = view_of("--yes", "--out", "oracle").metrics
    assert metrics.elicited == opened.graph.num_recipes
    assert not any(metrics.unread.values())
    assert [(of.precision, of.recall, of.first_right) for of in metrics.agreement.values()] == [(1.0, 1.0, 1.0)] * 2
    assert metrics.models == ("oracle-as-answered",)
    scorer = load_scorer("oracle", graph=opened.graph)
    assert isinstance(scorer, ElicitedScorer)
    players = {"pairs": pair_player(scorer.score_recipes), "w": knowledge_player(make_sources(["w"], scorer))}
    for part in ("train", "test"):
        world = World(opened, WordCraftConfig(part=part))
        assert {row.success for row in play_all(world, players, (1, 8), distractor_seeds=2)} == {1.0}


def test_the_same_command_again_sends_nothing_and_writes_the_same(view_of, stand_in):
    view_of("--yes", "--out", "one")
    view = view_of("--out", "two")  # needs no --yes
    assert (len(stand_in.bodies), view.estimate.stored, view.estimate.to_send) == (8, 8, 0)
    for name in ("model.safetensors", "elicited.csv", "metrics.json", "vocabulary.json", "unread.txt"):
        assert Path("one", name).read_bytes() == Path("two", name).read_bytes()
    view_of("--yes", "--out", "two", "--force", "--answers", "elsewhere")
    assert (len(stand_in.bodies), len(list(Path("elsewhere").iterdir()))) == (16, 8)


@pytest.mark.parametrize(
    ("file", "option"), [("models/elicited/mine.txt", ["--force"]), ("answers", ["--answers", "answers"])]
)
def test_an_output_that_exists_is_refused_before_anything_is_sent(view_of, ask, stand_in, file, option):
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).write_text("x")
    outcome = ask("--yes", *option)
    assert (outcome.code, outcome.kind) == (1, "OutputExistsError")
    assert not stand_in.bodies
    assert view_of().estimate.to_send == 8  # an estimate writes nothing


def test_the_folder_records_prompts_elicited_recipes_and_unreadable_lines(view_of, stand_in, opened):
    answer = stand_in.answer
    unread = "Here they are\n{0}: moon + water\n{1}: {1} + water"
    stand_in.answer = lambda goals: f"{unread.format(*goals)}\n{answer(goals)}"
    counts = {"no pair": 8, "unknown item": 8, "not requested": 0, "goal as ingredient": 8, "duplicate": 0}
    assert view_of("--yes", "--out", "said").metrics.unread == counts
    lines = Path("said/unread.txt").read_text()
    assert "no pair\tHere they are\n" in lines
    assert f"unknown item\t{opened.graph.entities[0]}: moon + water\n" in lines
    table = Path("said/elicited.csv").read_text().splitlines()
    assert (table[0], len(table)) == ("ingredient_a,ingredient_b,result,weight", 1 + opened.graph.num_recipes)
    record = read_run(Path("said"))
    assert (record.inputs["prompt_template"], record.inputs["graph"]) == (TEMPLATE_HASH, opened.graph.hash)
    assert record.kind == "elicit"
    assert "without recipes or split information" in Path("said/README.md").read_text()
    model = open_model("said")
    assert (model.kg, len(model.triples)) == ("none", 0)
    assert "oracle" in model.provenance["content"]
    Path("said/elicited.csv").write_text("x")
    load_scorer("said")  # the table is for people
    Path("said/metrics.json").write_text("{}")
    with pytest.raises(ArtefactError):
        open_model("said")


def test_test_figures_leave_out_elicited_recipes_on_other_parts(view_of, stand_in, opened):
    recipes = opened.graph.recipes
    first = {int(recipe[2]): tuple(recipe.tolist()) for recipe in recipes[::-1]}
    labels = opened.graph.entities
    table = {labels[c]: [(labels[a], labels[b]), (labels[a], "no such thing")] for a, b, c in first.values()}
    stand_in.answer = answers_from(table)
    agreement = view_of("--yes").metrics.agreement
    rows = {tuple(row) for row in recipes.tolist()}
    test = {tuple(row) for row in recipes[opened.split.is_in("test")].tolist()}
    named = {*first.values()}
    assert (agreement["all"].right, agreement["all"].recipes) == (len(named), len(rows))
    assert agreement["all"].recall == pytest.approx(len(named) / len(rows))
    expected = len(named - (rows - test)), len(named & test), len(test)
    assert (agreement["test"].elicited, agreement["test"].right, agreement["test"].recipes) == expected


def test_an_agent_is_trained_on_elicited_recipes_saved_evaluated_and_explained(view_of, succeed, caplog):
    view_of("--yes")
    elicited = ("--scorer", "models/elicited")
    training = ("--use", "u,v,w", "--steps", "256", "--eval-every", "0", "--out", "agent", "--features", "random")
    outcome = succeed("train-agent", "kitchen", *elicited, *training)
    assert "in-sample" not in caplog.text + outcome.err
    agent = open_agent(Path("agent"))
    assert agent.run.kg == "none"
    assert [label.symbol for label in agent.policy.labels] == ["α", "u", "v", "w"]
    card = Path("agent/README.md").read_text()
    assert "a scorer not trained on recipes" in card
    assert "knowledge graph mixed" not in card
    assert len(agent.policy.sources["w"].keys) == 1 + len(load_scorer("models/elicited").elicited)
    succeed("evaluate-agent", "agent", "--distractor-seeds", "1")
    succeed("explain", "agent", "--goal", "bread", "--episodes", "1")
    succeed("evaluate-agent", "kitchen", *elicited, "--distractors", "1", "--distractor-seeds", "1")
    succeed("score", "models/elicited", "_", "combinesWith", "flour")
    succeed("score", "models/elicited", "flour + water")


def test_links_of_elicited_recipes_are_compared_with_baselines_of_the_train_recipes(view_of, succeed):
    view_of("--yes")
    report = json.loads(succeed("evaluate-links", "models/elicited", "--json").out)
    assert report["mrr"]["all"] == 1.0
    assert not report["has_seen_the_test_recipes"]
    assert 0 < report["baselines"]["frequency"]["all"] < 1
    page = Path("models/elicited/report/index.html").read_text()
    assert "trained on no recipe" in page
    assert "none knowledge graph" not in page
    succeed("compare", "models/elicited", "models/elicited")


def test_useless_answers_make_a_scorer_without_elicited_recipes(view_of, stand_in):
    stand_in.answer = lambda goals: "I would rather not."
    metrics = view_of("--yes", "--out", "silent").metrics
    assert (metrics.elicited, metrics.goals_answered) == (0, 0)
    assert metrics.agreement["all"].precision is None
    assert not np.asarray(load_scorer("silent").table("combinesWith")).any()
