"""Evidence for a link: the most similar training links, with their recipes.

Links (h', r, t) with a head similar to h, and links (h, r, t') with a tail similar to t, support (h, r, t)::

    evidence(h, r, t) = Σ_h' cos₊(h, h')³ + Σ_t' cos₊(t, t')³

over the training links, with non-negative cosines from :class:`~wordcraft_kg.models.scorers.roles.EntityRoles`.
docs/link-prediction.md measures faithfulness to the scores.

Source: k nearest neighbours as an explanation (Papernot and McDaniel 2018, "Deep k-nearest neighbors"; Hanawa et al.
2021, "Evaluation of similarity-based explanations"), restricted to links that share the head or the tail.
"""

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.roles import EntityRoles, Side

POWER = 3
"""Power of cosines, which emphasises the nearest links; 2 to 4 agree equally well with scores."""
RECIPES = 3
"""Maximum number of recipes listed per link."""


class LinkWitness(Record):
    """A training link that supports a scored link: same relation, and the same head or the same tail.

    ``weight`` is the similarity to the scored link, 1 for equality; ``share`` the weight relative to the sum over all
    supporting links. ``recipes`` are training recipes with this link, at most :data:`RECIPES`, and ``more`` counts the
    rest.
    """

    head: str
    relation: Relation
    tail: str
    weight: Share
    share: Share
    recipes: tuple[Recipe, ...]
    more: Count = 0


class LinkReason(Record):
    """The evidence for a scored link: training recipes with the link, and similar training links.

    ``learned_from`` are training recipes with this link, at most :data:`RECIPES`, and ``more`` counts the rest; if any,
    the scorer was trained on the link. ``evidence`` is the total weight over all supporting links, listed among the
    ``witnesses`` (largest weight first) or not.
    """

    learned_from: tuple[Recipe, ...]
    more: Count
    evidence: float
    witnesses: tuple[LinkWitness, ...]

    @property
    def is_in_sample(self) -> bool:
        """Whether the scorer was trained on the link."""
        return bool(self.learned_from)


class LinkEvidence:
    """Finds the training links, with their training recipes (n, 3), that support a scored link.

    The scorer needs factors, or a small enough table; otherwise a ConfigError.

    Example:
        >>> model = open_model("models/kitchen")
        >>> evidence = LinkEvidence(model.scorer, model.train_sample.recipes)
        >>> flour, water = model.scorer.entity_ids(["flour", "water"]).tolist()
        >>> evidence.reason(flour, COMBINES_WITH, water).is_in_sample
        True
    """

    def __init__(self, scorer: TripleScorer, recipes: Ids):
        self.roles, self.recipes = EntityRoles.of(scorer), recipes
        self.entities = scorer.entities

    def weights(self, head: int, relation: int, tail: int) -> tuple[Ids, NDArray[np.float64]]:
        """Return training links that support a link, (n, 3), without itself or mirrors, and their weights, (n,)."""
        triples, weights = [], []
        sides: tuple[Side, ...] = (
            ("head",) if relation == COMBINES_WITH and head == tail else ("head", "tail")
        )
        for side in sides:
            entity, end = (head, tail) if side == "head" else (tail, head)
            others = self.ends(end, relation, side)
            others = others[others != entity]
            ends = np.full(len(others), end)
            columns = (others, ends) if side == "head" else (ends, others)
            triples.append(
                np.column_stack([columns[0], np.full(len(others), relation), columns[1]])
            )
            units = self.roles.units[relation][side == "tail"]
            cosines = (units[others] @ units[entity]).astype(np.float64)
            weights.append(np.minimum(np.maximum(cosines, 0), 1) ** POWER)
        return np.concatenate(triples), np.concatenate(weights)

    def ends(self, entity: int, relation: int, side: Side) -> Ids:
        """Return the entities, ascending, on a side of training links with ``entity`` on the opposite side."""
        a, b, result = self.recipes.T
        if relation == COMBINES_WITH:
            return np.unique(np.concatenate([b[a == entity], a[b == entity]]))
        if side == "head":
            return np.unique(self.recipes[result == entity, :2])
        return np.unique(result[(a == entity) | (b == entity)])

    def reason(self, head: int, relation: int, tail: int, limit: int = 5) -> LinkReason:
        """Return the evidence for a link: at most ``limit`` supporting links, and recipes with the link."""
        triples, weights = self.weights(head, relation, tail)
        total = float(weights.sum())
        witnesses = []
        for row in np.argsort(-weights, kind="stable")[:limit].tolist():
            if weights[row] > 0:
                (h, _, t), weight = triples[row].tolist(), float(weights[row])
                labels = self.entities[h], RELATIONS[relation], self.entities[t]
                recipes = self._listed(h, relation, t)
                witnesses.append(LinkWitness(*labels, weight, min(weight / total, 1.0), *recipes))
        return LinkReason(*self._listed(head, relation, tail), total, tuple(witnesses))

    def recipes_of(self, head: int, relation: int, tail: int) -> Ids:
        """Return the training recipes with a link: row numbers in :attr:`recipes`, ascending."""
        a, b, result = self.recipes.T
        if relation == COMBINES_WITH:
            return np.flatnonzero(((a == head) & (b == tail)) | ((a == tail) & (b == head)))
        return np.flatnonzero(((a == head) | (b == head)) & (result == tail))

    def _listed(self, head: int, relation: int, tail: int) -> tuple[tuple[Recipe, ...], int]:
        rows = self.recipes_of(head, relation, tail)
        recipes = [
            [self.entities[entity] for entity in row]
            for row in self.recipes[rows[:RECIPES]].tolist()
        ]
        return tuple(Recipe.of(*labels) for labels in recipes), max(len(rows) - RECIPES, 0)
