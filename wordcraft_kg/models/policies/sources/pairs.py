"""Sources with scores for pairs: u scores a slot's entity with the selection, v with the goal."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import lazily_zero
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.policies.sources import U, V
from wordcraft_kg.models.policies.sources.source import FoldedSource, ScoreView, check_constants
from wordcraft_kg.models.scorers.config import SelfEdges
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.scales import scaled_factors, scaled_table

_TABLE = {"scores": "N N float32"}
_FACTORS = {
    "left": "N m float32",
    "right": "N m float32",
    "shift": "float32",
    "dropped": "N bool",
    "itself": "float32",
}


class PairSource(FoldedSource):
    """Scores each slot's entity with a key entity (the goal or the selection), by a score table or matrix factors.

    For cross-fitted scorers (a model per left-out fold), each buffer has a first axis with K + 2 models: one trained on
    all K folds, one without each fold, and an empty model that scores 0. The task selects the model, by default the
    first.

    Attributes:
        scores: buffer, shape (E + 1, E + 1): score table by key and slot's entity; 0 for empty slots.
        left, right, shift, dropped, itself: buffers with the matrix factors, as in
            :class:`~wordcraft_kg.models.scorers.scales.ScaledFactors`, and a zero row for empty slots.
    """

    scores: Tensor
    left: Tensor
    right: Tensor
    shift: Tensor
    dropped: Tensor
    itself: Tensor

    def __init__(self, num_entities: int, constants: Mapping[str, Tensor]):
        super().__init__(num_entities, constants.get("fold_of_recipe"))
        self.is_table = "scores" in constants
        for name in _TABLE if self.is_table else _FACTORS:
            self.register_buffer(name, constants[name])

    @classmethod
    def of_pairs(
        cls, scorer: TripleScorer, relation: int, view: ScoreView, *, self_edges: SelfEdges = "keep"
    ) -> Self:
        """Make slot scores from a scorer's triples (slot's entity, relation, key entity), scaled as ``view`` says."""
        size = len(scorer.entities)
        constants = _constants(scorer, relation, replace(view, self_edges=self_edges))
        folded = folds_of(scorer)
        if folded is None:
            return cls(size, constants)
        of_recipe = cls.fold_numbers(folded, view)
        if view.tasks is not None:
            graph = view.tasks.graph
            of_folds = [
                _constants(
                    folded.left_out(fold),
                    relation,
                    replace(view, self_edges=self_edges, observed=folded.trained_on(fold, graph)),
                )
                for fold in range(folded.count)
            ]
            empty = {name: torch.zeros_like(tensor) for name, tensor in constants.items()}
            models = (constants, *of_folds, empty)
            constants = {name: torch.stack([model[name] for model in models]) for name in constants}
        return cls(size, {**constants, "fold_of_recipe": of_recipe}).bound(view)

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Self:  # noqa: D102 - inherited
        layouts, folds = _TABLE if "scores" in constants else _FACTORS, cls.num_folds(constants)
        if folds is not None:
            layouts = {name: f"models {layout}" for name, layout in layouts.items()}
        check_constants(constants, layouts, N=num_entities + 1, models=(folds or 0) + 2)
        return cls(num_entities, {name: lazily_zero(tensor) for name, tensor in constants.items()})

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:  # noqa: D102 - inherited
        return (len(scorer.entities) + 1) ** 2 * 4

    @abstractmethod
    def key(self, goal: Tensor, selection: Tensor) -> Tensor:
        """Return the entity to score slots with (goal or selection), shape (B,)."""

    def forward(
        self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None
    ) -> Tensor:
        """Return the score of each table slot, as :meth:`Source.forward`."""
        key = self.key(goal, selection)[:, None]
        rows, width = table, self.num_entities + 1
        model = self.model_of(task)
        if self.is_table:
            cells = torch.add(
                table, key if model is None else key + width * model[:, None], alpha=width
            )
            return self.scores.view(-1).index_select(0, cells.reshape(-1)).view(cells.shape)
        shift, itself, keys = self.shift, self.itself, key[:, 0]
        if self.left.ndim == 3:  # there are several models
            model = torch.zeros_like(goal) if model is None else model
            shift, itself = shift[model][:, None], itself[model][:, None]
            rows, keys = table + width * model[:, None], keys + width * model
        slots = self.left.flatten(0, -2).index_select(0, rows.reshape(-1)).view(*table.shape, -1)
        scores = torch.bmm(slots, self.right.flatten(0, -2)[keys][:, :, None])[:, :, 0] - shift
        scores = torch.where((table == key) & self.dropped.view(-1)[rows], itself, scores)
        return scores.masked_fill((table == self.num_entities) | (key == self.num_entities), 0)


class CombinesWith(PairSource):
    """The source u of Jiang et al. 2020, ``u_i = L(e_i, combinesWith, e_s)``: slot i with selection s, else 0."""

    label = U

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "CombinesWith":  # noqa: D102 - inherited
        return cls.of_pairs(scorer, COMBINES_WITH, view, self_edges=view.self_edges)

    def key(self, goal: Tensor, selection: Tensor) -> Tensor:  # noqa: D102 - inherited
        return selection


class ComponentOf(PairSource):
    """The source v of Jiang et al. 2020, ``v_i = L(e_i, componentOf, e_g)``: slot i with the goal g."""

    label = V

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "ComponentOf":  # noqa: D102 - inherited
        return cls.of_pairs(scorer, COMPONENT_OF, view)

    def key(self, goal: Tensor, selection: Tensor) -> Tensor:  # noqa: D102 - inherited
        return goal


def _constants(scorer: TripleScorer, relation: int, view: ScoreView) -> dict[str, Tensor]:
    size = len(scorer.entities)
    settings: dict[str, Any] = {"self_edges": view.self_edges, "observed": view.observed}
    if not view.by_factors:
        table = torch.zeros(size + 1, size + 1)
        table[:-1, :-1] = scaled_table(scorer, relation, view.scale, **settings).detach().cpu().T
        return {"scores": table}
    assert isinstance(scorer, FactoredScorer)
    constants = dict(vars(scaled_factors(scorer, relation, view.scale, **settings)))
    for name in ("left", "right", "dropped"):
        constants[name] = torch.cat([constants[name], torch.zeros_like(constants[name][:1])])
    return constants
