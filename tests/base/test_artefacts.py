"""Reading files: what has no end is not begun, and what is not finite is not a weight."""

import os
from pathlib import Path

import pytest
import safetensors.torch
import torch

from wordcraft_kg.base.artefacts import LARGE_FILE, SMALL_FILE, read_large_file, read_small_file
from wordcraft_kg.base.errors import ArtefactError, ConfigError, RecipeFileError
from wordcraft_kg.base.tensors import read_tensors
from wordcraft_kg.graphs.book_files import MAX_BOOK_SIZE, read_book
from wordcraft_kg.models.scorers.features import make_features


def pipe(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


@pytest.fixture(params=[pipe, device, Path.mkdir])
def endless(request, tmp_path):
    """A path that must not be opened."""
    path = tmp_path / "book.csv"
    request.param(path)
    return path


@pytest.mark.parametrize("read", [read_small_file, read_large_file])
def test_only_regular_files_are_read(endless, read):
    with pytest.raises(ArtefactError, match=r"book\.csv is damaged: not a regular file"):
        read(endless)


@pytest.mark.parametrize(
    ("read", "largest"), [(read_small_file, SMALL_FILE), (read_large_file, LARGE_FILE)]
)
def test_a_file_that_is_too_large_is_not_read(tmp_path, read, largest):
    path = tmp_path / "hole"
    path.touch()
    os.truncate(path, largest + 1)
    with pytest.raises(
        ArtefactError, match=rf"hole is damaged: {largest + 1:,} bytes; the limit is {largest:,}"
    ):
        read(path)


def test_what_a_user_names_is_not_read_either_if_it_has_no_end(endless):
    with pytest.raises(RecipeFileError, match=r"not a regular file|is an empty folder"):
        read_book(endless)
    with pytest.raises((ConfigError, ArtefactError), match="expected a file"):
        make_features(str(endless), ["water"])


def test_a_book_larger_than_any_is_refused(tmp_path):
    path = tmp_path / "book.csv"
    path.touch()
    os.truncate(path, MAX_BOOK_SIZE + 1)
    with pytest.raises(RecipeFileError, match="the limit is 1,073,741,824"):
        read_book(path)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_weights_that_are_not_finite_are_refused_by_name(value):
    tensors = {"sound": torch.zeros(3), "entity_real": torch.tensor([[0.0, value]])}
    with pytest.raises(ArtefactError, match="the tensor entity_real holds NaN or infinity"):
        read_tensors(Path("model.safetensors"), safetensors.torch.save(tensors))
    del tensors["entity_real"]
    assert list(read_tensors(Path("model.safetensors"), safetensors.torch.save(tensors))) == [
        "sound"
    ]
