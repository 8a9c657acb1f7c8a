"""What each source adds to an agent (the agent plays again with the source's scores set to 0), and bins."""

import json

import numpy as np
import pytest
import torch

from wordcraft_kg import (
    RecipesConfig,
    RecipeScorerConfig,
    SplitConfig,
    WordCraftConfig,
    World,
    open_book,
    open_graph,
    open_model,
    train_recipes,
)
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer, play_all
from wordcraft_kg.agents.players import BEST_PAIR, scorer_players
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.evaluation.agent_metrics import MADE, NOT_MADE, OPEN_END, binned, source_gains
from wordcraft_kg.graphs.graph_folder import write_graph_folder
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import SymbolicScorer


@pytest.fixture(scope="module")
def policy(opened_kitchen):
    """A policy with u and v of all known links."""
    graph = opened_kitchen.graph
    config = PolicyConfig(features="random", self_edges="keep", key_size=5, value_size=4)
    scorer = SymbolicScorer(graph, graph.triples)
    return make_policy(config, graph, 4, scorer=scorer)[0]


@pytest.fixture(scope="module")
def evaluator(opened_kitchen):
    world = World(opened_kitchen, WordCraftConfig("test", num_distractors=4))
    return Evaluator(world, distractor_seeds=2)


def follow(policy, **weights):
    """Set the mixing weights, equal in all states."""
    last = policy.mixture[2]
    with torch.no_grad():
        last.weight.zero_()
        for place, label in enumerate(policy.labels):
            last.bias[place] = weights.get(label.name, 0.0)


def test_a_source_with_weight_0_adds_nothing(policy, evaluator):
    follow(policy, v=1.0)
    result = evaluator(PolicyPlayer(policy))
    gains = source_gains([policy], evaluator, [result])
    assert gains.keys() == {"combines (u)", "component (v)"}
    unused = gains["combines (u)"]
    assert (unused.without, unused.gain) == (result.success.mean(), 0)
    assert unused.gain_ci == (0, 0)
    assert unused.adds_nothing
    expected = f"adds nothing: with its scores set to 0 the agent makes {unused.without:.3f}, "
    assert unused.sentence == expected + "a difference of +0.000 [+0.000, +0.000]"


def test_a_source_that_the_agent_follows_adds_its_paired_difference(policy, evaluator):
    follow(policy, u=1.0, v=1.0)
    result = evaluator(PolicyPlayer(policy))
    used = source_gains([policy], evaluator, [result])["component (v)"]
    assert used.without == evaluator(PolicyPlayer(policy, silent=["v"])).success.mean()
    assert used.gain == pytest.approx(result.success.mean() - used.without)
    assert used.gain_ci[0] > 0
    assert not used.adds_nothing
    assert used.sentence.startswith("adds to success")


def test_a_source_that_hurts_adds_nothing(policy, evaluator):
    follow(policy, u=1.0, v=-1.0)
    found = source_gains([policy], evaluator, [evaluator(PolicyPlayer(policy))])["component (v)"]
    assert found.gain < 0
    assert found.adds_nothing


def test_several_runs_count_together(policy, evaluator):
    follow(policy, v=1.0)
    results = [evaluator(PolicyPlayer(policy))] * 2
    once = source_gains([policy], evaluator, results[:1])
    assert source_gains([policy, policy], evaluator, results) == once


def test_silent_sources_score_0_and_others_as_before(policy):
    states = States(torch.tensor([0]), torch.tensor([1]), torch.tensor([[1, 2, 3, 4]]))
    scores = policy.external_scores(states)
    silenced = policy.external_scores(states, ["u"])
    assert scores[:, 0].any()
    assert not silenced[:, 0].any()
    assert torch.equal(silenced[:, 1], scores[:, 1])


