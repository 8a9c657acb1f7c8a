"""Policies that choose single slots: self-attention, the paper's baseline, and own networks.

Tables have few slots, so product shapes matter more than sizes: ``index_select`` fetches vectors, a
row's slots are columns in a single small product, and softmax runs along the first axis. Below, B
is the number of states, A of slots, F the length of an entity vector, d the size of keys.
"""

import math
from collections.abc import Iterable, Mapping
from typing import cast

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.functional import linear
from torch.nn.modules.dropout import _DropoutNd

from wordcraft_kg.base import ConfigError
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.models.policies.policy import (
    EntityVectors,
    Policy,
    PolicyOutput,
    Weights,
    look_up,
)
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.sources.source import Source
from wordcraft_kg.models.policies.states import States

FOLD_LIMIT = 300
"""Dimensions F up to which query and key weights are multiplied once per update.

The product has F columns instead of d: cheaper than both products in each step as long as F is not
much larger than d, which is 300 by default.
"""
MOST_ATTEMPTS = 5
"""Attempts that a policy tells apart, the deepest tasks' number; more count as this many."""
NUM_PHASES = 2 * MOST_ATTEMPTS
"""Phases of an episode: each attempt, without and with a selection."""


class AttentionPolicy(Policy):
    """Self-attention actor-critic, alone or guided by knowledge sources.

    With vectors x for goal g, selection s and slot i, ``α_i = Q([x_g; x_s]) · K(x_i) / √d``,
    ``V = MLP(wᵀ x)`` with ``w = softmax(α)`` over the slots (or the raw α), and with sources
    ``β = λα·α + Σ_s λ_s·source_s``, ``λ = MLP(wᵀ x)`` with separate weights. Logits are β, or α
    without sources. An MLP is a linear map W with bias, a rectifier and a linear map; W is applied
    after the sum over slots. With the mixing "residual", λα is 1 and the others are learned
    numbers: where these are 0, the policy is that without sources. With ``config.sees_attempts``,
    learned terms for the phase of the episode (:func:`phase_terms`) are added to
    ``Kᵀ Q([x_g; x_s]) / √d``, to V and to λ.

    If recipes have other sizes than two, x_s is the mean over the selected entities. For the action
    to combine, a learned key takes the place of the entity's vector, and a learned term for the
    number of selected entities is added to its α; sources give it 0.

    Permuting the slots permutes the logits and leaves the value as it is, so the policy takes any
    table size.

    Source: Jiang et al. 2020, sections "Self-attention Actor-Critic Network" and "Learning Mixing
    Coefficients".
    """

    def __init__(
        self,
        config: PolicyConfig,
        vectors: EntityVectors,
        sources: Iterable[Source] = (),
        *,
        most_picks: int = 0,
    ):
        """Draw a network by torch's global generator.

        Args:
            config: settings.
            vectors: entity vectors.
            sources: knowledge sources in mixing order; without sources there is no mixture.
            most_picks: S, if recipes have other sizes than two; 0 for pairs.

        Raises:
            ConfigError: for ``kg_only`` without sources.
        """
        super().__init__(config, vectors, sources)
        if config.kg_only and not self.sources:
            raise ConfigError("`kg_only` mixes only scorer scores; give a `scorer` too.")
        self.attention = TableAttention(vectors.dim, config.key_size)
        self.value = _head(vectors.dim, config.value_size, 1)
        if self.sources and config.mixing == "residual":
            self.lambdas = self.source_weights()
        elif self.sources:
            self.mixture = _head(vectors.dim, config.value_size, len(self.labels))
            if config.mixing != "softmax":
                # λ begin at or near the first mixing weights.
                self.mixture.get_parameter("2.bias").data.copy_(self.first_lambdas())
                if self.looks_ahead:
                    # Exactly the planner; otherwise the drawn weights add small differences.
                    nn.init.zeros_(self.mixture.get_parameter("2.weight"))
        if config.sees_attempts:
            # Zeros, so that a policy starts like one that does not see attempts.
            self.phases = phase_terms(vectors.dim, len(self.labels))
        self.most_picks = most_picks
        if most_picks:
            zeros = [("key", torch.zeros(vectors.dim)), ("counts", torch.zeros(most_picks + 1))]
            self.combine = nn.ParameterDict(zeros)

    def weights(  # noqa: D102 - inherited
        self, generator: torch.Generator | None = None
    ) -> Weights:
        return super().weights() | self.attention.weights()

    def output(  # noqa: D102 - inherited
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        table = states.table
        mask = states.slot_mask(self.num_entities)
        vectors = look_up(weights["vectors"], table) if "vectors" in weights else None
        # Attention logits, shape (B, A). Empty slots have zero vectors, so their α is 0 until
        # masked.
        rows = self.attention.rows(weights, states.goal, states.selection)
        phases = None
        if self.config.sees_attempts:
            phases = phases_of(states, self.num_entities)
            rows = rows + weights["phases.rows"].index_select(0, phases)
        alpha = slot_products(rows, vectors, table)
        if self.most_picks:
            combine_alpha = (rows @ weights["combine.key"]) + weights[
                "combine.counts"
            ].index_select(0, states.num_selected(self.num_entities))
            alpha = torch.cat([alpha[:, :-1], combine_alpha[:, None]], dim=1)
        is_softmax = self.config.value_readout == "softmax"
        readout = masked_softmax(alpha, mask) if is_softmax else alpha.masked_fill(~mask, 0)
        # The state's encoding before W, shape (B, F): the readout pools the slots' vectors. The
        # value and the mixing weights see the table only through it.
        encoding = weighted_sums(readout, vectors, table, self.num_entities)
        value = _mlp(encoding, weights, "value")[:, 0]
        if phases is not None:
            value = value + weights["phases.value"].index_select(0, phases)
        lambdas = None
        if self.sources:
            lambdas = self._lambdas(encoding, weights, phases)
        return self.mixed(alpha, value, mask, external_scores, lambdas)

    def _lambdas(self, encoding: Tensor, weights: Weights, phases: Tensor | None) -> Tensor:
        """Return λ, shape (B, S), for encodings (B, F) and phases (B,)."""
        if self.config.mixing == "residual":
            lambdas = weights["lambdas"].expand(len(encoding), -1)
        else:
            lambdas = _mlp(encoding, weights, "mixture")
        if phases is not None:
            lambdas = lambdas + weights["phases.lambdas"].index_select(0, phases)
        return torch.softmax(lambdas, dim=1) if self.config.mixing == "softmax" else lambdas


def phase_terms(dim: int, num_lambdas: int) -> nn.ParameterDict:
    """Return learned terms for each phase of an episode: attempts left, with or without selection.

    An entity that makes the goal is the right choice in the last attempt, and one that makes an
    intermediate in an earlier attempt: without the phase, one λ serves both.

    Args:
        dim: F, the length of vectors.
        num_lambdas: S, the number of mixed scores.

    Returns:
        zeros: ``rows``, shape (:data:`NUM_PHASES`, F), added to the query after the keys are folded
        in; ``value``, shape (:data:`NUM_PHASES`,), added to V; and only with sources ``lambdas``,
        shape (:data:`NUM_PHASES`, S), added to λ, before a softmax.
    """
    terms = nn.ParameterDict()
    terms["rows"] = torch.zeros(NUM_PHASES, dim)
    terms["value"] = torch.zeros(NUM_PHASES)
    if num_lambdas:
        terms["lambdas"] = torch.zeros(NUM_PHASES, num_lambdas)
    return terms


def phases_of(states: States, nothing: int) -> Tensor:
    """Return each state's phase, shape (B,), int64, from 0 to :data:`NUM_PHASES` - 1.

    A state in attempt n from the end has the phase ``2 (n - 1)``, or 1 more with a selection.

    Args:
        states: states of B episodes, with ``attempts``.
        nothing: E, the id without a selection.

    Raises:
        ConfigError: if the attempts left are unknown.
    """
    if states.attempts is None:
        raise ConfigError("a policy with `sees_attempts` needs the attempts left in its states.")
    attempts_left = states.attempts.left.clamp(1, MOST_ATTEMPTS)
    return 2 * (attempts_left - 1) + (states.num_selected(nothing) > 0)


def masked_softmax(logits: Tensor, mask: Tensor) -> Tensor:
    """Return the softmax over slots where ``mask`` is True, shape (B, A); exactly 0 elsewhere."""
    # Slots first, as in `log_policy`: many states per row, few slots per column.
    by_slot = logits.masked_fill(~mask, -torch.inf).T.contiguous()
    return torch.softmax(by_slot, dim=0).T


class TableAttention(nn.Module):
    """Scaled dot-product attention from goal and selection to each slot.

    ``α_i = Q([x_g; x_s]) · K(x_i) / √d`` for goal g, selection s and slot i. As
    ``q · K x = (Kᵀ q) · x``, and vectors do not depend on the sample, keys are folded into the
    query: no slot's key is ever computed. K has no bias, which would shift all slots equally.

    Source: Jiang et al. 2020, section "Self-attention Actor-Critic Network". The paper's query also
    has the second selection, which is always empty when an action is chosen.
    """

    def __init__(self, dim: int, key_size: int):
        """Draw the maps Q, from 2 F to d, and K, from F to d; ``dim`` is F, ``key_size`` d."""
        super().__init__()
        self.query = nn.Linear(2 * dim, key_size)
        self.key = nn.Linear(dim, key_size, bias=False)

    def weights(self) -> Weights:
        """Return the tensors for :meth:`rows`.

        Returns:
            ``query``, ``query.bias`` and, unless folded into these, ``key``.
        """
        # Dividing the key weights by √d once replaces a division of each α.
        key = self.key.weight / math.sqrt(self.key.out_features)
        query = self.query.weight.T
        bias = cast("Tensor", self.query.bias)
        if self.key.in_features <= FOLD_LIMIT:
            return {"query": query @ key, "query.bias": bias @ key}
        return {
            "query": query,
            "query.bias": bias,
            "key": key,
        }

    @staticmethod
    def rows(
        weights: Mapping[str, Tensor],
        goal: Tensor,
        selection: Tensor,
    ) -> Tensor:
        """Return ``Kᵀ q / √d``; its dot product with a slot's entity vector is the slot's α.

        Args:
            weights: results of :meth:`weights` and :meth:`EntityVectors.weights`.
            goal: shape (B,), int64.
            selection: shape (B,), int64; E, whose vector is zero, without a selection. Of shape
                (B, S), the mean vector of the selected entities counts.

        Returns:
            shape (B, F).
        """
        query = weights["query"]
        bias = weights["query.bias"]
        vectors = weights.get("vectors")
        if vectors is not None:
            # Both vectors side by side, shape (B, 2 F).
            if selection.ndim == 1:
                query_inputs = look_up(vectors, torch.stack([goal, selection], dim=1)).flatten(1)
            else:
                mean_vector = _mean_row(vectors, selection)
                query_inputs = torch.cat([look_up(vectors, goal), mean_vector], dim=1)
            projected = torch.addmm(bias, query_inputs, query)
        else:
            # One-hot vectors: the query's upper half has a row for each goal, the lower half for
            # each selection; the row of zeros below each is that of E.
            halves = query.view(2, -1, query.shape[1])
            by_goal, by_selection = nn.functional.pad(halves, (0, 0, 0, 1))
            goal_rows = by_goal.index_select(0, goal)
            if selection.ndim == 1:
                selection_rows = by_selection.index_select(0, selection)
            else:
                selection_rows = _mean_row(by_selection, selection)
            projected = bias + goal_rows + selection_rows
        return projected @ weights["key"] if "key" in weights else projected


def slot_products(rows: Tensor, vectors: Tensor | None, table: Tensor) -> Tensor:
    """Return each slot's dot product ``r · x_i`` with its table's r, shape (B, A).

    Args:
        rows: shape (B, F).
        vectors: entity vectors of the slots, shape (B, A, F); None for one-hot vectors, which are
            never written out.
        table: ids in the slots, shape (B, A).
    """
    if vectors is not None:
        return torch.bmm(rows[:, None, :], vectors.transpose(1, 2))[:, 0]
    # The product with a one-hot vector is an entry of the row; E has the appended 0.
    return nn.functional.pad(rows, (0, 1)).gather(1, table)


def weighted_sums(
    weights: Tensor, vectors: Tensor | None, table: Tensor, num_entities: int
) -> Tensor:
    """Return each table's weighted sum of entity vectors, ``Σ_i w_i x_i``, shape (B, F).

    Args:
        weights: shape (B, A).
        vectors: as for :func:`slot_products`.
        table: ids in the slots, shape (B, A).
        num_entities: E, the length of one-hot vectors.
    """
    if vectors is not None:
        return torch.bmm(weights[:, None, :].contiguous(), vectors)[:, 0]
    # Weights of one-hot vectors are added up by entity; the column of E is cut off.
    sums = weights.new_zeros(len(weights), num_entities + 1)
    return sums.scatter_add(1, table, weights)[:, :-1]


def _mean_row(rows: Tensor, selection: Tensor) -> Tensor:
    """Return the mean row of selected entities, shape (B, n); zeros without one.

    Args:
        rows: shape (E + 1, n), the last one of zeros.
        selection: shape (B, S), ids in any order, padded with E.
    """
    num_selected = (selection != len(rows) - 1).sum(1, keepdim=True)
    return look_up(rows, selection).sum(1) / num_selected.clamp(min=1)


def _head(
    dim: int,
    size: int,
    outputs: int,
) -> nn.Sequential:
    return nn.Sequential(nn.Linear(dim, size), nn.ReLU(), nn.Linear(size, outputs))


def _mlp(
    encoding: Tensor,
    weights: Weights,
    name: str,
) -> Tensor:
    """Apply the head with this name, see :func:`_head`, to encodings (B, F)."""
    first = linear(encoding, weights[f"{name}.0.weight"], weights[f"{name}.0.bias"])
    return linear(torch.relu(first), weights[f"{name}.2.weight"], weights[f"{name}.2.bias"])


class MLPPolicy(Policy):
    """The simple baseline: one hidden layer on the vectors of goal, selection and all slots.

    Works for one number of slots only, and permuting the slots changes the output.

    Source: Jiang et al. 2020, appendix "Extended Discussion".
    """

    def __init__(
        self,
        config: PolicyConfig,
        vectors: EntityVectors,
        num_slots: int,
    ):
        """Draw a network by torch's global generator, without knowledge sources.

        Args:
            config: settings.
            vectors: entity vectors.
            num_slots: slots of all tables.
        """
        super().__init__(config, vectors)
        self.num_slots = num_slots
        self.hidden = nn.Linear((2 + num_slots) * vectors.dim, config.hidden_size)
        self.logits = nn.Linear(config.hidden_size, num_slots)
        self.value = nn.Linear(config.hidden_size, 1)

    def output(  # noqa: D102 - inherited
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        table = states.table
        if table.shape[1] != self.num_slots:
            raise ConfigError(
                f"the tables have {table.shape[1]} slots: this mlp was made for {self.num_slots}. "
                "Use the `num_distractors` from training, or an attention policy, which takes any "
                "table size."
            )
        ids = torch.cat([states.goal[:, None], states.selection[:, None], table], dim=1)
        inputs = look_up(weights["vectors"], ids).flatten(1)
        # Logits and value share the hidden layer.
        inner = torch.relu(linear(inputs, weights["hidden.weight"], weights["hidden.bias"]))
        logits = linear(inner, weights["logits.weight"], weights["logits.bias"])
        value = linear(inner, weights["value.weight"], weights["value.bias"])
        return self.mixed(logits, value[:, 0], table != self.num_entities, None, None)


class NetworkPolicy(Policy):
    """A network for slots, ``network(states, vectors) -> (logits, value)``, alone or with sources.

    The network gets B states, with A slots, and the entity vectors, shape (E + 1, F), of which the
    last row is zeros: ``vectors[states.table]`` has shape (B, A, F), and an empty slot or no
    selection the vector 0. It returns logits (B, A) for tables of any size, and values (B,). Empty
    slots are masked here, and the scores of sources added, each times a learned number.

    The same parameters give the same output in training and in evaluation: the network is always in
    evaluation mode.

    Raises:
        ConfigError: for a network that is no module with parameters, or has dropout or running
            statistics; or for outputs of other shapes.
    """

    def __init__(
        self,
        config: PolicyConfig,
        vectors: EntityVectors,
        sources: Iterable[Source],
        network: nn.Module,
    ):
        """Take a network; the other arguments are those of the base class."""
        super().__init__(config, vectors, sources)
        if not isinstance(network, nn.Module) or not [*network.parameters()]:
            raise ConfigError(
                f"`policy` {config.policy} makes a {type(network).__name__}; expected a module of "
                "torch with parameters."
            )
        for module in network.modules():
            is_dropout = isinstance(module, _DropoutNd) and module.p > 0
            if is_dropout or getattr(module, "track_running_stats", False):
                raise ConfigError(
                    f"`policy` {config.policy} has a {type(module).__name__}, which acts otherwise "
                    "in training; expected a network that does not, such as one with LayerNorm."
                )
        self.network = network.eval()
        if self.sources:
            self.lambdas = self.source_weights()

    def output(  # noqa: D102 - inherited
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        parameters = with_prefix(weights, "network.")
        result = functional_call(self.network, parameters, (states, weights["vectors"]))
        parts = result if isinstance(result, tuple) else (result,)
        shapes = [tuple(getattr(part, "shape", ())) for part in parts]
        expected = [tuple(states.table.shape), tuple(states.goal.shape)]
        if shapes != expected:
            raise ConfigError(
                f"`policy` {self.config.policy} gives the shapes {shapes}; expected logits and "
                f"values, {expected}."
            )
        logits, value = result
        mask = states.slot_mask(self.num_entities)
        lambdas = weights["lambdas"].expand(len(logits), -1) if self.sources else None
        return self.mixed(logits, value, mask, external_scores, lambdas)
