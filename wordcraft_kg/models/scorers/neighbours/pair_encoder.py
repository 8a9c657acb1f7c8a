"""The pair encoder: networks that score any result of a pair, and any pair for a result.

With word vectors v, and learnt vectors of single entities that begin at 0::

    h(x)    = relu(W1 v_x + id_x)
    z(a, b) = MLP[h_a + h_b, h_a h_b, |h_a - h_b|]
    s       = z · g_c + bias_c + u(a, b),  g_c = W2 v_c + id'_c

Neighbour lists see a recipe only if known recipes have similar entities in all three places; the
encoder scores any recipe. On large books it gives the recipe ranker three features, and proposes
results of a pair from all entities. :mod:`wordcraft_kg.models.recipes.encoder_fitting` fits it. On
small books these features may come from the encoder of other, large books, as outside knowledge.

Shapes: T entities, D numbers of a word vector, U of an ingredient, Z of a result, V hidden units.
"""

from typing import NamedTuple

import torch
from torch import Tensor

_PAIRS = 4_096
"""Pairs that are encoded at once: their inputs take 6 MiB."""
_RECIPES = 2**16
"""Recipes whose pairs are gathered at once: 64 MiB at most."""


class PairEncoder(NamedTuple):
    """A fitted encoder, for inference.

    Vectors of entities are stored for all, in half precision: twice the speed of computing them
    from words, and no more memory than the learnt parts of their sums.

    Attributes:
        used: h of each entity, shape (T, U), half.
        made: g of each entity, shape (T, Z), half.
        bias: bias of each result, shape (T,).
        first: shape (3 U, V), weights of the sum, the product and the distance of h.
        first_bias: shape (V,).
        second: shape (V, Z), gives z.
        second_bias: shape (Z,).
        pair: shape (V,), gives u.
        pair_bias: shape ().
        used_words: shape (D, U), W1: makes h of an entity that has words alone.
        used_bias: shape (U,).
        made_words: shape (D, Z), W2.
        made_bias: shape (Z,).
        bias_words: shape (D,), makes the bias of an entity that has words alone.
        bias_base: shape ().
    """

    used: Tensor
    made: Tensor
    bias: Tensor
    first: Tensor
    first_bias: Tensor
    second: Tensor
    second_bias: Tensor
    pair: Tensor
    pair_bias: Tensor
    used_words: Tensor
    used_bias: Tensor
    made_words: Tensor
    made_bias: Tensor
    bias_words: Tensor
    bias_base: Tensor

    def with_entities(self, vectors: Tensor) -> "PairEncoder":
        """Return an encoder of n more entities, which have words alone, (n, D)."""
        ingredient_vectors = (vectors @ self.used_words + self.used_bias).relu()
        result_vectors = vectors @ self.made_words + self.made_bias
        bias = vectors @ self.bias_words + self.bias_base
        return self._replace(
            used=torch.cat([self.used, ingredient_vectors.half()]),
            made=torch.cat([self.made, result_vectors.half()]),
            bias=torch.cat([self.bias, bias]),
        )

    def of_first(self, number: int) -> "PairEncoder":
        """Return an encoder of the first entities alone."""
        # Cloned, because a part of a tensor would keep, and save, the whole.
        return self._replace(
            used=self.used[:number].clone(),
            made=self.made[:number].clone(),
            bias=self.bias[:number].clone(),
        )

    def without_words(self, dim: int) -> "PairEncoder":
        """Return an encoder to which all entities with words alone are the same.

        For word vectors of another kind than those that it was fitted with.

        Args:
            dim: length of the other word vectors.
        """
        zeros = self.bias_words.new_zeros
        return self._replace(
            used_words=zeros(dim, self.used_words.shape[1]),
            made_words=zeros(dim, self.made_words.shape[1]),
            bias_words=zeros(dim),
        )

    def hidden_units(self, a: Tensor, b: Tensor) -> Tensor:
        """Return the hidden units of pairs of ids, shape (n,) each: shape (n, V)."""
        size = self.used.shape[1]
        # The part of h_a + h_b is a sum of two entities' parts: a table of 10 slots has 55 pairs.
        entities, place = torch.cat([a, b]).unique(return_inverse=True)
        ingredient_vectors = self.used[entities].float()
        sum_parts = ingredient_vectors @ self.first[:size]
        product_weights = self.first[size:]
        places = place.view(2, len(a))
        units = torch.empty(len(a), self.first.shape[1], device=a.device)
        # In blocks: the inputs of a pair take a KiB and a half.
        for start in range(0, len(a), _PAIRS):
            block = slice(start, start + _PAIRS)
            first_places, second_places = places[:, block]
            h_first = ingredient_vectors[first_places]
            h_second = ingredient_vectors[second_places]
            product = h_first * h_second
            distance = (h_first - h_second).abs()
            inputs = torch.cat([product, distance], dim=-1)
            sums = sum_parts[first_places]
            sums.add_(sum_parts[second_places])
            sums.add_(self.first_bias)
            pair_units = torch.addmm(sums, inputs, product_weights)
            units[block] = pair_units.relu_()
        return units

    def encode(self, a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
        """Return z, shape (n, Z), and u, shape (n,), of pairs of ids, shape (n,) each."""
        units = self.hidden_units(a, b)
        z = units @ self.second + self.second_bias
        u = units @ self.pair + self.pair_bias
        return z, u

    def features(self, a: Tensor, b: Tensor, goal: Tensor) -> Tensor:
        """Return s, s - u and u, see the module, of recipes.

        Args:
            a: ids, shape (B, P).
            b: ids, shape (B, P).
            goal: ids, shape (B,).

        Returns:
            shape (B, P, 3).
        """
        size = len(self.bias)
        # Tables of a batch, and goals of a search, share pairs: each is encoded once.
        codes = torch.minimum(a, b) * size + torch.maximum(a, b)
        # Distinct pairs, and which of them stands in each place, shape (B, P).
        pairs, place = codes.unique(return_inverse=True)
        units = self.hidden_units(pairs // size, pairs % size)
        u_of_pairs = units @ self.pair + self.pair_bias
        u = u_of_pairs[place]
        result_vectors = self.made[goal].float()
        biases = self.bias[goal] + result_vectors @ self.second_bias
        # z · g is (units second) · g or units · (second g): the last layer is applied to pairs or
        # to goals, to whichever there are fewer of.
        if len(pairs) < len(goal):
            pair_factors = units @ self.second
            goal_factors = result_vectors
        else:
            pair_factors = units
            goal_factors = result_vectors @ self.second.T
        goal_scores = torch.empty_like(u)
        # In blocks: a search asks for a million recipes, each of which would take up to a KiB.
        step = max(1, _RECIPES // max(place.shape[1], 1))
        for start in range(0, len(goal), step):
            rows = slice(start, start + step)
            own_pairs = pair_factors[place[rows]]
            # A product of a matrix and a column for each goal: (rows, P, 1).
            products = own_pairs @ goal_factors[rows, :, None]
            goal_scores[rows] = products[..., 0]
        goal_scores += biases[:, None]
        return torch.stack([goal_scores + u, goal_scores, u], dim=-1)

    def result_scores(self, a: Tensor, b: Tensor) -> Tensor:
        """Return s - u of all entities as results of pairs, shape (n, T).

        Args:
            a: ids, shape (n,).
            b: ids, shape (n,).
        """
        z, _ = self.encode(a, b)
        result_vectors = self.made.float()
        return z @ result_vectors.T + self.bias


ENCODER = tuple(f"encoder_{name}" for name in PairEncoder._fields)
"""Names of an encoder's tensors, in files and modules."""


def pair_inputs(one: Tensor, other: Tensor) -> Tensor:
    """Return the inputs of a pair's network, in which the order of the pair does not count.

    Args:
        one: h of the first entities, shape (n, U).
        other: h of the second entities, shape (n, U).

    Returns:
        shape (n, 3 U).
    """
    return torch.cat([one + other, one * other, (one - other).abs()], dim=-1)