def test_bins_hold_their_bounds_and_are_named_by_them():
    values = np.array([0, 1, 2, 3, 4, 9, 10, 1_000])
    found = {
        name: values[mask].tolist()
        for name, mask in binned(values, ((0, 0), (1, 3), (5, 9), (10, OPEN_END)))
    }
    assert found == {"0": [0], "1–3": [1, 2, 3], "5–9": [9], "10+": [10, 1_000]}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A graph split by goal, and a model that learned from another book, which makes every second
    test goal."""
    home = tmp_path_factory.mktemp("by-goal")
    opened = open_graph("kitchen", SplitConfig("by-goal", train_ratio=0.6, seed=1))
    write_graph_folder(home / "graph", open_book("kitchen"), opened.split)
    recipes = [
        list(map(opened.graph.entities.__getitem__, row)) for row in opened.split.recipes("test")
    ]
    goals = sorted({result for _, _, result in recipes})
    rows = [f"moonstone,{number}-stone,{goal}" for number, goal in enumerate(goals[::2])]
    # A recipe that both books share is not used, so it makes no goal.
    rows += [",".join(recipe) for recipe in recipes if recipe[2] == goals[1]]
    (home / "other.csv").write_text("\n".join(["ingredient_a,ingredient_b,result", *rows]))
    settings = RecipeScorerConfig(folds=3, features="one-hot", with_=(str(home / "other.csv"),))
    train_recipes(RecipesConfig(str(home / "graph"), settings), home / "model")
    return home


@pytest.fixture(scope="module")
def model(home):
    return open_model(home / "model")


@pytest.mark.slow
def test_a_model_folder_lists_the_goals_of_the_other_book(home, model):
    """A model folder lists the goals that the other book makes in a hashed file."""
    goals = {model.opened.graph.entities[goal] for goal in model.opened.split.recipes("test")[:, 2]}
    assert model.history.made_by_other_books == frozenset(sorted(goals)[::2])
    metrics = home / "model" / "metrics.json"
    before = metrics.read_text()
    values = json.loads(before)
    values["outside"][0]["makes"] = []
    metrics.write_text(json.dumps(values))
    with pytest.raises(ArtefactError, match=r"metrics\.json"):
        open_model(home / "model")
    metrics.write_text(before)


@pytest.mark.slow
def test_without_another_book_there_are_no_groups(home, tmp_path):
    settings = RecipeScorerConfig(folds=3, features="one-hot")
    train_recipes(RecipesConfig(str(home / "graph"), settings), tmp_path / "words")
    assert open_model(tmp_path / "words").history.made_by_other_books is None


@pytest.mark.slow
def test_evaluate_agent_shows_both_kinds_of_goals(run, home, model):
    command = ["evaluate-agent", str(home / "graph"), "--scorer", str(home / "model")]
    outcome = run(*command, "--distractors", "2", "--json")
    assert outcome.code == 0, outcome.err
    view = json.loads(outcome.out)
    world = World(model.opened, WordCraftConfig(part="test", num_distractors=2))
    goals = model.opened.graph.labels(world.tasks.goals)
    made = np.array([goal in model.history.made_by_other_books for goal in goals])
    assert view["shares"] == {MADE: made.mean(), NOT_MADE: pytest.approx(1 - made.mean())}
    by_w = {row["goals"]: row for row in view["rows"] if row["player"] == f"model, {BEST_PAIR}"}
    tables = view["distractor_seeds"]
    assert by_w[MADE]["episodes"] == tables * made.sum()
    wins = {goals: row["success"] * row["episodes"] for goals, row in by_w.items()}
    assert wins[MADE] + wins[NOT_MADE] == pytest.approx(wins[""])
    # The mask decides the rows: the player's success on these tasks alone.
    player = {BEST_PAIR: scorer_players(model.opened.graph, model.scorer, model.triples)[BEST_PAIR]}
    rows = play_all(world, player, [2], groups={MADE: made, NOT_MADE: ~made})
    assert [row.success for row in rows] == [by_w[name]["success"] for name in ("", MADE, NOT_MADE)]
    lines = run(*command, "--distractors", "2").out.splitlines()
    of_player = [line for line in lines if line.startswith(f"model, {BEST_PAIR}")]
    assert [name for line in of_player for name in (MADE, NOT_MADE) if line.endswith(name)] == [
        MADE,
        NOT_MADE,
    ]
    assert f"{MADE}: {made.mean():.0%} of the tasks" in lines
