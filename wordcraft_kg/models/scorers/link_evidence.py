"""The links of training that support another link, and the recipes that they come from.

A link (h, r, t) is explained by examples: links (h', r, t) whose head is to the scorer like h, and links (h, r, t')
whose tail is to it like t. ::

    evidence(h, r, t) = Σ_h' cos₊(h, h')³ + Σ_t' cos₊(t, t')³

over the links of training, with the cosine, 0 where it is negative, of both in
:class:`~wordcraft_kg.models.scorers.roles.EntityRoles`. docs/link-prediction.md measures how faithful it is.

Source: k nearest neighbours as an explanation (Papernot and McDaniel 2018, "Deep k-nearest neighbors"; Hanawa et al.
2021, "Evaluation of similarity-based explanations"), with the neighbours that share an end.
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
"""To which cosines are raised, so that what is nearest says most. 2 to 4 agree with scores as well."""
RECIPES = 3
"""Most recipes that are named for a link."""


class LinkWitness(Record):
    """A link of training that supports another one, with which it shares the relation and an end.

    Attributes:
        weight: how like the other it is to the scorer, 1 for the same.
        share: its share of the evidence for the other one.
        recipes: recipes of training that give it, at most :data:`RECIPES`.
        more: number of further ones.
    """

    head: str
    relation: Relation
    tail: str
    weight: Share
    share: Share
    recipes: tuple[Recipe, ...]
    more: Count = 0


class LinkReason(Record):
    """The reasons of a scorer to believe in a link.

    Attributes:
        learned_from: recipes of training that give the link itself, at most :data:`RECIPES`: its score is memory.
        more: number of further ones.
        evidence: sum of the weights of all supporting links, named or not.
        witnesses: supporting links, largest weight first.
    """

    learned_from: tuple[Recipe, ...]
    more: Count
    evidence: float
    witnesses: tuple[LinkWitness, ...]

    @property
    def is_memory(self) -> bool:
        """Whether the scorer was trained on the link."""
        return bool(self.learned_from)


class LinkEvidence:
    """Names the links and recipes of training that support a link.

    Attributes:
        roles: how alike entities are to the scorer.
        recipes: shape (n, 3), the recipes of its training.

    Example:
        >>> model = open_model("models/kitchen")
        >>> evidence = LinkEvidence(model.scorer, model.dose.recipes)
        >>> flour, water = model.scorer.entity_ids(["flour", "water"]).tolist()
        >>> evidence.reason(flour, COMBINES_WITH, water).is_memory
        True
    """

    def __init__(self, scorer: TripleScorer, recipes: Ids):
        """Compare entities by a scorer's scores; ``recipes``, shape (n, 3), are those of its training.

        Raises:
            ConfigError: if the scorer has too many entities for a table of scores, and no factors.
        """
        self.roles, self.recipes = EntityRoles.of(scorer), recipes
        self.entities = scorer.entities

    def weights(self, head: int, relation: int, tail: int) -> tuple[Ids, NDArray[np.float64]]:
        """Return the links that support a link of ids, shape (n, 3), and their weights, shape (n,).

        The link itself is not among them. A combinesWith link of an entity with itself is supported in one direction
        only.
        """
        triples, weights = [], []
        sides: tuple[Side, ...] = ("head",) if relation == COMBINES_WITH and head == tail else ("head", "tail")
        for side in sides:
            entity, end = (head, tail) if side == "head" else (tail, head)
            others = self.ends(end, relation, side)
            others = others[others != entity]
            ends = np.full(len(others), end)
            columns = (others, ends) if side == "head" else (ends, others)
            triples.append(np.column_stack([columns[0], np.full(len(others), relation), columns[1]]))
            units = self.roles.units[relation][side == "tail"]
            cosines = (units[others] @ units[entity]).astype(np.float64)
            weights.append(np.minimum(np.maximum(cosines, 0), 1) ** POWER)
        return np.concatenate(triples), np.concatenate(weights)

    def ends(self, entity: int, relation: int, side: Side) -> Ids:
        """Return the entities on a side of the links of training that have the given one on the other; ascending."""
        a, b, result = self.recipes.T
        if relation == COMBINES_WITH:
            return np.unique(np.concatenate([b[a == entity], a[b == entity]]))
        if side == "head":
            return np.unique(self.recipes[result == entity, :2])
        return np.unique(result[(a == entity) | (b == entity)])

    def reason(self, head: int, relation: int, tail: int, limit: int = 5) -> LinkReason:
        """Return at most ``limit`` supporting links of a link of ids, and the recipes that give it."""
        triples, weights = self.weights(head, relation, tail)
        total = float(weights.sum())
        witnesses = []
        for row in np.argsort(-weights, kind="stable")[:limit].tolist():
            if weights[row] > 0:
                (h, _, t), weight = triples[row].tolist(), float(weights[row])
                recipes = self.recipes_of(h, relation, t)
                witnesses.append(
                    LinkWitness(
                        head=self.entities[h],
                        relation=RELATIONS[relation],
                        tail=self.entities[t],
                        weight=weight,
                        share=min(weight / total, 1.0),
                        recipes=self._labels(recipes[:RECIPES]),
                        more=max(len(recipes) - RECIPES, 0),
                    )
                )
        own = self.recipes_of(head, relation, tail)
        return LinkReason(self._labels(own[:RECIPES]), max(len(own) - RECIPES, 0), total, tuple(witnesses))

    def recipes_of(self, head: int, relation: int, tail: int) -> Ids:
        """Return the recipes of training that give a link of ids: rows of :attr:`recipes`, ascending."""
        a, b, result = self.recipes.T
        if relation == COMBINES_WITH:
            return np.flatnonzero(((a == head) & (b == tail)) | ((a == tail) & (b == head)))
        return np.flatnonzero(((a == head) | (b == head)) & (result == tail))

    def _labels(self, rows: Ids) -> tuple[Recipe, ...]:
        found = self.recipes[rows].tolist()
        return tuple(Recipe.of(*(self.entities[entity] for entity in row)) for row in found)
