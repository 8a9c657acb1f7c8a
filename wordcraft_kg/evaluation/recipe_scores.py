"""Recipe scores: best results of a pair, best partners of an ingredient, and supporting recipes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

import msgspec
import numpy as np
import torch

from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.evaluation.queries import RecipeQuery
from wordcraft_kg.evaluation.scores import Known, ScoringModel
from wordcraft_kg.graphs.arrays import Ids, are_among, recipe_keys
from wordcraft_kg.graphs.chains import mark_half_products
from wordcraft_kg.graphs.folder import TrainedOn
from wordcraft_kg.graphs.splits import Part
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import LEAST_SHARE
from wordcraft_kg.models.scorers.neighbours.results import CANDIDATES
from wordcraft_kg.models.scorers.recipes import RecipeScorer, RecipeScores, Witness

# Supporting recipes are sorted by share; more would push the results off the screen.
_SUPPORT = 3


class ScoredRecipe(Record):
    """A recipe with its score.

    Attributes:
        ingredient_a, ingredient_b: labels of the ingredients.
        result: label of the result.
        score: higher is more plausible, on the scorer's own scale.
        known: split part with the recipe, or `new` if the book lacks it; None without the graph.
        in_sample: whether the scorer was trained on the recipe, so that its score says nothing
            about other recipes.
        because: supporting train recipes; recipes that make the result itself come first.
        probability: probability of the result if the pair makes something, where results of a pair
            are listed; None elsewhere and without a calibration.
        outside: evidence from outside the train recipes.
    """

    ingredient_a: str
    ingredient_b: str
    result: str
    score: float
    known: Known | None
    in_sample: bool
    because: tuple[Witness, ...]
    probability: Share | None
    outside: tuple[OutsideEvidence, ...]


class RankedRecipe(ScoredRecipe):
    """A recipe with its score, and the rank of each entity in its slot among all entities.

    Known recipes compete: the ranks are unfiltered.

    Attributes:
        rank_as_result: rank of the result, from 1.
        rank_as_ingredient_a, rank_as_ingredient_b: rank of each ingredient, from 1.
        trained_on: training graph of the scorer; None if not recorded.
    """

    rank_as_result: Count
    rank_as_ingredient_a: Count
    rank_as_ingredient_b: Count
    trained_on: TrainedOn | None


class OpenRecipe(Record):
    """The best entities for the open slot in a recipe.

    Attributes:
        ingredient_a, ingredient_b: labels of the ingredients; None for the open slot.
        result: label of the result; None for the open slot.
        top: the completed recipes, best first.
        trained_on: training graph of the scorer; None if not recorded.
    """

    ingredient_a: str | None
    ingredient_b: str | None
    result: str | None
    top: tuple[ScoredRecipe, ...]
    trained_on: TrainedOn | None


class ScoredRecipeRow(Record):
    """A row in a file of recipe scores.

    Attributes:
        line: line of the query in the queries' file, from 1.
        ingredient_a, ingredient_b: labels of the ingredients.
        result: label of the result.
        score: higher is more plausible, on the scorer's own scale.
        rank: rank in the list for an open slot, from 1; None for a full recipe.
        known: split part with the recipe, or `new`; None without the graph.
        in_sample: whether the scorer was trained on the recipe.
    """

    line: int
    ingredient_a: str
    ingredient_b: str
    result: str
    score: float
    rank: int | None
    known: Known | None
    in_sample: bool


@dataclass(frozen=True)
class RecipeScoring:
    """A recipe scorer, and the recipes that it and its book know.

    Attributes:
        model: the opened model.
        scorer: its recipe scorer; of a cross-fitted one that of all train recipes.
        parts: keys of the recipes in each split part, ascending, by
            :func:`~wordcraft_kg.graphs.arrays.recipe_keys`; empty without the graph.
        seen: keys of the recipes that the scorer was trained on, ascending.
    """

    model: ScoringModel
    scorer: RecipeScores
    parts: dict[Part, Ids]
    seen: Ids

    @classmethod
    def of(cls, model: ScoringModel) -> "RecipeScoring":
        """Return a model's recipe scorer.

        Raises:
            ConfigError: if the model scores links (triples), not recipes.
        """
        # The model of all train recipes answers: queries are about new recipes.
        scorer = whole_of(model.scorer)
        split = model.split
        if not isinstance(scorer, RecipeScores):
            raise ConfigError(
                f"{model.scorer.name} scores links, not recipes. Give a link, such as flour "
                "combinesWith water, or train a recipe scorer with `wordcraft-kg train-recipes`."
            )
        size = len(scorer.entities)
        trained_on = scorer.recipes.cpu().numpy().astype(np.int64)
        parts = {}
        if split is not None:
            parts = {part: np.sort(_keys(split.recipes(part), size)) for part in get_args(Part)}
        return cls(model, scorer, parts, np.sort(_keys(trained_on, size)))

    def rows(self, query: RecipeQuery) -> Ids:
        """Return a query's recipes as ids, shape (n, 3).

        That is one recipe, or a recipe for each entity in the open slot.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        # Half-products of chains are no things of the game, and no answers.
        everything = np.flatnonzero(~mark_half_products(self.scorer.entities))
        ids = [everything if slot is None else [self._entity(slot)] for slot in query.slots]
        # Named entities broadcast along the open slot.
        return np.stack(np.broadcast_arrays(*ids), axis=1).astype(np.int64)

    def _entity(self, label: str) -> int:
        """Return an entity's id, or raise UnknownEntityError with the nearest labels."""
        entities = self.scorer.entities
        try:
            return entities.index(label)
        except ValueError:
            hint = nearest(label, entities)
            raise UnknownEntityError(
                f"no entity '{label}' in {self.model.scorer.name}.{hint}"
            ) from None

    def scores(self, rows: Ids) -> torch.Tensor:
        """Return scores, shape (n,), of recipes as ids (ingredients and result), shape (n, 3)."""
        return self.scorer.score_recipes(*torch.from_numpy(rows.copy()).T).cpu()

    def known(self, rows: Ids) -> list[Known | None]:
        """Return the split part of each recipe, ids of shape (n, 3).

        The part is ``new`` for a recipe that the book lacks, and None without the graph.
        """
        if self.model.split is None:
            return [None] * len(rows)
        parts: list[Known | None] = ["new"] * len(rows)
        keys = _keys(rows, len(self.scorer.entities))
        for part, recipes in self.parts.items():
            for row in np.flatnonzero(are_among(keys, recipes)):
                parts[row] = part
        return parts

    def in_sample(self, rows: Ids) -> list[bool]:
        """Return whether the scorer was trained on each recipe, ids of shape (n, 3)."""
        return are_among(_keys(rows, len(self.scorer.entities)), self.seen).tolist()

    def best(
        self, query: RecipeQuery, top: int, *, new_only: bool = False
    ) -> tuple[Ids, list[float]]:
        """Return the best recipes for a query's open slot, best first; equal scores in id order.

        A scorer with a pair encoder, or of a large book, proposes the results of a pair; elsewhere
        all entities are scored.

        Recipes that make an ingredient are omitted if the book has none, because recipe books drop
        such recipes by default.

        Args:
            query: a query with an open slot.
            top: most recipes to return.
            new_only: omit known recipes.

        Returns:
            Recipes as ids, shape (n, 3), and their scores.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        scorer = self.scorer
        scores = None
        if query.result is None and isinstance(scorer, RecipeScorer) and scorer.proposes_results:
            rows, scores = self._proposed(scorer, query, top)
        else:
            rows = self.rows(query)
        if not self.model.proposes_self_results:
            is_other = (rows[:, :2] != rows[:, 2:]).all(axis=1)
            rows = rows[is_other]
            scores = None if scores is None else scores[torch.from_numpy(is_other)]
        if scores is None:
            scores = self.scores(rows)
        # Stable: equal scores keep the order of ids on every device.
        order = torch.sort(scores, descending=True, stable=True).indices.numpy()
        if new_only:
            is_new = [part == "new" for part in self.known(rows[order])]
            order = order[is_new]
        best = order[:top].copy()
        return rows[best], scores[best].tolist()

    def _proposed(
        self, scorer: RecipeScorer, query: RecipeQuery, top: int
    ) -> tuple[Ids, torch.Tensor]:
        """Return results that a scorer proposes for a pair, as recipes (n, 3), and their scores.

        Args:
            scorer: proposes results.
            query: a pair with an open result.
            top: results to propose at least, if there are so many.
        """
        a, b = (scorer.entity_ids([label]) for label in query.slots[:2] if label is not None)
        ids, scores = scorer.best_results(a, b, max(top, CANDIDATES))
        # Half-products of chains are no things of the game, and no answers.
        is_half = mark_half_products(scorer.entities)
        # The id E stands for missing results.
        is_answer = torch.from_numpy(~np.append(is_half, True))[ids[0].cpu()]
        results = ids[0].cpu()[is_answer]
        pair = torch.cat([a, b]).cpu().expand(len(results), 2)
        return torch.cat([pair, results[:, None]], dim=1).numpy(), scores[0].cpu()[is_answer]

    def recipes(self, rows: Ids, scores: Sequence[float]) -> Iterator[ScoredRecipe]:
        """Yield scored recipes, ids of shape (n, 3), with their split parts and evidence."""
        finder = self.model.outside
        parts = self.known(rows)
        in_sample = self.in_sample(rows)
        for i, score in enumerate(scores):
            a, b, result = self.labels(rows[i])
            because = tuple(self.scorer.supporting_recipes(a, b, result, limit=_SUPPORT))
            outside = finder.of_recipe(a, b, result) if finder else ()
            yield ScoredRecipe(
                ingredient_a=a,
                ingredient_b=b,
                result=result,
                score=score,
                known=parts[i],
                in_sample=in_sample[i],
                because=because,
                probability=None,
                outside=outside,
            )

    def labels(self, row: Ids) -> tuple[str, str, str]:
        """Return recipe labels, shape (3,)."""
        a, b, result = (self.scorer.entities[entity] for entity in row.tolist())
        return a, b, result


def _keys(rows: Ids, num_entities: int) -> Ids:
    """Return a number for each recipe, ids of shape (n, 3), by which recipes are looked up."""
    return recipe_keys(*rows.T, num_entities=num_entities)


def view_recipe(scoring: RecipeScoring, query: RecipeQuery) -> RankedRecipe:
    """Score a recipe, and rank each entity in its slot.

    Raises:
        UnknownEntityError: for a label that the scorer does not know.
    """
    row = scoring.rows(query)
    score = scoring.scores(row)
    (recipe,) = scoring.recipes(row, score.tolist())

    def rank(slot: int) -> int:
        labels = list(query.slots)
        labels[slot] = None
        open_query = RecipeQuery(labels[0], labels[1], labels[2])
        rows = scoring.rows(open_query)
        scores = scoring.scores(rows)
        # A recipe's score among others may differ in its last bits from its score alone, so that
        # it would be ranked behind itself.
        is_other = (rows != row).any(axis=1)
        among = scores[~is_other].max() if not is_other.all() else score[0]
        # Optimistic for ties: entities with equal scores share the best rank.
        return 1 + int((scores[is_other] > among).sum())

    return RankedRecipe(
        **msgspec.structs.asdict(recipe),
        rank_as_result=rank(2),
        rank_as_ingredient_a=rank(0),
        rank_as_ingredient_b=rank(1),
        trained_on=scoring.model.kg,
    )


def view_open_recipe(
    scoring: RecipeScoring, query: RecipeQuery, top: int, *, new_only: bool = False
) -> OpenRecipe:
    """List the best entities for the open slot in a recipe.

    Args:
        scoring: the recipe scorer.
        query: a query with an open slot.
        top: most entities to list.
        new_only: omit known recipes.

    Returns:
        The completed recipes; results of a pair have probabilities if the scorer is calibrated.

    Raises:
        UnknownEntityError: for a label that the scorer does not know.
    """
    rows, scores = scoring.best(query, top, new_only=new_only)
    best = tuple(scoring.recipes(rows, scores))
    folds = folds_of(scoring.model.scorer)
    # Calibrated for results of a pair only: partners of an ingredient compete in another way.
    if query.result is None and folds is not None and folds.probabilities is not None:
        shares = folds.result_probabilities(*query.labels)[rows[:, 2]].tolist()
        best = tuple(
            msgspec.structs.replace(recipe, probability=share)
            for recipe, share in zip(best, shares, strict=True)
        )
    return OpenRecipe(*query.slots, best, scoring.model.kg)


def score_recipe_queries(
    scoring: RecipeScoring, queries: Sequence[RecipeQuery], top: int, *, new_only: bool = False
) -> Iterator[ScoredRecipeRow]:
    """Score queries in their order.

    Args:
        scoring: the recipe scorer.
        queries: recipes with or without an open slot.
        top: most rows for a query with an open slot.
        new_only: omit known recipes.

    Yields:
        A row for a full recipe, up to ``top`` rows for a query with an open slot.

    Raises:
        UnknownEntityError: for a label that the scorer does not know.
    """
    # Full recipes are scored in one batch, which is much faster than one by one.
    recipes = [scoring.rows(query) for query in queries if not query.is_open]
    scores = iter(scoring.scores(np.concatenate(recipes)).tolist() if recipes else ())
    for query in queries:
        if query.is_open:
            rows, values = scoring.best(query, top, new_only=new_only)
            ranks: Sequence[int | None] = range(1, len(rows) + 1)
        else:
            rows = scoring.rows(query)
            values = [next(scores)]
            ranks = [None]
        parts = scoring.known(rows)
        in_sample = scoring.in_sample(rows)
        line = query.line or 0
        for i, row in enumerate(rows):
            if not new_only or parts[i] == "new":
                labels = scoring.labels(row)
                yield ScoredRecipeRow(line, *labels, values[i], ranks[i], parts[i], in_sample[i])


def main_support(witnesses: Sequence[Witness]) -> Sequence[Witness]:
    """Return the supporting recipes with at least 1 % weight share, or else the first recipe."""
    return [witness for witness in witnesses if witness.share >= LEAST_SHARE] or witnesses[:1]


def because(witnesses: Sequence[Witness]) -> str:
    """Format supporting recipes with their strengths, as ``river + wood -> driftwood 0.41``."""
    supporting = main_support(witnesses)
    return ", ".join(f"{witness.recipe} {strength(witness)}" for witness in supporting)


def strength(witness: Witness) -> str:
    """Format the evidence of a supporting recipe, relative to the strongest."""
    return "< 0.01" if witness.strength < 0.01 else format(witness.strength, ".2g")


BECAUSE = (
    "similar train recipes, one part of a score: those with the same result first, each by its "
    "strength (1: the strongest)"
)
"""What a list of supporting recipes covers, and its order."""
