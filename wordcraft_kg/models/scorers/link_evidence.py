"""Evidence for a link: the most similar training links, with their recipes.

Links (h', r, t) with a head similar to h, and links (h, r, t') with a tail similar to t, support
(h, r, t)::

    evidence(h, r, t) = Σ_h' cos₊(h, h')³ + Σ_t' cos₊(t, t')³

over the training links, with cosines from :class:`EntityRoles`, 0 where they are negative. So
evidence needs nothing but scores.

The page docs/link-prediction.md shows it under *Supporting evidence*.

Source: k nearest neighbours as an explanation (Papernot and McDaniel 2018, "Deep k-nearest
neighbors"; Hanawa et al. 2021, "Evaluation of similarity-based explanations"), restricted to links
that share the head or the tail.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    RELATIONS,
    Ids,
    Recipe,
    Relation,
    recipe_triples,
)
from wordcraft_kg.graphs.recipes import recipes_of_ids
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.score_limits import check_table, has_table

Side = Literal["head", "tail"]
_Rows = NDArray[np.float32]
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
        >>> len(evidence.reason(flour, COMBINES_WITH, water).learned_from)
        1
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
            links = np.full((len(neighbours), 3), (head, relation, tail))
            links[:, 0 if side == "head" else 2] = neighbours
            triples.append(links)
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

    def _listed(self, head: int, relation: int, tail: int) -> tuple[tuple[Recipe, ...], int]:
        """Return the first recipes with a link, and the number of further recipes."""
        *ingredients, result = self.recipes.T
        uses_of_head = np.sum([column == head for column in ingredients], axis=0)
        if relation == COMBINES_WITH:
            uses_of_tail = np.sum([column == tail for column in ingredients], axis=0)
            # An entity is combined with itself where it stands twice.
            min_uses = 2 if head == tail else 1
            has_link = (uses_of_head >= min_uses) & (uses_of_tail >= min_uses)
        else:
            has_link = (uses_of_head > 0) & (result == tail)
        recipes = self.recipes[has_link]
        listed = recipes[:RECIPES]
        return recipes_of_ids(self.entities, listed), len(recipes) - len(listed)


# --- similar entities -----------------------------------------------------------------------------


@dataclass(frozen=True)
class EntityRoles:
    """Similarities between entities by role; the four roles are head and tail in each relation.

    In a role, an entity is represented by its scores with all entities (row as head, column as
    tail), centred by row and column; uncentred rows mainly show which entities score high overall.
    Only row products matter, so factors can replace tables: :attr:`units` are then different
    coordinates for the same vectors.

    Attributes:
        units: unit vectors for each of :data:`ROLES`, shape (E, m) each; 0 for entities without
            scores.
        lengths: shape (E, 4), float32: vector lengths by entity and role, relative to the role's
            root mean square.

    Example:
        >>> scorer = load_scorer("models/kitchen")
        >>> roles = EntityRoles.of(scorer)
        >>> [scorer.entities[i] for i, _ in roles.nearest(3, limit=2)]
        ['pear', 'lemon']
    """

    units: tuple[_Rows, ...]
    lengths: _Rows

    @classmethod
    def of(cls, scorer: TripleScorer) -> "EntityRoles":
        """Compute each entity's vectors from a scorer's factors, or else from its table.

        Raises:
            ConfigError: if the scorer has no factors and the graph is too large for a score table.
        """
        size = len(scorer.entities)
        units = []
        lengths = []
        for relation in range(len(RELATIONS)):
            # A recipe scorer's factors stand for its scores, so tables come first where they fit.
            if isinstance(scorer, FactoredScorer) and not has_table(size):
                left_factors, right = scorer.factors(relation)
                roles = _factor_roles(left_factors.cpu().numpy(), right.cpu().numpy())
            else:
                check_table("comparing entities by scores", size)
                table = centred(scorer.table(relation).cpu().numpy())
                roles = table, np.ascontiguousarray(table.T)
            for rows in roles:
                norms = np.linalg.norm(rows, axis=1)
                units.append(_unit(rows, norms))
                # Relative lengths: each role counts alike, whatever the scale of its scores.
                root_mean_square = np.sqrt(np.mean(norms**2))
                lengths.append(norms / (root_mean_square or 1.0))
        return cls(tuple(units), np.stack(lengths, axis=1).astype(np.float32))

    def alike(self, entity: int, relation: int, side: Side) -> _Rows:
        """Return cosines between an entity's vector in a role and those of all entities.

        Args:
            entity: entity id.
            relation: relation id of the role.
            side: side of the role.

        Returns:
            shape (E,), float32.
        """
        rows = self.units[ROLES.index((relation, side))]
        return np.asarray(rows @ rows[entity])

    def nearest(self, entity: int, limit: int = 5) -> list[tuple[int, float]]:
        """Return the most similar entities by vectors joined over the four roles.

        Args:
            entity: entity id.
            limit: maximum number of entities.

        Returns:
            ids and cosines, nearest first, without the entity itself; ties are in id order.
        """
        # The cosine of joined vectors is the mean of the roles' cosines, weighted by lengths.
        total = np.linalg.norm(self.lengths, axis=1)
        # Without scores, weights are 0, not NaN.
        products = np.maximum(total * total[entity], 1e-12)
        role_products = self.lengths * self.lengths[entity]
        weights = role_products / products[:, None]
        role_cosines = [self.alike(entity, relation, side) for relation, side in ROLES]
        # Shape (E, 4).
        cosines = np.stack(role_cosines, axis=1)
        means = (weights * cosines).sum(axis=1)
        order = np.argsort(-means, kind="stable")
        nearest = order[order != entity][:limit]
        return [(neighbour, float(means[neighbour])) for neighbour in nearest.tolist()]


ROLES: tuple[tuple[int, Side], ...] = (
    (COMBINES_WITH, "head"),
    (COMBINES_WITH, "tail"),
    (COMPONENT_OF, "head"),
    (COMPONENT_OF, "tail"),
)
"""Relations and sides, in the order of :attr:`EntityRoles.units`."""


def centred(scores: NDArray[Any]) -> NDArray[Any]:
    """Subtract row means and column means from a score table, shape (E, E)."""
    by_row = scores - scores.mean(axis=1, keepdims=True)
    return np.asarray(by_row - by_row.mean(axis=0))


def _factor_roles(left: _Rows, right: _Rows) -> tuple[_Rows, _Rows]:
    """Return vectors with the same products as rows and columns in the centred ``left rightᵀ``."""
    # Centred factors have a centred product. 64 bits, because squares of small differences follow.
    heads = left.astype(np.float64)
    heads -= left.mean(axis=0, dtype=np.float64)
    tails = right.astype(np.float64)
    tails -= right.mean(axis=0, dtype=np.float64)
    return _turned(heads, tails), _turned(tails, heads)


def _turned(rows: NDArray[np.float64], opposite_rows: NDArray[np.float64]) -> _Rows:
    """Return X with ``X Xᵀ = rows (othersᵀ others) rowsᵀ``, shape (E, m)."""
    # A root of the small (m, m) matrix; rounding can make its least eigenvalues negative.
    products = opposite_rows.T @ opposite_rows
    values, vectors = np.linalg.eigh(products)
    root = vectors * np.sqrt(values.clip(min=0))
    return np.asarray(rows @ root, dtype=np.float32)


def _unit(rows: _Rows, lengths: _Rows) -> _Rows:
    """Scale rows to length 1; rows that are zero up to rounding become zeros."""
    longest = float(np.max(lengths, initial=0))
    tolerance = 1e-6 * longest or 1.0
    inverse = 1 / np.maximum(lengths, tolerance)
    factors = np.where(lengths > tolerance, inverse, 0)
    scaled = factors[:, None] * rows
    return np.asarray(scaled, dtype=np.float32)
