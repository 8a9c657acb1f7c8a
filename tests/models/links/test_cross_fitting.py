"""The models of the folds: what they have seen, how they are trained and kept, and what a spoilt
folder says."""

import json
import logging
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import refuses, resume
from link_helpers import interrupted, rewritten, same_files, train

from wordcraft_kg import (
    ComplExConfig,
    LinkModelConfig,
    RecipesConfig,
    RecipeScorerConfig,
    open_model,
    save_scorer,
    train_recipes,
)
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError, LeakError
from wordcraft_kg.evaluation.ranked_links import rank_links
from wordcraft_kg.graphs import (
    OpenedGraph,
    RecipeGraph,
    SplitConfig,
    draw_train_sample,
    is_in,
    make_folds,
    make_split,
    open_book,
    recipe_triples,
    triples_hash,
)
from wordcraft_kg.models.links import link_training as cross_fitting
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.protocol import FactoredScorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.scorer_folder import load_scorer, make_scorer

SHORT = ComplExConfig(dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3)

FILES = ["folds.json", "folds.safetensors"]


@pytest.fixture
def spoilt_folds(folded, tmp_path):
    """Copy the model with changed tensors or record of its folds."""
    return lambda **changes: rewritten(folded, tmp_path / "spoilt", **changes)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0, 1])
def test_recipes_of_a_fold_without_a_model_are_refused(spoilt_folds, kept):
    with pytest.raises(ArtefactError, match="names other folds"):
        load_scorer(spoilt_folds(record=lambda values: values.update(folds=values["folds"][:kept])))


def test_scores_and_tables_are_those_of_a_model_without_folds(folded, opened_kitchen, tmp_path):
    plain = load_scorer(train(opened_kitchen, replace(SHORT, folds=0), tmp_path / "plain").folder)
    scorer = load_scorer(folded)
    assert not isinstance(plain, CrossFitted)
    assert not (tmp_path / "plain" / FILES[0]).exists()
    torch.testing.assert_close(scorer.table(0), plain.table(0), rtol=0, atol=0)
    torch.testing.assert_close(
        scorer.score("egg", 1, "bread"), plain.score("egg", 1, "bread"), rtol=0, atol=0
    )
    assert not torch.equal(scorer.left_out(0).table(0), plain.table(0))


def test_the_record_has_each_models_rank_of_its_own_fold(folded, opened_kitchen):
    """The record says how well each model ranks the fold that it has not seen."""
    scorer, folds, graph = (
        load_scorer(folded),
        make_folds(opened_kitchen.split, 3),
        opened_kitchen.graph,
    )
    for number, fold in enumerate(scorer.record.folds):
        own = recipe_triples(graph.recipes[folds.of_recipe == number])
        unseen = own[~is_in(own, folds.triples([number]), graph.num_entities)]
        assert (fold.queries, fold.trained_on) == (
            2 * len(unseen),
            triples_hash(folds.triples([number])),
        )
        for ranked, mrr in (
            (scorer.left_out(number), fold.mrr),
            (scorer.whole, fold.in_sample_mrr),
        ):
            assert mrr == pytest.approx(
                mean_reciprocal_rank(rank_triples(ranked, unseen, folds.triples()))
            )
    weights = [fold.queries for fold in scorer.record.folds]
    assert scorer.record.mrr == pytest.approx(
        np.average([fold.mrr for fold in scorer.record.folds], weights=weights)
    )
    metrics = open_model(folded).metrics
    assert (metrics.folds, metrics.fold_mrr) == (3, scorer.record.mrr)
    assert metrics.fold_in_sample_mrr == scorer.record.in_sample_mrr
    assert "cross-fitted: 3 folds" in (folded / "README.md").read_text()
    run = json.loads((folded / "run.json").read_text())
    assert run["inputs"]["folds"] == folds.hash
    assert set(FILES) < set(run["outputs"])


def test_embeddings_of_a_large_graph_have_folds_by_factors(folded, monkeypatch):
    small = load_scorer(folded)
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1)
    large = load_scorer(folded)
    assert isinstance(large, FactoredScorer)
    assert not isinstance(small, FactoredScorer)
    for one, other in ((large, small), (large.left_out(2), small.left_out(2))):
        left, right = one.factors(0)
        torch.testing.assert_close(left @ right.T, other.table(0))


