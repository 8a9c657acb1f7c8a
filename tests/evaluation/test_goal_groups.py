"""Figures of a scorer that learned from another book: goals that this book makes, and goals that it
does not make."""

import json

import numpy as np
import pytest

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
from wordcraft_kg.agents.evaluation import play_all
from wordcraft_kg.agents.players import BEST_PAIR, scorer_players
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.evaluation.agent_metrics import MADE, NOT_MADE
from wordcraft_kg.graphs.folder import write_graph_folder

# Trainings with a second book, which take half a minute together.
pytestmark = pytest.mark.slow


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


def test_a_model_folder_lists_the_goals_of_the_other_book(home, model):
    """A model folder lists the goals that the other book makes in a hashed file."""
    goals = {model.opened.graph.entities[goal] for goal in model.opened.split.recipes("test")[:, 2]}
    assert model.made_by_other_books == frozenset(sorted(goals)[::2])
    metrics = home / "model" / "metrics.json"
    before = metrics.read_text()
    values = json.loads(before)
    values["outside"][0]["makes"] = []
    metrics.write_text(json.dumps(values))
    with pytest.raises(ArtefactError, match=r"metrics\.json"):
        open_model(home / "model")
    metrics.write_text(before)


def test_without_another_book_there_are_no_groups(home, tmp_path):
    settings = RecipeScorerConfig(folds=3, features="one-hot")
    train_recipes(RecipesConfig(str(home / "graph"), settings), tmp_path / "words")
    assert open_model(tmp_path / "words").made_by_other_books is None


def test_evaluate_agent_shows_both_kinds_of_goals(run, home, model):
    command = ["evaluate-agent", str(home / "graph"), "--scorer", str(home / "model")]
    outcome = run(*command, "--distractors", "2", "--json")
    assert outcome.code == 0, outcome.err
    view = json.loads(outcome.out)
    world = World(model.opened, WordCraftConfig(part="test", num_distractors=2))
    goals = model.opened.graph.labels(world.tasks.goals)
    made = np.array([goal in model.made_by_other_books for goal in goals])
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
    after = lines[[line.startswith(f"model, {BEST_PAIR}") for line in lines].index(True) + 1 :]
    assert after[0].startswith(f"  {MADE} ")
    assert after[1].startswith(f"  {NOT_MADE} ")
    assert f"{MADE}: {made.mean():.0%} of the tasks" in lines
