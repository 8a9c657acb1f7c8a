"""Entity vectors from a sentence encoder: the folder of vectors that ``features`` reads.

Labels are encoded in the order of their numbers of tokens, and a batch holds labels with equal
numbers. So no label is padded, and the labels' order in a graph changes nothing. Other labels in a
batch may change the last bits of float32, as a matrix product sums in an order that depends on its
size; most of it disappears in half precision. The same labels and encoder give the same bits on a
machine.
"""

import io
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.apps.elicitation.foreign_code import (
    check_counts,
    check_modules,
    check_sentence_transformers,
    check_size,
    loading,
    working,
)
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    read_json,
)
from wordcraft_kg.models.scorers.features import ENCODED
from wordcraft_kg.runs.record import write_run
from wordcraft_kg.runs.run_folder import Progress

_PART = 512
"""Labels between two reports, about a second's work; part of the result's last bits."""
_BATCH = 64
"""Most labels in a forward pass; part of the result's last bits."""


def encode_labels(
    labels: Sequence[str], path: Path, report: Progress | None = None
) -> tuple[NDArray[np.float16], dict[str, str]]:
    """Encode N labels with a sentence encoder, or with mean pooling over another transformer.

    No code of the model is run: modules that sentence-transformers does not have are refused by
    name.

    Args:
        labels: N texts.
        path: model folder that ``sentence_transformers`` loads, with weights in safetensors.
        report: called with the numbers of encoded and of all labels; None for no progress.

    Returns:
        vectors of length 1, shape (N, D), and the SHA-256 hashes of the weights by file name.

    Raises:
        MissingExtraError: if a package is missing or too old.
        ConfigError: if a label has only tokens for unknown text, and so the vector of any such
            label.
        ArtefactError: if the model is damaged, incomplete, needs code, or is far larger than its
            weights.
    """
    model, hashes = _open_encoder(path)
    lengths = [len(tokens) for tokens in _tokens(model, path, labels)]
    # The longest first: an estimate of the time left then errs on the safe side, and a lack of
    # memory shows at once. Labels of equal length by name, not by their order in a graph.
    order = sorted(range(len(labels)), key=lambda row: (-lengths[row], labels[row]))
    parts: list[NDArray[np.float16]] = []
    for start in range(0, len(order), _PART):
        rows = order[start : start + _PART]
        part_labels = [labels[row] for row in rows]
        parts.append(_vectors(model, path, part_labels, [lengths[row] for row in rows]))
        if report:
            report(start + len(rows), len(labels), {})
    ordered = np.concatenate(parts)
    vectors = np.empty_like(ordered)
    vectors[order] = ordered
    return vectors, hashes


def _tokens(model: Any, path: Path, labels: Sequence[str]) -> list[list[int]]:
    """Return the numbers of the tokens of labels, a list for each label.

    Tokenizers other than those of transformers are not known here; then characters stand in.

    Raises:
        ArtefactError: if the tokenizer fails.
        ConfigError: if a label has no token, as with an encoder for another script.
    """
    tokenizer = model.tokenizer
    if not hasattr(tokenizer, "unk_token_id"):
        return [list(map(ord, label)) for label in labels]
    with working(path):
        tokens = tokenizer(list(labels), add_special_tokens=False).input_ids
    unknown = tokenizer.unk_token_id
    for label, ids in zip(labels, tokens, strict=True):
        # All labels without a token of their own would get the same vector. A vocabulary of bytes
        # has tokens for any text.
        if unknown is not None and {*ids} <= {unknown}:
            raise ConfigError(
                f"the label '{label}' has no tokens in this encoder's vocabulary. Use an "
                "`encoder` for the labels' language, or rename the entity."
            )
    return list(tokens)


def _vectors(
    model: Any, path: Path, labels: Sequence[str], lengths: Sequence[int]
) -> NDArray[np.float16]:
    """Return the vectors of labels, ordered by their numbers of tokens, shape (N, D).

    Raises:
        ArtefactError: if the model fails, or a number is not finite.
    """
    parts = []
    # Equal numbers of tokens: padding would change the last bits with the other labels.
    for _, same_length in groupby(range(len(labels)), key=lambda row: lengths[row]):
        batch = [labels[row] for row in same_length]
        # Such as tokens beyond the rows of the weights.
        with working(path):
            part = model.encode(
                batch, batch_size=_BATCH, normalize_embeddings=True, show_progress_bar=False
            )
        parts.append(part)
    # Half precision: a vector's last bits have no meaning, and the folder is half as large.
    vectors: NDArray[np.float16] = np.concatenate(parts).astype(np.float16)
    if not np.isfinite(vectors).all():
        raise ArtefactError(
            f"'{path}' gives vectors that are not finite. Restore a copy of the weights."
        )
    return vectors


def _open_encoder(path: Path) -> tuple[Any, dict[str, str]]:
    """Return the encoder, and the hashes of its weights; see :func:`encode_labels`."""
    with loading(path, "a sentence encoder") as hashes:
        check_sentence_transformers()
        from sentence_transformers import SentenceTransformer
        from transformers import AutoConfig, AutoModel

        if not path.is_dir():
            raise ValueError("it is a file, expected a folder")
        check_modules(path)
        # The settings of the transformer lie beside modules.json, or in the folder of its module.
        for folder in (path, *(file.parent for file in path.glob("*/config.json"))):
            settings = read_json(folder / "config.json")
            check_counts(path, settings)
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
    return model, hashes


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
    buffer = io.BytesIO()
    # No pickle: the array has numbers only, and readers refuse anything else.
    np.save(buffer, vectors, allow_pickle=False)
    names = "".join(f"{label}\n" for label in labels).encode()
    files = {ENCODED: buffer.getvalue(), Path(ENCODED).with_suffix(".labels.txt").name: names}
    return write_run(out, "encode", files, inputs=inputs, force=force)
