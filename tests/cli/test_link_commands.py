"""The commands of link prediction as a user runs them: training, reports and comparisons."""

import json
import re
import shutil

import numpy as np
import pytest
from helpers import frozen, in_file
from pykeen.pipeline import pipeline
from quick import QUICK, TINY, text_of

from wordcraft_kg import from_pykeen, save_scorer
from wordcraft_kg.graphs import RELATIONS, Split, open_graph
from wordcraft_kg.models.scorers.baselines import NeighbourScorer

METRICS = ("mrr", "hits@1", "hits@3", "hits@10")

WEIGHTS = "model.safetensors"


@pytest.fixture
def workshop(trained, tmp_path):
    """A copy of the graph and the models, for a test to change."""
    shutil.copytree(trained, tmp_path / "workshop")
    return tmp_path / "workshop"


@pytest.fixture(scope="module")
def evaluated(trained, tmp_path_factory):
    """The folder of a report of ``one``, what the command printed, and what it
    printed with --json."""
    out = tmp_path_factory.mktemp("evaluated") / "report"
    command = ("evaluate-links", trained / "one", "--out", out, "--quiet")
    return out, text_of(*command), json.loads(text_of(*command, "--json", "--force"))


@pytest.mark.parametrize(
    ("command", "parameters"),
    [
        (("train-complex", *QUICK), 1_312),
        (("train-links", "--model", "SimplE", *TINY, "--negatives", 2), 1_312),
    ],
)
def test_a_quiet_training_prints_one_object_and_nothing_on_stderr(
    run, tmp_path, command, parameters
):
    name, *options = command
    outcome = run(name, "kitchen", *options, "--out", tmp_path / "model", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    values = json.loads(outcome.out)
    expected = {
        "out": str(tmp_path / "model"),
        "kg": "partial",
        "epochs": 4,
        "parameters": parameters,
    }
    assert values.items() >= expected.items()
    assert 0 < values["train_mrr"] < 1
    assert values["seconds"] > 0
    assert (tmp_path / "model" / WEIGHTS).is_file()


def test_models_go_to_a_folder_of_their_own_by_default(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run("train-complex", "kitchen", *QUICK, "--kg", "full")
    run("train-links", "kitchen", *TINY, "--model", "DistMult", "--loop", "symmetric")
    assert sorted(path.name for path in (tmp_path / "models").iterdir()) == [
        "kitchen-distmult-partial",
        "kitchen-full",
    ]


def test_a_model_that_hardly_fits_is_told_to_train_longer(run, tmp_path, caplog):
    name = "train-complex"
    least = ("--dim", 1, "--epochs", 1, *in_file(name, learning_rate=1e-6), "--folds", 0, "--quiet")
    assert run(name, "kitchen", "--n3", 0.1, *least, "--out", tmp_path / "model").code == 0
    (warning,) = (message for message in caplog.messages if "hardly fits" in message)
    assert warning.endswith("try more --epochs.")


def test_evaluate_links_prints_one_object_with_baselines(evaluated, trained):
    """Evaluate links prints one object with the headline and its baselines."""
    values = evaluated[2]
    assert {"all", *RELATIONS} <= set(values["metrics"])
    for metrics in values["metrics"].values():
        assert all(0 <= metrics[metric] <= 1 for metric in METRICS)
    assert set(values["baselines"]) == {"frequency", "votes", "neighbours", "random"}
    split = open_graph(trained / "graph").split
    assert values["queries"] == 2 * len(split.held_out("test"))
    assert values["leaked_left_out"] == len(split.triples_of("test")) - len(split.held_out("test"))
    folder, text, _ = evaluated
    assert all(
        part in text
        for part in ("leaked ones left out", "with leaked", "frequency", "random", "index.html")
    )
    mrr = values["metrics"]["all"]["mrr"]
    assert f"{mrr:.3f}" in (folder / "index.html").read_text(encoding="utf-8")
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report | {"report": str(folder / "index.html")} == values
    assert values["provenance"]["trained by"]
    assert (folder / "ranks.csv").is_file()


def test_a_leak_is_an_exit_code_of_1_and_said_on_stderr(run, trained, tmp_path, monkeypatch):
    monkeypatch.setattr(Split, "held_out", lambda self, part: self.triples_of(part))
    outcome = run("evaluate-links", trained / "one", "--out", tmp_path / "report", "--json")
    assert outcome.code == 1
    assert "CHECK FAILED: no evaluated triple is in the training triples" in outcome.err
    checks = {check["id"]: check["passed"] for check in json.loads(outcome.out)["checks"]}
    assert not checks["leak"]


def test_compare_links_prints_one_object_with_the_paired_difference(
    printed, run, evaluated, trained
):
    command = ("compare", *(trained / name for name in ("one", "two", "links")))
    values = printed(*command)
    assert {"graph", "queries", "triples", "models", "best"} <= set(values)
    one, two, seeds = values["models"]
    assert (one["name"], two["name"], seeds["name"], seeds["seeds"]) == (
        "one",
        "two",
        "links",
        [0, 3],
    )
    assert [one[metric] for metric in METRICS] == [
        evaluated[2]["metrics"]["all"][metric] for metric in METRICS
    ]
    assert two["difference"] == pytest.approx(two["mrr"] - one["mrr"])
    assert two["difference_ci"][0] <= two["difference"] <= two["difference_ci"][1]
    assert "difference" not in one
    assert seeds["mrr"] == pytest.approx(np.mean(seeds["mrr_of_seeds"]))
    text = run(*command).out
    assert re.search("\nlinks +2 ", text)
    assert "has seen these triples" not in text
    assert "; no significant difference: " in run("compare", trained / "one", trained / "one").out


def test_models_of_one_name_are_told_apart_by_their_paths(printed, workshop):
    shutil.copytree(workshop / "two", workshop / "copies" / "one")
    paths = [workshop / "one", workshop / "copies" / "one"]
    values = printed("compare", *paths, "--graph", workshop / "graph")
    assert [model["name"] for model in values["models"]] == [str(path) for path in paths]


def test_several_models_are_compared_with_the_first_on_a_page(
    printed, refused, run, trained, tmp_path
):
    page = tmp_path / "new" / "comparison.html"
    command = ("compare", *(trained / name for name in ("one", "two", "full")), "--out", page)
    text = run(*command).out.splitlines()
    # The best first, on the page, too; the first model of the command is the reference.
    names = [line.split()[0] for line in text[1:4]]
    places = [line.split()[2] for line in text[1:4]]
    assert sorted(names) == ["full", "one", "two"]
    assert places == sorted(places, reverse=True)
    assert "; differences to one, widened for 3 pairs of models (Bonferroni)" in text[4]
    assert re.findall(r'<th scope="row">(\w+)', page.read_text()) == names
    assert "has seen these triples" in text[5]
    assert text[-1] == f"wrote {page}   open {page}"
    assert "3 link predictors on the same queries" in page.read_text()
    before = page.read_bytes()
    refused(*command, says="--force", kind="OutputExistsError")
    assert page.read_bytes() == before
    assert printed(*command, "--force")["best"]
    assert page.read_bytes() == before


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
    assert scored["answers"][0]["ranks"]["tail"] >= 1
    judged = printed("evaluate-links", models / name, "--out", tmp_path / "report")
    assert 0 < judged["metrics"]["all"]["mrr"] < 1
    assert all(check["passed"] for check in judged["checks"])
    assert not judged["model"]["has_seen_the_test_recipes"]
    page = (tmp_path / "report" / "index.html").read_text()
    assert "someone else, and saved as a model folder" in page
    compared = printed("compare", models / "mine", models / "theirs")
    assert compared["models"][1]["difference"] < 0  # an epoch teaches DistMult nothing
    options = ("--scorer", models / name, "--distractor-seeds", 1, "--distractors", 1)
    assert run("evaluate-agent", "kitchen", *options).code == 0