@pytest.mark.parametrize(
    ("settings", "count"),
    [
        ({}, 5),
        ({"kg": "full"}, 0),
        ({"folds": 0}, 0),
        ({"folds": 2}, 2),
        ({"kg": "full", "folds": 0}, 0),
    ],
)
def test_partial_graphs_have_five_folds_by_default_and_full_ones_none(
    settings, count, opened_kitchen
):
    for kind in (ComplExConfig, LinkModelConfig):
        assert cross_fitting.decided_folds(kind(**settings), opened_kitchen).folds == count


def test_a_book_that_cannot_be_cut_has_none_unless_they_are_asked_for(caplog):
    recipes = [("a", "b", "c"), ("a", "c", "b"), ("b", "c", "a"), ("a", "a", "c")]
    graph = RecipeGraph.from_recipes(recipes, name="tiny")
    opened = OpenedGraph(graph, make_split(graph, SplitConfig(train_ratio=0.5)), "tiny")
    units = int(opened.split.is_in("train").sum())
    assert units < 5
    with caplog.at_level(logging.WARNING):
        assert cross_fitting.decided_folds(ComplExConfig(), opened).folds == 0
    assert not caplog.records
    with refuses("folds"):
        cross_fitting.decided_folds(ComplExConfig(folds=5), opened)


@pytest.mark.parametrize(
    "settings", [*({"folds": n} for n in (1, -1, 2.5, True, 2**25)), {"kg": "full", "folds": 5}]
)
@pytest.mark.parametrize("kind", [ComplExConfig, LinkModelConfig])
def test_numbers_of_folds_that_cannot_be_are_refused(kind, settings):
    with refuses("folds"):
        kind(**settings)


@pytest.mark.parametrize(
    "epoch", [pytest.param(5, marks=pytest.mark.slow), pytest.param(9, marks=pytest.mark.slow), 14]
)
def test_an_interrupted_run_goes_on_with_the_folds_that_are_missing(
    folded, opened_kitchen, tmp_path, epoch, monkeypatch
):
    folder = interrupted(opened_kitchen, SHORT, tmp_path / "model", epoch)
    with pytest.raises(ArtefactError, match="interrupted, not done"):
        load_scorer(folder)
    kept = sorted(path.stem for path in (folder / "checkpoints").glob("fold-*.json"))
    assert len(kept) == (epoch - 5) // 4
    again = []
    monkeypatch.setattr(
        cross_fitting, "fit", lambda *arguments: again.append(arguments) or fit(*arguments)
    )
    resume(folder)
    assert len(again) == 3 - len(kept)
    assert same_files(folder, folded)
    assert not (folder / "checkpoints").exists()


@pytest.mark.slow
def test_a_damaged_fold_is_trained_again(folded, opened_kitchen, tmp_path, caplog):
    folder = interrupted(opened_kitchen, SHORT, tmp_path / "model", 14)
    path = folder / "checkpoints" / "fold-1.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with caplog.at_level(logging.WARNING):
        resume(folder)
    assert "Training fold 1 again" in caplog.text
    assert same_files(folder, folded)


PROGRAM = """
import sys
from pathlib import Path
from wordcraft_kg.models.links import link_training as cross_fitting
from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.link_training import train_links
from wordcraft_kg.runs import checkpoints

cross_fitting.LONG = 0.0
checkpoints.cores = lambda: 2
print("the program ran")
config = ComplExConfig(dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3)
train_links(LinksConfig("kitchen", config), Path(sys.argv[1]))
"""


@pytest.mark.slow
def test_processes_side_by_side_give_the_same_bits(folded, tmp_path):
    """Processes side by side give the same bits and do not run the program again."""
    (tmp_path / "program.py").write_text(PROGRAM)  # without a `__main__` guard
    command = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "model")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "the program ran\n", "")
    assert same_files(tmp_path / "model", folded)


def drop(name):
    return lambda found: found.pop(name)


def set_to(name, value):
    return lambda found: found.__setitem__(name, value)


