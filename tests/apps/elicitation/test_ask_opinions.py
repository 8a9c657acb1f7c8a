"""The command as a whole: the estimate, the model folder, and players and agents that are guided by it."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from stand_in import StandIn, answers_from, table_of

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.players import knowledge_player, pair_player, play_all
from wordcraft_kg.apps.elicitation.prompts import TEMPLATE_HASH
from wordcraft_kg.apps.elicitation.scorer import OpinionScorer
from wordcraft_kg.apps.elicitation.view import OpinionsView
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.runs.record import read_run


@pytest.fixture
def asked(stand_in: StandIn, run):
    """Ask about the kitchen; return the view that the command prints."""

    def ask(*arguments: object) -> OpinionsView:
        fixed = ("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--json", "--quiet")
        outcome = run(*fixed, *arguments)
        assert outcome.code == 0, outcome.err
        return msgspec.json.decode(outcome.out, type=OpinionsView)

    return ask


def test_nothing_is_asked_without_yes_but_the_estimate_is_told(asked, stand_in, run, opened):
    view = asked("--price-in", 2, "--price-out", 10)
    found = view.estimate
    assert (found.goals, found.prompts, found.kept, found.to_ask) == (opened.graph.num_entities, 8, 0, 8)
    assert found.price == pytest.approx((2 * found.tokens_in + 10 * found.tokens_out) / 1e6)
    assert (view.out, view.metrics) == (None, None)
    text = run("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle").out
    assert "nothing was asked; add --yes to ask" in text
    assert not stand_in.asked
    assert not Path("models").exists()
    asked("--yes")
    sent = sum(len(message["content"]) for body in stand_in.asked for message in body["messages"])
    assert found.tokens_in == pytest.approx(sent / 4, rel=0.01)


def test_what_a_perfect_table_says_makes_perfect_players(asked, opened):
    view = asked("--yes", "--out", "oracle")
    metrics = view.metrics
    assert metrics.opinions == opened.graph.num_recipes
    assert not any(metrics.unread.values())
    assert [(of.precision, of.recall, of.first_right) for of in metrics.agreement.values()] == [(1.0, 1.0, 1.0)] * 2
    assert (metrics.tokens_in, metrics.tokens_out, metrics.models) == (56, 40, ("oracle-as-answered",))
    scorer = load_scorer("oracle", graph=opened.graph)
    assert isinstance(scorer, OpinionScorer)
    players = {"pairs": pair_player(scorer.score_recipes), "w": knowledge_player(make_sources(["w"], scorer))}
    for part in ("train", "test"):
        world = World(opened, WordCraftConfig(part=part))
        assert {row.success for row in play_all(world, players, (1, 8), draws=2)} == {1.0}


def test_the_same_command_again_asks_nothing_and_writes_the_same(asked, stand_in):
    asked("--yes", "--out", "one")
    assert len(stand_in.asked) == 8
    view = asked("--out", "two")  # nothing is left to ask, so no leave is needed
    assert len(stand_in.asked) == 8
    assert (view.estimate.kept, view.estimate.to_ask) == (8, 0)
    for name in ("model.safetensors", "opinions.csv", "metrics.json", "vocabulary.json", "unread.txt"):
        assert Path("one", name).read_bytes() == Path("two", name).read_bytes()
    asked("--yes", "--out", "two", "--force", "--answers", "elsewhere")
    assert len(stand_in.asked) == 16
    assert len(list(Path("elsewhere").iterdir())) == 8


def test_an_output_that_exists_is_refused_before_anything_is_asked(asked, stand_in, run):
    Path("models/opinions").mkdir(parents=True)
    Path("models/opinions/mine.txt").write_text("x")
    outcome = run("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--yes", "--force")
    assert (outcome.code, outcome.kind) == (1, "OutputExistsError")
    assert not stand_in.asked
    assert asked().estimate.to_ask == 8  # an estimate writes nothing, so that nothing is in its way


def test_the_folder_says_what_was_asked_and_what_could_not_be_read(asked, stand_in, opened):
    answer = stand_in.answer
    stand_in.answer = lambda goals: (
        f"Here they are\n{answer(goals)}\n{goals[0]}: moon + water\n{goals[1]}: {goals[1]} + water"
    )
    view = asked("--yes", "--out", "said")
    assert view.metrics.unread == {
        "no pair": 8,
        "unknown thing": 8,
        "makes itself": 8,
        "not asked for": 0,
        "named twice": 0,
    }
    lines = Path("said/unread.txt").read_text().splitlines()
    assert "no pair\tHere they are" in lines
    assert f"unknown thing\t{opened.graph.entities[0]}: moon + water" in " ".join(lines)
    table = Path("said/opinions.csv").read_text().splitlines()
    assert table[0] == "ingredient_a,ingredient_b,result,weight"
    assert len(table) == 1 + opened.graph.num_recipes
    run_record = read_run(Path("said"))
    assert run_record.inputs["prompt_template"] == TEMPLATE_HASH
    assert (run_record.kind, run_record.inputs["graph"]) == ("ask-opinions", opened.graph.hash)
    card = Path("said/README.md").read_text()
    assert "no recipe, and nothing of the split" in card
    model = open_model("said")
    assert (model.kg, len(model.triples)) == ("none", 0)
    assert "oracle" in model.provenance["what it is"]
    Path("said/opinions.csv").write_text("x")
    load_scorer("said")  # the table is for people
    Path("said/metrics.json").write_text("{}")
    with pytest.raises(ArtefactError):
        open_model("said")


def test_figures_against_the_test_part_leave_out_what_other_parts_say(asked, stand_in, opened):
    split, recipes = opened.split, opened.graph.recipes
    is_test = split.is_in("test")
    first = {int(recipe[2]): tuple(recipe.tolist()) for recipe in recipes[::-1]}
    labels = opened.graph.entities
    table = {labels[c]: [(labels[a], labels[b]), (labels[a], "no such thing")] for a, b, c in first.values()}
    stand_in.answer = answers_from(table)
    metrics = asked("--yes").metrics
    rows = {tuple(row) for row in recipes.tolist()}
    test = {tuple(row) for row in recipes[is_test].tolist()}
    said = {tuple(row) for row in first.values()}
    everything, of_test = metrics.agreement["all"], metrics.agreement["test"]
    assert (everything.right, everything.recipes) == (len(said), len(rows))
    assert everything.recall == pytest.approx(len(said) / len(rows))
    judged = said - (rows - test)
    assert (of_test.opinions, of_test.right, of_test.recipes) == (len(judged), len(judged & test), len(test))


def test_an_agent_is_trained_on_opinions_saved_judged_explained_and_compared(asked, run, caplog):
    asked("--yes")
    outcome = run(
        *("train-agent", "kitchen", "--scorer", "models/opinions", "--use", "u,v,w", "--steps", "256"),
        *("--eval-every", "0", "--out", "agent", "--features", "random", "--quiet"),
    )
    assert outcome.code == 0, outcome.err
    assert "from memory" not in caplog.text + outcome.err  # it was taught no recipe
    agent = open_agent(Path("agent"))
    assert agent.run.kg == "none"
    assert [label.symbol for label in agent.policy.labels] == ["α", "u", "v", "w"]
    card = Path("agent/README.md").read_text()
    assert "was taught no recipe" in card
    assert "knowledge graph mixed" not in card
    assert len(agent.policy.sources["w"].keys) == 1 + len(load_scorer("models/opinions").opinions)
    for command in (
        ("evaluate-agent", "agent", "--draws", "1"),
        ("explain", "agent", "--goal", "bread", "--episodes", "1"),
        ("evaluate-agent", "kitchen", "--scorer", "models/opinions", "--distractors", "1", "--draws", "1"),
        ("score", "models/opinions", "_", "combinesWith", "flour"),
        ("score", "models/opinions", "flour + water"),
    ):
        outcome = run(*command, "--quiet")
        assert outcome.code == 0, (command, outcome.err)


def test_links_of_opinions_are_judged_beside_baselines_that_have_the_train_recipes(asked, run):
    asked("--yes")
    outcome = run("evaluate-links", "models/opinions", "--json", "--quiet")
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert found["mrr"]["all"] == 1.0
    assert not found["has_seen_the_test_recipes"]
    assert 0 < found["baselines"]["frequency"]["all"] < 1
    page = Path("models/opinions/report/index.html").read_text()
    assert "taught no recipe" in page
    assert "none knowledge graph" not in page
    outcome = run("compare", "models/opinions", "models/opinions", "--quiet")
    assert outcome.code == 0, outcome.err


def test_an_endpoint_that_says_nothing_of_use_gives_a_scorer_without_opinions(asked, stand_in):
    stand_in.answer = lambda goals: "I would rather not."
    view = asked("--yes", "--out", "silent")
    assert (view.metrics.opinions, view.metrics.goals_with_opinions) == (0, 0)
    assert view.metrics.agreement["all"].precision is None
    scorer = load_scorer("silent")
    assert not np.asarray(scorer.table("combinesWith")).any()


def test_table_of_the_stand_in_is_that_of_the_graph(opened):
    table = table_of(opened.graph)
    assert sum(map(len, table.values())) == opened.graph.num_recipes


def test_a_file_in_the_place_of_answers_is_refused_before_anything_is_asked(stand_in, run):
    Path("answers").write_text("x")
    arguments = ("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--yes")
    outcome = run(*arguments, "--answers", "answers")
    assert (outcome.code, outcome.kind) == (1, "OutputExistsError")
    assert not stand_in.asked
