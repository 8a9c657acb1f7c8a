"""The ranker: a network with one hidden layer that makes a score of features."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

RANKER = ("first", "first_bias", "second", "bias")
"""Names of a ranker's weights, in files and modules."""


@dataclass(frozen=True, eq=False)
class Ranker:
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
    def empty(cls, num_features: int) -> "Ranker":
        """Return a network that scores 0 whatever the features."""
        return cls(torch.zeros(num_features, 1), torch.zeros(1), torch.zeros(1), torch.zeros(()))

    def __call__(self, features: Tensor) -> Tensor:
        """Return a single network's scores, shape (...), of features, shape (..., F).

        A row has the same bits in any batch, so that scores can be kept.
        """
        # In place, which takes less memory.
        hidden = (features @ self.first).add_(self.first_bias).relu_()
        # A product of a matrix and a vector would add a row's terms in an order that depends on the
        # number of rows.
        return hidden.mul_(self.second).sum(-1) + self.bias

    def of_models(self, features: Tensor, model: Tensor) -> Tensor:
        """Return the scores of B rows by the network of each row.

        Args:
            features: shape (F, B, P).
            model: network of each row, shape (B,), int64.

        Returns:
            shape (B, P).
        """
        scores = features.new_empty(features.shape[1:])
        # A batch has rows of few models: a product for each takes far less memory than weights for
        # each row.
        for number in model.unique().tolist():
            rows = (model == number).nonzero()[:, 0]
            network = Ranker(
                self.first[number],
                self.first_bias[number],
                self.second[number],
                self.bias[number],
            )
            # (F, rows, P) to (rows, P, F).
            of_rows = features[:, rows].permute(1, 2, 0)
            scores[rows] = network(of_rows)
        return scores

    def weights(self) -> dict[str, Tensor]:
        """Return the weights by their names in :data:`RANKER`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}
