"""Similarities between entities, by a model's scores for each entity as head and as tail.

Evidence for links, and the explorer's list of similar entities, use them.

The page docs/link-prediction.md, *Supporting evidence*, shows what they are for.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.config import check_table, has_table
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer

Side = Literal["head", "tail"]
_Rows = NDArray[np.float32]


@dataclass(frozen=True)
class EntityRoles:
    """Similarities between entities by role; the four roles are head and tail in each relation.

    In a role, an entity is represented by its scores with all entities (row as head, column as
    tail), centred by row and column; uncentred rows mainly show which entities score high overall.
    Only row products matter, so factors can replace tables: :attr:`units` are then different
    coordinates for the same vectors.

    Attributes:
        units: unit vectors by relation and side (head, tail), shape (E, m); 0 for entities without
            scores.
        lengths: shape (E, 4), float32: vector lengths by entity and role, relative to the role's
            root mean square.

    Example:
        >>> scorer = load_scorer("models/kitchen")
        >>> roles = EntityRoles.of(scorer)
        >>> [scorer.entities[i] for i, _ in roles.nearest(3, limit=2)]
        ['pear', 'lemon']
    """

    units: tuple[tuple[_Rows, _Rows], ...]
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
                roles = _table_roles(scorer.table(relation).cpu().numpy())
            side_units = []
            for rows in roles:
                norms = np.linalg.norm(rows, axis=1)
                side_units.append(_unit(rows, norms))
                # Relative lengths: each role counts alike, whatever the scale of its scores.
                root_mean_square = np.sqrt(np.mean(norms**2))
                lengths.append(norms / (root_mean_square or 1.0))
            units.append((side_units[0], side_units[1]))
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
        as_head, as_tail = self.units[relation]
        rows = as_head if side == "head" else as_tail
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
        # Without scores, weights are 0, not NaN.
        products = np.maximum(self._total * self._total[entity], 1e-12)
        role_products = self.lengths * self.lengths[entity]
        weights = role_products / products[:, None]
        role_cosines = [self.alike(entity, relation, side) for relation, side in ROLES]
        # Shape (E, 4).
        cosines = np.stack(role_cosines, axis=1)
        means = (weights * cosines).sum(axis=1)
        order = np.argsort(-means, kind="stable")
        # One more than the limit, because the entity is usually nearest to itself.
        nearest = order[: limit + 1].tolist()
        neighbours = [
            (neighbour, float(means[neighbour])) for neighbour in nearest if neighbour != entity
        ]
        return neighbours[:limit]

    @cached_property
    def _total(self) -> _Rows:
        """Lengths of the joined vectors, shape (E,)."""
        return np.asarray(np.linalg.norm(self.lengths, axis=1))


ROLES: tuple[tuple[int, Side], ...] = (
    (COMBINES_WITH, "head"),
    (COMBINES_WITH, "tail"),
    (COMPONENT_OF, "head"),
    (COMPONENT_OF, "tail"),
)
"""Relations and sides, in the order of :attr:`EntityRoles.lengths`."""


def centred(scores: NDArray[Any]) -> NDArray[Any]:
    """Subtract row means and column means from a score table, shape (E, E)."""
    by_row = scores - scores.mean(axis=1, keepdims=True)
    return np.asarray(by_row - by_row.mean(axis=0))


def _table_roles(scores: _Rows) -> tuple[_Rows, _Rows]:
    """Return vectors of heads and of tails, (E, E) each: rows and columns of the centred table."""
    table = centred(scores)
    return table, np.ascontiguousarray(table.T)


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
