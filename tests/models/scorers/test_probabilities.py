"""Scores as probabilities: what is recovered, what is never looked at, and what is said where
nothing can be fitted."""

import json
import shutil
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from link_helpers import train
from scipy.special import expit, softmax

from wordcraft_kg import (
    ComplExConfig,
    RecipesConfig,
    RecipeScorerConfig,
    load_scorer,
    train_recipes,
)
from wordcraft_kg.base import ArtefactError, ConfigError, sha256_of
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    Folds,
    RecipeGraph,
    Split,
    is_in,
    make_folds,
    open_graph,
)
from wordcraft_kg.models.scorers import probabilities
from wordcraft_kg.models.scorers.probabilities import (
    LOG_ODDS,
    SEGMENTS,
    Curve,
    HeldOut,
    Probabilities,
    _fit_results,
    fit_curve,
    fit_sigmoid,
    known_share,
    rank_log_odds,
    score_fold,
)

CENTRES = LOG_ODDS.centres


@pytest.fixture(scope="module")
def folder(opened_kitchen, tmp_path_factory):
    """A cross-fitted ComplEx of the kitchen; read only."""
    settings = ComplExConfig(dim=16, epochs=15, n3=0.1, popularity=1.0, folds=3)
    return train(opened_kitchen, settings, tmp_path_factory.mktemp("models") / "folded").folder


@pytest.fixture(scope="module")
def scorer(folder):
    return load_scorer(folder)


@pytest.fixture(scope="module")
def folds(scorer, opened_kitchen):
    return make_folds(opened_kitchen.split, scorer.count, scorer.record.seed)


def fitted(scorer, folds):
    seen = [score_fold(scorer.left_out(fold), folds, fold) for fold in range(folds.count)]
    return Probabilities.fit(scorer.whole, folds, seen)


def counts(chances, share, folds=2, amount=4_000.0):
    """Expected counts where the true triples have these chances, and a share of them is known."""
    weights = amount * np.exp(-((CENTRES / 3) ** 2))
    true = np.tile(weights * chances * share, (folds, 1))
    return true, np.tile(weights, (folds, 1)) - true


@pytest.mark.parametrize(
    ("share", "slopes"), [(0.3, (1.2, 0.6, 0.3)), (0.8, (1.2, 0.6, 0.3)), (0.3, (0.7,))]
)
def test_slopes_and_the_intercept_of_the_unseen_are_recovered(share, slopes):
    low, high = SEGMENTS
    parts = [
        np.minimum(CENTRES, low),
        np.clip(CENTRES - low, 0, high - low),
        np.maximum(CENTRES - high, 0),
    ]
    parts = parts if len(slopes) > 1 else [CENTRES]
    log_odds = -5 + sum(slope * part for slope, part in zip(slopes, parts, strict=True))
    positives, unlabelled = counts(expit(log_odds), share)
    curve = fit_curve(positives, unlabelled, share, len(slopes))
    assert curve.slopes == pytest.approx(slopes, abs=0.02)
    # Of the triples that are true, the known ones are not among those that the whole model is asked
    # for.
    assert curve.intercept == pytest.approx(-5 + np.log(1 - share), abs=0.02)
    assert curve.reason == ""


def test_each_kind_has_an_intercept_and_all_share_the_slope():
    centres = np.linspace(-3, 3, 25)
    chances = expit(np.array([[-2.0], [0.5]]) + 0.8 * centres)
    weights = np.exp(-(centres**2) / 4) * 500
    fit = fit_sigmoid(weights * chances, weights * (1 - chances), centres[:, None], (0.0, 0.0, 1.0))
    assert fit == pytest.approx([-2.0, 0.5, 0.8], abs=0.01)


@pytest.mark.parametrize("slope", [-1.0, 0.0])
def test_a_higher_score_is_never_less_probable(slope):
    true, others = counts(expit(-4 + slope * CENTRES), 0.5)
    curve = fit_curve(true, others, 0.5)
    assert curve.slopes == (0,)
    assert "do not separate" in curve.reason
    assert np.ptp(curve.probability(CENTRES)) == 0
    assert curve.probability(CENTRES)[0] == pytest.approx(curve.rate)


@pytest.mark.parametrize("known", [0, 5, "all"])
def test_a_fold_of_one_class_has_its_base_rate_and_says_why(known):
    true, others = np.zeros((2, 2, len(CENTRES)))
    if known == "all":
        true[:, 100:200] = 1
    else:
        others[:, 100:600] = 1
        true[0, 700] = known
    curve = fit_curve(true, others, 0.5)
    assert "too few" in curve.reason
    assert curve.slopes == (0,)
    assert 0 < curve.rate <= 0.5
    assert curve.probability(np.array([-20.0, 20.0])) == pytest.approx(curve.rate)


