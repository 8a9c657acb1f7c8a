"""Features for two ingredients and a goal, from known recipes, and a small neural network on top.

Policies score many tables at each step, so features for two entities are looked up in arrays. The evidence depends on
three entities; its sum runs over the few recipes with results most similar to the goal.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.graphs.arrays import Ids, padded
from wordcraft_kg.models.scorers.kernel import normalised
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge, pairs_of
from wordcraft_kg.models.scorers.ranker import RANKER

FEATURES = (
    "part_sum",
    "link_sum",
    "words_sum",
    "uses_sum",
    "part_min",
    "link_min",
    "words_min",
    "uses_min",
    "pair",
    "pair_link",
    "known",
    "makes",
    "words_pair",
    "itself",
    "made",
    "evidence",
    "words_evidence",
)
"""Features of a pair (a, b) and a goal c, in the order of the ranker's weights; sums and minima run over a and b.

| feature | meaning |
|---|---|
| part_* | componentOf(a, c) and (b, c) by kernel regression |
| link_* | the same by the link ranker |
| words_sum, words_min | word cosines of a and c, b and c |
| uses_* | log(1 + recipes that use a), and b |
| pair, pair_link | combinesWith(a, b) by the kernel and by the link ranker |
| known, makes | a + b has known results; c is a known result |
| words_pair, itself | word cosine of a and b; a equals b |
| made | log(1 + recipes that make c) |
| evidence | log of the recipe-to-recipe kernel, see :class:`RecipeKnowledge` |
| words_evidence | the same with powers of word cosines |
"""
EVIDENCE = 16
"""Supporting recipes per goal: those with the most similar results. More change no figure."""
FLOOR = 1e-4
"""Added to evidence before the logarithm."""
_WORDS_POWER = 4
"""Power of word cosines in the evidence; only near synonyms count."""

BUFFERS = (
    "parts",
    "pairs",
    "numbers",
    "results",
    "alike",
    "words",
    "counts",
    "supporting",
    *RANKER,
)
"""Names of the stored tensors."""


class RecipeKnowledge(PairKnowledge):
    """Arrays and networks that score any ingredient pair with any goal, for M models, such as the fold models.

    Row E is the empty slot. Columns from E + 1 on are entities of other books, which only supporting recipes contain;
    without other books W is E + 1.

    The evidence is ``G(a, b, c) = Σ_r k(c, c_r) [k(a, a_r) k(b, b_r) + k(a, b_r) k(b, a_r)]``
    over the recipes r with results most similar to c, with the squared normalised similarity k.

    Attributes:
        parts: shape (M, E + 1, E + 1, 2), half: componentOf scores by ingredient and goal, from the recipe kernel and
            the learned link ranker.
        pairs: shape (M, E + 1, E + 1, 2), half: combinesWith scores, likewise.
        numbers: shape (M, E + 1, E + 1), int32: number of a known pair, 0 for unknown pairs.
        results: shape (M, N + 1, L), int32: results by known pair, padded with E.
        alike: shape (M, E + 1, W), half: k.
        words: shape (E + 1, W), half: word cosines.
        counts: shape (M, E + 1, 2): log(1 + n), for n recipes that use (a + a counts twice), and that make, an entity.
        supporting: shape (M, E + 1, R, 3), int16: recipes with results most similar to a goal, padded with E.
    """

    parts: Tensor
    pairs: Tensor
    numbers: Tensor
    results: Tensor
    alike: Tensor
    words: Tensor
    counts: Tensor
    supporting: Tensor
    _words_alike: Tensor
    feature_names: ClassVar[tuple[str, ...]] = FEATURES
    made_name: ClassVar[str] = "made"
    sampled_results: ClassVar[int] = 42_000
    buffer_names: ClassVar[tuple[str, ...]] = BUFFERS

    def __init__(self, constants: Mapping[str, Tensor]):
        super().__init__()
        for name in BUFFERS:
            self.register_buffer(name, constants[name])
        self.num_entities = len(self.words) - 1
        self.register_buffer("_words_alike", torch.empty(0), persistent=False)
        self.register_load_state_dict_post_hook(_forget)

    @classmethod
    def of_constants(cls, constants: Mapping[str, Tensor], num_entities: int) -> Self:  # noqa: D102 - inherited
        return cls(constants)

    @classmethod
    def stacked(cls, models: Sequence[PairKnowledge]) -> Self:  # noqa: D102 - inherited
        nothing = models[0].num_entities
        results = [model.results for model in models if isinstance(model, RecipeKnowledge)]
        shape = [max(each.shape[axis] for each in results) for axis in (1, 2)]

        def joined(name: str) -> Tensor:
            parts = [getattr(model, name) for model in models]
            if name == "words":
                return parts[0].clone()  # tensors in a file may not share memory
            if name == "results":
                parts = [
                    nn.functional.pad(
                        part,
                        (0, shape[1] - part.shape[2], 0, shape[0] - part.shape[1]),
                        value=nothing,
                    )
                    for part in parts
                ]
            return torch.cat(parts)

        return cls({name: joined(name) for name in BUFFERS})

    def of_entities(self, own: Tensor) -> Self:
        """Return the knowledge about the entities ``own``, (n,), with ids from 0; other entities come last."""
        size, empty = self.num_entities, len(own)
        rows = torch.cat([own, own.new_tensor([size])])
        is_other = torch.ones(size + 1, dtype=torch.bool).index_fill(0, rows, False)
        order = torch.cat([rows, is_other.nonzero()[:, 0]])
        place = torch.argsort(order)

        def renumbered(ids: Tensor, highest: int) -> Tensor:
            numbers = place[ids.long()]
            return numbers.where(numbers <= highest, torch.tensor(empty)).to(ids.dtype)

        square = {
            name: getattr(self, name)[:, rows][:, :, rows] for name in ("parts", "pairs", "numbers")
        }
        return type(self)(
            self.constants()
            | square
            | {
                "results": renumbered(self.results, empty),
                "alike": self.alike[:, rows][:, :, order],
                "words": self.words[rows][:, order],
                "counts": self.counts[:, rows],
                "supporting": renumbered(self.supporting[:, rows], size),
            }
        )

    def features(  # noqa: D102 - inherited
        self, goal: Tensor, table: Tensor, model: Tensor, pairs: tuple[Tensor, Tensor] | None = None
    ) -> Tensor:
        width, wide = self.num_entities + 1, self.words.shape[1]
        slots = table.shape[1]
        one, other = pairs or pairs_of(slots, table.device)
        rows = (model * width)[:, None] + table
        a, b = table.index_select(1, one), table.index_select(1, other)
        cells = rows.index_select(1, one) * width + b
        part, link = _rows(self.parts, rows * width + goal[:, None]).unbind(-1)
        words = _rows(self.words, table * wide + goal[:, None])
        uses = self.counts[:, :, 0].flatten().index_select(0, rows.view(-1)).view(rows.shape)
        of_slots = torch.stack([part, link, words, uses])
        of_a, of_b = of_slots.index_select(2, one), of_slots.index_select(2, other)
        pair, pair_link = _rows(self.pairs, cells).unbind(-1)
        number = self.numbers.view(-1).index_select(0, cells.view(-1)).view(cells.shape)
        known_results = self.results.flatten(0, 1).index_select(
            0, (number + (model * self.results.shape[1])[:, None]).view(-1)
        )
        makes = (
            known_results.view(*number.shape, self.results.shape[2]) == goal[:, None, None]
        ).any(-1)
        made = self.counts[:, :, 1].flatten().index_select(0, model * width + goal)
        evidence = (
            self._evidence(goal, table, model).flatten(2).index_select(2, one * slots + other)
        )
        rest = [
            pair,
            pair_link,
            number > 0,
            makes,
            _rows(self.words, a * wide + b),
            a == b,
            made[:, None].expand_as(a),
        ]
        return torch.cat(
            [of_a + of_b, torch.minimum(of_a, of_b), torch.stack(rest), evidence.add(FLOOR).log()]
        )

    def _evidence(self, goal: Tensor, table: Tensor, model: Tensor) -> Tensor:
        width, wide = self.num_entities + 1, self.words.shape[1]
        supporting = self.supporting.flatten(0, 1).index_select(0, model * width + goal).long()
        result = supporting[..., 2]
        ingredients = supporting[..., :2].transpose(1, 2).flatten(1)[:, None]
        rows = (model * width)[:, None] + table

        def summed(like: Tensor, rows: Tensor, goal: Tensor) -> Tensor:
            weight = _rows(like, goal[:, None] * wide + result)
            one, other = _rows(like, (rows * wide)[:, :, None] + ingredients).chunk(2, dim=2)
            return torch.bmm(one * weight[:, None], other.transpose(1, 2))

        by_recipes = summed(self.alike, rows, model * width + goal)
        both = torch.stack([by_recipes, summed(self._words_like(), table, goal)])
        return both + both.transpose(2, 3)

    def _words_like(self) -> Tensor:
        if not len(self._words_alike):
            self._words_alike = (self.words.float().clamp(min=0) ** _WORDS_POWER).half()
        return self._words_alike

    def support_of(  # noqa: D102 - inherited
        self, a: int, b: int, goal: int, model: int
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        supporting, alike = self.supporting[model, goal].long(), self.alike[model]
        one, other, result = supporting.T
        straight = alike[a, one].float() * alike[b, other]
        crossed = alike[a, other].float() * alike[b, one]
        return supporting, alike[goal, result].float(), straight, crossed

    def component_scores(self, entities: Tensor) -> Tensor:  # noqa: D102 - inherited
        return self.parts[0, entities, :-1, 1].float()

    def word_cosines(self, entity: int, others: Tensor) -> Tensor:  # noqa: D102 - inherited
        return self.words[entity, others].float()

    def have_recipes(self, entity: int, others: Tensor) -> Tensor:  # noqa: D102 - inherited
        return self.numbers[0, entity, others] > 0

    def log_uses(self) -> Tensor:  # noqa: D102 - inherited
        return self.counts[0, :-1, 0]

    def knows(self, recipes: Tensor, model: int) -> Tensor:  # noqa: D102 - inherited
        one, other, result = recipes.T
        number = self.numbers[model, one, other].long()
        return (number > 0) & (self.results[model, number] == result[:, None]).any(1)


def _forget(knowledge: nn.Module, _: object) -> None:
    assert isinstance(knowledge, RecipeKnowledge)
    knowledge._words_alike = torch.empty(0)


def knowledge_of(
    recipes: Ids,
    kernel: Tensor,
    text: Tensor,
    tables: tuple[Tensor, Tensor],
    links: tuple[Tensor, Tensor],
) -> RecipeKnowledge:
    """Return feature arrays from training recipes (n, 3), M = 1; network weights are 0 until :meth:`with_ranker`.

    All tables have shape (E, E): ``kernel`` holds similarities, ``text`` word cosines, ``tables`` combinesWith and
    componentOf scores by the recipe kernel, ``links`` the same by the learned link ranker.
    """
    size = len(text)
    alike = normalised(kernel) ** 2
    counts = torch.zeros(size + 1, 2)
    users, makers = (
        torch.from_numpy(recipes[:, :2].ravel().copy()),
        torch.from_numpy(recipes[:, 2].copy()),
    )
    counts[:-1, 0], counts[:-1, 1] = (
        torch.bincount(ids, minlength=size)[:size].log1p() for ids in (users, makers)
    )
    supporting = torch.full((size + 1, EVIDENCE, 3), size, dtype=torch.int16)
    nearest = torch.cat(
        [
            torch.sort(rows[:, makers], descending=True, stable=True).indices[:, :EVIDENCE]
            for rows in alike.split(512)
        ]
    )
    supporting[:-1, : nearest.shape[1]] = torch.from_numpy(recipes.astype("int16"))[nearest]
    numbers, results = _known_pairs(recipes, size)
    return RecipeKnowledge(
        {
            "parts": _padded(torch.stack([tables[1], links[1]], dim=-1))[None],
            "pairs": _padded(torch.stack([tables[0], links[0]], dim=-1))[None],
            "numbers": numbers[None],
            "results": results[None],
            "alike": _padded(alike)[None],
            "words": _padded(text),
            "counts": counts[None],
            "supporting": supporting[None],
            "first": torch.zeros(1, len(FEATURES), 1),
            "first_bias": torch.zeros(1, 1),
            "second": torch.zeros(1, 1),
            "bias": torch.zeros(1),
        }
    )


def _known_pairs(recipes: Ids, size: int) -> tuple[Tensor, Tensor]:
    pairs, number = np.unique(recipes[:, :2], axis=0, return_inverse=True)
    of_pair: list[list[int]] = [[] for _ in range(len(pairs) + 1)]
    for pair, result in zip(number.reshape(-1).tolist(), recipes[:, 2].tolist(), strict=True):
        of_pair[pair + 1].append(result)
    numbers = torch.zeros(size + 1, size + 1, dtype=torch.int32)
    one, other = torch.from_numpy(pairs.copy()).T
    numbers[one, other] = numbers[other, one] = torch.arange(1, len(pairs) + 1, dtype=torch.int32)
    return numbers, torch.from_numpy(padded(of_pair, size, 1)).int()


def _rows(table: Tensor, cells: Tensor) -> Tensor:
    numbers = table.shape[3:]
    flat = (
        table.view(torch.int32) if numbers else table
    )  # two half numbers are fetched as one number
    return (
        flat.reshape(-1)
        .index_select(0, cells.reshape(-1))
        .view(table.dtype)
        .view(*cells.shape, *numbers)
        .float()
    )


def _padded(table: Tensor) -> Tensor:
    pad = (0, 0) * (table.ndim - 2) + (0, 1, 0, 1)
    return nn.functional.pad(table, pad).half()
