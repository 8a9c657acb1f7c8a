"""A kind of model from outside the package needs one line; the example's serves everything that
takes a model."""

import importlib.util
import signal
from pathlib import Path

import pytest
import torch

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.base import ArtefactError, ConfigError, NotRegisteredError, sha256_of
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.models.model_folder import MODELS, open_model
from wordcraft_kg.models.scorers.scorer_folder import load_scorer
from wordcraft_kg.runs.record import read_run
from wordcraft_kg.runs.training import train

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_model.py"


@pytest.fixture(scope="module")
def own():
    """The example, imported."""
    spec = importlib.util.spec_from_file_location("own_model", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def press(done, *_):
    if done == 5:
        signal.raise_signal(signal.SIGINT)


@pytest.fixture(scope="module")
def folder(own, tmp_path_factory):
    """A model that was interrupted and went on."""
    out = tmp_path_factory.mktemp("models") / "hubs"
    with pytest.raises(KeyboardInterrupt, match="epoch 5 is saved"):
        train(own.HubsTraining, own.HubsConfig("kitchen", epochs=20), out, progress=press)
    return train(own.HubsTraining, own.HubsConfig("kitchen", epochs=20), out)


def test_a_run_that_went_on_has_the_bits_of_one_without_interruption(own, folder, tmp_path):
    whole = train(own.HubsTraining, own.HubsConfig("kitchen", epochs=20), tmp_path / "whole")
    assert sha256_of(whole / "model.safetensors") == sha256_of(folder / "model.safetensors")
    assert len(read_run(folder).resumed) == 1


def test_it_is_opened_with_what_its_evaluation_needs(own, folder):
    model = open_model(folder)
    assert (model.kg, model.seed, model.comparable_settings) == (
        "partial",
        0,
        {"kg": "partial", "epochs": 20},
    )
    assert (model.triples == model.opened.split.partial).all()
    assert model.provenance["what it is"].startswith("how often")
    torch.testing.assert_close(
        load_scorer(folder).table("componentOf"), model.scorer.table("componentOf")
    )
    assert 0 < own.unseen_mrr(model.opened, folder) < 1


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(("evaluate-links", "{}", "--out", "report"), marks=pytest.mark.slow),
        ("score", "{}", "flour", "combinesWith", "water"),
        ("compare", "{}", "{}"),
    ],
    ids=lambda command: command[0],
)
def test_commands_take_it_like_any_other(run, folder, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    done = run(*(part.format(folder) for part in command), "--json")
    assert done.code == 0, done.err


def test_an_agent_learns_with_it_and_is_explained(run, folder, tmp_path):
    small = ("--steps", 64, "--distractors", 1)
    assert (
        run(
            "train-agent",
            "kitchen",
            "--scorer",
            folder,
            *small,
            "--out",
            tmp_path / "run",
            "--quiet",
        ).code
        == 0
    )
    explained = run("explain", tmp_path / "run", "--episodes", 1)
    assert (explained.code, "u" in explained.out) == (0, True)


def test_the_explorer_shows_it(folder):
    explored = Explored.open("kitchen", models=[folder])
    assert explored.predictor().model.kg == "partial"


def test_a_model_of_an_unknown_kind_is_refused_with_those_that_are_known(folder, monkeypatch):
    monkeypatch.delitem(MODELS, "train-hubs")
    with pytest.raises(
        NotRegisteredError,
        match=r"a model from train-hubs, which is not registered.*train-recipes.*MODELS",
    ):
        open_model(folder)


def test_its_settings_are_read_strictly(own, folder, tmp_path):
    (tmp_path / "config.toml").write_text('[train-hubs]\ngraph = "kitchen"\nepochs = "many"\n')
    with pytest.raises(ArtefactError, match=r"config.toml is damaged.*epochs"):
        own.HubsConfig.read(tmp_path)
    with pytest.raises(ConfigError, match="`force`"):
        train(own.HubsTraining, own.HubsConfig("everyday", epochs=20), folder, keep=True)


def test_a_registry_looks_for_what_is_installed_once_a_name_is_missing():
    registry = Registry("nobody.adds.to.this", {"one": 1})
    registry["two"] = 2
    assert (dict(registry), "three" in registry, len(registry)) == ({"one": 1, "two": 2}, False, 2)
    del registry["one"]
    with pytest.raises(KeyError):
        registry["one"]
