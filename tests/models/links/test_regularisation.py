"""Choosing the regularisation of a small book on its train recipes."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from link_helpers import interrupt_after, random_graph, train
from resumption import resume

from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.links import regularisation
from wordcraft_kg.models.links import training as link_training
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import N3_PARTIAL, ComplExConfig, LinkModelConfig
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.regularisation import (
    HELD_OUT,
    N3,
    POPULARITY,
    choose,
    split_of_train,
)
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples

OPEN = ComplExConfig(dim=8, epochs=5)


def silent(done, total):
    """Nobody watches."""


def opened(graph, **settings):
    return OpenedGraph(graph, make_split(graph, SplitConfig(**settings)), "here")


@pytest.fixture(scope="module")
def choice(opened_kitchen):
    return choose(opened_kitchen, OPEN, silent)


def test_the_most_cautious_of_the_good_combinations_is_chosen(choice):
    """Every combination is a candidate and the most cautious of the good ones is chosen."""
    assert {(found.n3, found.popularity) for found in choice.candidates} == {
        (n, p) for n in N3 for p in POPULARITY
    }
    best = max(found.mrr for found in choice.candidates)
    good = [found for found in choice.candidates if found.mrr >= 0.95 * best]
    most = max(found.popularity for found in good)
    chosen = max((found for found in good if found.popularity == most), key=lambda found: found.mrr)
    assert (choice.n3, choice.popularity, choice.mrr) == (chosen.n3, chosen.popularity, chosen.mrr)
    assert len({found.mrr for found in choice.candidates}) > len(N3)


def test_the_same_seed_chooses_the_same(opened_kitchen, choice):
    assert choose(opened_kitchen, OPEN, silent) == choice
    assert choose(opened_kitchen, replace(OPEN, seed=7), silent) != choice


def test_only_train_recipes_are_held_out(opened_kitchen):
    split = opened_kitchen.split
    fold = split_of_train(split, HELD_OUT, seed=3)
    np.testing.assert_array_equal(fold.graph.recipes, split.recipes("train"))
    assert fold.graph.entities == split.graph.entities
    assert len(fold.held_out("test"))


def test_a_split_by_goal_holds_out_goals_of_train(kitchen):
    fold = split_of_train(make_split(kitchen, SplitConfig("by-goal")), HELD_OUT, seed=3)
    assert fold.config.kind == "by-goal"
    assert not set(fold.recipes("train")[:, 2]) & set(fold.recipes("test")[:, 2])


def test_the_figures_are_those_of_a_ranking_of_what_was_held_out(opened_kitchen, monkeypatch):
    monkeypatch.setattr(regularisation, "FOLDS", 1)
    found = choose(opened_kitchen, OPEN, silent)
    fold = split_of_train(opened_kitchen.split, HELD_OUT, OPEN.seed)

    def mrr(scorer):
        return mean_reciprocal_rank(rank_triples(scorer, fold.held_out("test"), fold.graph.triples))

    for candidate in found.candidates:
        settings = replace(
            OPEN, n3=candidate.n3, popularity=candidate.popularity, epochs=found.epochs
        )
        model = fit(settings, triples_factory(fold.graph, fold.partial), lambda epoch: None)
        scorer = make_scorer(
            *scorer_tensors(settings, model, fold.partial), fold.graph.entities, fold.graph.hash
        )
        assert candidate.mrr == pytest.approx(mrr(scorer))
    assert found.frequency_mrr == pytest.approx(mrr(FrequencyScorer(fold.graph, fold.partial)))


@pytest.mark.parametrize(
    "settings",
    [
        replace(OPEN, n3=0.1),
        ComplExConfig(popularity=1.0),
        ComplExConfig(kg="full"),
        LinkModelConfig(),
    ],
    ids=["n3", "popularity", "full", "another model"],
)
def test_what_is_given_or_does_not_exist_is_not_chosen(opened_kitchen, settings):
    assert choose(opened_kitchen, settings, silent) is None


def test_a_large_book_chooses_its_popularity_only_on_one_fold_and_a_sample(
    opened_kitchen, monkeypatch
):
    monkeypatch.setattr(regularisation, "SMALL", 0)
    monkeypatch.setattr(regularisation, "RANKED", 40)
    found = choose(opened_kitchen, replace(OPEN, negatives=16), silent)
    assert {(one.n3, one.popularity) for one in found.candidates} == {
        (N3_PARTIAL, p) for p in POPULARITY
    }
    assert (found.folds, found.queries) == (1, 80)


def test_a_book_with_too_little_to_hold_out_keeps_the_fixed_default():
    assert choose(opened(random_graph(num_entities=6, num_recipes=8)), OPEN, silent) is None
    once = [
        (f"a{i}", f"b{i}", f"c{i}") for i in range(40)
    ]  # nothing can be held out without losing an entity
    assert (
        choose(opened(RecipeGraph.from_recipes(once, name="once"), kind="none"), OPEN, silent)
        is None
    )


@pytest.mark.slow
def test_with_popularity_alone_the_choice_equals_counting():
    """Where there is nothing but popularity to learn the choice keeps up with counting."""
    rng = np.random.default_rng(0)
    parts = (rng.random((400, 2)) ** 2 * 60).astype(int)
    graph = RecipeGraph.from_recipes(
        [
            (f"e{a}", f"e{b}", f"e{c}")
            for (a, b), c in zip(parts, rng.integers(60, size=400), strict=True)
        ]
    )
    found = choose(opened(graph), replace(OPEN, dim=32, epochs=50), silent)
    without = max(row.mrr for row in found.candidates if row.popularity == 0)
    assert without < found.frequency_mrr
    assert found.mrr > 0.97 * found.frequency_mrr


# --- in a run -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_records_what_was_chosen_and_from_what(opened_kitchen, tmp_path, choice):
    trained = train(opened_kitchen, OPEN, tmp_path / "model")
    assert trained.metrics.choice == choice
    config = tomllib.loads((trained.folder / "config.toml").read_text())["train-complex"]
    assert (config["n3"], config["popularity"]) == (choice.n3, choice.popularity)
    assert "choice.json" in json.loads((trained.folder / "run.json").read_text())["inputs"]
    assert json.loads((trained.folder / "choice.json").read_text())["mrr"] == choice.mrr
    assert str(choice) in (trained.folder / "README.md").read_text()
    assert str(choice) in open_model(trained.folder).provenance.values()


@pytest.mark.slow
def test_a_resumed_run_does_not_choose_again(opened_kitchen, tmp_path, monkeypatch):
    settings = replace(OPEN, epochs=10)
    undisturbed = train(opened_kitchen, settings, tmp_path / "undisturbed")
    assert train(
        opened_kitchen, settings, tmp_path / "model", progress=interrupt_after(4)
    ).interrupted
    monkeypatch.setattr(link_training, "choose", lambda *arguments: pytest.fail("chosen again"))
    resumed = resume(tmp_path / "model")
    assert resumed.metrics.choice == undisturbed.metrics.choice is not None
    weights = [
        (folder / "model.safetensors").read_bytes()
        for folder in (resumed.folder, undisturbed.folder)
    ]
    assert weights[0] == weights[1]


def test_ctrl_c_while_choosing_leaves_nothing(opened_kitchen, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        train(opened_kitchen, OPEN, tmp_path / "model", progress=interrupt_after(0))
    assert list(tmp_path.iterdir()) == []
