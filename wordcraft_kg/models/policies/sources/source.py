"""The base of all sources, and of those that look their scores up in a table of pairs."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from wordcraft_kg.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.policies.sources import Label, source_class
from wordcraft_kg.models.scorers.config import Scale, SelfEdges
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.tables import TABLE_LIMIT


@dataclass(frozen=True)
class ScoreView:
    """How a source reads a scorer; the default takes the scores as they are.

    Attributes:
        scale: see :func:`~wordcraft_kg.models.scorers.scales.scaled_table`.
        self_edges: see there.
        observed: triples that the scorer was trained on, shape (T, 3), for ``self_edges`` ``observed``.
    """

    scale: Scale = "none"
    self_edges: SelfEdges = "keep"
    observed: Ids | None = None


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


class TableSource(Source):
    """Looks scores up by a key (the goal or the entity held) and the slot's entity.

    Attributes:
        scores: buffer, shape (E + 1, E + 1): by key, by the slot's entity; 0 for nothing.
    """

    scores: Tensor

    def __init__(self, num_entities: int, scores: Tensor | None = None):
        """Take the scores of all pairs, shape (E, E), by the slot's entity and the key; None leaves room for them."""
        super().__init__(num_entities)
        table = torch.zeros(num_entities + 1, num_entities + 1)
        if scores is not None:
            table[:-1, :-1] = scores.detach().cpu().T
        self.register_buffer("scores", table)

    @classmethod
    def num_bytes(cls, num_entities: int) -> int:  # noqa: D102 - inherited
        return (num_entities + 1) ** 2 * 4

    @abstractmethod
    def key(self, goal: Tensor, selection: Tensor) -> Tensor:
        """Return the entity whose scores are asked for, shape (B,)."""

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:  # noqa: D102 - inherited
        cells = torch.add(table, self.key(goal, selection)[:, None], alpha=self.num_entities + 1)
        return self.scores.view(-1).index_select(0, cells.reshape(-1)).view(cells.shape)


def make_sources(names: Iterable[str], scorer: TripleScorer, view: ScoreView = ScoreView()) -> list[Source]:
    """Return sources of a scorer by name.

    Raises:
        ConfigError: if their tables would not fit (before anything is computed), or the scorer cannot serve one.

    Example:
        >>> u, v = make_sources(["u", "v"], load_scorer("models/kitchen"))
        >>> u.label.symbol, v.graph_hash == open_graph("kitchen").graph.hash
        ('u', True)
    """
    kinds = [source_class(name) for name in names]
    size = len(scorer.entities)
    needed = sum(kind.num_bytes(size) for kind in kinds)
    if needed > TABLE_LIMIT:
        raise ConfigError(
            f"the scores of all pairs of {size:,} entities take {needed / 2**20:,.0f} MiB; expected at most "
            f"{TABLE_LIMIT / 2**20:.0f} MiB, because sources look them up in tables."
        )
    sources = [kind.of_scorer(scorer, view) for kind in kinds]
    for source in sources:
        source.graph_hash = scorer.graph_hash
    return sources
