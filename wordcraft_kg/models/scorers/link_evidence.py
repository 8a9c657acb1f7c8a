"""Evidence for a link: the most similar training links, with their recipes.

Links (h', r, t) with a head similar to h, and links (h, r, t') with a tail similar to t, support
(h, r, t)::

    evidence(h, r, t) = Σ_h' cos₊(h, h')³ + Σ_t' cos₊(t, t')³

over the training links, with cosines from :class:`~wordcraft_kg.models.scorers.roles.EntityRoles`,
0 where they are negative. So evidence needs nothing but scores.

The page docs/link-prediction.md shows it under *Supporting evidence*.

Source: k nearest neighbours as an explanation (Papernot and McDaniel 2018, "Deep k-nearest
neighbors"; Hanawa et al. 2021, "Evaluation of similarity-based explanations"), restricted to links
that share the head or the tail.
"""

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipes import Recipe, recipes_of_ids
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation, recipe_triples
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.roles import EntityRoles, Side

POWER = 3
"""Power of cosines, which emphasises the nearest links; 2 to 4 agree equally well with scores."""
RECIPES = 3
"""Maximum number of recipes listed per link."""


class LinkWitness(Record):
    """A training link that supports a scored link: same relation, and same head or same tail.

    Attributes:
        head: the link's head.
        relation: the relation of both links.
        tail: the link's tail.
        weight: similarity to the scored link, 1 for equality.
        share: the weight relative to the sum over all supporting links.
        recipes: training recipes with this link, at most :data:`RECIPES`.
        more: number of further training recipes with this link.
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

    Attributes:
        learned_from: training recipes with the link, at most :data:`RECIPES`; if any, the scorer
            was trained on it.
        more: number of further training recipes with the link.
        evidence: total weight over all supporting links, also those not listed.
        witnesses: supporting links, largest weight first.
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
    """Finds the training links, with their training recipes, that support a scored link.

    Attributes:
        roles: similarities between entities, by the scorer's scores.
        recipes: training recipes, rows of ``graph.sets``.
        triples: their triples, shape (T, 3).
        entities: labels in id order.

    Example:
        >>> model = open_model("models/kitchen")
        >>> evidence = LinkEvidence(model.scorer, model.train_sample.sets)
        >>> flour, water = model.scorer.entity_ids(["flour", "water"]).tolist()
        >>> evidence.reason(flour, COMBINES_WITH, water).is_in_sample
        True
    """

    def __init__(self, scorer: TripleScorer, recipes: Ids):
        """Compare all entities by their scores.

        Args:
            scorer: any scorer of links.
            recipes: its training recipes, rows of ``graph.sets``.

        Raises:
            ConfigError: if the scorer has no factors and the graph is too large for a score table.
        """
        self.roles = EntityRoles.of(scorer)
        self.recipes = recipes
        self.entities = scorer.entities
        self.triples = recipe_triples(recipes, len(self.entities))

    def weights(self, head: int, relation: int, tail: int) -> tuple[Ids, NDArray[np.float64]]:
        """Return the training links that support a link of ids, and their weights.

        Args:
            head: entity id.
            relation: relation id.
            tail: entity id.

        Returns:
            links, ids of shape (n, 3), without the link itself, and weights from 0 to 1, shape
            (n,). A combinesWith link of an entity with itself has each supporting link once, not in
            both directions.
        """
        # Both sides of a symmetric self link would list the same links, mirrored.
        is_self_pair = relation == COMBINES_WITH and head == tail
        sides: tuple[Side, ...] = ("head",) if is_self_pair else ("head", "tail")
        triples = []
        weights = []
        for side in sides:
            # The entity of this side is replaced by others, and the opposite end stays.
            entity, end = (head, tail) if side == "head" else (tail, head)
            neighbours = self.ends(end, relation, side)
            neighbours = neighbours[neighbours != entity]
            triples.append(_links(neighbours, relation, end, side))
            cosines = self.roles.alike(entity, relation, side)[neighbours]
            # Rounding can lift the cosine of equal vectors above 1.
            positive = cosines.astype(np.float64).clip(0, 1)
            weights.append(positive**POWER)
        return np.concatenate(triples), np.concatenate(weights)

    def ends(self, entity: int, relation: int, side: Side) -> Ids:
        """Return the entities on one side of training links.

        Args:
            entity: id of the entity on the opposite side of the links.
            relation: relation id of the links.
            side: the side of the returned entities.

        Returns:
            distinct ids, ascending.
        """
        # combinesWith stands in the triples in both directions.
        column, opposite = (0, 2) if side == "head" else (2, 0)
        is_link = (self.triples[:, 1] == relation) & (self.triples[:, opposite] == entity)
        return np.unique(self.triples[is_link, column])

    def reason(self, head: int, relation: int, tail: int, limit: int = 5) -> LinkReason:
        """Return the evidence for a link of ids.

        Args:
            head: entity id.
            relation: relation id.
            tail: entity id.
            limit: maximum number of supporting links; links with weight 0 are never listed.
        """
        triples, weights = self.weights(head, relation, tail)
        # Over all supporting links, so that shares do not depend on the limit.
        total = float(weights.sum())
        witnesses = []
        order = np.argsort(-weights, kind="stable")
        for row in order[:limit].tolist():
            weight = float(weights[row])
            if weight > 0:
                h, _, t = triples[row].tolist()
                recipes, num_further = self._listed(h, relation, t)
                witness = LinkWitness(
                    head=self.entities[h],
                    relation=RELATIONS[relation],
                    tail=self.entities[t],
                    weight=weight,
                    # A single witness can exceed the rounded sum.
                    share=min(weight / total, 1.0),
                    recipes=recipes,
                    more=num_further,
                )
                witnesses.append(witness)
        learned_from, num_further = self._listed(head, relation, tail)
        return LinkReason(learned_from, num_further, total, tuple(witnesses))

    def recipes_of(self, head: int, relation: int, tail: int) -> Ids:
        """Return the training recipes with a link.

        Args:
            head: entity id.
            relation: relation id.
            tail: entity id.

        Returns:
            row numbers in :attr:`recipes`, ascending.
        """
        *ingredients, result = self.recipes.T
        uses_of_head = np.sum([column == head for column in ingredients], axis=0)
        if relation != COMBINES_WITH:
            return np.flatnonzero((uses_of_head > 0) & (result == tail))
        # An entity is combined with itself where it stands twice.
        uses_of_tail = np.sum([column == tail for column in ingredients], axis=0)
        min_uses = 2 if head == tail else 1
        return np.flatnonzero((uses_of_head >= min_uses) & (uses_of_tail >= min_uses))

    def _listed(self, head: int, relation: int, tail: int) -> tuple[tuple[Recipe, ...], int]:
        """Return the first recipes with a link, and the number of further recipes."""
        rows = self.recipes_of(head, relation, tail)
        listed = self.recipes[rows[:RECIPES]]
        return recipes_of_ids(self.entities, listed), len(rows) - len(listed)


def _links(side_ids: Ids, relation: int, end: int, side: Side) -> Ids:
    """Return the links between one entity and others, shape (n, 3).

    Args:
        side_ids: ids of the entities on ``side``, shape (n,).
        relation: relation id.
        end: id of the entity on the opposite side.
        side: side of these entities.
    """
    ends = np.full(len(side_ids), end)
    relations = np.full(len(side_ids), relation)
    if side == "head":
        return np.column_stack([side_ids, relations, ends])
    return np.column_stack([ends, relations, side_ids])
