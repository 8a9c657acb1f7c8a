"""Models of recipes as sets: words spelt with letters on cards, each card with a carrier x or y."""

import itertools
import json
import math
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize
import torch
from link_helpers import interrupt_after

from wordcraft_kg import load_scorer, open_model
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphError
from wordcraft_kg.evaluation import ranked_sets
from wordcraft_kg.evaluation.ranked_sets import rank_sets, read_predictions
from wordcraft_kg.evaluation.suggestions import Wish, suggest
from wordcraft_kg.graphs import (
    RecipeGraph,
    SplitConfig,
    make_split,
    open_book,
    write_graph_folder,
)
from wordcraft_kg.models.recipes import set_fitting
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_training import train_recipes
from wordcraft_kg.models.recipes.set_training import rows_of_sets, with_new_entities
from wordcraft_kg.models.scorers.sets import knowledge as set_knowledge, loops
from wordcraft_kg.models.scorers.sets.knowledge import SetKnowledge
from wordcraft_kg.models.scorers.sets.parts import parse_formula, read_parts
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

ROOT = Path(__file__).parents[3]


@pytest.fixture
def scorer(letters_model):
    return letters_model.scorer


def labels_of(scorer, ids):
    return {scorer.entities[entity] for entity in ids}


def test_recipes_lose_the_carriers_and_no_letter(letters_model, scorer):
    assert letters_model.metrics.lost == {"x": 1.0, "y": 1.0}
    assert letters_model.metrics.shared == {}
    assert scorer.knowledge.is_key.sum() == len("abcdefgh")


def test_most_unseen_goals_get_their_set_first_with_a_high_probability(letters_model, scorer):
    graph = letters_model.opened.graph
    rows = graph.sets[letters_model.opened.split.is_in("test")]
    first = [scorer.recipes(int(row[-1]), 1)[0] for row in rows]
    is_right = [
        set(best.ingredients) == set(row[:-1].tolist()) - {graph.num_entities}
        for best, row in zip(first, rows, strict=True)
    ]
    assert np.mean(is_right) > 0.7
    assert np.mean([best.probability for best in first]) > 0.5


def test_suggestions_bring_each_letter_and_no_other_unless_any_part_is_allowed(scorer):
    suggestions = scorer.recipes("Gbdh", 10)
    assert len(suggestions) > 3
    for suggestion in suggestions:
        letters = {label[0] for label in labels_of(scorer, suggestion.ingredients)}
        assert letters == {"b", "d", "h"}
    assert sum(suggestion.probability for suggestion in suggestions) <= 1
    assert len(scorer.recipes("Gbdh", 99, has_coverage=False)) > len(scorer.recipes("Gbdh", 99))


def test_scores_of_sets_are_their_probabilities_in_any_order_and_batch(scorer):
    goals = ["Gbdh", "Gbdh", "Gac"]
    best = [*scorer.recipes("Gbdh", 2), scorer.recipes("Gac", 1)[0]]
    sets = np.full((4, 8), -1)
    for row, suggestion in enumerate(best):
        sets[row, -len(suggestion.ingredients) :] = suggestion.ingredients[::-1]
    sets[3, :2] = scorer.entity_ids(["ax", "bx"])
    goal_ids = scorer.entity_ids([*goals, "Gac"]).numpy()
    scores = scorer.score_sets(sets, goal_ids)
    expected = [math.log(suggestion.probability) for suggestion in best]
    np.testing.assert_allclose(scores[:3], expected, rtol=1e-4)
    # b is brought in vain, and c is missing: both have the least share.
    assert scores[3] < 2 * math.log(1e-3)
    singles = [scorer.score_sets(sets[[row]], goal_ids[[row]])[0] for row in range(4)]
    np.testing.assert_array_equal(scores, singles)


def test_new_goals_and_ingredients_are_known_by_their_parts(letters, scorer):
    parts = str(letters / "parts.csv")
    wider = with_new_entities(scorer, ["Gnew", "new card"], parts, "one-hot")
    assert [labels_of(wider, best.ingredients) for best in wider.recipes("Gnew", 2)] == [
        labels_of(scorer, best.ingredients) for best in scorer.recipes("Gac", 2)
    ]
    sets = np.full((3, 8), -1)
    for row, cards in enumerate((["dx", "new card"], ["dy", "new card"], ["dx", "hx"])):
        sets[row, :2] = wider.entity_ids(cards)
    scores = wider.score_sets(sets, wider.entity_ids(["Gbd"] * 3).numpy())
    assert scores[0] > scores[1] > scores[2]
    with pytest.raises(ConfigError, match="'strange' has the part q, which no entity"):
        with_new_entities(scorer, ["strange"], parts, "one-hot")


