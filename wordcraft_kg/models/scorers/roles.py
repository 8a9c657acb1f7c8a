"""Similarity of entities to a scorer: as heads and as tails of each relation, by scores."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.config import check_table
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer

Side = Literal["head", "tail"]
_Rows = NDArray[np.float32]


@dataclass(frozen=True)
class EntityRoles:
    """Similarity of entities by role: head or tail of a relation.

    In a role, an entity is represented by its row (as tail: column) of scores with all entities, centred by row and
    column; uncentred rows mainly show which entities score high overall. Only products of rows matter, so factors
    replace tables: :attr:`units` are other coordinates of the same vectors.

    Attributes:
        units: by relation and side (head, tail), unit rows (0 for entities without scores), shape (E, m).
        lengths: shape (E, 4), float32: row lengths relative to the root mean square of the role.

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
        """Compute roles from the scores of all pairs, or from their factors.

        Raises:
            ConfigError: for too many pairs without factors.
        """
        size = len(scorer.entities)
        units, lengths = [], []
        for relation in range(len(RELATIONS)):
            if isinstance(scorer, FactoredScorer):
                roles = _of_factors(*(part.cpu().numpy() for part in scorer.factors(relation)))
            else:
                check_table("comparing entities by their scores", size)
                roles = _of_table(scorer.table(relation).cpu().numpy())
            found = [np.linalg.norm(rows, axis=1) for rows in roles]
            units.append(tuple(_unit(rows, length) for rows, length in zip(roles, found, strict=True)))
            lengths += [length / (np.sqrt(np.mean(length**2)) or 1.0) for length in found]
        return cls(tuple(units), np.stack(lengths, axis=1).astype(np.float32))  # type: ignore[arg-type]

    def alike(self, entity: int, relation: int, side: Side) -> _Rows:
        """Return cosines between an entity and all entities in a role, shape (E,)."""
        rows = self.units[relation][side == "tail"]
        return np.asarray(rows @ rows[entity])

    def nearest(self, entity: int, limit: int = 5) -> list[tuple[int, float]]:
        """Return the nearest entities over all roles with cosines, nearest first; each role weighs the same."""
        weights = self.lengths * self.lengths[entity] / np.maximum(self._total * self._total[entity], 1e-12)[:, None]
        cosines = np.stack([self.alike(entity, relation, side) for relation, side in ROLES], axis=1)
        found = (weights * cosines).sum(axis=1)
        order = np.argsort(-found, kind="stable")
        return [(other, float(found[other])) for other in order[: limit + 1].tolist() if other != entity][:limit]

    @cached_property
    def _total(self) -> _Rows:
        return np.asarray(np.linalg.norm(self.lengths, axis=1))


ROLES: tuple[tuple[int, Side], ...] = tuple((relation, side) for relation in (0, 1) for side in ("head", "tail"))
"""Relations and sides, in the order of :attr:`EntityRoles.lengths`."""


def centred(scores: NDArray[Any]) -> NDArray[Any]:
    """Return scores of all pairs, shape (E, E), with row and column means of 0."""
    by_row = scores - scores.mean(axis=1, keepdims=True)
    return np.asarray(by_row - by_row.mean(axis=0))


def _of_table(scores: _Rows) -> tuple[_Rows, _Rows]:
    """Return the rows of a table as heads and as tails, shape (E, m) each."""
    whole = centred(scores)
    return whole, np.ascontiguousarray(whole.T)


def _of_factors(left: _Rows, right: _Rows) -> tuple[_Rows, _Rows]:
    """Return vectors with the same products as rows and columns of the centred ``left rightᵀ``."""
    heads, tails = (side.astype(np.float64) - side.mean(axis=0, dtype=np.float64) for side in (left, right))
    return _turned(heads, tails), _turned(tails, heads)


def _turned(rows: NDArray[np.float64], others: NDArray[np.float64]) -> _Rows:
    """Return X with ``X Xᵀ = rows (othersᵀ others) rowsᵀ``, shape (E, m)."""
    values, vectors = np.linalg.eigh(others.T @ others)
    return np.asarray(rows @ (vectors * np.sqrt(values.clip(min=0))), dtype=np.float32)


def _unit(rows: _Rows, lengths: _Rows) -> _Rows:
    """Scale rows to length 1; rows of zeros up to rounding become zeros."""
    least = 1e-6 * float(np.max(lengths, initial=0)) or 1.0
    return np.asarray(np.where(lengths > least, 1 / np.maximum(lengths, least), 0)[:, None] * rows, dtype=np.float32)
