"""A scorer that was not trained here, and a model of PyKEEN's, in all commands that take a model
folder."""

import pytest
from frozen import frozen
from pykeen.pipeline import pipeline

from wordcraft_kg import from_pykeen, open_graph, save_scorer
from wordcraft_kg.models.scorers.baselines import NeighbourScorer


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A folder with `mine`, a scorer, and `theirs`, a model that PyKEEN's pipeline has trained."""
    home, opened, quiet = (
        tmp_path_factory.mktemp("models"),
        open_graph("kitchen"),
        {"use_tqdm": False},
    )
    mine = NeighbourScorer(opened.graph, opened.split.partial)
    save_scorer(home / "mine", mine, opened, kg="partial", origin="neighbours")
    settings = {
        "model": "DistMult",
        "model_kwargs": {"embedding_dim": 4},
        "epochs": 1,
        "random_seed": 0,
    }
    data = {"dataset": "wordcraft", "dataset_kwargs": {"graph": "kitchen"}}
    with frozen():
        result = pipeline(**data, **settings, training_kwargs=quiet, evaluation_kwargs=quiet)
    save_scorer(
        home / "theirs", from_pykeen(result.model, result.training, opened), opened, kg="partial"
    )
    return home


@pytest.mark.parametrize("name", ["mine", pytest.param("theirs", marks=pytest.mark.slow)])
def test_links_commands_take_it(printed, name, run, models, tmp_path):
    scored = printed("score", models / name, "water", "combinesWith", "flour")
    assert scored["rank_as_tail"] >= 1
    judged = printed("evaluate-links", models / name, "--out", tmp_path / "report")
    assert 0 < judged["mrr"]["all"] < 1
    assert judged["checks_passed"]
    assert not judged["has_seen_the_test_recipes"]
    page = (tmp_path / "report" / "index.html").read_text()
    assert "someone else, and saved as a model folder" in page
    compared = printed("compare", models / "mine", models / "theirs")
    assert compared["models"][1]["difference"] < 0  # an epoch teaches DistMult nothing
    options = ("--scorer", models / name, "--distractor-seeds", 1, "--distractors", 1)
    assert run("evaluate-agent", "kitchen", *options).code == 0


def test_no_training_goes_on_with_it(refused, models):
    refused("train-complex", "kitchen", "--out", models / "mine", kind="OutputExistsError")
