"""Attention of the goal and the selection over the table, and the entity vectors that it uses.

Rows of a batch have few slots, so the shapes of products matter more than their size: vectors are fetched by
``index_select``, a row's slots are the columns of one small product, and softmax runs along the first axis.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

FOLD_LIMIT = 300
"""Dimensions up to which query and key weights are multiplied once for all samples of an update."""


class EntityVectors(nn.Module):
    """The vectors x of entities: constant, learned or one-hot; that of nothing, the id after the last, is zero.

    One-hot vectors are never written out, since a product with one is a row of the weights.

    Attributes:
        num_entities: E, which is also the id of nothing.
        dim: F, the length of a vector.
        is_one_hot: whether the vectors are the rows of the identity.
    """

    vectors: Tensor

    def __init__(self, num_entities: int, vectors: Tensor | None = None, *, learned_dim: int = 0):
        """Take constant vectors, shape (E, F); without them, learn vectors of ``learned_dim`` or use one-hot ones."""
        super().__init__()
        self.num_entities = num_entities
        self.is_one_hot = vectors is None and not learned_dim
        if vectors is not None:
            self.register_buffer("vectors", vectors.detach().to(torch.float32).clone())
        elif learned_dim:
            self.vectors = nn.Parameter(torch.randn(num_entities, learned_dim))
        else:
            self.register_buffer("vectors", torch.empty(0, 0))
        self.dim = num_entities if self.is_one_hot else self.vectors.shape[1]

    def weights(self) -> dict[str, Tensor]:
        """Return ``vectors`` of all entities and of nothing, shape (E + 1, F); without that key if they are one-hot."""
        return {} if self.is_one_hot else {"vectors": nn.functional.pad(self.vectors, (0, 0, 0, 1))}


def look_up(vectors: Tensor, ids: Tensor) -> Tensor:
    """Return the vectors of entities, ``ids`` of any shape: shape (*ids, F)."""
    return vectors.index_select(0, ids.reshape(-1)).view(*ids.shape, vectors.shape[1])


def masked_softmax(logits: Tensor, mask: Tensor) -> Tensor:
    """Return the softmax over the slots where ``mask`` is True, shape (B, A); exactly 0 elsewhere."""
    return torch.softmax(logits.masked_fill(~mask, -torch.inf).T.contiguous(), dim=0).T


class TableAttention(nn.Module):
    """Scaled dot-product attention of goal and selection over the slots, and sums over slots.

    ``α_i = Q([x_g; x_s]) · K(x_i) / √d``. Since ``q · K x = (Kᵀ q) · x``, and since vectors do not depend on the
    sample, keys are folded into the query: no slot's key is ever computed. K has no bias, since it would add the
    same to every slot.

    Source: Jiang et al. 2020, section "Self-attention Actor-Critic Network". The second selection is always empty when
    an action is chosen, and is left out of the query.
    """

    def __init__(self, dim: int, key_size: int):
        """Make the projections of F = ``dim`` to d = ``key_size``."""
        super().__init__()
        self.query = nn.Linear(2 * dim, key_size)
        self.key = nn.Linear(dim, key_size, bias=False)

    def weights(self) -> dict[str, Tensor]:
        """Return ``query``, ``query.bias`` and, unless it is folded into them, ``key``."""
        key = self.key.weight / math.sqrt(self.key.out_features)
        if self.key.in_features <= FOLD_LIMIT:
            return {"query": self.query.weight.T @ key, "query.bias": self.query.bias @ key}
        return {"query": self.query.weight.T, "query.bias": self.query.bias, "key": key}

    @staticmethod
    def rows(weights: Mapping[str, Tensor], goal: Tensor, selection: Tensor) -> Tensor:
        """Return ``Kᵀ q / √d``, whose product with a slot's vector is its α: shape (B, F).

        Args:
            weights: weights of the attention and of the entities' vectors.
            goal: shape (B,).
            selection: shape (B,).
        """
        query, bias, vectors = weights["query"], weights["query.bias"], weights.get("vectors")
        if vectors is not None:
            both = look_up(vectors, torch.stack([goal, selection], dim=1)).flatten(1)
            projected = torch.addmm(bias, both, query)
        else:
            by_goal, by_selection = nn.functional.pad(query.view(2, -1, query.shape[1]), (0, 0, 0, 1))
            projected = bias + by_goal.index_select(0, goal) + by_selection.index_select(0, selection)
        return projected @ weights["key"] if "key" in weights else projected


class Slots:
    """The vectors on the tables of a batch: products with them, and weighted sums of them."""

    def __init__(self, vectors: Tensor | None, table: Tensor):
        """Take the vectors of all entities, shape (E + 1, F), None for one-hot ones, and tables, shape (B, A)."""
        self.table = table
        self.vectors = None if vectors is None else look_up(vectors, table)

    def dot(self, rows: Tensor) -> Tensor:
        """Return ``r · x_i`` for each slot: rows (B, F) -> (B, A)."""
        if self.vectors is not None:
            return torch.bmm(rows[:, None, :], self.vectors.transpose(1, 2))[:, 0]
        return nn.functional.pad(rows, (0, 1)).gather(1, self.table)

    def sum(self, weights: Tensor, num_entities: int) -> Tensor:
        """Return ``Σ_i w_i x_i``: weights (B, A) -> (B, F)."""
        if self.vectors is not None:
            return torch.bmm(weights[:, None, :].contiguous(), self.vectors)[:, 0]
        sums = weights.new_zeros(len(weights), num_entities + 1)
        return sums.scatter_add(1, self.table, weights)[:, :-1]
