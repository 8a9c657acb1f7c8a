"""Refuse a pretrained model that asks for far more memory than its weights hold.

The checks come before memory is allocated: a few bytes of config.json can ask for all of it, and
the system then ends the process, or others.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.elicitation.weights import weight_files
from wordcraft_kg.base.artefacts import read_json
from wordcraft_kg.base.errors import ArtefactError

_COUNT = re.compile(r".*(layer|block|expert|group|depth|stage)(?!.*_size$).*|num_labels")
"""Names of numbers of parts, such as num_hidden_layers, n_layer or depths; block_size is a length.

transformers makes a text for each of the ``num_labels``, even for a model without classes.
"""
_MORE_PARTS = 1_024
"""Parts beyond the number of stored tensors: layers may share the tensors of one part."""
_MORE_ELEMENTS = 2**26
"""Elements beyond twice the stored ones: computed tables, and new parts such as a pooler."""


def check_counts(path: Path, config: Mapping[str, Any]) -> None:
    """Check the numbers of parts in a model's settings against its weights.

    The model is not built: even a model without values takes memory for each of its layers.

    Args:
        path: model folder or ``.gguf`` file.
        config: content of ``config.json``, or the settings in a ``.gguf`` file.

    Raises:
        ArtefactError: if a number of layers or other parts is far above the number of stored
            tensors.
    """
    limit = len(_shapes(path)) + _MORE_PARTS
    for name, value in _numbers(config):
        if value > limit and _COUNT.fullmatch(name):
            raise _too_large(path, f"{name} is {value:,}", f"at most {limit:,} for these weights")


def check_size(path: Path, build: Callable[[], Any]) -> None:
    """Check the size of a model against its weights.

    Args:
        path: model folder or ``.gguf`` file.
        build: builds the model, a torch module; called on torch's device meta, which holds no
            values.

    Raises:
        ArtefactError: if the model has far more elements than the weights.
    """
    import torch

    # Building a model draws from the global generator; its state is restored.
    with torch.random.fork_rng(devices=[]), torch.device("meta"):
        model = build()
    # Buffers count as well: tables of positions may be larger than the weights.
    tensors = [*model.parameters(), *model.buffers()]
    num_elements = sum(tensor.numel() for tensor in tensors)
    stored = sum(prod(shape) for shape in _shapes(path))
    limit = 2 * stored + _MORE_ELEMENTS
    if num_elements > limit:
        raise _too_large(path, f"config.json gives {num_elements:,} numbers", f"at most {limit:,}")


def check_modules(folder: Path) -> None:
    """Check the modules of a sentence encoder, each in a folder with settings and weights.

    Raises:
        ArtefactError: if a matrix of a module is far larger than the weights in the module's
            folder.
    """
    for file in sorted(folder.glob("*/config.json")):
        config = read_json(file)
        sizes = dict(_numbers(config)) if isinstance(config, dict) else {}
        matrix = sizes.get("in_features", 1) * sizes.get("out_features", 1)
        # Each kind of module has one of these sizes; a missing size counts as 1.
        num_elements = max(matrix, sizes.get("dimension", 1))
        stored = sum(prod(shape) for shape in _shapes(file.parent))
        if num_elements > 2 * stored + _MORE_ELEMENTS:
            raise _too_large(
                file.parent, f"config.json gives {num_elements:,} numbers", f"{stored:,}"
            )


def _too_large(path: Path, found: str, expected: str) -> ArtefactError:
    return ArtefactError(
        f"'{path}' is damaged: {found}, expected {expected}. Restore a copy of config.json and "
        "the weights."
    )


def _numbers(value: Any, name: str = "") -> Iterator[tuple[str, int]]:
    """Yield all whole numbers in settings with the name of their setting, at any depth."""
    if isinstance(value, Mapping):
        for inner_name, inner in value.items():
            yield from _numbers(inner, str(inner_name))
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _numbers(inner, name)
    elif isinstance(value, int) and not isinstance(value, bool):
        yield name, value
    # JSON may write a whole number as 1e9, which Python reads as a float.
    elif isinstance(value, float) and value > _MORE_PARTS and value == value // 1:
        yield name, int(value)


def _shapes(path: Path) -> list[Sequence[int]]:
    """Return the shapes of all stored tensors; only the heads of the files are read."""
    if path.is_file():
        from gguf import GGUFReader

        return [tuple(map(int, tensor.shape)) for tensor in GGUFReader(path).tensors]
    from safetensors import safe_open

    shapes: list[Sequence[int]] = []
    for file in weight_files(path):
        with safe_open(file, framework="numpy") as tensors:
            names = tensors.keys()
            shapes += [tensors.get_slice(name).get_shape() for name in names]
    return shapes