def test_a_goal_whose_part_no_train_recipe_brings_is_refused_by_its_name(scorer):
    knowledge = scorer.knowledge
    without_a = [
        row for row in knowledge.recipes.tolist() if not scorer.entities[row[8]].startswith("Ga")
    ]
    tensors = dict(scorer.tensors())
    fitted = set_fitting.fit_sets(
        np.array(without_a), knowledge.amounts, knowledge.words, seed=0, folds=2
    )
    tensors |= fitted.tensors() | {"recipes": torch.tensor(without_a)}
    SetScorer.check(tensors, len(scorer.entities))
    other = SetScorer(tensors, scorer.entities, scorer.graph_hash)
    with pytest.raises(ConfigError, match="no train recipe brings a, a part of 'Gab'"):
        other.recipes("Gab")


def test_supporting_recipes_are_of_similar_goals_and_never_the_recipe_itself(scorer):
    best = scorer.recipes("Gab", 1)[0]
    near = scorer.near_recipes("Gab", best.ingredients)
    assert near[0].strength == 1
    assert all(scorer.entities[recipe.result] != "Gab" for recipe in near)
    assert all(set(best.ingredients) & set(recipe.ingredients) for recipe in near)


def test_links_are_scored_by_shares_and_by_how_often_ingredients_meet(scorer):
    parts = scorer.score(["dx", "dy", "hx", "Gad"], "componentOf", "Gad")
    assert parts[0] > parts[1] > parts[2] == parts[3]
    assert scorer.score("ax", "combinesWith", "bx") > scorer.score("ax", "combinesWith", "cy")
    table = scorer.table("combinesWith")
    torch.testing.assert_close(table, table.T)


def test_goals_without_parts_do_not_count_as_having_lost_all(scorer):
    knowledge = scorer.knowledge
    amounts = knowledge.amounts.copy()
    amounts[knowledge.goal_ids[::3]] = 0
    some = SetKnowledge(knowledge.recipes, amounts, knowledge.words)
    np.testing.assert_array_equal(some.lost, knowledge.lost)
    np.testing.assert_array_equal(some.is_key, knowledge.is_key)


# --- loops against slow references ----------------------------------------------------------------


def test_votes_equal_those_of_the_formula(scorer):
    knowledge = scorer.knowledge
    size = len(knowledge.ingredient_ids)
    entity = scorer.entity_ids("Gbdh").item()
    amounts = knowledge.amounts[entity]
    goal = knowledge.goal(entity, np.zeros(size, np.float32))
    for kernel, (kinds, shares) in enumerate(loops.WIDTHS):
        votes = dict.fromkeys(range(size), 0.0)
        for row in knowledge.recipes:
            known = knowledge.amounts[row[-1]]
            jaccard = np.sum((known > 0) & (amounts > 0)) / np.sum((known > 0) | (amounts > 0))
            distance = np.abs(known - amounts).sum() / 2
            similarity = math.exp(-(1 - jaccard) / kinds - distance / shares)
            for entity in row[:-1][row[:-1] >= 0]:
                votes[int(knowledge.number_of[entity])] += similarity
        np.testing.assert_allclose(goal.votes[kernel], list(votes.values()), rtol=1e-4)