def test_places_are_log_odds_of_ranks_with_ties_halved():
    among = np.array([1.0, 2.0, 2.0, 3.0])
    ranks = [
        1 - sum((x > s) + 0.5 * (x == s) for x in among) / 4 for s in (0.0, 1.0, 2.0, 3.0, 4.0)
    ]
    found = rank_log_odds(np.array([0.0, 1.0, 2.0, 3.0, 4.0]), among)
    expected = [(4 * rank + 0.5) / 5 for rank in ranks]
    clipped = np.clip(expected, 0.1, 0.9)
    np.testing.assert_allclose(found, np.log(clipped / (1 - clipped)))
    assert rank_log_odds(np.array([7.0]), np.full(5, 7.0)) == pytest.approx(0)


@pytest.mark.slow
def test_every_triple_outside_training_is_counted_once_and_the_others_not(scorer, folds):
    size, known = len(scorer.entities), {tuple(row) for row in folds.triples().tolist()}
    for fold in range(folds.count):
        seen = score_fold(scorer.left_out(fold), folds, fold)
        trained_on = {tuple(row) for row in folds.triples([fold]).tolist()}
        true, others = np.zeros((2, 2, 2))
        for triple in product(range(size), (COMBINES_WITH, COMPONENT_OF), range(size)):
            head, relation, tail = triple
            true[relation, int(head == tail)] += triple in known - trained_on
            others[relation, int(head == tail)] += triple not in known
        np.testing.assert_array_equal(seen.positives.sum(axis=-1), true)
        np.testing.assert_array_equal(seen.unlabelled.sum(axis=-1), others)


def test_a_sample_of_pairs_stands_for_all(scorer, folds, monkeypatch):
    everything = score_fold(scorer.left_out(0), folds, 0)
    monkeypatch.setattr(probabilities, "MAX_CELLS", 4_000)
    sample = score_fold(scorer.left_out(0), folds, 0)
    np.testing.assert_array_equal(sample.positives.sum(axis=-1), everything.positives.sum(axis=-1))
    np.testing.assert_allclose(
        sample.unlabelled.sum(axis=-1), everything.unlabelled.sum(axis=-1), rtol=0.03
    )
    again = score_fold(scorer.left_out(0), folds, 0)
    np.testing.assert_array_equal(sample.unlabelled, again.unlabelled)


def test_recipes_outside_train_change_nothing_but_by_their_number(scorer, folds):
    """The results of all test recipes are replaced; only what is looked at could change."""
    graph, split = folds.split.graph, folds.split
    recipes, outside = graph.recipes.copy(), ~split.is_in("train")
    recipes[outside, 2] = (recipes[outside, 2] + 7) % graph.num_entities
    other = RecipeGraph.__new__(RecipeGraph)
    other.__dict__.update({**graph.__dict__, "recipes": recipes})
    swapped = Split.__new__(Split)
    swapped.__dict__.update({**split.__dict__, "graph": other})
    changed = Folds(swapped, folds.count, folds.seed, folds.of_recipe)
    # Those of the model were fitted with the results as they are.
    assert fitted(scorer, changed) == scorer.probabilities


def test_the_share_that_is_known_follows_from_the_number_of_recipes(folds):
    train_recipes, outside = folds.split.is_in("train").sum(), (~folds.split.is_in("train")).sum()
    plain = 1 / (1 + outside * folds.count / train_recipes)
    # A fold keeps all recipes of its pairs, so all its pairs are new; but the more recipes are
    # known, the fewer are its new ingredients of a result.
    assert known_share(folds, COMBINES_WITH) == pytest.approx(plain)
    assert plain + 0.01 < known_share(folds, COMPONENT_OF) < plain + 0.15


def test_probabilities_rise_and_sum_to_the_unseen_triples(scorer, opened_kitchen):
    """Probabilities rise with scores and add up to about the unseen triples."""
    split, size = opened_kitchen.split, len(scorer.entities)
    everything = torch.arange(size)
    for relation in (COMBINES_WITH, COMPONENT_OF):
        scores = scorer.table(relation).flatten()
        chances = scorer.probability(everything[:, None], relation, everything[None, :])
        assert (chances.shape, chances.dtype) == ((size, size), torch.float32)
        different = ~torch.eye(size, dtype=torch.bool).flatten()
        order = torch.argsort(scores[different])
        assert bool((chances.flatten()[different][order].diff() >= 0).all())
        known = torch.zeros(size, size, dtype=torch.bool)
        partial = split.partial[split.partial[:, 1] == relation]
        known[partial[:, 0], partial[:, 2]] = True
        unseen = opened_kitchen.graph.triples
        unseen = unseen[(unseen[:, 1] == relation) & ~is_in(unseen, split.partial, size)]
        assert float(chances[~known].sum()) == pytest.approx(len(unseen), rel=0.35)


