"""Predictions computed from recipes without training, and link features for the rankers (small networks)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.kernel import TEXT, completion, kernel_scores, link_matrices, normalised, similarity
from wordcraft_kg.models.scorers.pair_features import FLOOR


@dataclass(frozen=True, eq=False)
class Base:
    """Tables of shape (E, E) for all pairs of E entities, computed from recipes and word vectors.

    An entity without recipes is described by words alone and does not change rows of known entities.

    Attributes:
        recipes: the recipes as ids (ingredient, ingredient, result), shape (n, 3).
        seen: ids of all entities in the recipes.
        text: word vector cosines.
        kernel: entity similarity by recipes and words.
        structure: entity similarity by recipes alone.
        alike: the normalised kernel, squared.
        words_like: positive word cosines to the power 4.
        combines, components: combinesWith and componentOf links of the recipes, 1 or 0, row = head.
        completed: combinesWith scores by known pairs with the same result, from
            :func:`~wordcraft_kg.models.scorers.kernel.completion`.
        pairs, parts: combinesWith (ingredient pair) and componentOf (ingredient, result) scores, predicted with the
            kernel and standardised.
    """

    recipes: Ids
    seen: Tensor
    text: Tensor
    kernel: Tensor
    structure: Tensor
    alike: Tensor
    words_like: Tensor
    combines: Tensor
    components: Tensor
    completed: Tensor
    pairs: Tensor
    parts: Tensor

    @classmethod
    def of(cls, recipes: Ids, text: Tensor) -> "Base":
        """Compute the attributes from recipes (n, 3) and word cosines ``text`` (E, E), zeros without words."""
        size = len(text)
        kernel = similarity(recipes, text)
        combines, components = link_matrices(recipes, size)
        seen = torch.from_numpy(np.unique(recipes) if len(recipes) else np.arange(size))
        completed = completion(recipes, size)
        pairs, parts = kernel_scores(recipes, kernel, completed, seen)
        return cls(
            recipes=recipes,
            seen=seen,
            text=text,
            kernel=kernel,
            structure=kernel - TEXT * text.clamp(min=0) ** 2,
            alike=normalised(kernel) ** 2,
            words_like=text.clamp(min=0) ** 4,
            combines=combines,
            components=components,
            completed=completed,
            pairs=pairs,
            parts=parts,
        )

    def column(self, number: int) -> Tensor:
        """Return a recipe column (0 and 1: ingredients, 2: results) as entity ids, shape (n,)."""
        return torch.from_numpy(self.recipes[:, number].copy())


class LinkTables(NamedTuple):
    """Further link features, equal in all folds: knowledge from outside the recipes.

    ``pairs`` are symmetric tables for combinesWith, ``parts`` tables for componentOf, row = ingredient; shape (E, E)
    each.
    """

    pairs: Sequence[Tensor] = ()
    parts: Sequence[Tensor] = ()


NOTHING = LinkTables()


def link_features(base: Base, outside: LinkTables = NOTHING) -> tuple[Tensor, Tensor]:
    """Return F features, from the tables in ``base`` and ``outside``, for all combinesWith and componentOf links.

    Each tensor has shape (E, E, F), row = head; F depends on the relation.
    """
    pairs, parts = [*features_of_pairs(base), *outside.pairs], [*features_of_parts(base), *outside.parts]
    return torch.stack(pairs, dim=-1), torch.stack(parts, dim=-1)


def features_of_pairs(base: Base) -> list[Tensor]:
    """Return the combinesWith features from ``base``: symmetric tables of shape (E, E)."""
    combines, similar = base.combines, _to_others(base.structure)
    made = base.components.sum(0).log1p()
    degree = combines.sum(1).log1p()
    first, second = base.column(0), base.column(1)
    return [
        base.pairs,
        _log(base.completed),
        _log(_symmetric(similar @ combines)),
        _log(_symmetric(similar**3 @ combines)),
        _log(_symmetric(_to_others(base.words_like) @ combines)),
        _log(_symmetric(base.alike[:, first] @ base.alike[:, second].T)),
        _log(_symmetric(base.words_like[:, first] @ base.words_like[:, second].T)),
        base.text,
        base.kernel,
        degree[:, None] + degree,
        (degree[:, None] - degree).abs(),
        made[:, None] + made,
        torch.eye(len(combines)),
        torch.diag((base.alike @ combines.diagonal()) / base.alike[:, base.seen].sum(1).clamp(min=FLOOR)),
    ]


def features_of_parts(base: Base) -> list[Tensor]:
    """Return the componentOf features from ``base``: tables of shape (E, E), row = ingredient."""
    components, similar, words = base.components, _to_others(base.structure), _to_others(base.words_like)
    used, made = components.sum(1).log1p(), components.sum(0).log1p()
    first, second, result = (base.column(number) for number in range(3))
    ingredient = base.alike[:, first] + base.alike[:, second]
    by_words = base.words_like[:, first] + base.words_like[:, second]
    shape = components.shape
    return [
        base.parts,
        _log(similar @ components),
        _log(similar**3 @ components),
        _log(components @ similar),
        _log(components @ similar**3),
        _log(words @ components),
        _log(components @ words),
        _log(ingredient @ base.alike[:, result].T),
        _log(by_words @ base.words_like[:, result].T),
        base.text,
        base.kernel,
        _log(base.combines @ components),
        _log(components @ components),
        base.combines,
        used[:, None].expand(shape),
        used.expand(shape),
        made[:, None].expand(shape),
        made.expand(shape),
    ]


def _log(sums: Tensor) -> Tensor:
    return (sums.clamp(min=0) + FLOOR).log()


def _symmetric(table: Tensor) -> Tensor:
    return table + table.T


def _to_others(similarity: Tensor) -> Tensor:
    return similarity - torch.diag(similarity.diagonal())