def test_the_beam_finds_what_a_full_search_finds(scorer):
    knowledge = scorer.knowledge
    size = len(knowledge.ingredient_ids)
    log_network = np.random.default_rng(0).normal(size=size).astype(np.float32)
    goal = knowledge.goal(scorer.entity_ids("Gceh").item(), log_network)
    sets = np.full((99, 8), -1, dtype=np.int64)
    nothing = np.empty(0, dtype=np.float32)
    log_again = np.array([-1, -2, -3], dtype=np.float32)
    count = loops.search(knowledge.lists, goal.keys, goal.shares, log_again, nothing, 4, sets)
    shares = (goal.shares[0] + goal.shares[3]) / 2
    options = [
        [i for i in range(size) if knowledge.lists.has_part[i, key] and goal.is_allowed[i]]
        for key in goal.keys
    ]
    scores = {}
    for choice in itertools.product(*options):
        for more in itertools.product(*([None, *each] for each in options)):
            extra = [(key, i) for key, i in enumerate(more) if i is not None]
            members = {*choice, *(i for _, i in extra)}
            if len(members) == len(choice) + len(extra):
                score = sum(shares[key, i] for key, i in enumerate(choice))
                score += sum(shares[key, i] + log_again[key] for key, i in extra)
                row = tuple(sorted(members))
                scores[row] = max(score, scores.get(row, -np.inf))
    assert count == len(scores) > 8
    found = [scores[tuple(row[row >= 0].tolist())] for row in sets[:count]]
    np.testing.assert_allclose(found, sorted(scores.values(), reverse=True), rtol=1e-5)


def test_what_is_missing_equals_non_negative_least_squares():
    rng = np.random.default_rng(0)
    members = rng.random((20, 8, 6)).astype(np.float32)
    members[:, :3, :3] += 2 * np.eye(3)
    members[:, 3:] = 0
    amounts = rng.random(6).astype(np.float32)
    kinds = np.array([0, 0, 0, 0, 1, 2])
    result = np.empty((20, 3), dtype=np.float32)
    loops.balance(members, kinds, amounts, result)
    for row in range(20):
        weights, _ = scipy.optimize.nnls(members[row, :, :4].T, amounts[:4])
        brought = weights @ members[row]
        expected = [np.abs(brought - amounts)[:4].sum(), *(brought - amounts)[4:]]
        np.testing.assert_allclose(result[row], expected, atol=0.02)


def test_recipes_agree_with_a_set_by_the_ingredients_that_it_lacks(scorer, monkeypatch):
    # All recipes may agree.
    monkeypatch.setattr(set_knowledge, "_NEAR_RECIPES", 99)
    knowledge = scorer.knowledge
    goal = scorer.evidence(int(scorer.entity_ids("Gbdh")))
    sets, _ = knowledge.candidates(goal)
    agreements = knowledge._agreements(goal, sets)
    for row, ingredients in enumerate(sets.tolist()):
        for kernel in (0, 1):
            total = share = 0.0
            for recipe in knowledge.recipes:
                members = knowledge.number_of[recipe[:-1][recipe[:-1] >= 0]]
                useful = [each for each in members if goal.is_allowed[each]]
                known = np.flatnonzero(knowledge.goal_ids == recipe[-1])[0]
                weight = goal.similarity[kernel, known] * bool(useful)
                total += weight
                share += weight * 0.1 ** sum(each not in ingredients for each in useful)
            assert agreements[row, kernel] == pytest.approx(np.log(share / total + 1e-3), rel=1e-3)


def test_a_lost_part_that_a_goal_keeps_may_come_from_an_ingredient_of_it_alone(monkeypatch):
    """Carbon for a carbide: cards with x lose it in most words, and X is a card of x alone."""
    amounts = np.array(
        [[1, 0, 1], [0, 1, 1], [0, 0, 1], *[[1, 1, 0]] * 5, *[[1, 1, 1]] * 2], dtype=np.float32
    )
    amounts /= amounts.sum(1, keepdims=True)
    rows = [[0, 1, -1, goal] for goal in range(3, 8)] + [[0, 1, 2, 8]]
    recipes = np.full((6, 9), -1)
    recipes[:, [0, 1, 2, 8]] = rows
    knowledge = SetKnowledge(recipes, amounts, np.zeros((10, 0), np.float32))
    assert knowledge.is_key.tolist() == [True, True, False]
    monkeypatch.setattr(set_knowledge, "_NEAR_SETS", 0)
    goal = knowledge.goal(9, np.zeros(3, np.float32))
    sets, _ = knowledge.candidates(goal)
    assert [0, 1, 2] in sets[:, :3].tolist()
    without = knowledge.goal(3, np.zeros(3, np.float32))
    assert 2 not in knowledge.candidates(without)[0]


# --- the same bits, and folders from elsewhere ----------------------------------------------------


