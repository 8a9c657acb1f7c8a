"""Tiny graphs and models that are trained once a session."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from link_helpers import train

from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig


@pytest.fixture(scope="session")
def complex_folder(opened_kitchen: OpenedGraph, made_once) -> Path:
    """A ComplEx model of the kitchen; read only, see `spoilt`."""
    config = ComplExConfig(dim=8, epochs=4, n3=0.1, folds=0)
    return made_once("complex/kitchen", lambda out: train(opened_kitchen, config, out))


@pytest.fixture(scope="session")
def distmult_folder(opened_kitchen: OpenedGraph, made_once) -> Path:
    """A model whose scorer is a table; read only."""
    config = LinkModelConfig(model="distmult", loop="symmetric", dim=4, epochs=2, folds=0)
    return made_once("distmult/kitchen-distmult", lambda out: train(opened_kitchen, config, out))


@pytest.fixture
def spoilt(complex_folder: Path, tmp_path: Path) -> Callable[[str], tuple[Path, Path]]:
    """Copy the ComplEx model and return the copy, with the path of one of its files, for a test to damage."""

    def copy(name: str) -> tuple[Path, Path]:
        folder = tmp_path / "copy"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(complex_folder, folder)
        return folder, folder / name

    return copy
