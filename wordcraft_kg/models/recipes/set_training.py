"""Train models of recipes as sets into a model folder, by the command ``train-recipes``.

A book with larger sets than pairs trains such a model, and any book with the setting ``parts``.
"""

import time
from collections.abc import Sequence
from dataclasses import fields
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch

from wordcraft_kg.base import (
    ConfigError,
    Record,
    as_values,
    dump_json,
    nearest,
    write_atomically,
)
from wordcraft_kg.base.tensors import copied
from wordcraft_kg.graphs import (
    MOST_INGREDIENTS,
    OUTSIDE,
    Folds,
    Ids,
    OpenedGraph,
    RecipeGraph,
)
from wordcraft_kg.models.knowledge.books import word_features
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_records import (
    FitsTraining,
    SetMetrics,
    TrainedRecipes,
    counter,
)
from wordcraft_kg.models.recipes.set_fitting import FittedSets, fit_sets, folds_of_recipes
from wordcraft_kg.models.scorers.cross_fitting import FoldsRecord
from wordcraft_kg.models.scorers.features import named
from wordcraft_kg.models.scorers.scorer_folder import (
    FOLDS_RECORD,
    FOLDS_TENSORS,
    OF_RECIPE,
    write_scorer,
)
from wordcraft_kg.models.scorers.sets.knowledge import (
    MOST_KINDS,
    NO_INGREDIENT,
    Flags,
    SetKnowledge,
    Vector,
)
from wordcraft_kg.models.scorers.sets.parts import (
    NO_PARTS,
    Parts,
    parts_of_labels,
    read_parts,
)
from wordcraft_kg.models.scorers.sets.scorer import SetScorer, stored_names
from wordcraft_kg.runs.run_folder import Progress, RunFolder

_OF_PAIRS = ("train_fraction", "label_noise", "with_", "without", "device")
"""Settings that models of sets do not have."""
_FEWEST_GOALS = 10
_WITHOUT_WORDS = {
    "glove": "the graph lacks it, and glove has no vector for its words. Correct the label.",
    "minilm": (
        "a model of minilm words knows the labels of built-in books alone. Train with `features` "
        "glove for other labels."
    ),
}
"""Reasons and remedies for labels without a vector, by word vectors."""


def word_vectors(features: str, labels: Sequence[str], *, allow_missing: bool) -> Vector:
    """Return unit vectors of labels as a model stores them, shape (E, D); D = 0 for one-hot.

    Args:
        features: as in the settings.
        labels: labels of entities.
        allow_missing: whether labels may lack a vector.
    """
    vectors = word_features(features, labels, allow_missing=allow_missing).unit_vectors
    return vectors.astype(np.float16).astype(np.float32)


def with_new_entities(
    scorer: SetScorer, labels: Sequence[str], parts: str, features: str
) -> SetScorer:
    """Return a scorer that also knows labels which its graph lacks, by their parts and words.

    Args:
        scorer: the model's scorer.
        labels: the new entities, without duplicates.
        parts: the model's source of parts.
        features: the model's word vectors.

    Raises:
        ConfigError: if a label has no parts or words, or a part that the model's graph lacks.
    """
    shares = Parts.nothing(len(labels))
    if parts != NO_PARTS:
        amounts = parts_of_labels(parts, labels)
        for label, amounts_of_label in zip(labels, amounts, strict=True):
            unknown = [part for part in amounts_of_label if part not in scorer.part_labels]
            if unknown:
                raise ConfigError(
                    f"'{label}' has the part {unknown[0]}, which no entity of the model's graph "
                    "has. Train on a book with such recipes."
                )
        shares = Parts.of(amounts, scorer.part_labels)
    elif features == "one-hot":
        raise ConfigError(
            f"no entity '{labels[0]}'.{nearest(labels[0], scorer.entities)} The model knows the "
            "graph's entities alone: train with `parts` or words for new ones."
        )
    try:
        words = word_vectors(features, labels, allow_missing=False)
    except ConfigError:
        if features not in _WITHOUT_WORDS:
            raise
        names = ", ".join(f"'{label}'" for label in labels)
        raise ConfigError(
            f"no words for {names}: {_WITHOUT_WORDS[features]}{nearest(labels[0], scorer.entities)}"
        ) from None
    return scorer.with_entities(labels, shares, words)