def test_equal_seeds_give_equal_bits_and_no_global_generator_changes(letters_model, monkeypatch):
    monkeypatch.setattr(set_fitting, "_EPOCHS", 2)
    knowledge = letters_model.scorer.knowledge
    data = (knowledge.recipes, knowledge.amounts, knowledge.words)
    state = torch.random.get_rng_state()
    first, second, other = (
        set_fitting.fit_sets(*data, seed=seed, folds=2).tensors() for seed in (1, 1, 2)
    )
    assert torch.equal(state, torch.random.get_rng_state())
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert not torch.equal(first["network.first"], other["network.first"])


def test_an_interrupted_training_continues_to_the_same_bytes(letters, tmp_path, monkeypatch):
    monkeypatch.setattr(set_fitting, "_EPOCHS", 1)
    settings = RecipeScorerConfig(folds=3, parts=str(letters / "parts.csv"))
    config = RecipesConfig(str(letters / "graph"), settings)
    whole = train_recipes(config, tmp_path / "whole").folder
    with pytest.raises(KeyboardInterrupt, match="part 2 is saved"):
        train_recipes(config, tmp_path / "resumed", progress=interrupt_after(1))
    fits = []
    fit_network = set_fitting.fit_network
    monkeypatch.setattr(
        set_fitting,
        "fit_network",
        lambda *args, **settings: fits.append(args) or fit_network(*args, **settings),
    )
    resumed = train_recipes(config, tmp_path / "resumed").folder
    # The last fold, and all recipes.
    assert len(fits) == 2
    name = "model.safetensors"
    assert (resumed / name).read_bytes() == (whole / name).read_bytes()
    assert not (resumed / "checkpoints").exists()


def test_a_training_does_not_continue_with_other_parts(letters, tmp_path, monkeypatch):
    monkeypatch.setattr(set_fitting, "_EPOCHS", 1)
    parts = tmp_path / "parts.csv"
    shutil.copy(letters / "parts.csv", parts)
    config = RecipesConfig(str(letters / "graph"), RecipeScorerConfig(folds=3, parts=str(parts)))
    with pytest.raises(KeyboardInterrupt):
        train_recipes(config, tmp_path / "model", progress=interrupt_after(1))
    parts.write_text(parts.read_text().replace("Gab,a,1", "Gab,a,2"))
    with pytest.raises(ArtefactError, match="`parts` has changed"):
        train_recipes(config, tmp_path / "model")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("recipes", lambda t: t.index_fill(1, torch.tensor([0]), 999)),
        ("recipes", lambda t: t.index_fill(1, torch.tensor([0]), -1)),
        ("recipes", lambda t: t.flip(1)),
        ("recipes", lambda t: t[:0]),
        ("amounts", lambda t: -t),
        ("amounts", lambda t: t[:, 1:]),
        ("part_names", lambda t: torch.tensor([97, 10, 97], dtype=torch.uint8)),
        ("part_names", lambda t: torch.tensor([255], dtype=torch.uint8)),
        ("network.second", lambda t: t[..., 1:]),
        ("network", lambda t: t[:0]),
        ("committee", lambda t: t[:0]),
        ("mean", lambda t: t[1:]),
        ("deviation", torch.zeros_like),
        ("calibration", lambda t: -t),
        ("words", lambda t: t.float()),
    ],
)
def test_forged_tensors_are_refused(scorer, name, change):
    tensors = dict(scorer.tensors())
    # A change of a whole network, or of one tensor.
    for each in [key for key in tensors if key == name or key.startswith(f"{name}.")]:
        tensors[each] = change(tensors[each])

    def load():
        SetScorer.check(tensors, len(scorer.entities))
        return SetScorer(tensors, scorer.entities, scorer.graph_hash)

    with pytest.raises((ValueError, KeyError, RuntimeError)):
        load()


# --- books, settings and parts --------------------------------------------------------------------


def test_a_book_of_pairs_trains_a_model_of_sets_only_if_parts_are_named(opened_kitchen, tmp_path):
    settings = RecipeScorerConfig(folds=2, parts="none", features="one-hot")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(set_fitting, "_EPOCHS", 1)
        trained = train_recipes(RecipesConfig(opened_kitchen.source, settings), tmp_path / "model")
    scorer = load_scorer(trained.folder)
    assert isinstance(scorer, SetScorer)
    sizes = {len(suggestion.ingredients) for suggestion in scorer.recipes("bread", 10)}
    assert 2 in sizes
    assert "parts" not in RecipesConfig("kitchen").values()


