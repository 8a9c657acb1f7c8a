"""Tiny graphs and models that are trained once a session."""

import shutil

import pytest
from link_helpers import train

from wordcraft_kg.models.links.link_config import ComplExConfig, LinkModelConfig


@pytest.fixture(scope="session")
def complex_folder(opened_kitchen, made_once):
    """A ComplEx model of the kitchen; read only, see `spoilt`."""
    config = ComplExConfig(dim=8, epochs=4, n3=0.1, folds=0)
    return made_once("complex/kitchen", lambda out: train(opened_kitchen, config, out))


@pytest.fixture(scope="session")
def folded(opened_kitchen, made_once):
    """A cross-fitted ComplEx model of the kitchen; read only."""
    config = ComplExConfig(dim=8, epochs=4, n3=0.1, popularity=1.0, folds=3)
    return made_once("folded/kitchen", lambda out: train(opened_kitchen, config, out))


@pytest.fixture(scope="session")
def distmult_folder(opened_kitchen, made_once):
    """A model whose scorer is a table; read only."""
    config = LinkModelConfig(model="distmult", loop="symmetric", dim=4, epochs=2, folds=0)
    return made_once("distmult/kitchen-distmult", lambda out: train(opened_kitchen, config, out))


@pytest.fixture
def spoilt(complex_folder, tmp_path):
    """Copy the ComplEx model and return the copy, with the path of one of its files, for a test to
    damage."""

    def copy(name):
        folder = tmp_path / "copy"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(complex_folder, folder)
        return folder, folder / name

    return copy
