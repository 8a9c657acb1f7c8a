"""Files of a pretrained model: path, SHA-256 hashes, and errors of damaged files."""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path

from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import ArtefactError, ConfigError, WordCraftKGError, reason

_ENDINGS = (".safetensors", ".bin")
_NOT_NEEDED = ("onnx/*", "openvino/*", "*.h5", "*.ot", "*.msgpack", "*.onnx", "*.gguf")
"""Weights in the formats of other libraries, in folders on the Hugging Face hub."""


def locate_model(setting: str, name: str) -> Path:
    """Return a model's path, perhaps after a download from the hub; ConfigError naming ``setting`` otherwise."""
    if os.path.exists(name):
        return Path(name)
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(name, ignore_patterns=list(_NOT_NEEDED)))
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"`{setting}` '{name}' is not on disk, and cannot be downloaded from the hub ({reason(error)}). Give the "
            "path of a model folder with config.json and weights."
        ) from None


def hash_weights(path: Path) -> dict[str, str]:
    """Return SHA-256 hashes of a model's weights by file name; ArtefactError without weights or config.json."""
    if path.is_file():
        return {path.name: sha256_of(path)}
    files = [
        file
        for pattern in ("*", "*/*")
        for file in sorted(path.glob(pattern))
        if file.suffix in _ENDINGS
    ]
    if not files or not (path / "config.json").is_file():
        missing = "config.json" if files else "weights (*.safetensors or *.bin)"
        raise ArtefactError(
            f"'{path}' has no {missing}; expected the folder of a pretrained model. Download the whole folder."
        )
    return {file.relative_to(path).as_posix(): sha256_of(file) for file in files if file.is_file()}


@contextmanager
def loading(path: Path, expected: str) -> Iterator[None]:
    """Load a model without bars and warnings; ArtefactError if it is damaged or not of the ``expected`` kind."""
    try:
        with redirect_stderr(io.StringIO()):
            yield
    except WordCraftKGError:
        raise
    except Exception as error:  # libraries report damaged files by errors of many classes
        raise ArtefactError(
            f"'{path}' cannot be loaded as {expected}: {reason(error)}. Give another model, or restore a copy."
        ) from None
