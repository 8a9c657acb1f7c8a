"""Predictions computed from recipes without training, and link features for the rankers.

Rankers are small networks. Shapes: E entities, n recipes, F features.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.kernel import (
    TEXT,
    completion,
    kernel_scores,
    link_matrices,
    normalised,
    similarity,
)
from wordcraft_kg.models.scorers.pair_features import FLOOR


@dataclass(frozen=True, eq=False)
class Base:
    """Tables of shape (E, E) for all pairs of E entities, computed from recipes and word vectors.

    An entity without recipes is described by words alone and does not change rows of known
    entities.

    Attributes:
        recipes: the recipes as ids (ingredient, ingredient, result), shape (n, 3).
        seen: ids of all entities in the recipes.
        text: word vector cosines.
        kernel: entity similarity by recipes and words.
        completed: combinesWith scores by known pairs with the same result, from
            :func:`~wordcraft_kg.models.scorers.kernel.completion`.
        pairs: combinesWith scores of ingredient pairs, predicted with the kernel and standardised.
        parts: componentOf scores by ingredient (row) and result, likewise.
    """

    recipes: Ids
    seen: Tensor
    text: Tensor
    kernel: Tensor
    completed: Tensor
    pairs: Tensor
    parts: Tensor

    @classmethod
    def of(cls, recipes: Ids, text: Tensor) -> "Base":
        """Compute the attributes from recipes, ids (n, 3), and word cosines ``text``, (E, E).

        Without words the cosines are zeros.
        """
        size = len(text)
        kernel = similarity(recipes, text)
        # Without recipes no entity is better known than another: means run over all of them.
        known = np.unique(recipes) if len(recipes) else np.arange(size)
        seen = torch.from_numpy(known)
        completed = completion(recipes, size)
        pairs, parts = kernel_scores(recipes, kernel, completed, seen)
        return cls(recipes, seen, text, kernel, completed, pairs, parts)

    # Tables that follow from others are made when needed: a large book has no room for all.

    @property
    def structure(self) -> Tensor:
        """Entity similarity by recipes alone."""
        return self.kernel - TEXT * self.text.clamp(min=0) ** 2

    @property
    def alike(self) -> Tensor:
        """The normalised kernel, squared."""
        return normalised(self.kernel) ** 2

    @property
    def words_like(self) -> Tensor:
        """Positive word cosines to the power 4."""
        return self.text.clamp(min=0) ** 4

    @property
    def links(self) -> tuple[Tensor, Tensor]:
        """The combinesWith and componentOf links of the recipes, 1 or 0, row = head."""
        return link_matrices(self.recipes, len(self.text))

    def column(self, number: int) -> Tensor:
        """Return a recipe column (0 and 1: ingredients, 2: results) as entity ids, shape (n,)."""
        return torch.from_numpy(self.recipes[:, number].copy())


class LinkTables(NamedTuple):
    """Features from outside the recipes, tables of shape (E, E).

    Attributes:
        pairs: features of combinesWith links, symmetric.
        parts: features of componentOf links, row = ingredient.
    """

    pairs: Sequence[Tensor] = ()
    parts: Sequence[Tensor] = ()


NOTHING = LinkTables()
"""No features from outside the recipes."""


def link_features(base: Base, outside: LinkTables = NOTHING) -> Iterator[Tensor]:
    """Yield the features of all combinesWith, then of all componentOf links.

    Args:
        base: tables from the recipes.
        outside: further tables, after those of ``base``.

    Yields:
        shape (E, E, F), row = head; F differs between the relations.
    """
    yield torch.stack([*features_of_pairs(base), *outside.pairs], dim=-1)
    yield torch.stack([*features_of_parts(base), *outside.parts], dim=-1)


def features_of_pairs(base: Base) -> list[Tensor]:
    """Return the combinesWith features from ``base``: symmetric tables of shape (E, E)."""
    combines, components = base.links
    # Similarity to other entities: what an entity itself combines with is no prediction.
    similar = _to_others(base.structure)
    alike = base.alike
    words_like = base.words_like
    made = components.sum(0).log1p()
    degree = combines.sum(1).log1p()
    first = base.column(0)
    second = base.column(1)
    # How often entities like each one combine with themselves, on the diagonal.
    of_seen = alike[:, base.seen].sum(1).clamp(min=FLOOR)
    itself = (alike @ combines.diagonal()) / of_seen
    # The order is that of the saved ranker's weights. Products are symmetric in the two ingredients
    # only as sums with their transposes.
    return [
        base.pairs,
        _log(base.completed),
        _log(_symmetric(similar @ combines)),
        _log(_symmetric(similar**3 @ combines)),
        _log(_symmetric(_to_others(words_like) @ combines)),
        _log(_symmetric(_evidence(alike, [first], second))),
        _log(_symmetric(_evidence(words_like, [first], second))),
        base.text,
        base.kernel,
        degree[:, None] + degree,
        (degree[:, None] - degree).abs(),
        made[:, None] + made,
        torch.eye(len(combines)),
        torch.diag(itself),
    ]


def features_of_parts(base: Base) -> list[Tensor]:
    """Return the componentOf features from ``base``: tables of shape (E, E), row = ingredient."""
    combines, components = base.links
    similar = _to_others(base.structure)
    words = _to_others(base.words_like)
    used = components.sum(1).log1p()
    made = components.sum(0).log1p()
    ingredients = [base.column(0), base.column(1)]
    result = base.column(2)
    shape = components.shape
    # The order is that of the saved ranker's weights. Left factors stand for entities like the
    # ingredient, right factors for entities like the result.
    return [
        base.parts,
        _log(similar @ components),
        _log(similar**3 @ components),
        _log(components @ similar),
        _log(components @ similar**3),
        _log(words @ components),
        _log(components @ words),
        _log(_evidence(base.alike, ingredients, result)),
        _log(_evidence(base.words_like, ingredients, result)),
        base.text,
        base.kernel,
        _log(combines @ components),
        _log(components @ components),
        combines,
        used[:, None].expand(shape),
        used.expand(shape),
        made[:, None].expand(shape),
        made.expand(shape),
    ]


def _evidence(alike: Tensor, heads: Sequence[Tensor], tails: Tensor) -> Tensor:
    """Return ``Σ_r k(x, head_r) k(y, tail_r)`` for all entities x and y.

    Args:
        alike: the kernel k, shape (E, E).
        heads: ids of the recipes' heads, shape (n,) each; their kernels are added.
        tails: ids of the recipes' tails, shape (n,).

    Returns:
        shape (E, E), row = x.
    """
    of_heads = alike[:, heads[0]]
    for head in heads[1:]:
        of_heads = of_heads + alike[:, head]
    return of_heads @ alike[:, tails].T


def _log(sums: Tensor) -> Tensor:
    """Return logarithms of sums; rounding may make a sum of zeros negative."""
    return (sums.clamp(min=0) + FLOOR).log()


def _symmetric(table: Tensor) -> Tensor:
    return table + table.T


def _to_others(similarity: Tensor) -> Tensor:
    """Return a similarity (E, E) with zeros on the diagonal."""
    return similarity - torch.diag(similarity.diagonal())
