"""The scorer of recipes as sets: the best sets for a goal, and probabilities of any sets."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.graphs import COMPONENT_OF, MOST_INGREDIENTS, Ids
from wordcraft_kg.models.scorers.scorer import StoredScorer
from wordcraft_kg.models.scorers.sets.knowledge import (
    MOST_KINDS,
    NO_INGREDIENT,
    Flags,
    GoalEvidence,
    SetKnowledge,
    Vector,
)
from wordcraft_kg.models.scorers.sets.loops import NO_SHARE
from wordcraft_kg.models.scorers.sets.networks import Networks
from wordcraft_kg.models.scorers.sets.parts import Parts
from wordcraft_kg.models.scorers.sets.rules import Rule

LIMIT = 6.0
"""Largest standardised feature, beyond which a committee knows nothing."""
_KEPT_GOALS = 64
"""Goals whose evidence is kept."""
_RAREST = 1e-4
"""Least share of recipes that lose a part, or leave it unmet."""
_STYLE = "style_parts"
_LAYOUTS = {
    "recipes": "R 9 int64",
    "amounts": "E P float32",
    "part_names": "B uint8",
    "words": "E D float16",
    "network.first": "M I H float32",
    "network.first_bias": "M H float32",
    "network.second": "M H N float32",
    "network.second_bias": "M N float32",
    "committee.first": "C F K float32",
    "committee.first_bias": "C K float32",
    "committee.second": "C K 1 float32",
    "committee.second_bias": "C 1 float32",
    "mean": "F float32",
    "deviation": "F float32",
    "calibration": "2 float32",
}


class RankedSet(NamedTuple):
    """A set of ingredients for a goal.

    Attributes:
        ingredients: entities, ascending.
        score: log probability that a recipe of the goal has exactly these ingredients.
    """

    ingredients: tuple[int, ...]
    score: float

    @property
    def probability(self) -> float:
        """The probability."""
        return math.exp(self.score)


class NearRecipe(NamedTuple):
    """A train recipe that supports a set for a goal.

    Attributes:
        ingredients: entities, ascending.
        result: entity that they make.
        strength: relative to the strongest, which has 1.
    """

    ingredients: tuple[int, ...]
    result: int
    strength: float


class SetScorer(StoredScorer):
    """A learned scorer of recipes of one to eight ingredients, by parts and words.

    It also knows goals and ingredients that no train recipe has, see :meth:`with_entities`.

    Attributes:
        kind: ``sets``, the scorer kind in ``vocabulary.json``.
        knowledge: train recipes and all that they tell.
        part_labels: names of the parts, P of them.
        cross_fitted: the same with a model for each left-out fold of train, which agents need; None
            without. A :class:`~wordcraft_kg.models.scorers.cross_fitting.CrossFitted` scorer, which
            this module does not know.
    """

    kind: ClassVar[str] = "sets"
    shared: ClassVar[tuple[str, ...]] = ("amounts", "part_names", "words")

    def __init__(
        self,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **kwargs: Any,
    ):
        """Take over the stored tensors.

        Args:
            tensors: tensors by name, see :meth:`check`.
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            kwargs: ``device`` and ``name``, as in ``Scorer``.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if tensors do not fit together.
        """
        super().__init__(entities, graph_hash, **kwargs)
        self._tensors = {name: tensors[name] for name in _layouts(tensors)}
        words = tensors["words"].float().numpy()
        style_parts = tensors[_STYLE].numpy() if _STYLE in tensors else None
        self.knowledge = SetKnowledge(
            tensors["recipes"].numpy(), tensors["amounts"].numpy(), words, style_parts
        )
        self.cross_fitted: Any = None
        self.part_labels = names_of_parts(tensors["part_names"])
        self._network = Networks.of(tensors, "network.")
        self._committee = Networks.of(tensors, "committee.")
        self._mean = tensors["mean"]
        self._deviation = tensors["deviation"]
        self._temperature, self._none = tensors["calibration"].tolist()
        # A goal's sets are scored in several calls, such as a beam's.
        self._known_goal = lru_cache(_KEPT_GOALS)(self._goal)
        sizes = (len(self.knowledge.ingredient_ids), self.knowledge.num_features)
        if sizes != (self._network.second.shape[2], len(self._mean)):
            raise ValueError("the networks do not fit the recipes")

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return self._tensors

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        num_parts = len(names_of_parts(tensors["part_names"]))
        inputs = 2 * num_parts + tensors["words"].shape[-1]
        sizes = {"E": size, "P": num_parts, "I": inputs, "9": MOST_INGREDIENTS + 1, "1": 1, "2": 2}
        check_tensors(tensors, _layouts(tensors), **sizes)
        recipes = tensors["recipes"]
        ingredients = recipes[:, :-1]
        is_padding = ingredients == NO_INGREDIENT
        is_sound = (
            len(recipes) > 0
            and int(recipes.min()) >= NO_INGREDIENT
            and int(recipes.max()) < size
            and not bool((recipes[:, [0, -1]] < 0).any())
            # In order, and nothing behind the padding.
            and bool(((ingredients[:, 1:] >= ingredients[:, :-1]) | is_padding[:, 1:]).all())
        )
        amounts = tensors["amounts"]
        if not is_sound:
            raise ValueError("a recipe has no ingredient, or ids out of order or range")
        if 0 in (*tensors["network.second"].shape, *tensors["committee.first"].shape):
            raise ValueError("no network, or one without weights")
        if tensors["network.second"].shape[2] > MOST_KINDS:
            raise ValueError(f"more than {MOST_KINDS:,} different ingredients")
        if float(amounts.min()) < 0 or float(amounts.max()) > 1:
            raise ValueError("a share of a part is outside 0 .. 1")
        if not (float(tensors["deviation"].min()) > 0 and float(tensors["calibration"][0]) > 0):
            raise ValueError("a deviation or the temperature is not above 0")

    def with_entities(self, labels: Sequence[str], parts: Parts, words: Vector) -> "SetScorer":
        """Return a scorer that also knows entities which the graph lacks, behind all others.

        Args:
            labels: their labels.
            parts: their parts, with the names in :attr:`part_labels`.
            words: their unit vectors, shape (n, D).
        """
        amounts = torch.from_numpy(parts.amounts)
        vectors = torch.from_numpy(words.astype(np.float16))
        tensors = self._tensors | {
            "amounts": torch.cat([self._tensors["amounts"], amounts]),
            "words": torch.cat([self._tensors["words"], vectors]),
        }
        return SetScorer(
            tensors,
            (*self.entities, *labels),
            self.graph_hash,
            device=self.device,
            name=self.name,
        )

    def recipes(
        self,
        goal: int | str,
        limit: int = 10,
        *,
        has_coverage: bool = True,
        rule: Rule | None = None,
    ) -> list[RankedSet]:
        """Return the likeliest sets for a goal, best first.

        Args:
            goal: id or label; no train recipe need make it.
            limit: most sets.
            has_coverage: whether each key part of the goal must come from an ingredient, and no
                ingredient may bring a part that the goal lacks and recipes do not lose.
            rule: which sets are allowed, by labels; the probabilities stay those of any set.

        Raises:
            UnknownEntityError: if the scorer does not know the goal.
            ConfigError: if the goal has a part that no train recipe brings, or the rule allows no
                candidate.
        """
        entity = int(self.entity_ids(goal))
        evidence = self.evidence(entity, has_coverage=has_coverage)

        def is_allowed(row: Ids) -> bool:
            members = self.knowledge.ingredient_ids[row[row >= 0]]
            labels = tuple(self.entities[member] for member in members)
            return rule is None or rule(labels, self.entities[entity])

        sets, features = self.knowledge.candidates(
            evidence, has_coverage=has_coverage, is_allowed=is_allowed
        )
        if not len(sets):
            raise self._no_recipe(entity, evidence, has_rule=rule is not None)
        members = np.where(sets >= 0, self.knowledge.ingredient_ids[sets], NO_INGREDIENT)
        if has_coverage and rule is None:
            scores = self._scores(features)
            scores = scores - self._total(scores)
        else:
            # Sets that break coverage, or that a rule leaves, have the probabilities of any set.
            scores = self._score_for(entity, members)
        rows = np.argsort(-scores, kind="stable")[:limit]
        return [RankedSet(_ids(members[row]), float(scores[row])) for row in rows]

    def score_sets(self, sets: Ids, goals: Ids) -> Vector:
        """Return the log probability that a recipe of each goal has exactly these ingredients.

        A set of unlikely kind is scored with the likely ones of its goal in mind. An ingredient
        that no train recipe uses counts as the most similar one. A part that is brought in vain, or
        missing, costs the logarithm of the share of train recipes with that fault.

        Args:
            sets: shape (N, 8), ids of ingredients in any order, -1 for none.
            goals: shape (N,).

        Returns:
            shape (N,), float32, nats.
        """
        sets = np.asarray(sets, dtype=np.int64)
        goals = np.asarray(goals, dtype=np.int64)
        self.entity_ids(np.append(sets[sets >= 0], goals))
        result = np.empty(len(goals), dtype=np.float32)
        for goal in np.unique(goals).tolist():
            rows = np.flatnonzero(goals == goal)
            result[rows] = self._score_for(goal, sets[rows])
        return result

    def near_recipes(
        self, goal: int | str, ingredients: Sequence[int], limit: int = 3
    ) -> list[NearRecipe]:
        """Return train recipes that support a set: of similar goals, with common ingredients.

        Args:
            goal: id or label.
            ingredients: ids.
            limit: most recipes.
        """
        entity = int(self.entity_ids(goal))
        evidence = self.evidence(entity)
        recipes = self.knowledge.recipes
        members = recipes[:, :-1]
        is_common = np.isin(members, list(ingredients)) & (members >= 0)
        common = is_common.sum(1)
        union = (members >= 0).sum(1) + len(ingredients) - common
        weights = evidence.similarity[1][self.knowledge.lists.recipe_goals] * common / union
        # The recipe itself explains nothing.
        weights[(recipes[:, -1] == entity) & (common == union)] = 0
        rows = [row for row in np.argsort(-weights, kind="stable")[:limit] if weights[row] > 0]
        strongest = weights[rows[0]] if rows else 1
        return [
            NearRecipe(_ids(members[row]), int(recipes[row, -1]), float(weights[row] / strongest))
            for row in rows
        ]

    def evidence(self, entity: int, *, has_coverage: bool = True) -> GoalEvidence:
        """Return what train recipes tell of an entity as a goal."""
        with torch.no_grad():
            network = self._network(self.knowledge.inputs(np.array([entity])))
        log_network = torch.log_softmax(network, 2).mean(0)[0].numpy()
        return self.knowledge.goal(entity, log_network, has_coverage=has_coverage)

    def _no_recipe(self, entity: int, evidence: GoalEvidence, *, has_rule: bool) -> ConfigError:
        label = self.entities[entity]
        if evidence.missing >= 0:
            part = self.part_labels[evidence.missing]
            return ConfigError(
                f"no train recipe brings {part}, a part of '{label}', by another ingredient that "
                f"has no part which '{label}' lacks. Add recipes that bring it to the book, or "
                "suggest with `any_parts`."
            )
        if has_rule and len(evidence.keys):
            return ConfigError(
                f"the rule allows no likely set for '{label}'; expected one or more. Allow more "
                "sets, or leave out `rule`."
            )
        return ConfigError(f"no set is likely for '{label}': it has no known part, and no words.")

    def _scores(self, features: Vector) -> Vector:
        """Return the committee's scores of sets at the fitted temperature, shape (n,)."""
        scaled = (torch.from_numpy(features) - self._mean) / self._deviation
        with torch.no_grad():
            scores = self._committee(scaled.clamp(-LIMIT, LIMIT))[..., 0].mean(0)
        return np.asarray(scores / self._temperature)

    def _total(self, scores: Vector) -> float:
        """Return the log sum over candidates, and none of them."""
        return float(np.logaddexp.reduce(np.append(scores, self._none)))

    def _goal(self, goal: int) -> tuple[GoalEvidence, Ids, float]:
        """Return evidence of a goal, its candidates, and the log sum over them and none."""
        evidence = self.evidence(goal)
        candidates, features = self.knowledge.candidates(evidence)
        total = self._total(self._scores(features)) if len(candidates) else self._none
        return evidence, candidates, total

    def _score_for(self, goal: int, sets: Ids) -> Vector:
        """Return the log probabilities of sets for one goal."""
        knowledge = self.knowledge
        evidence, candidates, total = self._known_goal(goal)
        # An ingredient that no train recipe uses counts as the most similar one.
        unknown = np.setdiff1d(sets[sets >= 0], knowledge.ingredient_ids)
        similarity, stand_ins = knowledge.nearest_ingredients(unknown)
        number_of = knowledge.number_of.copy()
        number_of[unknown] = stand_ins
        likeness = np.zeros(len(number_of), dtype=np.float32)
        likeness[unknown] = np.log(similarity)
        numbers = knowledge.numbers(sets, number_of)
        scores = self._scores(knowledge.features(evidence, numbers))
        scores = scores + np.where(sets >= 0, likeness[sets], 0).sum(1)
        is_candidate = (numbers[:, None] == candidates[None]).all(2).any(1)
        totals = np.where(is_candidate, total, np.logaddexp(total, scores))
        return np.asarray(scores - totals + self._faults(sets, evidence))

    def _faults(self, sets: Ids, evidence: GoalEvidence) -> Vector:
        """Return what parts cost that are brought in vain, or missing, shape (n,), 0 or below."""
        knowledge = self.knowledge
        has_part = (knowledge.amounts[sets] > 0) & (sets >= 0)[..., None]
        is_brought: Flags = np.any(has_part, axis=1)
        in_vain = is_brought & (evidence.amounts <= 0) & knowledge.is_kept
        is_missing = ~is_brought[:, evidence.keys]
        lost = np.log(np.maximum(knowledge.lost, _RAREST))
        unmet = np.log(np.maximum(knowledge.unmet[evidence.keys], _RAREST))
        return np.asarray(in_vain @ lost + is_missing @ unmet)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        """Score links: the log share of an ingredient for a goal; how often two occur together."""
        heads, relations, tails = torch.broadcast_tensors(heads, relations, tails)
        scores = torch.empty(heads.shape)
        is_part = relations == COMPONENT_OF
        goals, rows = torch.unique(tails[is_part], return_inverse=True)
        shares = [self._ingredient_scores(goal) for goal in goals.tolist()]
        if shares:
            scores[is_part] = torch.from_numpy(np.stack(shares))[rows, heads[is_part].cpu()]
        numbers = self.knowledge.number_of
        first, second = (numbers[ids[~is_part].cpu().numpy()] for ids in (heads, tails))
        lift = np.where(np.minimum(first, second) < 0, 0, self.knowledge.lift[first, second])
        scores[~is_part] = torch.from_numpy(lift.astype(np.float32))
        return scores.to(self.device)

    def _ingredient_scores(self, goal: int) -> Vector:
        """Return each entity's log share as an ingredient of a goal, shape (E,)."""
        shares = self.evidence(goal).shares
        best = ((shares[0] + shares[-1]) / 2).max(0, initial=NO_SHARE)
        scores = np.full(len(self.entities), NO_SHARE, dtype=np.float32)
        scores[self.knowledge.ingredient_ids] = best
        return scores


def _layouts(tensors: Mapping[str, Tensor]) -> dict[str, str]:
    """Return the layouts of a model's tensors; the model without a fold names its kinds, too."""
    return _LAYOUTS | ({_STYLE: "P bool"} if _STYLE in tensors else {})


def names_of_parts(tensor: Tensor) -> tuple[str, ...]:
    """Return names of parts from a stored tensor of bytes.

    Raises:
        ValueError: if it is no text, or names a part twice.
    """
    names = tuple(bytes(tensor.to(torch.uint8).flatten().tolist()).decode().split("\n"))
    if len(set(names)) < len(names):
        raise ValueError("a part is named twice")
    return names


def stored_names(names: Sequence[str]) -> Tensor:
    """Return names of parts as a tensor of bytes."""
    return torch.tensor(list("\n".join(names).encode()), dtype=torch.uint8)


def _ids(row: Ids) -> tuple[int, ...]:
    return tuple(row[row >= 0].tolist())
