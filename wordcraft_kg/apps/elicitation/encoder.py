"""Entity vectors from a sentence encoder: the folder of vectors that ``features`` reads."""

import io
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.elicitation.foreign_code import (
    check_model_files,
    check_sentence_transformers,
)
from wordcraft_kg.apps.elicitation.sizes import check_counts, check_modules, check_size
from wordcraft_kg.apps.elicitation.weights import hash_weights, loading
from wordcraft_kg.base.artefacts import read_json, staged_folder, with_a_name, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.models.scorers.features import ENCODED
from wordcraft_kg.runs.folder import Progress
from wordcraft_kg.runs.record import end_run, start_run

_CHUNK = 256
"""Labels between two reports of progress."""


def encode_labels(
    labels: Sequence[str], path: Path, report: Progress | None = None
) -> tuple[NDArray[np.float16], dict[str, str]]:
    """Encode N labels with a sentence encoder, or with mean pooling over another transformer.

    No code of the model is run: modules that sentence-transformers does not have are refused by
    name.

    Args:
        labels: N texts.
        path: model folder that ``sentence_transformers`` loads, with weights in safetensors.
        report: called with the numbers of encoded and of all labels, and no metrics.

    Returns:
        vectors of length 1, shape (N, D), and the SHA-256 hashes of the weights by file name.

    Raises:
        MissingExtraError: if a package is missing or too old.
        ConfigError: if a label has only tokens for unknown text, and so the vector of any such
            label.
        ArtefactError: if the model is damaged, incomplete, needs code, or is far larger than its
            weights.
    """
    check_extra("text")
    check_sentence_transformers()
    check_model_files(path)
    hashes = hash_weights(path)
    with loading(path, "a sentence encoder"):
        import torch
        from sentence_transformers import SentenceTransformer
        from transformers import AutoConfig, AutoModel

        if not path.is_dir():
            raise ValueError("it is a file, expected a folder")
        check_modules(path)
        # The settings of the transformer lie beside modules.json, or in the folder of its module.
        for folder in (path, *(file.parent for file in path.glob("*/config.json"))):
            settings = read_json(folder / "config.json")
            check_counts(path, settings if isinstance(settings, dict) else {})
            if "model_type" in settings:
                config = AutoConfig.from_pretrained(str(folder), trust_remote_code=False)
                check_size(path, partial(AutoModel.from_config, config, trust_remote_code=False))
        # Said to each loader again: a folder's own settings could otherwise decide.
        options = {
            "dtype": torch.float32,
            "use_safetensors": True,
            "weights_only": True,
            "trust_remote_code": False,
        }
        model = SentenceTransformer(
            str(path),
            device="cpu",
            trust_remote_code=False,
            # Never ask the hub, even if a file of the folder names a model there.
            local_files_only=True,
            model_kwargs=options,
            processor_kwargs={"trust_remote_code": False},
            config_kwargs={"trust_remote_code": False},
        )
    _check_tokens(model.tokenizer, labels)
    # In chunks, for the report of progress.
    parts = []
    for start in range(0, len(labels), _CHUNK):
        some = list(labels[start : start + _CHUNK])
        parts.append(model.encode(some, normalize_embeddings=True, show_progress_bar=False))
        if report:
            report(start + len(some), len(labels), {})
    # Half precision: the last bits of a vector have no meaning, and the folder is half as large.
    vectors = np.concatenate(parts).astype(np.float16)
    if not np.isfinite(vectors).all():
        raise ArtefactError(
            f"'{path}' gives vectors that are not finite. Restore a copy of the weights."
        )
    return vectors, hashes


def _check_tokens(tokenizer: Any, labels: Sequence[str]) -> None:
    """Check that each label has a token of its own.

    All labels without one would get the same vector, as if they were the same entity.
    """
    unknown = getattr(tokenizer, "unk_token_id", None)
    if unknown is None:  # a vocabulary of bytes has tokens for any text
        return
    for label in labels:
        if {*tokenizer(label, add_special_tokens=False).input_ids} <= {unknown}:
            raise ConfigError(
                f"the label '{label}' has no tokens in this encoder's vocabulary. Use an "
                "`encoder` for the labels' language, or rename the entity."
            )


def vector_files(labels: Sequence[str], vectors: NDArray[np.float16]) -> dict[str, bytes]:
    """Return the files of a folder of vectors, by name: vectors, shape (N, D), and the N labels."""
    buffer = io.BytesIO()
    # No pickle: the array has numbers only, and readers refuse anything else.
    np.save(buffer, vectors, allow_pickle=False)
    names = "".join(f"{label}\n" for label in labels).encode()
    return {ENCODED: buffer.getvalue(), Path(ENCODED).with_suffix(".labels.txt").name: names}


def write_vectors(
    out: Path,
    labels: Sequence[str],
    vectors: NDArray[np.float16],
    *,
    inputs: Mapping[str, str],
    force: bool = False,
) -> Path:
    """Write a folder of vectors, for the option ``--features``.

    Args:
        out: folder to write.
        labels: N labels.
        vectors: their vectors, shape (N, D).
        inputs: hashes of graphs and weights by name, for the record.
        force: replace an existing output.

    Returns:
        The folder.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    folder = with_a_name(out)
    with staged_folder(folder, force=force) as staging:
        files = vector_files(labels, vectors)
        for name, content in files.items():
            write_atomically(staging / name, content)
        end_run(staging, start_run(staging, "encode", inputs=inputs), "done", tuple(files))
    return folder
