"""Suggested recipes for a goal, and scores of whole sets, with the recipes that support them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
import torch

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.evaluation.queries import OPEN, Query, RecipeQuery, pieces_of_recipe
from wordcraft_kg.evaluation.scores import Known
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.recipes import MOST_INGREDIENTS, label_fault
from wordcraft_kg.graphs.splits import Part, Split
from wordcraft_kg.graphs.triples import COMPONENT_OF
from wordcraft_kg.models.folder import open_model
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.recipes.records import SetMetrics
from wordcraft_kg.models.recipes.set_training import with_new_entities
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.sets.knowledge import NO_INGREDIENT
from wordcraft_kg.models.scorers.sets.rules import Rule
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

_SUPPORT = 3
"""Most supporting recipes of a suggestion."""
_SHORTLIST = 150
"""Ingredients whose pairs a recipe scorer compares for a goal, by their link to it."""


class SetSupport(Record):
    """A train recipe that supports a suggestion.

    Attributes:
        ingredients: labels of the ingredients.
        result: label of the result.
        strength: relative to the strongest, which has 1.
    """

    ingredients: tuple[str, ...]
    result: str
    strength: Share


class Suggestion(Record):
    """A recipe for a goal.

    Attributes:
        ingredients: labels of the ingredients.
        probability: that a recipe of the goal has exactly these ingredients, calibrated on train
            goals that the model had not seen; None for a recipe scorer of pairs.
        score: higher is more plausible; log probability in nats for a model of sets.
        known: split part with the recipe, or ``new``.
        because: train recipes of similar goals, or with similar ingredients.
    """

    ingredients: tuple[str, ...]
    probability: Share | None
    score: float
    known: Known
    because: tuple[SetSupport, ...]


class Suggestions(Record):
    """Suggested recipes for a goal.

    Attributes:
        goal: label of the goal.
        parts: shares of the goal's parts; empty without parts.
        new: entities of the query that the graph lacks, known by their parts and words.
        suggestions: recipes, best first.
        trained_on: training graph of the model.
    """

    goal: str
    parts: dict[str, float]
    new: tuple[str, ...]
    suggestions: tuple[Suggestion, ...]
    trained_on: TrainedOn


@dataclass(frozen=True)
class SetQuery:
    """A query for a recipe of any number of ingredients.

    Attributes:
        ingredients: labels; empty for the best sets of ``size`` ingredients.
        result: label of the result.
        size: number of ingredients.
    """

    ingredients: tuple[str, ...]
    result: str
    size: int

    @classmethod
    def parse(cls, words: Sequence[str], entities: frozenset[str]) -> "SetQuery":
        """Read ``a + b + c -> d`` or ``_ + _ + _ -> d``.

        Raises:
            ConfigError: for any other query, such as one without a result.
        """
        ingredients, result = pieces_of_recipe(words, entities)
        if result is None:
            raise ConfigError(
                f"no result in '{' '.join(words)}': a model of sets scores whole recipes; expected "
                "a + b + c = d. Add the result."
            )
        is_open = [label in OPEN and label not in entities for label in ingredients]
        if result in OPEN or (any(is_open) and not all(is_open)):
            raise ConfigError(
                f"cannot parse recipe '{' '.join(words)}' for a model of sets; expected "
                "a + b + c -> d, or _ + _ + _ -> d for the best sets of three."
            )
        if not 1 <= len(ingredients) <= MOST_INGREDIENTS:
            raise ConfigError(
                f"{len(ingredients)} ingredients; expected 1 to {MOST_INGREDIENTS}. Split the "
                "recipe."
            )
        if result in ingredients:
            raise ConfigError(
                f"'{result}' is among its own ingredients; expected other ingredients."
            )
        return cls(() if all(is_open) else ingredients, result, len(ingredients))


def is_set_model(model: Model) -> bool:
    """Return whether a model scores sets of any number of ingredients."""
    return isinstance(model.scorer, SetScorer)


def is_set_query(scorer: object, words: Sequence[str]) -> bool:
    """Return whether the words of a query are a recipe for a model of sets."""
    signs = ("+", "=", "->", "→")
    return isinstance(scorer, SetScorer) and any(sign in word for word in words for sign in signs)


def check_file_query(scorer: object, query: Query) -> None:
    """Refuse a file of recipes for a model of sets.

    Args:
        scorer: the model's scorer.
        query: the first query of the file.

    Raises:
        ConfigError: if the model is of sets, and the query a recipe.
    """
    if isinstance(scorer, SetScorer) and isinstance(query, RecipeQuery):
        raise ConfigError(
            "a file of recipes for a model of sets, which scores recipes one at a time; expected "
            "triples. Give each recipe as an argument, a + b + c -> d, or use `score_sets` in "
            "Python."
        )


def open_suggesting(folder: Path, graph: str | None = None) -> Model:
    """Open a model that can suggest recipes.

    Raises:
        ConfigError: if it scores links alone.

    Further errors are those of :func:`~wordcraft_kg.models.folder.open_model`.
    """
    model = open_model(folder, graph)
    if not isinstance(whole_of(model.scorer), SetScorer | RecipeScorer):
        raise ConfigError(
            f"{model.scorer.name} scores links, not recipes; expected a model from "
            "`wordcraft-kg train-recipes`."
        )
    return model


def suggest_recipes(
    model: Model,
    goal: str,
    top: int,
    *,
    has_coverage: bool = True,
    size: int | None = None,
    new_only: bool = False,
    rule: Rule | None = None,
) -> Suggestions:
    """Suggest recipes for a goal, also for one that the graph lacks if the model knows its parts.

    Args:
        model: from :func:`open_suggesting`.
        goal: label.
        top: most recipes.
        has_coverage: whether ingredients must bring the goal's parts, and no others.
        size: number of ingredients; None for any.
        new_only: whether recipes of the book are left out, by a model of sets.
        rule: which sets of a model of sets are allowed.

    Raises:
        ConfigError: if nothing is known of the goal, or the rule allows no set.
        UnknownEntityError: if a recipe scorer of pairs does not know the goal.
    """
    if not is_set_model(model):
        if rule is not None:
            raise ConfigError("`rule` chooses among the sets of a model of sets. Leave it out.")
        return _suggest_pairs(model, goal, top)
    goal = goal if goal in model.opened.graph else goal.strip()
    scorer, new = _scorer_of(model, [goal])
    ranked = scorer.recipes(goal, 10**6, has_coverage=has_coverage, rule=rule)
    split = model.opened.split
    sets = []
    for ranked_set in ranked:
        labels = [scorer.entities[entity] for entity in ranked_set.ingredients]
        is_new = not new_only or _known(split, labels, goal) == "new"
        if is_new and size in (None, len(labels)):
            sets.append(ranked_set)
    suggestions = [
        _suggestion(split, scorer, ranked_set.ingredients, goal, ranked_set.score)
        for ranked_set in sets[:top]
    ]
    return Suggestions(goal, _parts(scorer, goal), new, tuple(suggestions), model.kg)


def score_set(model: Model, query: SetQuery) -> Suggestions:
    """Score a whole recipe by a model of sets; entities that the graph lacks count by parts, words.

    Raises:
        ConfigError: if nothing is known of an entity.
    """
    scorer, new = _scorer_of(model, [*query.ingredients, query.result])
    ids = scorer.entity_ids(list(query.ingredients)).tolist()
    row = np.full((1, MOST_INGREDIENTS), NO_INGREDIENT)
    row[0, : len(ids)] = ids
    goal = query.result
    score = float(scorer.score_sets(row, scorer.entity_ids([goal]).numpy())[0])
    suggestion = _suggestion(model.opened.split, scorer, tuple(sorted(ids)), goal, score)
    return Suggestions(goal, _parts(scorer, goal), new, (suggestion,), model.kg)


def _scorer_of(model: Model, labels: Sequence[str]) -> tuple[SetScorer, tuple[str, ...]]:
    """Return the scorer with all labels of a query, and those that the graph lacks."""
    scorer, metrics = model.scorer, model.metrics
    assert isinstance(scorer, SetScorer)
    assert isinstance(metrics, SetMetrics)
    new = tuple(dict.fromkeys(label for label in labels if label not in model.opened.graph))
    for label in new:
        fault = label_fault(label)
        if fault is not None:
            raise ConfigError(f"{fault} Expected the name of an entity; correct the label.")
    if new:
        parts = model.settings.get("parts", metrics.parts)
        scorer = with_new_entities(scorer, new, parts, metrics.features)
    return scorer, new


def _parts(scorer: SetScorer, goal: str) -> dict[str, float]:
    return scorer.parts_of(goal) if scorer.knowledge.has_parts else {}


def _suggestion(
    split: Split, scorer: SetScorer, ids: tuple[int, ...], goal: str, score: float
) -> Suggestion:
    entities = scorer.entities
    support = [
        SetSupport(
            tuple(entities[entity] for entity in near.ingredients),
            entities[near.result],
            near.strength,
        )
        for near in scorer.near_recipes(goal, ids, _SUPPORT)
    ]
    labels = tuple(entities[entity] for entity in ids)
    split_part = _known(split, labels, goal)
    return Suggestion(labels, float(np.exp(score)), score, split_part, tuple(support))


def _known(split: Split, ingredients: Sequence[str], result: str) -> Known:
    """Return the part of a split that has a recipe, or ``new``."""
    graph = split.graph
    if not all(label in graph for label in (*ingredients, result)):
        return "new"
    width = graph.sets.shape[1] - 1
    if len(ingredients) > width:
        return "new"
    row = np.full((1, width + 1), graph.num_entities)
    row[0, : len(ingredients)] = sorted(graph.ids_of(ingredients))
    row[0, -1] = graph.id_of(result)
    number = int(graph.rows_of(row)[0])
    if number < 0:
        return "new"
    parts: tuple[Part, ...] = ("train", "valid", "test")
    return next(part for part in parts if split.is_in(part)[number])


def _suggest_pairs(model: Model, goal: str, top: int) -> Suggestions:
    """Suggest pairs by a recipe scorer, among the ingredients that best link to the goal."""
    scorer = whole_of(model.scorer)
    assert isinstance(scorer, RecipeScorer)
    (target,) = scorer.entity_ids([goal])
    everything = torch.arange(len(scorer.entities))
    links = scorer.score(everything, COMPONENT_OF, target)
    links[target] = -torch.inf
    shortlist = torch.topk(links, min(_SHORTLIST, len(links) - 1)).indices
    pairs = torch.tensor(list(combinations_with_replacement(shortlist.tolist(), 2)))
    scores = scorer.score_recipes(pairs[:, 0], pairs[:, 1], target)
    best = torch.sort(scores, descending=True, stable=True).indices[:top]
    suggestions = []
    for row in best.tolist():
        first, second = sorted(scorer.entities[entity] for entity in pairs[row].tolist())
        support = [
            SetSupport(witness.recipe.ingredients, witness.result, witness.strength)
            for witness in scorer.supporting_recipes(first, second, goal, limit=_SUPPORT)
        ]
        split_part = _known(model.opened.split, (first, second), goal)
        suggestions.append(
            Suggestion((first, second), None, float(scores[row]), split_part, tuple(support))
        )
    return Suggestions(goal, {}, (), tuple(suggestions), model.kg)