class SetsTraining(FitsTraining):
    """Trainer for models of sets.

    Attributes:
        features: name of the word vectors; one-hot for none.
        recipes: training recipes, shape (R, 9), (ingredients, padding -1, goal).
        parts: parts of all entities.
        words: unit vectors of all entities.
    """

    def __init__(self, config: RecipesConfig, opened: OpenedGraph):
        """Read parts and words.

        Args:
            config: all settings.
            opened: the graph with its split.

        Raises:
            ConfigError: if the settings do not fit the graph or models of sets.
        """
        super().__init__(config, opened)
        settings = config.settings
        _check_settings(settings)
        self.source = settings.parts or NO_PARTS
        graph = opened.graph
        allow_missing = settings.allow_missing
        self.parts = read_parts(self.source, graph.entities, allow_missing=allow_missing)
        # Parts are enough unless words are named.
        is_enough = settings.features == "auto" and self.source != NO_PARTS
        self.features = "one-hot" if is_enough else named(settings.features, graph.entities)
        self.words = word_vectors(self.features, graph.entities, allow_missing=allow_missing)
        is_used = np.ones(graph.num_recipes, dtype=bool)
        if settings.kg == "partial":
            is_used = opened.split.is_in("train")
        self.recipes = rows_of_sets(graph, is_used)
        num_ingredients = len(np.unique(self.recipes[:, :-1]))
        if num_ingredients > MOST_KINDS:
            raise ConfigError(
                f"{graph.name} has {num_ingredients:,} different ingredients; a model of sets "
                f"takes {MOST_KINDS:,}. Leave out `parts` for a recipe scorer of pairs."
            )
        # Agents learn by models without a fold of the train recipes.
        self.folds: Folds | None = None
        if settings.kg == "partial":
            of_recipe = np.full(graph.num_recipes, OUTSIDE, dtype=np.int64)
            of_recipe[is_used] = folds_of_recipes(self.recipes, settings.folds, settings.seed)
            self.folds = Folds(opened.split, settings.folds, settings.seed, of_recipe)
        num_goals = len(np.unique(self.recipes[:, -1]))
        if num_goals < max(_FEWEST_GOALS, settings.folds):
            raise ConfigError(
                f"{graph.name} has {num_goals} goals in train; expected {_FEWEST_GOALS} or more, "
                "and as many as `folds`. Use a larger book."
            )

    def inputs(self) -> dict[str, str]:  # noqa: D102 - inherited
        # The input `parts` also tells that a folder holds a model of sets.
        words = sha256(self.words.tobytes()).hexdigest()
        inputs = {"parts": self.parts.sha256, "features": words}
        if self.folds is not None:
            inputs["folds"] = self.folds.hash
        return inputs

    def make(  # noqa: D102 - inherited
        self, run: RunFolder[Record], report: Progress | None
    ) -> TrainedRecipes:
        settings = self.config.settings
        began = time.perf_counter()
        fitted = fit_sets(
            self.recipes,
            self.parts.amounts,
            self.words,
            seed=settings.seed,
            folds=settings.folds,
            saved=run.checkpoints,
            after=counter(run, report, settings.folds + 1),
        )
        tensors = {
            "recipes": torch.from_numpy(self.recipes),
            "amounts": torch.from_numpy(self.parts.amounts),
            "part_names": stored_names(self.parts.labels),
            "words": torch.from_numpy(self.words.astype(np.float16)),
            **fitted.tensors(),
        }
        write_scorer(run.path, SetScorer.kind, tensors, self.opened.graph)
        knowledge = SetKnowledge(self.recipes, self.parts.amounts, self.words)
        if self.folds is not None:
            self._write_folds(run.path, self.folds, fitted, knowledge.style_parts)
        metrics = SetMetrics(
            kg=settings.kg,
            recipes=len(self.recipes),
            goals=len(knowledge.goal_ids),
            ingredients=len(knowledge.ingredient_ids),
            parts=Path(self.source).name,
            features=self.features,
            seconds=round(time.perf_counter() - began, 3),
            folds=settings.folds,
            fold_top=fitted.order.top,
            lost=self._shares(knowledge.lost, ~knowledge.is_kept),
            shared=self._shares(knowledge.shared, knowledge.is_kept & ~knowledge.is_key),
        )
        graph = self.opened.graph
        goal = graph.entities[int(self.recipes[0, -1])]
        return self.finish(
            run,
            metrics,
            () if self.folds is None else (FOLDS_RECORD, FOLDS_TENSORS),
            f"A scorer of recipes as sets of the {metrics.kg} knowledge graph of {graph.name}",
            "Ranks sets of one to eight ingredients for a goal, and scores any set, with "
            "probabilities.",
            [f"scorer.recipes({goal!r}, 5)  # sets of ids, with probabilities"],
        )

    def _write_folds(
        self, folder: Path, folds: Folds, fitted: FittedSets, style_parts: Flags
    ) -> None:
        """Write the models without each fold, whose links nobody ranks.

        Args:
            folder: the model's folder.
            folds: of the train recipes.
            fitted: has the fit of each fold.
            style_parts: of the knowledge of all recipes, shape (P,).
        """
        tensors = {OF_RECIPE: torch.from_numpy(folds.of_recipe.copy())}
        fold_of_train = folds.of_recipe[folds.split.is_in("train")]
        for number in range(folds.count):
            own_tensors = {
                "recipes": torch.from_numpy(self.recipes[fold_of_train != number]),
                "style_parts": torch.from_numpy(style_parts),
                **fitted.tensors(number),
            }
            tensors |= {f"fold{number}.{name}": value for name, value in own_tensors.items()}
        record = FoldsRecord.unranked(folds)
        write_atomically(folder / FOLDS_TENSORS, safetensors.torch.save(copied(tensors)))
        write_atomically(folder / FOLDS_RECORD, dump_json(as_values(record)))

    def _shares(self, values: Vector, is_shown: Flags) -> dict[str, float]:
        """Return values of some parts by name, the largest first."""
        parts = [part for part in np.argsort(-values, kind="stable") if is_shown[part]]
        return {self.parts.labels[part]: round(float(values[part]), 3) for part in parts}


