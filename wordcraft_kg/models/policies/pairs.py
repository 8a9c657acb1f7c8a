"""The policy that scores pairs of slots for the goal, alone or with knowledge mixed in.

A first selection that leads to the goal depends on its partner, so pairs are scored together: the
policy is a softmax over pairs. Below, B is the number of states, A of slots, P of slot pairs, d of
hidden units.
"""

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import ClassVar

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.policies.networks import phase_terms, phases_of
from wordcraft_kg.models.policies.policy import (
    SPEED,
    EntityVectors,
    Policy,
    PolicyOutput,
    SourceWeights,
    Weights,
    checked_logits,
    look_up,
)
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.sources.source import Source
from wordcraft_kg.models.policies.states import States

LENGTH = 3.0
"""Length of the entity vectors as the network sees them.

Unit vectors of 50 dimensions and first weights of :class:`torch.nn.Linear` would give hidden units
near 0.
"""
FIRST_WORDS = 8.0
"""First weight of word cosines, without sources: the policy begins as a player of nearest words."""
BLOCK = 128
"""Tables whose pairs are scored together: their hidden units stay in the processor's cache."""


class PairPolicy(Policy):
    """Actor-critic that scores pairs of slots, alone or guided by knowledge sources.

    With vectors x of length :data:`LENGTH` for goal g and slots i and j, linear maps p, q, r of
    entities and a, b of goals, and products element by element::

        h_ij = norm(relu(p_i + p_j + q_i q_j + a_g + b_g (r_i + r_j)))
        α_ij = w · h_ij + c (cos(g, i) + cos(g, j)) + e [i = j]
        β_ij = α_ij + Σ_s λ_s · source_s,ij
        π(i, j) = softmax of β over unordered pairs, i = j included

    The norm makes mean 0 and variance 1 over the units; c, e and the λ are learned numbers. The
    first selection of an attempt has the marginal probability of its slot, where each order of a
    pair is equally probable, and the second the conditional one: together they choose the pair with
    probability π(i, j). The value is ``v · Σ_ij ρ_ij h_ij`` with ρ the softmax of α. With
    ``config.sees_attempts``, the number of attempts left adds learned terms to a, b, the value and
    λ.

    In training, a share ``config.dropout`` of h is dropped, the same units for all pairs of a
    table, and noise of length ``config.vector_noise`` is added to the vectors that the maps see,
    anew in each update: so the network learns what holds for a whole neighbourhood of words.

    Permuting the slots permutes the logits and leaves the value as it is, so the policy takes any
    table size.
    """

    steps_per_choice: ClassVar[int] = 2

    def __init__(
        self,
        config: PolicyConfig,
        vectors: EntityVectors,
        sources: Iterable[Source] = (),
    ):
        """Draw a network by torch's global generator.

        Args:
            config: settings.
            vectors: entity vectors.
            sources: knowledge sources in mixing order; without sources there is no mixture.

        Raises:
            ConfigError: for ``kg_only``, or another ``mixing`` than residual.
        """
        super().__init__(config, vectors, sources)
        if config.kg_only:
            raise ConfigError("`kg_only` needs `policy` attention.")
        if self.sources and config.mixing != "residual":
            raise ConfigError(
                f"`mixing` {config.mixing} needs `policy` attention; expected residual."
            )
        size = config.pair_size
        self.noise_size = size
        self.items = nn.Linear(vectors.dim, 3 * size)
        self.goals = nn.Linear(vectors.dim, 2 * size)
        # Without a bias, which a softmax ignores.
        self.score = nn.Linear(size, 1, bias=False)
        self.value = nn.Linear(size, 1)
        # Weights of word cosines, and of an item with itself.
        first = 0.0 if self.sources else FIRST_WORDS
        # On the CPU, as :meth:`first_lambdas`.
        self.words = SourceWeights(torch.tensor([first, 0.0], device="cpu"))
        if self.sources:
            self.lambdas = self.source_weights()
        if config.sees_attempts:
            self.phases = phase_terms(2 * size, len(self.labels))

    def weights(  # noqa: D102 - inherited
        self, generator: torch.Generator | None = None
    ) -> Weights:
        weights: Weights = {}
        # One-hot vectors are never written out.
        vectors = None
        if not self.vectors.is_one_hot:
            weights["units"] = nn.functional.normalize(self.vectors.vectors, dim=1)
            units = weights["units"][:-1]
            vectors = LENGTH * units
            if generator is not None and self.config.vector_noise:
                noise = torch.empty_like(units).normal_(generator=generator)
                scale = LENGTH * self.config.vector_noise / math.sqrt(self.vectors.dim)
                vectors = vectors + scale * noise
        weights |= {
            "items": _projected(self.items, vectors),
            "goals": _projected(self.goals, vectors),
            "words": self.words(),
            "readouts": torch.cat([self.score.weight, self.value.weight]),
            "value.bias": self.value.bias,
        }
        if self.lambdas is not None:
            weights["lambdas"] = self.lambdas()
        if self.config.sees_attempts:
            weights |= {f"phases.{name}": part for name, part in self.phases.named_parameters()}
        return weights

    # --- choices: pairs of slots ------------------------------------------------------------------

    def choose(  # noqa: D102 - inherited
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
        noise: Tensor | None = None,
    ) -> PolicyOutput:
        table = states.table
        num_slots = table.shape[1]
        # On a device, asking would wait for pending work.
        if table.device.type == "cpu":
            num_slots = states.num_used_slots(self.num_entities)
        phases = None
        if self.config.sees_attempts:
            # That of the attempt, whatever the selection.
            unselected = states._replace(selection=torch.full_like(states.goal, self.num_entities))
            phases = phases_of(unselected, self.num_entities)
        items = look_up(weights["items"], table[:, :num_slots])
        goals = weights["goals"].index_select(0, states.goal)
        if phases is not None:
            goals = goals + weights["phases.rows"].index_select(0, phases)
        # The weights of both readouts for each table, shape (B, 2, d).
        readouts = weights["readouts"].expand(len(table), -1, -1)
        dropout = self.config.dropout
        if noise is not None and dropout:
            # Dropping a unit is the same as a weight of 0.
            keep_scale = (noise >= dropout) / (1 - dropout)
            readouts = readouts * keep_scale[:, None]
        is_filled = table[:, :num_slots] != self.num_entities
        # Split before the pairs are made: so gradients are put together once.
        parts = [part.split(BLOCK) for part in (items, goals, readouts, is_filled)]
        blocks = [_of_pairs(*block) for block in zip(*parts, strict=True)]
        alpha = torch.cat([block[0] for block in blocks])
        alpha = alpha + self._of_words(weights, states.goal, table[:, :num_slots])
        value = torch.cat([block[1] for block in blocks]) + weights["value.bias"]
        # Pairs with slots that are empty in all tables come last.
        missing = self.num_choices(table.shape[1]) - self.num_choices(num_slots)
        alpha = nn.functional.pad(alpha, (0, missing), value=-torch.inf)
        if phases is not None:
            value = value + weights["phases.value"].index_select(0, phases)
        is_empty = alpha == -torch.inf
        lambdas = None
        if self.sources:
            lambdas = weights["lambdas"].expand(len(table), -1)
            if phases is not None:
                # As fast as the numbers to which they are added.
                lambdas = lambdas + SPEED * weights["phases.lambdas"].index_select(0, phases)
        # Empty pairs are finite until they are mixed, so that no λ makes a NaN of them, and masked
        # at the end, so that no gradient of -inf reaches a parameter.
        logits = alpha.masked_fill(is_empty, 0)
        return self.mixed(logits, value, ~is_empty, external_scores, lambdas)

    def _of_words(self, weights: Weights, goal: Tensor, table: Tensor) -> Tensor:
        """Return the part of α by word cosines, and for an item with itself, shape (B, P)."""
        if "units" in weights:
            goals = weights["units"].index_select(0, goal)
            cosines = (look_up(weights["units"], table) @ goals[:, :, None])[..., 0]
        else:  # one-hot
            cosines = (table == goal[:, None]).to(weights["words"].dtype)
        membership = _membership(table.shape[1], table.device).to(cosines.dtype)
        first, second = _pairs(table.shape[1], table.device)
        is_itself = table[:, first] == table[:, second]
        word_weights, self_weight = weights["words"]
        return word_weights * (cosines @ membership.T) + self_weight * is_itself

    def num_choices(self, slots: int) -> int:  # noqa: D102 - inherited
        return slots * (slots + 1) // 2

    def slots_of(self, choices: Tensor, slots: int) -> tuple[Tensor, ...]:  # noqa: D102
        first, second = _pairs(slots, choices.device)
        return first[choices], second[choices]

    def pairs_of(self, states: States, choices: Tensor) -> tuple[Tensor, Tensor]:  # noqa: D102
        slots = torch.stack(self.slots_of(choices, states.table.shape[1]), dim=1)
        first, second = states.table.gather(1, slots).unbind(1)
        return first, second

    def choices_with(self, states: States, is_listed: Tensor) -> Tensor:  # noqa: D102 - inherited
        first, second = _pairs(states.table.shape[1], is_listed.device)
        return is_listed[:, first, second]

    def _scores(self, source: Source, states: States) -> Tensor:
        states = states.with_selections_on_table(self.num_entities)
        table = states.table
        first, second = _pairs(table.shape[1], table.device)
        is_empty = table == self.num_entities
        scores = source.scores_of_pairs(states)[:, first, second]
        return scores.masked_fill(is_empty[:, first] | is_empty[:, second], 0)

    # --- slots ------------------------------------------------------------------------------------

    def output(  # noqa: D102 - inherited
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        slots = states.table.shape[1]
        states = states.with_selections_on_table(self.num_entities)
        pairs = self.choose(states, weights, external_scores)
        # The logit of each order of a pair, shape (B, A, A): its probability is half the pair's.
        table = states.table
        square = _square(table.shape[1], table.device)
        is_itself = table[:, :, None] == table[:, None]
        square_logits = pairs.logits[:, square]
        ordered = square_logits.where(is_itself, square_logits - math.log(2))
        logits = self._by_selection(states, ordered.logsumexp(2), ordered)[:, :slots]
        if pairs.sources is None or pairs.lambdas is None:
            return PolicyOutput(logits, pairs.value)
        # Shares of the partners of each slot: a first selection has their mean scores.
        shares = torch.softmax(ordered, 2).nan_to_num(0)
        scores = pairs.sources[:, :, square]
        means = (scores * shares[:, None]).sum(3)
        by_slot = self._by_selection(states, means.mT, scores.permute(0, 2, 3, 1))
        scores_by_slot = by_slot.mT[:, :, :slots]
        # The rest is the network's own: its score, and for a first selection the number of partners
        # that come into question. So contributions add up to the logits.
        lambdas = pairs.lambdas
        source_logits = torch.bmm(lambdas[:, None, 1:], scores_by_slot[:, 1:])[:, 0]
        network_logits = (logits - source_logits) / lambdas[:, :1]
        network_logits = network_logits.masked_fill(logits == -torch.inf, 0)
        scores_by_slot = torch.cat([network_logits[:, None], scores_by_slot[:, 1:]], dim=1)
        return PolicyOutput(logits, pairs.value, scores_by_slot, lambdas)

    def best_slots(  # noqa: D102 - inherited
        self,
        states: States,
        weights: Weights | None = None,
        external_scores: Tensor | None = None,
    ) -> Tensor:
        if external_scores is None:
            external_scores = self.external_scores(states)
        slots = states.table.shape[1]
        states = states.with_selections_on_table(self.num_entities)
        output = self.choose(states, weights or self.weights(), external_scores)
        logits = checked_logits(output.logits)
        # Those of the best pair; the slot with the largest marginal may be in no good pair.
        square = logits[:, _square(states.table.shape[1], logits.device)]
        return self._by_selection(states, square.amax(2), square)[:, :slots].argmax(1)

    def _by_selection(self, states: States, first: Tensor, second: Tensor) -> Tensor:
        """Return what belongs to each slot, shape (B, A, ...).

        Args:
            states: B states with each selection on the table.
            first: shape (B, A, ...): for states without a selection.
            second: shape (B, A, A, ...): by the selected slot, for the others.
        """
        # Without a selection any row serves, as it is not taken.
        row = (states.table == states.selection[:, None]).int().argmax(1)
        selected = second[torch.arange(len(row), device=row.device), row]
        is_first = states.selection == self.num_entities
        return first.where(is_first.view(-1, *[1] * (first.ndim - 1)), selected)


def _projected(layer: nn.Linear, vectors: Tensor | None) -> Tensor:
    """Return a linear map of all vectors, shape (E + 1, outputs), zeros for E; None for one-hot."""
    projected = LENGTH * layer.weight.T + layer.bias if vectors is None else layer(vectors)
    return nn.functional.pad(projected, (0, 0, 0, 1))


def _of_pairs(
    items: Tensor,
    goals: Tensor,
    readouts: Tensor,
    is_filled: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return α, shape (B, P), -inf for empty pairs, and the value but for its bias, shape (B,).

    Args:
        items: p, q and r of the slots' entities, shape (B, A, 3 d).
        goals: a and b of the goals, shape (B, 2 d).
        readouts: w and v, shape (B, 2, d).
        is_filled: shape (B, A), bool: the slots with an entity.
    """
    p, q, r = items.chunk(3, dim=-1)
    a, b = goals[:, None].chunk(2, dim=-1)
    membership = _membership(items.shape[1], items.device).to(items.dtype)
    # As 2 q_i q_j = (q_i + q_j)² - q_i² - q_j², all of a pair follows from sums over its slots, and
    # a product with a constant matrix adds faster than slots are fetched.
    sums = membership @ (p + b * r + a / 2 - q.square() / 2)
    products = membership @ q
    inner = torch.addcmul(sums, products, products, value=0.5).relu()
    hidden = nn.functional.layer_norm(inner, inner.shape[2:])
    # (B, P, d) by (B, d, 2).
    alpha, values = (hidden @ readouts.transpose(1, 2)).unbind(2)
    first, second = _pairs(items.shape[1], items.device)
    has_empty = ~(is_filled[:, first] & is_filled[:, second])
    alpha = alpha.masked_fill(has_empty, -torch.inf)
    # The value learns from the policy's attention, and does not change it.
    shares = torch.softmax(alpha.detach(), dim=1)
    return alpha, (shares * values).sum(1)


@lru_cache
def _pairs(slots: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the slots of each pair, shape (P,) each.

    Pairs come in the order of their later slot, so that numbers are the same at any table size.
    """
    # Acting may come first, in inference mode, whose tensors the learner cannot use.
    with torch.inference_mode(False):
        later, earlier = torch.tril_indices(slots, slots, device=device)
        return later, earlier


@lru_cache
def _membership(slots: int, device: torch.device) -> Tensor:
    """Return how often each slot is in each pair, shape (P, A): 2 in the pair with itself."""
    with torch.inference_mode(False):
        counts = [nn.functional.one_hot(slot, slots) for slot in _pairs(slots, device)]
        return torch.stack(counts).sum(0).float()


@lru_cache
def _square(slots: int, device: torch.device) -> Tensor:
    """Return the number of each slot pair, in both orders, shape (A, A)."""
    with torch.inference_mode(False):
        every = torch.arange(slots, device=device)
        later = torch.maximum(every[:, None], every)
        earlier = torch.minimum(every[:, None], every)
        # In the order of :func:`_pairs`.
        return later * (later + 1) // 2 + earlier
