"""Inductive link prediction: score entities outside the graph by label words.

A recipe scorer follows from recipes, label words and a few weights. An entity without recipes has
words alone, and similar words predict similar recipes.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ArtefactError, ConfigError, UnknownEntityError
from wordcraft_kg.base.feature_spec import FeatureSpec
from wordcraft_kg.base.labels import LabelIndex
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.recipes import check_label
from wordcraft_kg.models.recipes.base import Base
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.fitting import knowledge_from, scorer_tensors
from wordcraft_kg.models.scorers.config import check_dense
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.features import ENCODE, EntityFeatures, make_features, named
from wordcraft_kg.models.scorers.kernel import cosines
from wordcraft_kg.models.scorers.neighbours.lists import nearest_words
from wordcraft_kg.models.scorers.neighbours.scorer import NeighbourRecipeScorer
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import read_finished_run


def extended(scorer: Scorer, labels: Sequence[str], text: Tensor) -> RecipeScorer:
    """Return a copy of a recipe scorer that scores n more entities, described by words alone.

    Recipes and rankers stay, and old entities keep the same scores, up to rounding in 16-bit
    tables.

    Args:
        scorer: scores E entities; of a cross-fitted scorer, the main scorer is extended.
        labels: the new entities, which get ids from E on.
        text: word vector cosines by id, shape (E + n, E + n).

    Raises:
        ConfigError: if the scorer has another kind, a label is invalid or known, or there are too
            many entities.
        ArtefactError: if the link rankers do not fit the link features.
    """
    whole = whole_of(scorer)
    if not isinstance(whole, RecipeScorer):
        raise _other_kind(scorer)
    entities = _with_labels(whole, labels)
    if text.shape != (len(entities), len(entities)):
        raise ConfigError(
            f"text has shape {tuple(text.shape)}; expected word cosines for all {len(entities)} "
            "entities."
        )
    check_dense("a recipe scorer", len(entities))
    combines, component = (Ranker(**weights) for weights in whole.link_rankers.values())
    rankers = (combines, component)
    recipes = whole.recipes.numpy().astype("int64")
    try:
        knowledge = knowledge_from(Base.of(recipes, text), rankers)
    except RuntimeError:  # matrix shapes do not match
        raise ArtefactError(
            f"the link rankers in {scorer.name} are damaged. Train the model again."
        ) from None
    constants = whole.knowledge.constants()
    # The first axis is that of the models, and the main scorer has one.
    weights = {name: constants[name][0].cpu() for name in constants if name in RANKER}
    knowledge = knowledge.with_ranker(Ranker(**weights))
    return RecipeScorer(
        scorer_tensors(knowledge, rankers, recipes),
        entities,
        f"{whole.graph_hash} and {len(labels)} more",
        device=whole.device,
        name=scorer.name,
    )


def extended_lists(
    scorer: NeighbourRecipeScorer,
    labels: Sequence[str],
    vectors: NDArray[np.floating],
) -> NeighbourRecipeScorer:
    """Return a copy of a scorer by neighbour lists that scores n more entities.

    Old entities keep their lists, and so their scores up to rounding; the lists of new entities
    name old and new ones.

    Args:
        scorer: scores E entities.
        labels: the new entities, which get ids from E on.
        vectors: their unit word vectors, shape (n, D).

    Raises:
        ConfigError: if a label is invalid or known.
    """
    constants = scorer.knowledge.constants()
    # Half precision, as the vectors of old entities are stored.
    new = torch.from_numpy(vectors.astype(np.float16))
    every = torch.cat([constants["vectors"].cpu(), new])
    size = len(scorer.entities)
    near = constants["near_words"].cpu()
    of_new = nearest_words(every.float().numpy(), near.shape[1], first=size)
    near_words = torch.cat([near, torch.from_numpy(of_new)])
    return NeighbourRecipeScorer(
        constants | {"vectors": every, "near_words": near_words},
        _with_labels(scorer, labels),
        f"{scorer.graph_hash} and {len(labels)} more",
        device=scorer.device,
        name=scorer.name,
    )


def _with_labels(scorer: RecipeScorer, labels: Sequence[str]) -> tuple[str, ...]:
    """Return the labels of a scorer's entities and of new ones.

    Raises:
        ConfigError: if a new label exists already or is invalid.
    """
    checked = [check_label(label, "a new entity") for label in labels]
    entities = (*scorer.entities, *checked)
    if len({*entities}) < len(entities):
        repeated = next(label for label in reversed(entities) if entities.count(label) > 1)
        raise ConfigError(f"the new entity '{repeated}' exists already; expected each label once.")
    return entities


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
        scorer: the folder's scorer.
        labels: n labels; those without a vector are described by zeros.

    Raises:
        ConfigError: if the scorer has another kind.
        UnknownEntityError: if there are new labels, and the model uses no words.
        ArtefactError: if the folder is damaged, or the word vectors have changed.
    """
    whole = whole_of(scorer)
    own = len(whole.entities)
    index = LabelIndex(whole.entities)
    rows = [index.find(label) for label in labels]
    by_label = list(zip(labels, rows, strict=True))
    new = [label for label, row in by_label if row is None]
    # New labels get the ids after those of the model's entities.
    place = {label: own + number for number, label in enumerate(new)}
    ids = np.array([place[label] if row is None else row for label, row in by_label])
    if new:
        labelled = with_words(folder, scorer, new, allow_missing=True)
        return LabelledScorer(labelled, own, ids)
    if not isinstance(whole, RecipeScorer):
        raise _other_kind(scorer)
    return LabelledScorer(whole, own, ids)


