"""Files of a pretrained model: path, SHA-256 hashes, and errors of damaged files."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

from wordcraft_kg.base.artefacts import sha256_of
from wordcraft_kg.base.errors import ArtefactError, ConfigError, WordCraftKGError, reason

_FORMATS = ("onnx/*", "openvino/*", "*.h5", "*.ot", "*.msgpack", "*.onnx", "*.gguf")
"""Weights in the formats of other libraries, in folders on the Hugging Face hub."""
_CODE = ("*.py", "*.pyc", "*.so", "*.bin", "*.pt", "*.pth", "*.pkl", "*.pickle", "*.ckpt")
"""Programs and pickles: no file of a model that runs code is needed here."""


def locate_model(setting: str, name: str) -> Path:
    """Return a model's path, after a download from the hub if it is not on disk.

    Files of other libraries are not downloaded, nor programs and pickles.

    Args:
        setting: name of the setting, for the error.
        name: path, or name on the Hugging Face hub.

    Raises:
        ConfigError: if there is no such path, and the model cannot be downloaded.
    """
    if os.path.exists(name):
        return Path(name)
    # Imported late: a model on disk needs no client of the hub.
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(name, ignore_patterns=[*_FORMATS, *_CODE]))
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"`{setting}` '{name}' is not on disk, and cannot be downloaded from the hub "
            f"({reason(error)}). Give the path of a model folder with config.json and weights."
        ) from None


def hash_weights(path: Path) -> dict[str, str]:
    """Return SHA-256 hashes of a model's weights by file name.

    Names are relative to the folder, so that a record tells nothing of the machine.

    Args:
        path: folder of a pretrained model; or a single file with all weights, such as ``.gguf``.

    Raises:
        ArtefactError: if the folder has no weights in safetensors, or no config.json.
    """
    if path.is_file():
        return {path.name: sha256_of(path)}
    files = weight_files(path)
    if not files or not (path / "config.json").is_file():
        missing = "config.json" if files else "weights (*.safetensors)"
        raise ArtefactError(
            f"'{path}' has no {missing}; expected the folder of a pretrained model. Download the "
            "whole folder."
        )
    return {file.relative_to(path).as_posix(): sha256_of(file) for file in files}


def weight_files(folder: Path) -> list[Path]:
    """Return the safetensors files of a model folder, and of its modules in folders inside."""
    files = sorted(folder.glob("*")) + sorted(folder.glob("*/*"))
    return [file for file in files if file.suffix == ".safetensors" and file.is_file()]


@contextmanager
def loading(path: Path, expected: str) -> Iterator[None]:
    """Load a model without bars, warnings and questions.

    Args:
        path: the model, for errors.
        expected: kind of model in words, such as "a sentence encoder".

    Raises:
        ArtefactError: if the model is damaged, not of the ``expected`` kind, or needs code of its
            own.
    """
    stdin = sys.stdin
    try:
        # A library that asks "run the custom code? [y/N]" reads no answer, whatever stands in a
        # pipe.
        sys.stdin = io.StringIO()
        with (
            redirect_stderr(io.StringIO()),
            redirect_stdout(io.StringIO()),
            working(path, f"cannot be loaded as {expected}"),
        ):
            yield
    finally:
        sys.stdin = stdin


@contextmanager
def working(path: str | Path, problem: str = "fails") -> Iterator[None]:
    """Turn errors of the libraries that load or use a model into one that names the model.

    Args:
        path: the model.
        problem: what an error means, in words.

    Raises:
        ArtefactError: for any error but those of this package.
    """
    try:
        yield
    except WordCraftKGError:
        raise
    except BaseException as error:  # libraries report damaged files by errors of many classes
        # A panic of the tokenizers, which are written in Rust, is no Exception.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        # The only sign of this cause, which needs another remedy than a damaged file.
        if "trust_remote_code" in str(error):
            raise ArtefactError(
                f"'{path}' needs its own Python code, and code of a model is never run. Give a "
                "model that transformers itself knows."
            ) from None
        raise ArtefactError(
            f"'{path}' {problem}: {reason(error)}. Give another model, or restore a copy."
        ) from None
