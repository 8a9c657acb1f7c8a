"""The base of all sources, and of those that score pairs of entities."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import torch
from torch import Tensor, nn

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.policies.sources import Label, source_class
from wordcraft_kg.models.scorers.config import Scale, SelfEdges
from wordcraft_kg.models.scorers.limits import TABLE_LIMIT
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.scales import FACTORED_SCALES, scaled_factors, scaled_table


@dataclass(frozen=True)
class ScoreView:
    """How a source reads a scorer; the default takes the scores as they are.

    Attributes:
        scale: see :func:`~wordcraft_kg.models.scorers.scales.scaled_table`.
        self_edges: see there.
        observed: triples that the scorer was trained on, shape (T, 3), for ``self_edges`` ``observed``.
        by_factors: take the scores of pairs from the scorer's factors, because a table of all would be too large.
    """

    scale: Scale = "none"
    self_edges: SelfEdges = "keep"
    observed: Ids | None = None
    by_factors: bool = False


class Source(nn.Module, ABC):
    """Scores of slots that receive no gradient.

    Everything that a source has computed from a scorer is in its buffers, which are saved with a policy and are all
    that is needed to use the source again.

    Attributes:
        label: its name and symbol.
        reads_task: whether scores depend on the task; only then is the task passed.
        num_entities: E, which is also the id of nothing.
        graph_hash: hash of the graph whose ids it uses; empty if it was restored with a policy, which has the hash.
    """

    label: ClassVar[Label]
    reads_task: ClassVar[bool] = False

    def __init__(self, num_entities: int):
        """Prepare empty constants for E entities."""
        super().__init__()
        self.num_entities = num_entities
        self.graph_hash = ""

    @property
    def name(self) -> str:
        """Name in settings and records."""
        return self.label.name

    @classmethod
    @abstractmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "Source":
        """Return the source of a scorer.

        Raises:
            ConfigError: if this scorer cannot give what the source needs.
        """

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> "Source":
        """Return a source whose buffers have the sizes of the saved ones, so that these can be loaded."""
        return cls(num_entities)

    @classmethod
    def num_bytes(cls, num_entities: int) -> int:
        """Return the size of the constants, as far as it is known before they are computed."""
        return 0

    @abstractmethod
    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:
        """Score every slot.

        Args:
            goal: shape (B,), int64: the entity to make.
            selection: shape (B,), int64: the entity held, E for nothing.
            table: shape (B, A), int64: the entities on the table, E for an empty slot.
            task: shape (B,), int64: number of the task among the train tasks. None for other tasks, or if
                :attr:`reads_task` is False.

        Returns:
            shape (B, A), float32; 0 for an empty slot.
        """


class PairSource(Source):
    """Scores each slot's entity with a key, the goal or the entity held: by a table of all pairs, or by factors.

    Attributes:
        scores: buffer of a table, shape (E + 1, E + 1): by key, by the slot's entity; 0 for nothing.
        left: buffer of factors, like those below, see :class:`~wordcraft_kg.models.scorers.scales.ScaledFactors`;
            shape (E + 1, m), by the slot's entity; 0 for nothing.
        right: shape (E + 1, m), by the key; 0 for nothing.
        shift: shape (), what is taken off each product.
        dropped: shape (E + 1,), bool.
        itself: shape ().
    """

    scores: Tensor
    left: Tensor
    right: Tensor
    shift: Tensor
    dropped: Tensor
    itself: Tensor

    def __init__(self, num_entities: int, constants: Mapping[str, Tensor]):
        """Take the buffers, either ``scores`` or all others."""
        super().__init__(num_entities)
        self.is_table = "scores" in constants
        for name in ("scores",) if self.is_table else ("left", "right", "shift", "dropped", "itself"):
            self.register_buffer(name, constants[name])

    @classmethod
    def of_pairs(cls, scorer: TripleScorer, relation: int, view: ScoreView, *, self_edges: SelfEdges = "keep") -> Self:
        """Return the source of a scorer's scores of all pairs in one relation, slot's entity first, then key."""
        size = len(scorer.entities)
        if not view.by_factors:
            table = torch.zeros(size + 1, size + 1)
            scores = scaled_table(scorer, relation, view.scale, self_edges=self_edges, observed=view.observed)
            table[:-1, :-1] = scores.detach().cpu().T
            return cls(size, {"scores": table})
        assert isinstance(scorer, FactoredScorer)
        factors = scaled_factors(scorer, relation, view.scale, self_edges=self_edges, observed=view.observed)
        constants = dict(vars(factors))
        constants |= {name: _with_nothing(constants[name]) for name in ("left", "right", "dropped")}
        return cls(size, constants)

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Self:  # noqa: D102 - inherited
        return cls(num_entities, {name: torch.zeros_like(tensor) for name, tensor in constants.items()})

    @classmethod
    def num_bytes(cls, num_entities: int) -> int:  # noqa: D102 - inherited
        return (num_entities + 1) ** 2 * 4

    @abstractmethod
    def key(self, goal: Tensor, selection: Tensor) -> Tensor:
        """Return the entity whose scores are asked for, shape (B,)."""

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:  # noqa: D102 - inherited
        key = self.key(goal, selection)[:, None]
        if self.is_table:
            cells = torch.add(table, key, alpha=self.num_entities + 1)
            return self.scores.view(-1).index_select(0, cells.reshape(-1)).view(cells.shape)
        slots = self.left.index_select(0, table.reshape(-1)).view(*table.shape, -1)
        scores = torch.bmm(slots, self.right[key[:, 0]][:, :, None])[:, :, 0] - self.shift
        scores = torch.where((table == key) & self.dropped[table], self.itself, scores)
        return scores.masked_fill((table == self.num_entities) | (key == self.num_entities), 0)


def _with_nothing(rows: Tensor) -> Tensor:
    """Return rows of all entities with one of zeros for nothing."""
    return torch.cat([rows, torch.zeros_like(rows[:1])])


def pairs_need_factors(names: Iterable[str], scorer: TripleScorer, scale: Scale) -> bool:
    """Return whether tables of all pairs would be too large, so that sources have to score by factors.

    Raises:
        ConfigError: if they have to and cannot, saying what they would need and what works.
    """
    size = len(scorer.entities)
    needed = sum(source_class(name).num_bytes(size) for name in names)
    if needed <= TABLE_LIMIT:
        return False
    cost = (
        f"the scores of all pairs of {size:,} entities take {needed / 2**20:,.0f} MiB; expected at most "
        f"{TABLE_LIMIT / 2**20:.0f} MiB, because sources look them up in tables"
    )
    if not isinstance(scorer, FactoredScorer):
        raise ConfigError(
            f"{cost}; only the scores of ComplEx and DistMult can be computed without. Train one of these."
        )
    if scale not in FACTORED_SCALES:
        raise ConfigError(f"`scale` {scale}: {cost}. Choose {' or '.join(FACTORED_SCALES)}, which need none.")
    return True


def make_sources(names: Iterable[str], scorer: TripleScorer, view: ScoreView = ScoreView()) -> list[Source]:
    """Return sources of a scorer by name.

    Raises:
        ConfigError: if the scorer cannot serve one, or only by a table that would be too large (before it is computed).

    Example:
        >>> u, v = make_sources(["u", "v"], load_scorer("models/kitchen"))
        >>> u.label.symbol, v.graph_hash == open_graph("kitchen").graph.hash
        ('u', True)
    """
    names = tuple(names)
    if pairs_need_factors(names, scorer, view.scale):
        view = replace(view, by_factors=True)
    sources = [source_class(name).of_scorer(scorer, view) for name in names]
    for source in sources:
        source.graph_hash = scorer.graph_hash
    return sources
