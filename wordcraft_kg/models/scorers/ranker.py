"""The ranker: a network with one hidden layer that makes a score of features."""

from typing import NamedTuple

import torch
from torch import Tensor


class Ranker(NamedTuple):
    """A network with H hidden units, ``second · relu(x first + first_bias) + bias``.

    A single network, or M networks along a first axis.

    Attributes:
        first: shape (F, H), or (M, F, H).
        first_bias: shape (H,), or (M, H).
        second: shape (H,), or (M, H).
        bias: shape (), or (M,).
    """

    first: Tensor
    first_bias: Tensor
    second: Tensor
    bias: Tensor

    @classmethod
    def empty(cls, num_features: int, hidden: int = 1) -> "Ranker":
        """Return a network with so many hidden units that scores 0 whatever the features."""
        first = torch.zeros(num_features, hidden)
        return cls(first, torch.zeros(hidden), torch.zeros(hidden), torch.zeros(()))

    def __call__(self, features: Tensor) -> Tensor:
        """Return a single network's scores, shape (...), of features, shape (..., F).

        A row has the same bits in any batch, so that scores can be kept.
        """
        # In place, which takes less memory.
        hidden = (features @ self.first).add_(self.first_bias).relu_()
        # A product of a matrix and a vector would add a row's terms in an order that depends on the
        # number of rows.
        return hidden.mul_(self.second).sum(-1) + self.bias

    def model(self, number: int) -> "Ranker":
        """Return a single network of several."""
        return Ranker(*(weights[number] for weights in self))

    def of_models(self, features: Tensor, model: Tensor) -> Tensor:
        """Return the scores of B rows by the network of each row.

        Args:
            features: shape (B, P, F).
            model: network of each row, shape (B,), int64.

        Returns:
            shape (B, P).
        """
        numbers = model.unique().tolist()
        if len(numbers) == 1:
            return self.model(numbers[0])(features)
        scores = features.new_empty(features.shape[:-1])
        # A batch has rows of few models: a product for each takes far less memory than weights for
        # each row.
        for number in numbers:
            is_own = model == number
            scores[is_own] = self.model(number)(features[is_own])
        return scores


RANKER = Ranker._fields
"""Names of a ranker's weights, in files and modules."""
