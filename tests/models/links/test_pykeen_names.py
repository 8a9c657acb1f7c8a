"""PyKEEN knows our model, loop and dataset by name, whoever is imported first, and trains with them."""

import math
import subprocess
import sys

import pytest
from graph_folders import write_graph
from pykeen.datasets import dataset_resolver, get_dataset
from pykeen.hpo import hpo_pipeline
from pykeen.pipeline import pipeline

from wordcraft_kg.base.errors import ConfigError, SplitError
from wordcraft_kg.graphs import RELATIONS, open_graph
from wordcraft_kg.models.links.complex import ComplExN3

LOOK_UP = """
from pykeen.datasets import dataset_resolver
from pykeen.models import model_resolver
from pykeen.training import training_loop_resolver

for resolver, name in (
    (model_resolver, "ComplExN3"),
    (training_loop_resolver, "IndexedSymmetricLCWA"),
    (dataset_resolver, "wordcraft"),
):
    print(resolver.lookup(name).__name__)
"""


@pytest.fixture(autouse=True)
def own_pykeen_cache(tmp_path, monkeypatch):
    """Keep PyKEEN's cache of datasets out of the user's home."""
    monkeypatch.setattr("pykeen.datasets.utils.PYKEEN_DATASETS", tmp_path / "pykeen-cache")


def settings(graph):
    """Settings of PyKEEN's pipelines that name our dataset, model and loop."""
    names = {"dataset": "wordcraft", "model": "ComplExN3", "training_loop": "IndexedSymmetricLCWA", "device": "cpu"}
    return {
        **names,
        "dataset_kwargs": {"graph": str(graph)},
        "model_kwargs": {"embedding_dim": 4},
        "training_kwargs": {"num_epochs": 1, "batch_size": 512, "use_tqdm": False},
        "evaluation_kwargs": {"batch_size": 128, "use_tqdm": False},
    }


@pytest.mark.parametrize(
    "first",
    [
        "wordcraft_kg.models",
        pytest.param("pykeen.models", marks=pytest.mark.slow),
        pytest.param("wordcraft_kg.models.links.pykeen_bridge", marks=pytest.mark.slow),
    ],
)
def test_pykeen_knows_our_names_whichever_module_is_imported_first(first):
    code = f"import {first}\nimport wordcraft_kg.models\n{LOOK_UP}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.stdout.split(), done.stderr) == (["ComplExN3", "IndexedSymmetricLCWATrainingLoop", "WordCraft"], "")


def test_the_pipeline_trains_our_model_by_name(parted_kitchen, parted_folder):
    result = pipeline(**settings(parted_folder), loss="crossentropy", random_seed=0)
    assert isinstance(result.model, ComplExN3)
    assert [math.isfinite(loss) for loss in result.losses] == [True]
    assert 0 < result.get_metric("mrr") < 1
    assert result.training.num_triples == len(parted_kitchen.split.partial)


def test_the_pipeline_without_a_loss_is_an_error_that_says_which_loss_to_give():
    # PyKEEN's pipeline passes its own default, a margin loss, to every model, whatever the model's default is.
    with pytest.raises(ConfigError, match=r"(?i)cross.?entropy.*loss=.crossentropy."):
        pipeline(dataset="wordcraft", model="ComplExN3", training_loop="IndexedSymmetricLCWA", device="cpu")


def test_the_hpo_pipeline_takes_our_model_by_name_for_a_trial(parted_folder):
    result = hpo_pipeline(**settings(parted_folder), n_trials=1)
    (trial,) = result.study.trials
    assert trial.state.name == "COMPLETE"
    assert 0 < trial.value < 1


def test_the_dataset_holds_the_parts_of_the_graphs_split_and_keeps_its_ids(parted_kitchen, parted_folder):
    dataset = dataset_resolver.make("wordcraft", {"graph": parted_folder})
    graph, split = parted_kitchen.graph, parted_kitchen.split
    factories = (dataset.training, dataset.validation, dataset.testing)
    parts = (split.partial, split.held_out("valid"), split.held_out("test"))
    for factory, triples in zip(factories, parts, strict=True):
        assert sorted(factory.mapped_triples.tolist()) == sorted(triples.tolist())
        assert factory.entity_to_id == {name: i for i, name in enumerate(graph.entities)}
    assert dataset.training.relation_to_id == {name: i for i, name in enumerate(RELATIONS)}


def test_the_dataset_adds_inverse_triples_when_asked(parted_folder):
    plain, doubled = (
        dataset_resolver.make("wordcraft", {"graph": parted_folder, "create_inverse_triples": inverse}).training
        for inverse in (False, True)
    )
    assert (plain.num_relations, doubled.num_relations) == (2, 4)


def test_the_dataset_of_a_graph_without_test_triples_is_refused(tmp_path):
    with pytest.raises(SplitError, match="another split"):
        dataset_resolver.make("wordcraft", {"graph": write_graph(tmp_path / "unsplit", kind="none")})


def test_pykeen_sees_a_graph_that_was_built_again_in_the_same_folder(tmp_path):
    for seed in (0, 1):
        folder = write_graph(tmp_path / "graph", seed=seed)
        dataset = get_dataset(dataset="wordcraft", dataset_kwargs={"graph": str(folder)})
        partial = open_graph(folder).split.partial
        assert sorted(dataset.training.mapped_triples.tolist()) == sorted(partial.tolist())
