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
from link_helpers import interrupt_after, rewritten, same_files, train
from refusals import refuses
from resumption import resume

from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError, LeakError
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.folds import make_folds
from wordcraft_kg.graphs.triples import is_in, recipe_triples, triples_hash
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.links import training as cross_fitting
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.folder import load_scorer, make_scorer
from wordcraft_kg.models.scorers.protocol import FactoredScorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples

SHORT = ComplExConfig(dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3)
FILES = ["folds.json", "folds.safetensors"]


@pytest.fixture(scope="module")
def folded(opened_kitchen, tmp_path_factory):
    """A cross-fitted ComplEx of the kitchen; read only."""
    return train(opened_kitchen, SHORT, tmp_path_factory.mktemp("models") / "folded").folder


@pytest.fixture
def spoilt_folds(folded, tmp_path):
    """Copy the model with changed tensors or record of its folds."""
    return lambda **changes: rewritten(folded, tmp_path / "spoilt", **changes)


# --- what is trained ------------------------------------------------------------------------------


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


def test_a_fold_is_trained_as_a_model_of_its_triples_alone(parted_kitchen, tmp_path):
    folder = train(parted_kitchen, replace(SHORT, eval_every=1), tmp_path / "model").folder
    triples = make_folds(parted_kitchen.split, 3).triples([1])
    alone = fit(SHORT, triples_factory(parted_kitchen.graph, triples), lambda epoch: None)
    graph = parted_kitchen.graph
    expected = make_scorer(*scorer_tensors(SHORT, alone, triples), graph.entities, graph.hash)
    left_out = load_scorer(folder).left_out(1)
    torch.testing.assert_close(left_out.table(0), expected.table(0), rtol=0, atol=0)


def test_embeddings_of_a_large_graph_have_folds_by_factors(folded, monkeypatch):
    small = load_scorer(folded)
    monkeypatch.setattr("wordcraft_kg.models.scorers.config.TABLE_LIMIT", 1)
    large = load_scorer(folded)
    assert isinstance(large, FactoredScorer)
    assert not isinstance(small, FactoredScorer)
    for one, other in ((large, small), (large.left_out(2), small.left_out(2))):
        left, right = one.factors(0)
        torch.testing.assert_close(left @ right.T, other.table(0))


# --- how many -------------------------------------------------------------------------------------


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


def test_tables_of_folds_that_would_be_too_large_are_refused(opened_kitchen, monkeypatch):
    monkeypatch.setattr(cross_fitting, "TABLE_LIMIT", 2**18)
    with refuses("folds"):
        cross_fitting.decided_folds(LinkModelConfig(folds=6), opened_kitchen)
    assert (
        cross_fitting.decided_folds(LinkModelConfig(), opened_kitchen).folds == 5
    )  # they are just small enough
    assert cross_fitting.decided_folds(ComplExConfig(folds=6), opened_kitchen).folds == 6
    monkeypatch.setattr(cross_fitting, "TABLE_LIMIT", 2**16)
    assert cross_fitting.decided_folds(LinkModelConfig(), opened_kitchen).folds == 0


# --- interruptions --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "epoch", [pytest.param(5, marks=pytest.mark.slow), pytest.param(9, marks=pytest.mark.slow), 14]
)
def test_an_interrupted_run_goes_on_with_the_folds_that_are_missing(
    folded, opened_kitchen, tmp_path, epoch, monkeypatch
):
    trained = train(opened_kitchen, SHORT, tmp_path / "model", progress=interrupt_after(epoch))
    assert trained.interrupted
    assert json.loads((trained.folder / "run.json").read_text())["status"] == "interrupted"
    with pytest.raises(ArtefactError, match="interrupted, not done"):
        load_scorer(trained.folder)
    kept = sorted(path.stem for path in (trained.folder / "checkpoints").glob("fold-*.json"))
    assert len(kept) == (epoch - 5) // 4
    again = []
    monkeypatch.setattr(
        cross_fitting, "fit", lambda *arguments: again.append(arguments) or fit(*arguments)
    )
    assert not resume(trained.folder).interrupted
    assert len(again) == 3 - len(kept)
    assert same_files(trained.folder, folded)
    assert not (trained.folder / "checkpoints").exists()


@pytest.mark.slow
@pytest.mark.parametrize("is_damaged", [True, False], ids=["damaged", "of other epochs"])
def test_a_damaged_fold_or_one_of_other_epochs_is_trained_again(
    folded, opened_kitchen, tmp_path, caplog, is_damaged
):
    folder = train(opened_kitchen, SHORT, tmp_path / "model", progress=interrupt_after(14)).folder
    path = folder / "checkpoints" / f"fold-1.{'safetensors' if is_damaged else 'json'}"
    data = path.read_bytes()
    path.write_bytes(
        data[:-1] + b"x" if is_damaged else data.replace(b'"epochs": 4', b'"epochs": 1')
    )
    assert path.read_bytes() != data
    with caplog.at_level(logging.WARNING):
        resume(folder)
    assert ("Training fold 1 again" in caplog.text) == is_damaged
    assert same_files(folder, folded)


# --- side by side ---------------------------------------------------------------------------------

PROGRAM = """
import sys
from pathlib import Path
from wordcraft_kg.models.links import training as cross_fitting
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.training import train_links
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


# --- spoilt folders -------------------------------------------------------------------------------


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
