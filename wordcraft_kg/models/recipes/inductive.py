"""Inductive link prediction: score entities outside the graph by label words.

A recipe scorer follows from recipes, label words and a few weights. An entity without recipes has
words alone, and similar words predict similar recipes.

The page docs/explanation/recipe-scorer.md explains it under *New entities*.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base import ArtefactError, FeatureSpec, UnknownEntityError, nearest
from wordcraft_kg.graphs.recipes import check_label
from wordcraft_kg.models.knowledge.books import ids_among
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.features import ENCODE, EntityFeatures, make_features, named
from wordcraft_kg.models.scorers.neighbours.lists import nearest_words
from wordcraft_kg.models.scorers.neighbours.storage import named_weights
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.record import RunFiles, read_finished_run

_NEAREST = 8
"""Labels whose sentence vectors stand for that of a new label."""
_POWER = 4
"""Power of their cosines: the nearest ones count."""


def extended(
    scorer: RecipeScorer,
    labels: Sequence[str],
    vectors: NDArray[np.floating],
) -> RecipeScorer:
    """Return a copy of a recipe scorer that scores n more entities, described by words alone.

    Old entities keep their lists, and so their scores up to rounding; the lists of new entities
    name old and new ones.

    Args:
        scorer: scores E entities, without outside knowledge.
        labels: the new entities, each once, which get ids from E on.
        vectors: their unit word vectors, shape (n, D).

    Raises:
        RecipeFileError: if a label is invalid.
    """
    entities = (*scorer.entities, *(check_label(label, "a new entity") for label in labels))
    constants = scorer.knowledge.constants()
    old = constants["vectors"].cpu()
    # Half precision, as the vectors of old entities are stored.
    every = torch.cat([old, torch.from_numpy(vectors.astype(np.float16))])
    size = len(scorer.entities)
    near = constants["near_words"].cpu()
    new_neighbours = nearest_words(every.float().numpy(), near.shape[1], first=size)
    near_words = torch.cat([near, torch.from_numpy(new_neighbours)])
    num_own = torch.tensor([len(entities)], dtype=torch.int32)
    tensors = {"num_own": num_own, "vectors": every, "near_words": near_words}
    if scorer.knowledge.has_encoder:
        encoder = scorer.knowledge.encoder()
        new_vectors = every[size:].float().to(encoder.bias.device)
        tensors |= named_weights(encoder.with_entities(new_vectors), "encoder_")
    return RecipeScorer(
        constants | tensors,
        entities,
        f"{scorer.graph_hash} and {len(labels)} more",
        device=scorer.device,
        name=scorer.name,
    )


class LabelledScorer(NamedTuple):
    """A recipe scorer for the labels of any book.

    Attributes:
        scorer: scores all labels.
        own: number of entities that the model was trained on; ids from this one on are described by
            words alone.
        rows: the scorer's id for each label, shape (n,).
    """

    scorer: RecipeScorer
    own: int
    rows: NDArray[np.int64]


def for_labels(folder: str | Path, scorer: Scorer, labels: Sequence[str]) -> LabelledScorer:
    """Return a copy of a model's scorer for the labels of any book.

    Args:
        folder: the model's folder, written by ``train-recipes``.
        scorer: the folder's scorer, a recipe scorer or a cross-fitted one.
        labels: n labels; those without a vector are described by zeros.

    Raises:
        ConfigError: if the model's vector file is missing or damaged.
        UnknownEntityError: if there are new labels, and the model uses no words, or outside
            knowledge.
        ArtefactError: if the folder is damaged, or the word vectors have changed.
    """
    main = cast("RecipeScorer", whole_of(scorer))
    num_trained = len(main.entities)
    ids = ids_among(main.entities, labels)
    new = [label for label, row in zip(labels, ids.tolist(), strict=True) if row >= num_trained]
    labelled = with_words(folder, scorer, new, allow_missing=True) if new else main
    return LabelledScorer(labelled, num_trained, ids)


def with_words(
    folder: str | Path,
    scorer: Scorer,
    labels: Sequence[str],
    *,
    allow_missing: bool = False,
) -> RecipeScorer:
    """Return a copy of a model's scorer that scores new entities by the words in the labels.

    For a model with the built-in ``minilm`` vectors, a label outside the built-in books gets the
    mean vector of the labels that GloVe finds most similar.

    Args:
        folder: the model's folder, written by ``train-recipes``.
        scorer: the folder's scorer.
        labels: the new entities, without duplicates, none of which the scorer knows.
        allow_missing: use zeros for labels without a vector.

    Raises:
        UnknownEntityError: if the model is no recipe scorer, uses no words, or outside knowledge,
            or a label has no vector.
        ArtefactError: if the folder is damaged, or the word vectors have changed.
        ConfigError: if the model's vector file is missing or damaged.
        RecipeFileError: if a label is invalid.

    Example:
        >>> trained = load_scorer("models/kitchen-recipes")
        >>> scorer = with_words("models/kitchen-recipes", trained, ["pancake"])
        >>> scorer.score("flour", "componentOf", "pancake").shape
        torch.Size([])
    """

    def unknown(label: str, reason: str) -> UnknownEntityError:
        return UnknownEntityError(f"no entity '{label}'.{nearest(label, scorer.entities)} {reason}")

    folder = Path(folder)
    run = read_finished_run(folder, "a model of train-recipes", "model.safetensors")
    main = whole_of(scorer)
    if not isinstance(main, RecipeScorer) or run.kind != RecipeScorerConfig.command:
        raise unknown(
            labels[0],
            "This model knows only the graph's entities; a model of pairs from `wordcraft-kg "
            "train-recipes` scores new entities by words, a model of sets whole recipes, such as "
            "a + b -> c.",
        )
    # Reading the file compares its hash with the record.
    RunFiles(folder, run).bytes(CONFIG_FILE)
    settings = RecipesConfig.read(folder).settings
    if settings.with_:
        raise unknown(
            labels[0],
            "A model with outside knowledge (`with`) scores only the graph's entities; one that is "
            "trained without scores new entities by words.",
        )
    size = len(scorer.entities)
    words = named(settings.features, scorer.entities)
    spec = FeatureSpec.parse(words)
    if spec.prefix or spec.source in ("one-hot", "random"):
        vectors_say = "the words of other entities" if spec.prefix else "no words"
        raise unknown(
            labels[0],
            f"The model uses `features` {words}, which give {vectors_say}; train with glove or "
            "a vector file.",
        )
    every = (*scorer.entities, *labels)
    features = make_features(words, every, allow_missing=True)
    # The old entities' vectors alone, as in the training: their hash is in the record.
    before = replace(
        features,
        vectors=features.vectors[:size].copy(),
        known=features.known[:size].copy(),
    )
    if before.sha256 != run.inputs.get("features"):
        raise ArtefactError(
            f"`features` {words} have changed since '{folder}' was trained, so new words cannot be "
            "compared with the entities. Restore the vector file, or train again."
        )
    vectors = features.unit_vectors
    has_vector = features.known
    if words == "minilm":
        vectors, has_vector = _completed(features, every)
    # The error names the first label without a vector.
    for label, is_known in zip(labels, has_vector[size:], strict=True):
        if not (is_known or allow_missing):
            raise unknown(
                label,
                f"No word in this label has a vector in {words}. Train with glove, or with vectors "
                f"of the graph and this label, `{ENCODE} --labels LABEL`.",
            )
    return extended(main, labels, vectors[size:])


def _completed(
    features: EntityFeatures,
    labels: Sequence[str],
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return unit vectors (N, D), and whether each label has one, (N,).

    Labels without built-in sentence vectors, which only the built-in books' labels have, get the
    mean vector of the labels that GloVe finds most similar, weighted by these cosines to the power
    :data:`_POWER`.

    Args:
        features: the built-in sentence vectors.
        labels: the N labels.
    """
    glove = make_features("glove", labels, allow_missing=True)
    is_known = features.known
    vectors = features.unit_vectors.copy()
    new = np.flatnonzero(~is_known & glove.known)
    cosines = glove.unit_vectors[new] @ glove.unit_vectors[is_known].T
    weights = np.maximum(cosines, 0) ** _POWER
    # All but the largest weights of a row are 0.
    number = min(_NEAREST, weights.shape[1])
    thresholds = np.partition(weights, -number, axis=1)[:, -number, None]
    is_near = weights >= thresholds
    mean = (weights * is_near) @ vectors[is_known]
    norms = np.linalg.norm(mean, axis=1, keepdims=True)
    vectors[new] = mean / np.maximum(norms, np.finfo(np.float32).tiny)
    return vectors, is_known | glove.known