@pytest.mark.parametrize(
    ("tensors", "said"),
    [
        (drop("fold1.entity_imag"), r"3 folds are incomplete or damaged in .*folds\.safetensors"),
        (set_to("fold2.entity_real", torch.zeros(3, 2)), "3 folds are incomplete or damaged"),
        (set_to("fold0.entity_real", torch.zeros(())), "3 folds are incomplete or damaged"),
        (
            set_to("fold0.entity_real", torch.zeros(80, 14, dtype=torch.float64)),
            "3 folds are incomplete or damaged",
        ),
        (
            set_to("fold0.entity_real", torch.full((80, 14), torch.nan)),
            "'fold0.entity_real' holds NaN",
        ),
        (drop("of_recipe"), "are incomplete or damaged .*of_recipe"),
    ],
)
def test_a_missing_or_damaged_fold_is_named(spoilt_folds, tensors, said):
    with pytest.raises(ArtefactError, match=said):
        load_scorer(spoilt_folds(tensors=tensors))


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_folds_that_is_missing_or_changed_is_named(folded, tmp_path, name):
    folder = Path(shutil.copytree(folded, tmp_path / "copy"))
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[:-1] + b" ")
    with pytest.raises(ArtefactError, match=rf"{name} is damaged or was changed"):
        load_scorer(folder)
    (folder / name).unlink()
    with pytest.raises(ArtefactError, match=rf"{name} is missing"):
        load_scorer(folder)


@pytest.mark.parametrize("is_in_the_record", [True, False])
def test_folds_of_another_split_are_refused_when_a_model_is_opened(
    spoilt_folds, opened_kitchen, is_in_the_record
):
    other = make_folds(make_split(opened_kitchen.graph, SplitConfig(seed=1)), 3)
    changes = {"tensors": set_to("of_recipe", torch.from_numpy(other.of_recipe.copy()))}
    if is_in_the_record:
        changes = {"record": set_to("hash", other.hash)}
    folder = spoilt_folds(**changes)
    with pytest.raises(GraphMismatchError):
        (load_scorer if is_in_the_record else open_model)(folder)


def test_a_model_that_was_trained_on_other_triples_than_it_says_is_a_leak(
    spoilt_folds, opened_kitchen
):
    def swap(record):
        record["folds"][0]["trained_on"], record["folds"][1]["trained_on"] = (
            record["folds"][1]["trained_on"],
            record["folds"][0]["trained_on"],
        )

    scorer = load_scorer(spoilt_folds(record=swap))
    with pytest.raises(LeakError):
        scorer.trained_on(0, opened_kitchen.graph)
    np.testing.assert_array_equal(
        scorer.trained_on(2, opened_kitchen.graph), make_folds(opened_kitchen.split, 3).triples([2])
    )
    with pytest.raises(GraphMismatchError):
        scorer.trained_on(2, RecipeGraph.from_book(open_book("paper-examples")))


TRAIN_SAMPLE_MODELS_SHORT = ComplExConfig(
    dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3, train_fraction=0.5, label_noise=0.2, seed=1
)

PLAIN = replace(TRAIN_SAMPLE_MODELS_SHORT, folds=0)


@pytest.fixture(scope="module")
def with_train_sample(opened_kitchen, tmp_path_factory):
    """A cross-fitted ComplEx of half of the recipes, a fifth of them wrong; read only."""
    return train(
        opened_kitchen,
        TRAIN_SAMPLE_MODELS_SHORT,
        tmp_path_factory.mktemp("models") / "with_train_sample",
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


def test_other_link_predictors_learn_from_a_train_sample(opened_kitchen, tmp_path):
    settings = LinkModelConfig(model="distmult", dim=4, epochs=1, folds=0, train_fraction=0.1)
    model = open_model(train(opened_kitchen, settings, tmp_path / "distmult").folder)
    assert (len(model.train_sample.sets), model.metrics.triples) == (26, len(model.triples))


@pytest.mark.slow
def test_a_recipe_scorer_knows_its_train_sample_and_no_more(opened_kitchen, tmp_path):
    settings = RecipeScorerConfig(
        folds=3, features="one-hot", train_fraction=0.5, label_noise=0.2, seed=1
    )
    trained = train_recipes(RecipesConfig(opened_kitchen.source, settings), tmp_path / "recipes")
    model, folds = open_model(trained.folder), folds_of(opened_kitchen)
    np.testing.assert_array_equal(model.scorer.whole.recipes.numpy(), folds.train_sample.sets)
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
