"""Sources with scores for pairs: u scores a slot's entity with the selection, v with the goal.

:class:`GoalTable` takes the scores of v from a function, and :class:`SetTable` (t) scores slot and
selection together, from a table.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import check_tensors, with_prefix
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.policies.sources import T, U, V
from wordcraft_kg.models.policies.sources.source import (
    FoldedSource,
    Rows,
    ScoreView,
    Source,
    knowledge_of_models,
    models_of,
)
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.factors import SetTableScorer, TableScorer
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scales import (
    interpolated,
    sampled_scaling,
    scaled_table,
)

# Axis names and types of the buffers, for `check_tensors`; N is E + 1.
_TABLE = {"scores": "N N float32"}
_FACTORS = {
    "left": "N m float32",
    "right": "N m float32",
    "shift": "float32",
    "dropped": "N bool",
    "itself": "float32",
}
_LINKS = {
    "shift": "float32",
    "deviation": "float32",
    "dropped": "N bool",
    "itself": "float32",
}
_RANKS = {"knots": "K float32", "heights": "K float32"}
_KNOWLEDGE = "knowledge."
"""Prefix of the tensors from which a recipe scorer's links are scored."""


class PairSource(FoldedSource):
    """Scores each slot's entity with a key entity (the goal or the selection).

    Scores come from a table of all pairs. For graphs too large for a table, they come from matrix
    factors, or, with a recipe scorer, from its neighbour lists when they are asked for. Only the
    buffers of one of the three kinds exist.

    For cross-fitted scorers (a model per left-out fold), each buffer has a first axis with K + 2
    models: one trained on all K folds, one without each fold, and an empty model that scores 0. The
    task selects the model, by default the first.

    Attributes:
        relation: id of the relation.
        scores: buffer, shape (E + 1, E + 1): score table by key and slot's entity; 0 for empty
            slots and for the key E.
        left: buffer, shape (E + 1, m): factors by the slot's entity; like ``right``, with a row of
            zeros for E. A pair scores ``left[slot] · right[key] - shift``.
        right: buffer, shape (E + 1, m): factors by the key.
        knowledge: neighbour lists and link rankers, of K + 1 models with folds; None for tables
            and factors.
        shift: buffer, shape (): subtracted from each product or link score.
        deviation: buffer, shape (): link scores are divided by it; factors are divided already.
        dropped: buffer, shape (E + 1,), bool: entities whose score with itself is replaced.
        itself: buffer, shape (): the score that replaces these.
        knots: buffer, shape (K,): scores in ascending order, if scores become ranks.
        heights: buffer, shape (K,): the ranks of these scores, standardised.
    """

    takes_sets = True
    relation: ClassVar[int]
    scores: Tensor
    left: Tensor
    right: Tensor
    shift: Tensor
    deviation: Tensor
    dropped: Tensor
    itself: Tensor
    knots: Tensor
    heights: Tensor

    def __init__(
        self,
        num_entities: int,
        constants: Mapping[str, Tensor],
        knowledge: RecipeKnowledge | None = None,
    ):
        """Take the buffers of one kind, ``fold_of_recipe`` with folds, and for links knowledge."""
        num_models = knowledge.num_models if knowledge is not None else 1
        super().__init__(num_entities, constants.get("fold_of_recipe"), num_models)
        self.is_table = "scores" in constants
        self.knowledge = knowledge
        for name in _layouts(constants):
            self.register_buffer(name, constants[name])

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> Self:
        """Make slot scores from the triples (slot's entity, relation, key entity).

        Args:
            scorer: any scorer of triples, cross-fitted or not.
            view: scale, treatment of self edges, and the tasks to score by cross-fitted scorers.

        Returns:
            the source.

        Raises:
            LeakError: if a left-out model was trained on other recipes than its folds say.
            GraphMismatchError: if the tasks belong to another graph or split than the scorer's
                folds.
            ConfigError: for an unknown scale or treatment of self edges, or if ``view.observed`` is
                missing.
        """
        # The setting `self_edges` is about combinesWith alone; else all scores are kept.
        if cls.relation != COMBINES_WITH:
            view = replace(view, self_edges="keep")
        # A train task is scored by the model without its recipe's fold, never in-sample. Without
        # tasks there is nothing to choose by, and the model of all folds is enough.
        by_model = [
            _constants(model, cls.relation, model_view)
            for model, model_view in models_of(scorer, view)
        ]
        constants = by_model[0] if len(by_model) == 1 else _stacked(by_model)
        knowledge = None
        # Other scorers have factors in place of a table. A recipe scorer has none, so the source
        # keeps its knowledge, with the models of all folds, and scores links when they are asked.
        if view.without_tables and isinstance(whole_of(scorer), RecipeScorer):
            knowledge = knowledge_of_models(scorer, view)
        fold_numbers = cls.fold_numbers(scorer, view)
        if fold_numbers is not None:
            constants = {**constants, "fold_of_recipe": fold_numbers}
        return cls(len(scorer.entities), constants, knowledge)

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls, num_entities: int, constants: Mapping[str, Tensor]
    ) -> Self:
        layouts = _layouts(constants)
        num_models = cls.num_stored(constants)
        # With folds, buffers have one model more, which is empty. It needs no lists.
        if num_models > 1:
            layouts = {name: f"models {layout}" for name, layout in layouts.items()}
        check_tensors(constants, layouts, N=num_entities + 1, models=num_models + 1)
        _check_scaling(constants)
        link_constants = with_prefix(constants, _KNOWLEDGE)
        knowledge = None
        if link_constants:
            knowledge = RecipeKnowledge(link_constants, num_entities, num_models)
        return cls(num_entities, constants, knowledge)

    def with_key(self, states: States, key: Tensor) -> Tensor:
        """Score slots with a key entity: the goal, or a selected one.

        Args:
            states: states of B episodes.
            key: shape (B,): ids; E scores 0.

        Returns:
            shape (B, A), float32.
        """
        # Buffers may have a first axis of models, which lie one below the other in a flat view.
        # There the row of an entity is `first_rows` + entity.
        table = states.table
        model = self.model_of(states)
        first_rows = (self.num_entities + 1) * model
        if self.is_table:
            # A single `index_select` reads all scores.
            rows = first_rows + key
            cells = torch.add(table, rows[:, None], alpha=self.num_entities + 1)
            return self.scores.view(-1).index_select(0, cells.reshape(-1)).view(cells.shape)
        slot_rows = table + first_rows[:, None]
        if self.knowledge is None:
            scores = self._from_factors(slot_rows, first_rows + key)
        else:
            scores = self._from_links(self.knowledge, states, key)
        scores = scores - self.shift.view(-1)[model][:, None]
        if "deviation" in self._buffers:
            scores = scores / self.deviation.view(-1)[model][:, None]
        if "knots" in self._buffers:
            knots = self.knots.view(-1, self.knots.shape[-1])[model]
            heights = self.heights.view(-1, self.heights.shape[-1])[model]
            scores = interpolated(scores, knots, heights)
        is_dropped = (table == key[:, None]) & self.dropped.view(-1)[slot_rows]
        scores = torch.where(is_dropped, self.itself.view(-1)[model][:, None], scores)
        # The zero rows give -shift, not 0, so scores of E are set here.
        is_empty = (table == self.num_entities) | (key == self.num_entities)[:, None]
        if self.knowledge is not None:
            # Factors of the empty model are zeros; links were scored by another model.
            is_empty = is_empty | (model == self.num_models)[:, None]
        return scores.masked_fill(is_empty, 0)

    def _from_links(self, knowledge: RecipeKnowledge, states: States, key: Tensor) -> Tensor:
        """Return raw scores (B, A) of slots and keys by neighbour lists."""
        table = states.table
        models, _ = self.counted_models(states)

        def compute(rows: Rows) -> Tensor:
            return knowledge.slot_scores(self.relation, key[rows], table[rows], models[rows])

        # A slot's score with the goal is the same before and after the first action.
        return self.kept.scores((key, table, models), compute, table.shape[1:])

    def _from_factors(self, slot_rows: Tensor, key_rows: Tensor) -> Tensor:
        """Return raw scores (B, A) by the rows of slots (B, A) and keys (B,) in the factors."""
        left_rows = self.left.flatten(0, -2).index_select(0, slot_rows.reshape(-1))
        right = self.right.flatten(0, -2)[key_rows]
        # One small product for each state: (A, m) by (m, 1).
        return torch.bmm(left_rows.view(*slot_rows.shape, -1), right[:, :, None])[:, :, 0]