def test_a_book_whose_sets_no_search_finds_trains_with_low_probabilities(run, tmp_path):
    """No train goal of this kitchen has its set among the candidates, so nothing ranks them."""
    content = open_book(ROOT / "examples" / "kitchen-sets.csv")
    split = make_split(RecipeGraph.from_book(content), SplitConfig("by-goal"))
    write_graph_folder(tmp_path / "graph", content, split)
    settings = RecipeScorerConfig(folds=2, features="glove")
    train_recipes(RecipesConfig(str(tmp_path / "graph"), settings), tmp_path / "model")
    scorer = open_model(tmp_path / "model").scorer
    ranked = scorer.recipes("pesto", 5)
    assert len(ranked) == 5
    assert all(math.exp(row.score) < 0.05 for row in ranked)
    assert "suggestions are guesses" in run("suggest", tmp_path / "model", "--goal", "pesto").out


def test_a_model_whose_scores_say_nothing_can_be_opened(tmp_path):
    settings = RecipeScorerConfig(folds=3, parts="none", features="glove")
    train_recipes(RecipesConfig("kitchen", settings), tmp_path / "model")
    open_model(tmp_path / "model")


def test_goals_whose_parts_no_other_recipe_brings_are_refused():
    content = [(f"a{row}", f"b{row}", f"c{row}", f"d{row}") for row in range(20)]
    graph = RecipeGraph.from_recipes(content)
    with pytest.raises(GraphError, match="expected recipes that share ingredients"):
        set_fitting.fit_sets(
            rows_of_sets(graph, slice(None)),
            # Each recipe has a part of its own.
            np.eye(20, dtype=np.float32)[[int(label[1:]) for label in graph.entities]],
            np.eye(graph.num_entities, dtype=np.float32),
            seed=0,
        )


@pytest.mark.parametrize("setting", [{"label_noise": 0.1}, {"kg": "none", "with_": ("kitchen",)}])
def test_settings_of_models_of_pairs_are_refused(letters, tmp_path, setting):
    settings = RecipeScorerConfig(parts=str(letters / "parts.csv"), **setting)
    with pytest.raises(ConfigError, match="not for a model of sets"):
        train_recipes(RecipesConfig(str(letters / "graph"), settings), tmp_path / "model")
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("label,part\nax,a\n", "header"),
        ("label,part,amount\nax,a,much\n", "line 2 is 'ax', 'a', 'much'"),
        ("label,part,amount\nax,a,-1\n", "line 2"),
        ("label,part,amount\nax,a,nan\n", "line 2"),
        ('label,part,amount\nax,"a\nb",1\n', "line"),
        ("label,part,amount\nax,a,1,1\n", "line 2"),
        ("label,part,amount\nbx,a,1\n", "1 label of 1 without parts, such as 'ax'"),
    ],
)
def test_a_wrong_table_of_parts_is_refused_with_its_fault(put, text, fault):
    path = put(text, "parts.csv")
    with pytest.raises(ConfigError, match=fault):
        read_parts(str(path), ["ax"])


def test_formulas_are_read_with_brackets_decimals_and_hydrates_or_refused():
    pytest.importorskip("periodictable")
    assert parse_formula("BaTi0.9Zr0.1O3") == {"Ba": 1, "Ti": 0.9, "Zr": 0.1, "O": 3}
    assert parse_formula("K4[Fe(CN)6]") == {"K": 4, "Fe": 1, "C": 6, "N": 6}
    assert parse_formula("CuSO4·5H2O") == {"Cu": 1, "S": 1, "O": 9, "H": 10}
    for nonsense in ("LixCoO2", "pizza", "", "Foo", "NaCl@2", "5%NaCl//H2O", "Fe[56]2O3"):
        with pytest.raises(ConfigError, match="no chemical formula"):
            parse_formula(nonsense)


# --- evaluation -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ranked(letters_model):
    return rank_sets(letters_model, "letters")


def test_columns_are_goals_with_new_parts_and_of_which_no_set_is_known(letters_model, ranked):
    record, predictions = ranked
    split = letters_model.opened.split
    columns = record.methods[0].columns
    assert columns["all"].goals == len(predictions) == split.is_in("test").sum()
    # Each word is a new set of letters, and each set of cards makes one word.
    assert columns["new parts"].goals == columns["new sets"].goals == len(predictions)
    names = [method.name for method in record.methods]
    assert names[1:] == ["most frequent sets", "statistics of parts", "sets of the nearest goal"]


