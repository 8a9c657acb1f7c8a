"""Scorers of a train sample: training data, provenance, and no influence of a left-out fold."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from link_helpers import rewritten, train
from refusals import refuses

from wordcraft_kg.agents import training as agents
from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError, LeakError
from wordcraft_kg.evaluation.ranked_links import rank_links
from wordcraft_kg.graphs.folds import make_folds
from wordcraft_kg.graphs.train_samples import draw_train_sample
from wordcraft_kg.graphs.triples import triples_hash
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.training import train_recipes
from wordcraft_kg.models.saving import save_scorer
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.folder import load_scorer, make_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples

SHORT = ComplExConfig(
    dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3, train_fraction=0.5, label_noise=0.2, seed=1
)
PLAIN = replace(SHORT, folds=0)


@pytest.fixture(scope="module")
def with_train_sample(opened_kitchen, tmp_path_factory):
    """A cross-fitted ComplEx of half of the recipes, a fifth of them wrong; read only."""
    return train(
        opened_kitchen, SHORT, tmp_path_factory.mktemp("models") / "with_train_sample"
    ).folder


@pytest.fixture(scope="module")
def plain(opened_kitchen, tmp_path_factory):
    """The same without folds; read only."""
    return train(opened_kitchen, PLAIN, tmp_path_factory.mktemp("models") / "plain").folder


def folds_of(opened):
    folds = make_folds(opened.split, 3)
    return folds.with_train_sample(
        draw_train_sample(opened.split, 0.5, 0.2, 1, of_recipe=folds.of_recipe)
    )


def test_each_model_is_that_of_the_triples_that_it_was_trained_on(
    with_train_sample, opened_kitchen
):
    scorer, folds, graph = (
        load_scorer(with_train_sample),
        folds_of(opened_kitchen),
        opened_kitchen.graph,
    )
    assert (scorer.count, scorer.record.hash) == (3, make_folds(opened_kitchen.split, 3).hash)
    np.testing.assert_array_equal(scorer.of_recipe, folds.of_recipe)
    for fold, model in [
        ((), scorer.whole),
        *(((fold,), scorer.left_out(fold)) for fold in range(3)),
    ]:
        triples = folds.triples(fold)
        fitted = fit(PLAIN, triples_factory(graph, triples), lambda epoch: None)
        expected = make_scorer(*scorer_tensors(PLAIN, fitted, triples), graph.entities, graph.hash)
        for relation in (0, 1):
            torch.testing.assert_close(
                model.table(relation), expected.table(relation), rtol=0, atol=0
            )
        if fold:
            np.testing.assert_array_equal(scorer.trained_on(*fold, graph), triples)


def test_an_opened_model_tells_what_it_was_trained_on(with_train_sample, plain, opened_kitchen):
    for folder, train_sample in (
        (with_train_sample, folds_of(opened_kitchen).train_sample),
        (plain, draw_train_sample(opened_kitchen.split, 0.5, 0.2, 1)),
    ):
        model = open_model(folder)
        np.testing.assert_array_equal(model.train_sample.results, train_sample.results)
        np.testing.assert_array_equal(model.triples, train_sample.triples)
        assert model.run.inputs["train_sample"] == train_sample.hash
        words = "50 % of the train recipes, 20 % of them with a wrong result"
        assert model.provenance["learned from"] == words
        assert f"of {words} only" in (folder / "README.md").read_text()
        metrics = json.loads((folder / "metrics.json").read_text())
        assert (metrics["train_fraction"], metrics["label_noise"], metrics["triples"]) == (
            0.5,
            0.2,
            len(train_sample.triples),
        )
        ranks = rank_triples(model.scorer, train_sample.triples, train_sample.triples)
        assert model.metrics.train_mrr == pytest.approx(mean_reciprocal_rank(ranks))


def test_a_train_sample_that_is_not_the_one_of_the_training_is_a_leak(
    with_train_sample, opened_kitchen, tmp_path
):
    def right_again(tensors):
        tensors["train_results"] = torch.from_numpy(
            folds_of(opened_kitchen).train_sample.graph.recipes[:, 2].copy()
        )

    model = open_model(rewritten(with_train_sample, tmp_path / "spoilt", right_again))
    with pytest.raises(LeakError):
        model.scorer.trained_on(0, opened_kitchen.graph)
    with pytest.raises(GraphMismatchError):
        _ = model.triples
    with pytest.raises(LeakError):
        load_scorer(
            rewritten(
                with_train_sample, tmp_path / "none", lambda tensors: tensors.pop("train_results")
            )
        ).trained_on(0, opened_kitchen.graph)


@pytest.mark.parametrize("tensor", [torch.zeros(3, dtype=torch.int64), torch.zeros(271)])
def test_a_damaged_train_sample_is_refused(with_train_sample, tmp_path, tensor):
    folder = rewritten(
        with_train_sample, tmp_path / "spoilt", lambda tensors: tensors.update(train_results=tensor)
    )
    with pytest.raises(ArtefactError, match=r"are incomplete or damaged .*train_results"):
        load_scorer(folder)


def test_a_train_sample_that_is_drawn_otherwise_now_is_refused(with_train_sample, tmp_path):
    model = open_model(
        rewritten(with_train_sample, tmp_path / "other", inputs={"train_sample": "0" * 64})
    )
    with pytest.raises(GraphMismatchError):
        _ = model.triples


def test_a_saved_copy_keeps_its_train_sample(with_train_sample, opened_kitchen, tmp_path):
    copy = open_model(
        save_scorer(tmp_path / "copy", load_scorer(with_train_sample), opened_kitchen, kg="partial")
    )
    np.testing.assert_array_equal(copy.triples, open_model(with_train_sample).triples)
    np.testing.assert_array_equal(
        copy.scorer.trained_on(1, opened_kitchen.graph), folds_of(opened_kitchen).triples([1])
    )


def test_models_and_baselines_share_triples_and_knowledge(with_train_sample, opened_kitchen):
    """Models are evaluated on the same triples and baselines know what the model knows."""
    model = open_model(with_train_sample)
    ranked = rank_links(model.scorer, model.opened, train_sample=model.train_sample, max_queries=0)
    graph, test = opened_kitchen.graph, opened_kitchen.split.held_out("test")
    np.testing.assert_array_equal(ranked.queries, test)
    assert ranked.ranks.equals(rank_triples(model.scorer, test, graph.triples))
    known = rank_triples(FrequencyScorer(graph, model.triples), test, graph.triples)
    assert ranked.baseline_ranks["frequency"].equals(known)
    assert not known.equals(
        rank_triples(FrequencyScorer(graph, opened_kitchen.split.partial), test, graph.triples)
    )


def test_an_agent_takes_the_self_edges_of_the_train_sample(
    with_train_sample, monkeypatch, tmp_path
):
    seen = {}

    def stop(*args, observed, **options):
        seen["observed"] = observed
        raise ConfigError("enough")

    monkeypatch.setattr(agents, "make_policy", stop)
    config = AgentConfig(
        "kitchen", str(with_train_sample), trainer=ImpalaConfig(steps=512, eval_every=0)
    )
    with pytest.raises(ConfigError, match="enough"):
        agents.train_agent(config, tmp_path / "run")
    np.testing.assert_array_equal(seen["observed"], open_model(with_train_sample).triples)


def test_other_link_predictors_learn_from_a_train_sample(opened_kitchen, tmp_path):
    settings = LinkModelConfig(model="distmult", dim=4, epochs=1, folds=0, train_fraction=0.1)
    model = open_model(train(opened_kitchen, settings, tmp_path / "distmult").folder)
    assert (len(model.train_sample.recipes), model.metrics.triples) == (26, len(model.triples))


@pytest.mark.slow
def test_a_recipe_scorer_knows_its_train_sample_and_no_more(opened_kitchen, tmp_path):
    settings = RecipeScorerConfig(
        folds=3, features="one-hot", train_fraction=0.5, label_noise=0.2, seed=1
    )
    trained = train_recipes(RecipesConfig(opened_kitchen.source, settings), tmp_path / "recipes")
    model, folds = open_model(trained.folder), folds_of(opened_kitchen)
    np.testing.assert_array_equal(model.scorer.whole.recipes.numpy(), folds.train_sample.recipes)
    np.testing.assert_array_equal(model.triples, folds.train_sample.triples)
    for fold in range(3):
        np.testing.assert_array_equal(
            model.scorer.left_out(fold).recipes.numpy(), folds.recipes([fold])
        )
        np.testing.assert_array_equal(
            model.scorer.trained_on(fold, opened_kitchen.graph), folds.triples([fold])
        )
        assert model.scorer.record.folds[fold].trained_on == triples_hash(folds.triples([fold]))
    assert (model.metrics.recipes, model.metrics.train_fraction, model.metrics.label_noise) == (
        130,
        0.5,
        0.2,
    )
    assert (
        "50 % of the train recipes, 20 % of them with a wrong result"
        in (trained.folder / "README.md").read_text()
    )


@pytest.mark.parametrize("kind", [ComplExConfig, LinkModelConfig, RecipeScorerConfig])
@pytest.mark.parametrize(
    ("name", "value", "kg"),
    [
        *(
            ("train_fraction", value, "partial")
            for value in (0, 1.5, float("nan"), -0.1, True, "half")
        ),
        *(("label_noise", value, "partial") for value in (-1, 1.01, float("nan"))),
        *((name, 0.5, "full") for name in ("train_fraction", "label_noise")),
    ],
)
def test_a_share_or_noise_out_of_range_or_on_the_full_graph_is_refused(kind, name, value, kg):
    with refuses(name):
        kind(kg=kg, **{name: value})