def _other_kind(scorer: Scorer) -> ConfigError:
    """Return the error for a scorer that is no recipe scorer."""
    return ConfigError(
        f"{scorer.name} is not a recipe scorer; expected a model from `wordcraft-kg train-recipes`."
    )


def with_words(
    folder: str | Path,
    scorer: Scorer,
    labels: Sequence[str],
    *,
    where: Callable[[str], str] = lambda label: "",
    allow_missing: bool = False,
) -> RecipeScorer:
    """Return a copy of a model's scorer that scores new entities by the words in the labels.

    For a model with the built-in ``minilm`` vectors, a label outside the built-in books is compared
    by GloVe.

    Args:
        folder: the model's folder, written by ``train-recipes``.
        scorer: the folder's scorer.
        labels: the new entities, without duplicates.
        where: returns an error prefix for a label, such as a line number.
        allow_missing: use zeros for labels without a vector.

    Raises:
        UnknownEntityError: if the model uses no words, or a label has no vector.
        ArtefactError: if the folder is damaged, or the word vectors have changed.

    Example:
        >>> trained = load_scorer("models/kitchen-recipes")
        >>> scorer = with_words("models/kitchen-recipes", trained, ["pancake"])
        >>> scorer.score("flour", "componentOf", "pancake").shape
        torch.Size([])
    """

    def unknown(label: str, why: str) -> UnknownEntityError:
        return UnknownEntityError(
            f"{where(label)}no entity '{label}'.{nearest(label, scorer.entities)} {why}"
        )

    folder = Path(folder)
    run = read_finished_run(folder, "a model of train-recipes", "model.safetensors")
    if run.kind != RecipeScorerConfig.command:
        raise unknown(
            labels[0],
            "This model knows only the graph's entities; a model from `wordcraft-kg train-recipes` "
            "scores new entities by words.",
        )
    # Reading the file compares its hash with the record.
    RunFiles(folder, run).bytes(CONFIG_FILE)
    settings = RecipesConfig.read(folder).settings
    if settings.with_:
        raise unknown(
            labels[0],
            "A model with outside knowledge (`with`) scores only the graph's entities.",
        )
    size = len(scorer.entities)
    words = named(settings.features, scorer.entities)
    spec = FeatureSpec.parse(words)
    if spec.prefix or spec.source in ("one-hot", "random"):
        given = "the words of other entities" if spec.prefix else "no words"
        raise unknown(
            labels[0],
            f"The model uses `features` {words}, which give {given}; train with glove or a vector "
            "file.",
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
    whole = whole_of(scorer)
    text = torch.empty(0)
    known = features.known
    # Neighbour lists are found from vectors: cosines of all pairs of a large book have no room.
    if not isinstance(whole, NeighbourRecipeScorer):
        text, known = _compared(features, words, every)
    why = _why_unknown(words)
    # The error names the first label without a vector.
    for label, is_known in zip(labels, known[size:], strict=True):
        if not (is_known or allow_missing):
            raise unknown(label, why)
    if isinstance(whole, NeighbourRecipeScorer):
        return extended_lists(whole, labels, features.unit_vectors[size:])
    return extended(scorer, labels, text)


def _why_unknown(words: str) -> str:
    """Return why a label has no vector in the features ``words``, and what to do."""
    if words == "minilm":
        return "No word in this label has a vector."
    if os.path.isdir(words):
        again = (
            f"Encode it with the graph, `{ENCODE} --labels LABEL`, and train with these vectors, "
            "or with glove."
        )
        return f"The model's `features` {words} have no vector for this label. {again}"
    return f"No word in this label has a vector in {words}."


def _compared(
    features: EntityFeatures,
    words: str,
    labels: Sequence[str],
) -> tuple[Tensor, NDArray[np.bool_]]:
    """Return word cosines of all pairs, (N, N), and whether each label has a vector, (N,).

    Labels without built-in sentence vectors, which only the built-in books' labels have, are
    compared by GloVe.
    """
    text = cosines(torch.tensor(features.vectors))
    known = features.known
    if words != "minilm":
        return text, known
    glove = make_features("glove", labels, allow_missing=True)
    alike = cosines(torch.tensor(glove.vectors))
    new = torch.from_numpy(~known).nonzero()[:, 0]
    # Rows and columns: also a pair with an old label is compared by one kind of vectors.
    text[new] = alike[new]
    text[:, new] = alike[:, new]
    return text, known | glove.known