def test_shares_count_goals_with_a_right_set_among_the_first_k(letters_model, ranked):
    record, predictions = ranked
    graph = letters_model.opened.graph
    right = {
        str(recipe.result): set(recipe.ingredients)
        for recipe in graph.recipe_labels(graph.sets[letters_model.opened.split.is_in("test")])
    }
    for k, share in record.methods[0].columns["all"].shares.items():
        hits = [
            any(set(ranked_set) == right[goal] for ranked_set in sets[:k])
            for goal, sets in predictions.items()
        ]
        assert share == pytest.approx(np.mean(hits))
    assert record.methods[0].columns["all"].shares[1] > 0.7
    for method in record.methods[1:]:
        difference = record.methods[0].columns["all"].shares[1] - method.columns["all"].shares[1]
        assert difference > 0


def test_predictions_of_others_are_read_and_scored_alike(
    run, letters, letters_model, ranked, tmp_path
):
    record, predictions = ranked
    path = tmp_path / "other.json"
    with path.open("w") as file:
        # Ingredients in any order, a set named twice, and a goal that the book lacks.
        turned = {goal: [each[::-1] for each in sets] for goal, sets in predictions.items()}
        json.dump(turned | {"another": [["x"]]}, file)
    out = tmp_path / "report"
    outcome = run("evaluate-links", letters / "model", "--predictions", path, "--out", out)
    assert outcome.code == 0
    assert "other.json" in outcome.out
    written = json.loads((out / "sets.json").read_text())
    assert written["methods"][0]["columns"] == written["methods"][-1]["columns"]
    assert json.loads((out / "predictions.json").read_text()) == predictions
    assert run("evaluate-links", letters / "model", "--out", out).code == 1
    assert run("evaluate-links", letters / "model", "--out", out, "--force").code == 0
    assert written["calibration_error"] == pytest.approx(record.calibration_error)


def test_a_model_of_the_full_graph_shows_memory_not_prediction(run, letters, tmp_path, monkeypatch):
    monkeypatch.setattr(set_fitting, "_EPOCHS", 1)
    settings = RecipeScorerConfig(kg="full", folds=2, parts=str(letters / "parts.csv"))
    train_recipes(RecipesConfig(str(letters / "graph"), settings), tmp_path / "model")
    shown = run("evaluate-links", tmp_path / "model")
    assert shown.out.startswith("all goals were seen in training: memory, not prediction")
    record = json.loads((tmp_path / "model" / "report" / "sets.json").read_text())
    assert record["trained_on"] == "full"


@pytest.mark.parametrize("text", ["[]", "{", '{"a": [1]}', '{"a": ["b"]}'])
def test_a_file_without_predictions_is_refused(put, text):
    path = put(text, "wrong.json")
    with pytest.raises(ConfigError, match="no predictions"):
        read_predictions(path)


def test_train_sets_of_a_goal_are_no_answers_and_repeats_count_if_the_book_has_some(letters_model):
    taken = [frozenset({("ax", "bx")})]
    answers = [["bx", "ax"], ["bx", "ax", "ax"], ["cx", "ax"], ["ax", "cx"]]
    goals = ranked_sets._Goals([0], ["G"], [frozenset({("ax", "cx")})], taken, {}, True)
    assert goals.answers(0, answers) == [("ax", "ax", "bx"), ("ax", "cx")]
    np.testing.assert_array_equal(
        ranked_sets._hits(goals, {"G": answers}), [[False, True, True, True]]
    )
    # Without repeats in the book, the second answer is the first.
    assert goals._replace(has_repeats=False).answers(0, answers) == [("ax", "cx")]


def test_known_sets_of_a_goal_take_no_place_in_a_split_by_recipe(letters_model):
    graph = letters_model.opened.graph
    extra = [("ay", "bx", "Gab"), ("ax", "by", "Gab"), ("ay", "by", "Gab")]
    rows = [(*recipe.ingredients, recipe.result) for recipe in graph.recipe_labels(graph.sets)]
    wider = RecipeGraph.from_recipes([*rows, *extra])
    is_test = np.array(
        [
            str(recipe.result) == "Gab" and "ax" in recipe.ingredients
            for recipe in wider.recipe_labels(wider.sets)
        ]
    )
    split = SimpleNamespace(is_in=lambda part: is_test if part == "test" else ~is_test)
    shown = SimpleNamespace(opened=SimpleNamespace(graph=wider, split=split))
    goals = ranked_sets._test_goals(shown, letters_model.scorer)
    assert goals.labels == ["Gab"]
    assert goals.right == [{("ax", "bx"), ("ax", "by")}]
    assert goals.taken == [{("ay", "bx"), ("ay", "by")}]


