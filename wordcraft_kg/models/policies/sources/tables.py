"""Sources from tables: a function's scores of entities for goals, and scores of sets (t)."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.models.policies.sources import T
from wordcraft_kg.models.policies.sources.pairs import ComponentOf
from wordcraft_kg.models.policies.sources.source import ScoreView, Source
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.set_table import SetTableScorer


class GoalTable(ComponentOf):
    """Scores of each slot's entity for the goal, from a function of the labels; needs no scorer.

    Attributes:
        scores_of: the function, see :func:`wordcraft_kg.plugins.source`.
    """

    needs_scorer = False
    scores_of: ClassVar[Callable[[tuple[str, ...]], Any]]

    @classmethod
    def of_scorer(  # noqa: D102 - inherited
        cls, scorer: TripleScorer, view: ScoreView
    ) -> "GoalTable":
        size = len(scorer.entities)
        rows = cls.scores_of(scorer.entities)
        try:
            scores = torch.as_tensor(rows, dtype=torch.float32)
        except (TypeError, ValueError, RuntimeError):
            # Refused below: the shape is another.
            scores = torch.zeros(0)
        if scores.shape != (size, size) or scores.isinf().any() or scores.isnan().all():
            raise ConfigError(
                f"the source '{cls.label.name}' gives scores of shape {tuple(scores.shape)}; "
                f"expected {(size, size)}, by goal and entity: finite numbers, NaN where unknown."
            )
        by_entity = scores.nan_to_num(nan=float(scores.nanmean())).T
        # As scores of componentOf, on the same scale; combinesWith is not read.
        tables = torch.stack([torch.zeros_like(by_entity), by_entity])
        table = TableScorer(tables, scorer.entities, scorer.graph_hash)
        return cls.of_pairs(table, replace(view, tasks=None, without_tables=False))


class SetTable(Source):
    """The source table (t): ``t_i`` is the score of slot i and the selection for the goal.

    Without selection, it is that with the best partner on the table; 0 where the table has none.

    Attributes:
        keys: buffer, shape (N,), int64, ascending: numbers of pair and goal.
        values: buffer, shape (N,), float32: their scores.
    """

    label = T
    keys: Tensor
    values: Tensor

    def __init__(self, num_entities: int, keys: Tensor, values: Tensor):
        """Take the table."""
        super().__init__(num_entities)
        self.register_buffer("keys", keys)
        self.register_buffer("values", values)

    @classmethod
    def of_scorer(  # noqa: D102 - inherited
        cls, scorer: TripleScorer, view: ScoreView
    ) -> "SetTable":
        table = whole_of(scorer)
        if not isinstance(table, SetTableScorer):
            raise ConfigError(
                "`use` table (t) needs a model folder from `wordcraft-kg import-knowledge "
                "--scores`; leave out table, or name such a folder as `scorer`."
            )
        size = len(table.entities)
        is_pair = (table.sets != size).sum(1) == 2
        first, second = table.sets[is_pair, :2].T
        keys, order = _keys(first, second, table.results[is_pair], size).sort()
        return cls(size, keys, table.values[is_pair][order])

    @staticmethod
    def serves(scorer: TripleScorer) -> bool:
        """Return whether a scorer has a table of sets, which this source needs."""
        return isinstance(whole_of(scorer), SetTableScorer)

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls, num_entities: int, constants: Mapping[str, Tensor]
    ) -> "SetTable":
        check_tensors(constants, {"keys": "N int64", "values": "N float32"})
        if bool((constants["keys"].diff() <= 0).any()):
            raise ValueError("keys are not in ascending order")
        return cls(num_entities, constants["keys"], constants["values"])

    def forward(self, states: States) -> Tensor:  # noqa: D102 - inherited
        table, selection = states.table, states.selection[:, None]
        is_empty = table == self.num_entities
        partners = self.scores_of_pairs(states).masked_fill(is_empty[:, None], -torch.inf)
        with_selection = self._look_up(table, selection, states.goal[:, None])
        is_first = selection == self.num_entities
        scores = partners.amax(2).where(is_first, with_selection)
        return scores.masked_fill(is_empty, 0)

    def scores_of_pairs(self, states: States) -> Tensor:  # noqa: D102 - inherited
        table = states.table
        return self._look_up(table[:, :, None], table[:, None], states.goal[:, None, None])

    def _look_up(self, a: Tensor, b: Tensor, goal: Tensor) -> Tensor:
        """Return the scores of pairs for goals, float32, by ids that broadcast."""
        keys = _keys(a, b, goal, self.num_entities)
        if not len(self.keys):
            return torch.zeros(keys.shape, device=keys.device)
        place = torch.searchsorted(self.keys, keys).clamp(max=len(self.keys) - 1)
        return self.values[place].where(self.keys[place] == keys, 0.0)


def _keys(a: Tensor, b: Tensor, goal: Tensor, size: int) -> Tensor:
    """Return a number for each pair, in any order, and goal; ids up to ``size``."""
    first = torch.minimum(a, b)
    second = torch.maximum(a, b)
    return (goal * (size + 1) + first) * (size + 1) + second
