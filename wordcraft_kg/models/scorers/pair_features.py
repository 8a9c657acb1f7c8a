"""What recipes say about a pair and a goal, as a few numbers, and the small ranker that makes a score of them.

For many tables at once, because a policy asks at each step: everything that takes time is a table made before, and what
depends on three entities, the evidence, is a sum over the few recipes whose results are most like the goal.
"""

from collections.abc import Mapping, Sequence
from typing import Self

import torch
from torch import Tensor, nn

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.similarity import normalised

FEATURES = (
    "part_sum",
    "part_min",
    "part_max",
    "link_sum",
    "link_min",
    "words_sum",
    "words_min",
    "uses_sum",
    "uses_min",
    "pair",
    "pair_link",
    "known",
    "words_pair",
    "itself",
    "made",
    "evidence",
    "words_evidence",
)
"""The features of a pair (a, b) and a goal c, in the order of the ranker's weights.

| feature | meaning |
|---|---|
| part_* | componentOf(a, c) and (b, c) by kernel regression |
| link_* | the same by the link ranker |
| words_sum, words_min | cosines of the words of a and c, b and c |
| uses_* | log(1 + recipes that use a), and b |
| pair, pair_link | combinesWith(a, b) by the kernel and by the link ranker |
| known | a + b is known to make something |
| words_pair, itself | cosine of the words of a and b; a is b |
| made | log(1 + recipes of c) |
| evidence | log of the recipe-to-recipe kernel, see :class:`RecipeKnowledge` |
| words_evidence | the same with cosines of words instead |
"""
EVIDENCE = 48
"""Recipes that may speak for a goal: those whose results are most like it, its own first."""
FLOOR = 1e-4
"""Added to evidence before the logarithm."""
EXACT = 2.0
"""How much an entity is like itself, where 1 would do: what is remembered then stands out from what is concluded."""
_SHARED = ("words",)
"""Buffers that all models of a stack have in common."""


class RecipeKnowledge(nn.Module):
    """Tables from which any pair can be scored for any goal, for M models, and the rankers of these models.

    A row E stands for nothing. The evidence is
    ``G(a, b, c) = Σ_r k(c, c_r) [k(a, a_r) k(b, b_r) + k(a, b_r) k(b, a_r)]`` over the recipes r that may speak for c,
    with the squared normalised similarity k: recipes that differ little from this one say that it exists.

    Attributes:
        parts: shape (M, E + 1, E + 1, 2), half: by ingredient and goal, the kernel's componentOf and the link ranker's.
        pairs: shape (M, E + 1, E + 1, 3), half: the kernel's combinesWith, the link ranker's, and whether it is known.
        alike: shape (M, E + 1, E + 1), half: k, with :data:`EXACT` on the diagonal.
        words: shape (E + 1, E + 1), half: cosines of words.
        counts: shape (M, E + 1, 2): log(1 + recipes that use an entity), log(1 + recipes that make it).
        speaking: shape (M, E + 1, R, 3), int16: the recipes that may speak for a goal, by k of their results; E for
            none.
        first, first_bias, second, bias: the rankers, shapes (M, F, H), (M, H), (M, H) and (M,).
    """

    parts: Tensor
    pairs: Tensor
    alike: Tensor
    words: Tensor
    counts: Tensor
    speaking: Tensor
    first: Tensor
    first_bias: Tensor
    second: Tensor
    bias: Tensor

    def __init__(self, constants: Mapping[str, Tensor]):
        """Take the buffers."""
        super().__init__()
        for name in BUFFERS:
            self.register_buffer(name, constants[name])
        self.num_entities = len(self.words) - 1

    @classmethod
    def stacked(cls, models: Sequence["RecipeKnowledge"]) -> Self:
        """Return the models of several as one."""
        return cls(
            {
                name: getattr(models[0], name)
                if name in _SHARED
                else torch.cat([getattr(model, name) for model in models])
                for name in BUFFERS
            }
        )

    def constants(self) -> dict[str, Tensor]:
        """Return the buffers by name."""
        return dict(self.named_buffers())

    def with_ranker(self, weights: Mapping[str, Tensor]) -> Self:
        """Return the same knowledge of one model with another ranker."""
        return type(self)(self.constants() | {name: weights[name][None] for name in RANKER})

    def features(self, goal: Tensor, table: Tensor, model: Tensor) -> Tensor:
        """Return the features of the pairs of slots.

        Args:
            goal: shape (B,), int64.
            table: shape (B, A), int64; E for an empty slot.
            model: shape (B,), int64: the model that answers.

        Returns:
            shape (B, P, F): pairs in the order of :func:`pairs_of`.
        """
        width = self.num_entities + 1
        slots = table.shape[1]
        one, other = pairs_of(slots, table.device)
        rows = (model * width)[:, None] + table
        a, b = table.index_select(1, one), table.index_select(1, other)
        with_goal = _rows(self.parts, rows * width + goal[:, None])
        words = self.words.view(-1)
        word_with_goal = _rows(words, table * width + goal[:, None])
        uses, made = self.counts.view(-1, 2)[rows][..., 0], self.counts.view(-1, 2)[model * width + goal][:, 1]
        of_pair = _rows(self.pairs, rows.index_select(1, one) * width + b)
        word_of_pair = _rows(words, a * width + b)
        part_a, part_b = with_goal.index_select(1, one), with_goal.index_select(1, other)
        least = torch.minimum(part_a, part_b)
        words_a, words_b = word_with_goal.index_select(1, one), word_with_goal.index_select(1, other)
        uses_a, uses_b = uses.index_select(1, one), uses.index_select(1, other)
        sums = part_a + part_b
        evidence = [each.flatten(1).index_select(1, one * slots + other) for each in self._evidence(goal, table, model)]
        return torch.stack(
            [
                sums[..., 0],
                least[..., 0],
                torch.maximum(part_a[..., 0], part_b[..., 0]),
                sums[..., 1],
                least[..., 1],
                words_a + words_b,
                torch.minimum(words_a, words_b),
                uses_a + uses_b,
                torch.minimum(uses_a, uses_b),
                *of_pair.unbind(-1),
                word_of_pair,
                (a == b).float(),
                made[:, None].expand(-1, len(one)),
                *((each + FLOOR).log() for each in evidence),
            ],
            dim=-1,
        )

    def _evidence(self, goal: Tensor, table: Tensor, model: Tensor) -> tuple[Tensor, Tensor]:
        """Return the evidence for each two slots, by what recipes do and by words, two of shape (B, A, A)."""
        width = self.num_entities + 1
        speaking = self.speaking.view(-1, *self.speaking.shape[2:])[model * width + goal].long()
        rows = ((model * width)[:, None] + table) * width
        result = (model * width + goal)[:, None] * width + speaking[..., 2]
        by_deeds = self.alike.view(-1)

        def summed(like: Tensor, rows: Tensor, result: Tensor, power: int) -> Tensor:
            weight = _rows(like, result).clamp(min=0) ** power
            one, other = (
                _rows(like, rows[:, :, None] + speaking[:, None, :, part]).clamp(min=0) ** power for part in (0, 1)
            )
            both = torch.bmm(one * weight[:, None], other.transpose(1, 2))
            return both + both.transpose(1, 2)

        by_words = summed(self.words.view(-1), table * width, goal[:, None] * width + speaking[..., 2], 4)
        return summed(by_deeds, rows, result, 1), by_words

    def forward(self, goal: Tensor, table: Tensor, model: Tensor) -> Tensor:
        """Return the score of each two slots for the goal, shape (B, A, A), nats; -inf where one is empty."""
        features = self.features(goal, table, model)
        hidden = torch.relu(torch.baddbmm(self.first_bias[model][:, None], features, self.first[model]))
        scores = torch.bmm(hidden, self.second[model][:, :, None])[..., 0] + self.bias[model][:, None]
        is_empty = table == self.num_entities
        scores = scores.index_select(1, _square(table.shape[1], table.device)).view(*table.shape, -1)
        return scores.masked_fill(is_empty[:, :, None] | is_empty[:, None], -torch.inf)