def test_predictions_for_few_goals_say_so_and_for_none_are_refused(
    run, letters, letters_model, tmp_path
):
    (tmp_path / "none.json").write_text('{"Gother": [["ax", "bx"]]}')
    with pytest.raises(ConfigError, match=r"none\.json: answers for 'Gother' and none of the test"):
        rank_sets(letters_model, "letters", [tmp_path / "none.json"])
    with pytest.raises(ConfigError, match="no file"):
        read_predictions(tmp_path / "missing.json")
    graph = letters_model.opened.graph
    goal = graph.entities[int(graph.sets[letters_model.opened.split.is_in("test")][0, -1])]
    (tmp_path / "few.json").write_text(json.dumps({goal: [["ax", "bx"]]}))
    files = ("--predictions", tmp_path / "few.json", "--out", tmp_path / "report")
    assert "few.json: answers for 1 of " in run("evaluate-links", letters / "model", *files).out


@pytest.mark.parametrize(
    "files", [["letters"], ["a/x.json", "b/x.json"], ["statistics of parts"]], ids=len
)
def test_two_methods_of_the_same_name_are_refused(letters_model, tmp_path, files):
    paths = [tmp_path / file for file in files]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_text('{"Gab": [["ax", "bx"]]}')
    with pytest.raises(ConfigError, match=f"two methods are called '{paths[0].name}'"):
        rank_sets(letters_model, "letters", paths)


# --- the command line -----------------------------------------------------------------------------


def test_suggest_and_score_answer_with_probability_part_and_support(run, letters, letters_model):
    told = run("suggest", letters / "model", "--goal", "Gab", "--top", 1).out
    assert "probability" in told
    assert "ax + bx -> Gab" in told
    assert "because" in told
    new = run("suggest", letters / "model", "--goal", "Gnew", "--top", 1).out
    assert "'Gnew' not in the graph: scored by parts and words" in new
    assert "ax + cx -> Gnew" in run("score", letters / "model", "_ + _ -> Gnew", "--top", 1).out
    assert "ax + bx -> Gab" in run("score", letters / "model", "ax + bx -> Gab").out


def test_open_queries_for_new_recipes_leave_out_those_of_the_book(run, letters, letters_model):
    query = ("score", letters / "model", "_ + _ -> Gbd", "--top", 1)
    assert "bx + dx -> Gbd" in run(*query).out
    new = run(*query, "--new-only").out.splitlines()[1]
    assert " new " in new
    assert "-> Gbd" in new
    assert "bx + dx" not in new
    assert "--new-only filters a ranking" in run(*query[:2], "ax + bx -> Gab", "--new-only").err
    # Blanks around a label are no part of it.
    assert "ax + cx -> Gnew" in run("suggest", letters / "model", "--goal", " Gnew ").out


def test_files_of_recipes_and_links_of_new_entities_are_refused_with_the_reason(
    run, letters, letters_model, tmp_path
):
    (tmp_path / "q.csv").write_text("ingredient_a,ingredient_b,result\nax,bx,Gab\n")
    assert (
        "each recipe as an argument"
        in run("score", letters / "model", "--in", tmp_path / "q.csv").err
    )
    outcome = run("score", letters / "model", "Gnew", "componentOf", "Gab")
    assert "no entity 'Gnew'" in outcome.err
    assert "knows only the graph's entities" in outcome.err


RULES = """
def no_dx(ingredients, goal):
    return "dx" not in ingredients

def nothing(ingredients, goal):
    return False

def failing(ingredients, goal):
    return ingredients["bx"]

def text(ingredients, goal):
    return "yes"

number = 3
"""


@pytest.fixture
def rules(tmp_path, monkeypatch):
    (tmp_path / "rules_of_letters.py").write_text(RULES)
    (tmp_path / "rules_with_a_fault.py").write_text("def no_dx(:")
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)
    yield
    assert sys.path == path
    sys.modules.pop("rules_of_letters", None)