def test_pairs_of_an_entity_with_itself_have_a_rate_of_their_own(scorer):
    first = scorer.probabilities.relations[0]
    own = Curve(intercept=-1.0, rate=0.25, true=1, cells=4)
    changed = msgspec.structs.replace(first, itself=own)
    found = Probabilities(relations=(changed, scorer.probabilities.relations[1]))
    ids = torch.tensor([0, 1])
    chances = found.predict(scorer.table(0)[:2, :2], ids[:, None], torch.tensor(0), ids[None])
    assert chances.diagonal().tolist() == pytest.approx([expit(-1.0)] * 2)
    assert chances[0, 1] == scorer.probability(0, 0, 1) != chances[0, 0]


def test_the_record_is_an_output_and_a_folder_without_it_loads_as_before(folder, tmp_path):
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    run = json.loads((copy / "run.json").read_text())
    assert run["outputs"]["calibration.json"] == sha256_of(copy / "calibration.json")
    text = (copy / "calibration.json").read_text()
    scores = json.loads(text)["relations"][0]["scores"]
    spoilt_records = [{}, json.loads(text) | {"temperature": 0.0}]
    for changes, of_curve in (
        ({"scores": scores[:-1]}, {}),
        ({"scores": [], "rank_log_odds": []}, {}),
        ({"scores": scores[::-1]}, {}),
        ({}, {"slopes": [1.0, 1.0]}),
        ({}, {"slopes": [-1.0]}),
        ({}, {"intercept": 1e308}),
    ):
        spoilt = json.loads(text)
        spoilt["relations"][0].update(changes)
        spoilt["relations"][0]["distinct"].update(of_curve)
        spoilt_records.append(spoilt)
    for spoilt in spoilt_records:
        (copy / "calibration.json").write_text(json.dumps(spoilt))
        run["outputs"]["calibration.json"] = sha256_of(copy / "calibration.json")
        (copy / "run.json").write_text(json.dumps(run))
        with pytest.raises(ArtefactError, match=r"calibration\.json"):
            load_scorer(copy)
    (copy / "calibration.json").unlink()
    del run["outputs"]["calibration.json"]
    (copy / "run.json").write_text(json.dumps(run))
    before = load_scorer(copy)
    torch.testing.assert_close(before.table(0), load_scorer(folder).table(0), rtol=0, atol=0)
    with pytest.raises(ConfigError, match="has no calibration"):
        before.probability(0, 0, 1)
    with pytest.raises(ConfigError, match="cannot predict results"):
        before.result_probabilities(0, 1)


@pytest.mark.slow
def test_shares_of_results_are_a_softmax_with_the_best_temperature(tmp_path):
    config = RecipesConfig("kitchen", RecipeScorerConfig(folds=3, features="one-hot"))
    scorer = load_scorer(train_recipes(config, tmp_path / "model").folder)
    temperature = scorer.probabilities.temperature
    found = scorer.result_probabilities(["water", "fire"], "flour")
    assert found.shape == (2, len(scorer.entities))
    torch.testing.assert_close(found.sum(dim=-1), torch.ones(2))
    scores = scorer.whole.score_recipes("water", "flour", torch.arange(len(scorer.entities)))
    torch.testing.assert_close(found[0], torch.softmax(scores / temperature, dim=0))
    opened = open_graph("kitchen")
    folds = make_folds(opened.split, 3, scorer.record.seed)
    seen = [score_fold(scorer.left_out(fold), folds, fold) for fold in range(3)]

    def loss(value):
        pairs = [pair for part in seen for pair in zip(part.results, part.is_right, strict=True)]
        return -sum(np.log(softmax(row / value)[right].sum()) for row, right in pairs)

    best = loss(temperature)
    assert best < min(loss(temperature * 0.9), loss(temperature * 1.1))
    assert sum(part.is_right.sum() for part in seen) >= 3


def test_a_book_whose_results_nobody_proposes_has_shares_of_zero():
    nothing = np.zeros((2, 2, 1))
    scores = np.array([[2.0, 1.0, -np.inf], [0.5, 0.0, -1.0]])
    none_right = np.zeros((2, 3), dtype=bool)
    # Without a temperature the model would refuse to list results at all.
    assert _fit_results([HeldOut(nothing, nothing, scores, none_right)]) == (1, 0)
