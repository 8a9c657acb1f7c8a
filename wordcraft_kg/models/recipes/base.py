"""What follows from recipes in closed form, and the features of links that rankers learn to weigh."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.kernel import TEXT, completion, kernel_scores, link_matrices, normalised, similarity
from wordcraft_kg.models.scorers.pair_features import FLOOR


@dataclass(frozen=True, eq=False)
class Base:
    """What some recipes say, in tables of shape (E, E).

    An entity of no recipe is described by its words alone and says nothing of the others: however many of them are
    added, the rows of the others stay.

    Attributes:
        recipes: shape (n, 3): the recipes.
        seen: ids of the entities that occur in them.
        text: cosines of words.
        kernel: how alike entities are, by what recipes do with them and by words.
        structure: the same without words.
        alike: the normalised kernel, squared.
        words_like: the positive cosines of words to the power 4.
        combines, components: the links that the recipes give, 1 or 0.
        completed: see :func:`~wordcraft_kg.models.scorers.kernel.completion`.
        pairs, parts: combinesWith and componentOf as the kernel predicts them, standardised.
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
        """Compute everything; ``text`` are the cosines of all entities' words, zeros without words."""
        size = len(text)
        kernel = similarity(recipes, text)
        combines, components = link_matrices(recipes, size)
        # Without recipes there is nothing to learn, from whomsoever.
        seen = torch.from_numpy(np.unique(recipes) if len(recipes) else np.arange(size))
        pairs, parts = kernel_scores(recipes, kernel, seen)
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
            completed=completion(recipes, size),
            pairs=pairs,
            parts=parts,
        )

    @property
    def first(self) -> Tensor:
        """One ingredient of each recipe, shape (n,)."""
        return torch.from_numpy(self.recipes[:, 0].copy())

    @property
    def second(self) -> Tensor:
        """The other ingredient of each recipe, shape (n,)."""
        return torch.from_numpy(self.recipes[:, 1].copy())

    @property
    def result(self) -> Tensor:
        """The result of each recipe, shape (n,)."""
        return torch.from_numpy(self.recipes[:, 2].copy())


def link_features(base: Base) -> tuple[Tensor, Tensor]:
    """Return the features of all combinesWith and componentOf links, shapes (E, E, F), row = head.

    Those of combinesWith are symmetric, as the relation is.
    """
    return torch.stack(_of_pairs(base), dim=-1), torch.stack(_of_parts(base), dim=-1)


def _of_pairs(base: Base) -> list[Tensor]:
    combines, similar = base.combines, _to_others(base.structure)
    made = base.components.sum(0).log1p()
    degree = combines.sum(1).log1p()
    return [
        base.pairs,
        _log(base.completed),
        _log(_symmetric(similar @ combines)),
        _log(_symmetric(similar**3 @ combines)),
        _log(_symmetric(_to_others(base.words_like) @ combines)),
        _log(_symmetric(base.alike[:, base.first] @ base.alike[:, base.second].T)),
        _log(_symmetric(base.words_like[:, base.first] @ base.words_like[:, base.second].T)),
        base.text,
        base.kernel,
        degree[:, None] + degree,
        (degree[:, None] - degree).abs(),
        made[:, None] + made,
        torch.eye(len(combines)),
        torch.diag((base.alike @ combines.diagonal()) / base.alike[:, base.seen].sum(1).clamp(min=FLOOR)),
    ]


def _of_parts(base: Base) -> list[Tensor]:
    components, similar, words = base.components, _to_others(base.structure), _to_others(base.words_like)
    used, made = components.sum(1).log1p(), components.sum(0).log1p()
    ingredient = base.alike[:, base.first] + base.alike[:, base.second]
    by_words = base.words_like[:, base.first] + base.words_like[:, base.second]
    result = base.alike[:, base.result]
    shape = components.shape
    return [
        base.parts,
        _log(similar @ components),
        _log(similar**3 @ components),
        _log(components @ similar),
        _log(components @ similar**3),
        _log(words @ components),
        _log(components @ words),
        _log(ingredient @ result.T),
        _log(by_words @ base.words_like[:, base.result].T),
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
    """Return how alike different entities are."""
    return similarity - torch.diag(similarity.diagonal())