RANKER = ("first", "first_bias", "second", "bias")
BUFFERS = ("parts", "pairs", "alike", "words", "counts", "speaking", *RANKER)


def knowledge_of(
    recipes: Ids,
    kernel: Tensor,
    text: Tensor,
    tables: tuple[Tensor, Tensor],
    links: tuple[Tensor, Tensor],
    known: Tensor,
) -> RecipeKnowledge:
    """Return the knowledge of one model, with a ranker of zeros.

    Args:
        recipes: shape (n, 3), what it has seen.
        kernel: how alike entities are, shape (E, E).
        text: cosines of words, shape (E, E).
        tables: the kernel's combinesWith and componentOf, two of shape (E, E).
        links: the link ranker's.
        known: the combinesWith links of the recipes, shape (E, E).
    """
    size = len(text)
    alike = normalised(kernel) ** 2
    alike.fill_diagonal_(EXACT)
    counts = torch.zeros(size + 1, 2)
    users, makers = torch.from_numpy(recipes[:, :2].ravel().copy()), torch.from_numpy(recipes[:, 2].copy())
    counts[:-1, 0], counts[:-1, 1] = (torch.bincount(ids, minlength=size)[:size].log1p() for ids in (users, makers))
    speaking = torch.full((size + 1, EVIDENCE, 3), size, dtype=torch.int16)
    if len(recipes):
        nearest = torch.sort(alike[:, makers], dim=1, descending=True, stable=True).indices[:, :EVIDENCE]
        speaking[:-1, : nearest.shape[1]] = torch.from_numpy(recipes.astype("int16"))[nearest]
    return RecipeKnowledge(
        {
            "parts": _padded(torch.stack([tables[1], links[1]], dim=-1))[None],
            "pairs": _padded(torch.stack([tables[0], links[0], known], dim=-1))[None],
            "alike": _padded(alike)[None],
            "words": _padded(text),
            "counts": counts[None],
            "speaking": speaking[None],
            "first": torch.zeros(1, len(FEATURES), 1),
            "first_bias": torch.zeros(1, 1),
            "second": torch.zeros(1, 1),
            "bias": torch.zeros(1),
        }
    )


def pairs_of(slots: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the slots of each pair, two of shape (P,), with ``one <= other``."""
    one, other = torch.triu_indices(slots, slots, device=device)
    return one, other


def _square(slots: int, device: torch.device) -> Tensor:
    """Return the number of the pair of each two slots, shape (A * A,)."""
    one, other = pairs_of(slots, device)
    number = torch.zeros(slots, slots, dtype=torch.int64, device=device)
    number[one, other] = number[other, one] = torch.arange(len(one), device=device)
    return number.view(-1)


def _rows(table: Tensor, cells: Tensor) -> Tensor:
    """Return cells of a table of halves as floats; each may be a row of several numbers."""
    numbers = table.shape[3:]
    flat = table.reshape(-1, *numbers)
    return flat.index_select(0, cells.reshape(-1)).view(*cells.shape, *numbers).float()


def _padded(table: Tensor) -> Tensor:
    """Return a table with a row and a column of zeros for nothing, as halves."""
    pad = (0, 0) * (table.ndim - 2) + (0, 1, 0, 1)
    return nn.functional.pad(table, pad).half()
