"""Features for two ingredients and a goal, from known recipes, and a small neural network on top.

Policies score many tables at each step, so features for two entities are looked up in arrays. The
evidence depends on three entities; its sum runs over the few recipes with results most similar to
the goal.
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
"""Features of a pair (a, b) and a goal c, in the order of the ranker's weights.

Sums and minima run over a and b.

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
_GOALS = 512
"""Goals whose supporting recipes are sorted at once."""

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
    """Arrays and networks that score any ingredient pair with any goal, for M models.

    The models are, for instance, those of folds. Row E is the empty slot. Columns from E + 1 on are
    entities of other books, which only supporting recipes contain; without other books W is E + 1.

    The evidence is ``G(a, b, c) = Σ_r k(c, c_r) [k(a, a_r) k(b, b_r) + k(a, b_r) k(b, a_r)]``
    over the recipes r with results most similar to c, with the squared normalised similarity k.

    Attributes:
        parts: shape (M, E + 1, E + 1, 2), half: componentOf scores by ingredient and goal, from the
            recipe kernel and the learned link ranker.
        pairs: shape (M, E + 1, E + 1, 2), half: combinesWith scores, likewise.
        numbers: shape (M, E + 1, E + 1), int32: number of a known pair, 0 for unknown pairs.
        results: shape (M, N + 1, L), int32: results by known pair, padded with E. Row 0, of unknown
            pairs, is padding alone.
        alike: shape (M, E + 1, W), half: k, which is squared already.
        words: shape (E + 1, W), half: word cosines.
        counts: shape (M, E + 1, 2): log(1 + n), for n recipes that use (a + a counts twice), and
            that make, an entity.
        supporting: shape (M, E + 1, R, 3), int16: recipes with results most similar to a goal,
            padded with E.
        feature_names: :data:`FEATURES`.
        made_name: ``made``.
        sampled_results: as in :class:`PairKnowledge`.
        buffer_names: :data:`BUFFERS`.
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
        most_pairs = max(each.shape[1] for each in results)
        most_results = max(each.shape[2] for each in results)

        def widened(part: Tensor) -> Tensor:
            """Pad results to the largest number of pairs, and of results for a pair."""
            # torch lists the last axis first, and padding before each axis before padding after.
            pad = (0, most_results - part.shape[2], 0, most_pairs - part.shape[1])
            return nn.functional.pad(part, pad, value=nothing)

        def joined(name: str) -> Tensor:
            parts = [getattr(model, name) for model in models]
            if name == "words":
                # All models have the same words; tensors in a file may not share memory.
                return parts[0].clone()
            if name == "results":
                parts = [widened(part) for part in parts]
            return torch.cat(parts)

        return cls({name: joined(name) for name in BUFFERS})

    def of_entities(self, own: Tensor) -> Self:
        """Return the knowledge about the entities ``own``, ids (n,), which get the ids from 0.

        All other entities come last, as those of other books do.
        """
        size = self.num_entities
        empty = len(own)
        # New order: own entities, the empty slot, all others; `place` maps old ids to new ones.
        rows = torch.cat([own, own.new_tensor([size])])
        is_other = torch.ones(size + 1, dtype=torch.bool).index_fill(0, rows, False)
        order = torch.cat([rows, is_other.nonzero()[:, 0]])
        place = torch.argsort(order)

        def renumbered(ids: Tensor, highest: int) -> Tensor:
            """Return new ids; those above ``highest`` become the empty slot."""
            numbers = place[ids.long()]
            return numbers.where(numbers <= highest, torch.tensor(empty)).to(ids.dtype)

        changed = {
            # A known result that is no own entity is no result; a supporting recipe may still
            # contain it.
            "results": renumbered(self.results, empty),
            "supporting": renumbered(self.supporting[:, rows], size),
            "alike": self.alike[:, rows][:, :, order],
            "words": self.words[rows][:, order],
            "counts": self.counts[:, rows],
        }
        for name in ("parts", "pairs", "numbers"):
            changed[name] = getattr(self, name)[:, rows][:, :, rows]
        return type(self)(self.constants() | changed)

    def features(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        pairs: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        width = self.num_entities + 1
        wide = self.words.shape[1]
        slots = table.shape[1]
        one, other = pairs or pairs_of(slots, table.device)
        # Axes are flattened and indexed once, by number of a row (model, entity) or of a cell in
        # it: one index takes less time than an index for each axis.
        rows = (model * width)[:, None] + table
        a = table.index_select(1, one)
        b = table.index_select(1, other)
        cells = rows.index_select(1, one) * width + b

        # Of an ingredient and the goal, shape (4, B, A): computed once for each slot, not pair.
        goals = goal[:, None]
        part, link = _rows(self.parts, rows * width + goals).unbind(-1)
        words = _rows(self.words, table * wide + goals)
        log_uses = self.counts[:, :, 0].flatten()
        uses = log_uses.index_select(0, rows.view(-1)).view(rows.shape)
        of_slots = torch.stack([part, link, words, uses])
        of_a = of_slots.index_select(2, one)
        of_b = of_slots.index_select(2, other)

        # Of a pair, shape (B, P) each.
        pair, pair_link = _rows(self.pairs, cells).unbind(-1)
        words_pair = _rows(self.words, a * wide + b)
        numbers = self.numbers.view(-1)
        number = numbers.index_select(0, cells.view(-1)).view(cells.shape)
        # Row 0 of each model, of unknown pairs, holds padding, which equals no goal.
        known_rows = number + (model * self.results.shape[1])[:, None]
        known_results = self.results.flatten(0, 1).index_select(0, known_rows.view(-1))
        known_results = known_results.view(*number.shape, self.results.shape[2])
        makes = (known_results == goal[:, None, None]).any(-1)
        log_made = self.counts[:, :, 1].flatten()
        made = log_made.index_select(0, model * width + goal)
        made_of_pairs = made[:, None].expand_as(a)

        of_tables = self._evidence(goal, table, model).flatten(2)
        evidence = of_tables.index_select(2, one * slots + other)
        # In the order of FEATURES; flags become numbers.
        of_pairs = torch.stack(
            [pair, pair_link, number > 0, makes, words_pair, a == b, made_of_pairs]
        )
        return torch.cat(
            [of_a + of_b, torch.minimum(of_a, of_b), of_pairs, evidence.add(FLOOR).log()]
        )

    def _evidence(self, goal: Tensor, table: Tensor, model: Tensor) -> Tensor:
        """Return the evidence for all slot pairs, by recipes and by words, shape (2, B, A, A)."""
        width = self.num_entities + 1
        wide = self.words.shape[1]
        goal_rows = model * width + goal
        supporting = self.supporting.flatten(0, 1).index_select(0, goal_rows).long()
        result = supporting[..., 2]
        # All first ingredients, then all second ones, shape (B, 1, 2 R): one look-up serves both.
        both = supporting[..., :2].transpose(1, 2)
        ingredients = both.flatten(1)[:, None]
        rows = (model * width)[:, None] + table

        def summed(like: Tensor, rows: Tensor, goal: Tensor) -> Tensor:
            """Return ``Σ_r like(c, c_r) like(a, a_r) like(b, b_r)`` for all slots a and b.

            Args:
                like: similarities of rows and all W entities.
                rows: row of each slot's entity, shape (B, A).
                goal: row of each goal, shape (B,).

            Returns:
                shape (B, A, A).
            """
            weight = _rows(like, goal[:, None] * wide + result)
            of_slots = _rows(like, (rows * wide)[:, :, None] + ingredients)
            one, other = of_slots.chunk(2, dim=2)
            # The sum over recipes is a matrix product of slots by recipes and recipes by slots.
            return torch.bmm(one * weight[:, None], other.transpose(1, 2))

        by_recipes = summed(self.alike, rows, goal_rows)
        # All models have the same words, so rows are entities there.
        by_words = summed(self._words_like(), table, goal)
        straight = torch.stack([by_recipes, by_words])
        # The transpose holds the crossed order of ingredients.
        return straight + straight.transpose(2, 3)

    def _words_like(self) -> Tensor:
        """Return powers of positive word cosines, shape (E + 1, W); computed once."""
        if not len(self._words_alike):
            self._words_alike = (self.words.float().clamp(min=0) ** _WORDS_POWER).half()
        return self._words_alike

    def support_of(  # noqa: D102 - inherited
        self,
        a: int,
        b: int,
        goal: int,
        model: int,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        supporting = self.supporting[model, goal].long()
        alike = self.alike[model]
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
        is_result = self.results[model, number] == result[:, None]
        return (number > 0) & is_result.any(1)


def _forget(knowledge: nn.Module, _: object) -> None:
    """Drop what was computed from other words."""
    assert isinstance(knowledge, RecipeKnowledge)
    knowledge._words_alike = torch.empty(0)


def knowledge_of(
    recipes: Ids,
    kernel: Tensor,
    text: Tensor,
    tables: tuple[Tensor, Tensor],
    links: tuple[Tensor, Tensor],
) -> RecipeKnowledge:
    """Return feature arrays from training recipes for one model, M = 1.

    Network weights are 0 until :meth:`PairKnowledge.with_ranker`.

    Args:
        recipes: training recipes, ids (n, 3).
        kernel: entity similarities, shape (E, E).
        text: word cosines, shape (E, E).
        tables: combinesWith and componentOf scores by the recipe kernel, shape (E, E) each.
        links: the same by the learned link ranker.

    Returns:
        the knowledge, of E entities.
    """
    size = len(text)
    alike = normalised(kernel) ** 2
    users = torch.from_numpy(recipes[:, :2].ravel().copy())
    made = torch.from_numpy(recipes[:, 2].copy())
    # The last row, of the empty slot, stays 0.
    counts = torch.zeros(size + 1, 2)
    num_uses = torch.bincount(users, minlength=size)[:size]
    num_makers = torch.bincount(made, minlength=size)[:size]
    counts[:-1, 0] = num_uses.log1p()
    counts[:-1, 1] = num_makers.log1p()

    # In blocks of goals, because a row has a column for each recipe. The sort is stable, so that
    # recipes with equally similar results stay in the order of the book.
    nearest = torch.cat(
        [
            torch.sort(rows[:, made], descending=True, stable=True).indices[:, :EVIDENCE]
            for rows in alike.split(_GOALS)
        ]
    )
    # 16 bits hold all ids: a graph with more entities is too large for these tables.
    supporting = torch.full((size + 1, EVIDENCE, 3), size, dtype=torch.int16)
    short = torch.from_numpy(recipes.astype("int16"))
    supporting[:-1, : nearest.shape[1]] = short[nearest]
    numbers, results = _known_pairs(recipes, size)
    # A cell holds both numbers of a pair, so that one look-up fetches them.
    parts = torch.stack([tables[1], links[1]], dim=-1)
    pairs = torch.stack([tables[0], links[0]], dim=-1)
    return RecipeKnowledge(
        {
            "parts": _padded(parts)[None],
            "pairs": _padded(pairs)[None],
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
    """Return the number of each pair, (E + 1, E + 1), from 1, and the results of each number."""
    pairs, number = np.unique(recipes[:, :2], axis=0, return_inverse=True)
    # Number 0 stands for unknown pairs, which have no results.
    of_pair: list[list[int]] = [[] for _ in range(len(pairs) + 1)]
    results = recipes[:, 2].tolist()
    for pair, result in zip(number.reshape(-1).tolist(), results, strict=True):
        of_pair[pair + 1].append(result)
    numbers = torch.zeros(size + 1, size + 1, dtype=torch.int32)
    one, other = torch.from_numpy(pairs.copy()).T
    from_one = torch.arange(1, len(pairs) + 1, dtype=torch.int32)
    numbers[one, other] = from_one
    numbers[other, one] = from_one
    return numbers, torch.from_numpy(padded(of_pair, size, 1)).int()


def _rows(table: Tensor, cells: Tensor) -> Tensor:
    """Return float32 values of a table at numbered cells, with the cells' shape.

    A table with a fourth axis, of two half numbers, gives both for each cell.
    """
    numbers = table.shape[3:]
    # Two half numbers are fetched as one number of 32 bits, by one look-up.
    flat = table.view(torch.int32) if numbers else table
    fetched = flat.reshape(-1).index_select(0, cells.reshape(-1))
    return fetched.view(table.dtype).view(*cells.shape, *numbers).float()


def _padded(table: Tensor) -> Tensor:
    """Return a table, half, with a row and a column of zeros for the empty slot."""
    # torch lists the last axis first: a third axis, of numbers in a cell, stays as it is.
    pad = (0, 0) * (table.ndim - 2) + (0, 1, 0, 1)
    return nn.functional.pad(table, pad).half()
