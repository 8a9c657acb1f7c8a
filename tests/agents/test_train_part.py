"""Trainings on two books that differ in held-out results alone: equal to the bit."""

import json
from functools import partial

import pytest
import torch
from permuted import split_of, with_other_results, write_opened
from safetensors.torch import load_file
from short_fits import short_fits

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    TaskConfig,
    open_graph,
    train_agent,
)
from wordcraft_kg.agents import training
from wordcraft_kg.agents.plan_weights import fit_plan_weights
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.links.training import train_links
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.training import train_recipes

KINDS = (
    "by-goal",
    *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("by-recipe", "by-slot")),
)


@pytest.fixture(scope="module", params=KINDS)
def graphs(request, tmp_path_factory):
    """Folders of the kitchen, and of the kitchen with other held-out results."""
    opened = split_of(open_graph("kitchen").graph, request.param)
    both = (opened, with_other_results(opened, 1))
    assert len({each.graph.hash for each in both}) == 2
    parent = tmp_path_factory.mktemp("graphs")
    return [write_opened(each, parent / str(i) / "kitchen") for i, each in enumerate(both)]


@pytest.fixture(scope="module")
def links(graphs, tmp_path_factory):
    """ComplEx on the partial graph, with folds."""
    settings = ComplExConfig(dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3)
    return made(
        graphs, tmp_path_factory, lambda graph, out: train_links(LinksConfig(graph, settings), out)
    )


@pytest.fixture(scope="module")
def recipes(graphs, tmp_path_factory):
    settings = RecipeScorerConfig(folds=3, features="one-hot")
    with short_fits():
        return made(
            graphs,
            tmp_path_factory,
            lambda graph, out: train_recipes(RecipesConfig(graph, settings), out),
        )


def made(graphs, tmp_path_factory, train):
    parent = tmp_path_factory.mktemp("trained")
    for i, graph in enumerate(graphs):
        train(str(graph), parent / str(i))
    return [parent / str(i) for i in range(len(graphs))]


def assert_same_tensors(folders, names):
    for name in names:
        one, other = (load_file(folder / name) for folder in folders)
        assert one.keys() == other.keys()
        for key, tensor in one.items():
            # Folds of the recipes, numbered in the book: held-out recipes have the fold -1.
            is_train = tensor >= 0 if key.endswith("of_recipe") else torch.ones_like(tensor) > 0
            in_other = other[key] >= 0 if key.endswith("of_recipe") else is_train
            assert torch.equal(tensor[is_train], other[key][in_other]), (name, key)


@pytest.mark.parametrize("kind", ["links", pytest.param("recipes", marks=pytest.mark.slow)])
def test_no_scorer_depends_on_held_out_results(request, graphs, kind):
    folders = request.getfixturevalue(kind)
    assert_same_tensors(folders, ("model.safetensors", "folds.safetensors"))
    one, other = ((folder / "calibration.json").read_bytes() for folder in folders)
    assert one == other


@pytest.mark.parametrize(
    ("scorer", "use"),
    [("links", "u,v"), pytest.param("recipes", "u,v,w,p", marks=pytest.mark.slow)],
)
def test_no_agent_depends_on_held_out_results(graphs, scorer, use, request, tmp_path, monkeypatch):
    """With p there are weights of plans, which are learned from play."""
    monkeypatch.setattr(training, "MOST_TASKS", 20)
    monkeypatch.setattr(training, "CURVE_TASKS", 20)
    monkeypatch.setattr(training, "fit_plan_weights", partial(fit_plan_weights, tasks=100))
    folders = []
    for i, graph in enumerate(graphs):
        trainer = ImpalaConfig(steps=256, batch_size=16, tables=32, log_every=64)
        tasks = TaskConfig(depth=2, distractors=3)
        model = request.getfixturevalue(scorer)[i]
        config = AgentConfig(str(graph), str(model), tasks, PolicyConfig(use=use), trainer)
        folders.append(train_agent(config, tmp_path / str(i)).folder)
    assert_same_tensors(folders, ("policy.safetensors", "constants.safetensors"))
    logs = []
    for folder in folders:
        lines = map(json.loads, (folder / "metrics.jsonl").read_text().splitlines())
        apart = ("seconds", "steps_per_second", "test_success")
        logs.append([{k: v for k, v in line.items() if k not in apart} for line in lines])
    assert logs[0] == logs[1]
