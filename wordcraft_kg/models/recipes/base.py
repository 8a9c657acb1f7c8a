"""All that follows from recipes in closed form, with which the rankers begin."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.kernel import completion, kernel_scores, link_matrices
from wordcraft_kg.models.scorers.similarity import TEXT, normalised, similarity


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