class CombinesWith(PairSource):
    """The source combines (u): ``u_i = L(e_i, combinesWith, e_s)`` with selection s, else 0.

    With several selected entities, their mean.

    Source: Jiang et al. 2020, section "Link Prediction Model".
    """

    label = U
    relation = COMBINES_WITH

    def forward(self, states: States) -> Tensor:  # noqa: D102 - inherited
        return states.mean_over_selection(
            lambda selected: self.with_key(states, selected), self.num_entities
        )


class ComponentOf(PairSource):
    """The source component (v), ``v_i = L(e_i, componentOf, e_g)``: slot i with the goal g.

    Source: Jiang et al. 2020, section "Link Prediction Model".
    """

    label = V
    relation = COMPONENT_OF

    def forward(self, states: States) -> Tensor:  # noqa: D102 - inherited
        return self.with_key(states, states.goal)

    def scores_of_pairs(self, states: States) -> Tensor:  # noqa: D102 - inherited
        # The score of a slot is the same whatever is selected.
        scores: Tensor = self(states)
        return (scores[:, :, None] + scores[:, None]) / 2


def _layouts(constants: Mapping[str, Tensor]) -> dict[str, str]:
    """Return axis names and types of the buffers of one model, whose kind their names tell."""
    if "scores" in constants:
        return _TABLE
    layout = _FACTORS if "left" in constants else _LINKS
    return layout | _RANKS if "knots" in constants else layout