@pytest.mark.usefixtures("rules")
def test_a_rule_of_the_user_leaves_sets_out_and_changes_no_probability(
    run, letters, letters_model, tmp_path
):
    command = ("suggest", letters / "model", "--goal", "Gbdh", "--top", 9)
    free, ruled = (
        {tuple(each["recipe"][:-1]): each["probability"] for each in json.loads(out)["suggestions"]}
        for out in (
            run(*command, "--json").out,
            run(*command, "--rule", "rules_of_letters:no_dx", "--json").out,
        )
    )
    expected = {sets: chance for sets, chance in free.items() if "dx" not in sets}
    assert len(expected) < len(free)
    assert ruled == pytest.approx(expected, rel=1e-4)
    shown = run(
        "evaluate-links", letters / "model", "--rule", "rules_of_letters:no_dx", "--out", "ruled"
    )
    assert "the model's sets are those that rules_of_letters:no_dx allows" in shown.out
    predictions = json.loads((tmp_path / "ruled" / "predictions.json").read_text())
    assert not any("dx" in each for sets in predictions.values() for each in sets)
    assert json.loads((tmp_path / "ruled" / "sets.json").read_text())["has_rule"]
    # Nothing is left of the rule in the model.
    assert "dx" in run(*command).out


@pytest.mark.usefixtures("rules")
@pytest.mark.parametrize(
    ("rule", "fault"),
    [
        ("no_dx", "expected module:function"),
        ("missing_rules:no_dx", "cannot import it (ModuleNotFoundError"),
        ("rules_with_a_fault:no_dx", "cannot import it (SyntaxError"),
        ("rules_of_letters:missing", "has no attribute 'missing'"),
        ("rules_of_letters:number", "is a int"),
        ("rules_of_letters:failing", "failed for ax + bx -> Gab (TypeError"),
        ("rules_of_letters:text", "returned 'yes' for"),
        ("rules_of_letters:nothing", "the rule allows no likely set for 'Gab'"),
    ],
)
def test_a_rule_that_is_no_function_of_sets_is_refused_with_the_reason(
    refused, letters, rule, fault
):
    refused("suggest", letters / "model", "--goal", "Gab", "--rule", rule, says=fault)


@pytest.mark.parametrize(
    ("query", "fault"),
    [
        ("ax + b\tx -> Gab", "control character"),
        ("Gab -> Gab", "among its own ingredients"),
        ("ax + _ -> Gab", "cannot parse recipe"),
        (" + ".join(["ax"] * 9) + " -> Gab", "9 ingredients"),
        ("ax + nothing -> Gab", "'nothing'"),
        ("ax + bx", "Add the result"),
    ],
)
def test_queries_that_no_model_of_sets_can_answer_are_refused(refused, letters, query, fault):
    refused("score", letters / "model", query, says=fault)


def test_a_recipe_scorer_of_pairs_suggests_the_train_recipes_of_a_goal(run, recipes_folder):
    refused = run("suggest", recipes_folder, "--goal", "dough", "--rule", "operator:contains")
    assert "`rule`" in refused.err or "--rule" in refused.err
    told = run("suggest", recipes_folder, "--goal", "dough", "--top", 3).out
    assert "flour + water -> dough" in told


def test_a_model_of_sets_suggests_for_the_whole_book_an_item_a_pair_and_a_list(
    run, letters, letters_model
):
    graph = letters_model.opened.graph
    known = set(graph.recipe_labels())
    best = suggest(letters_model, Wish(), 1).suggestions[0].recipe.ingredients
    for wish in (Wish(), Wish(item="ax"), Wish(pair=best[:2]), Wish(table=best)):
        found = suggest(letters_model, wish, 20).suggestions
        assert found
        assert not known.intersection(each.recipe for each in found)
        for each in found:
            assert wish.item is None or wish.item in each.recipe.ingredients
            assert set(wish.pair) <= set(each.recipe.ingredients)
            # The listed entities make known ones, too, which further steps use.
            assert (each.steps is not None) == bool(wish.table)
    table = letters / "found.csv"
    assert run("suggest", letters / "model", "--with-item", "ax", "--out", table).code == 0
    assert max(map(len, open_book(table).recipes)) > 3