def rows_of_sets(graph: RecipeGraph, is_used: Any) -> Ids:
    """Return recipes as a model of sets stores them, shape (R, 9).

    Args:
        graph: the recipe graph.
        is_used: which of its recipes.

    Returns:
        Rows (ingredients, padding -1, goal).
    """
    sets = graph.sets[is_used]
    ingredients = np.where(sets[:, :-1] == graph.num_entities, NO_INGREDIENT, sets[:, :-1])
    rows = np.full((len(sets), MOST_INGREDIENTS + 1), NO_INGREDIENT, dtype=np.int64)
    rows[:, : ingredients.shape[1]] = ingredients
    rows[:, -1] = sets[:, -1]
    return rows


def _check_settings(settings: RecipeScorerConfig) -> None:
    """Refuse settings of models of pairs."""
    defaults = {field.name: field.default for field in fields(RecipeScorerConfig)}
    refused_settings = [name for name in _OF_PAIRS if getattr(settings, name) != defaults[name]]
    if settings.kg == "none":
        refused_settings.append("kg none")
    if refused_settings:
        names = ", ".join(f"`{name.removesuffix('_')}`" for name in refused_settings)
        raise ConfigError(
            f"{names}: not for a model of sets, which a book with larger sets than pairs, or "
            "`parts`, asks for. Leave them out."
        )