def _check_scaling(constants: Mapping[str, Tensor]) -> None:
    """Check saved numbers by which scores are divided, or among which they are looked up.

    Raises:
        ValueError: if a deviation is not positive, or knots are too few or not ascending.
    """
    if "deviation" in constants:
        deviations = constants["deviation"].flatten()
        # The last of several models is the empty one, whose scores are not used.
        deviation_rows = deviations[:-1] if len(deviations) > 1 else deviations
        if not bool((deviation_rows > 0).all()):
            raise ValueError("deviation holds a number that is not positive")
    if "knots" in constants:
        knots = constants["knots"]
        if knots.shape[-1] < 2 or bool((knots.diff() < 0).any()):
            raise ValueError("knots are not two or more numbers in ascending order")


def _stacked(by_model: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Stack the models' buffers along a first axis, then zeros for the empty model."""
    stacked = {}
    for name, tensor in by_model[0].items():
        tensors = [constants[name] for constants in by_model]
        stacked[name] = torch.stack([*tensors, torch.zeros_like(tensor)])
    return stacked


def _constants(
    scorer: TripleScorer,
    relation: int,
    view: ScoreView,
) -> dict[str, Tensor]:
    """Return the buffers for one model's scores of all pairs."""
    size = len(scorer.entities)
    settings: dict[str, Any] = {
        "self_edges": view.self_edges,
        "observed": view.observed,
    }
    if not view.without_tables:
        table = torch.zeros(size + 1, size + 1)
        scores = scaled_table(scorer, relation, view.scale, **settings)
        # Heads are slots and tails are keys; transposed, a state's slots share a row in memory.
        table[:-1, :-1] = scores.detach().cpu().T
        return {"scores": table}
    constants = sampled_scaling(scorer, relation, view.scale, **settings)
    if not isinstance(scorer, RecipeScorer):
        assert isinstance(scorer, FactoredScorer)
        left_factors, right = (part.detach().cpu() for part in scorer.factors(relation))
        # Divided once here, not at each score.
        deviation = constants.pop("deviation")
        constants["shift"] = constants["shift"] / deviation
        constants |= {"left": left_factors / deviation, "right": right}
    for name in {"left", "right", "dropped"} & {*constants}:
        # A row for E; zeros, so that the factors' product is finite there.
        constants[name] = torch.cat([constants[name], torch.zeros_like(constants[name][:1])])
    return constants


class GoalTable(ComponentOf):
    """Scores of each slot's entity for the goal, from a function of the labels; needs no scorer.

    Attributes:
        scores_of: the function, see :func:`wordcraft_kg.plugins.source`.
    """

    needs_scorer = False
    scores_of: ClassVar[Callable[[tuple[str, ...]], Any]]

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> Self:  # noqa: D102 - inherited
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
        return super().of_scorer(table, replace(view, tasks=None, without_tables=False))


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
