"""Policies as torch modules: from states of B episodes to slot logits and state values."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import ClassVar, NamedTuple, cast

import torch
from torch import Tensor, nn

from wordcraft_kg.base import ArtefactError, UnknownEntityError, nearest, refuse
from wordcraft_kg.graphs import Entity, TaskSet
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.sources import ALPHA, Label
from wordcraft_kg.models.policies.sources.source import FoldedSource, Source
from wordcraft_kg.models.policies.states import Attempts, States

Weights = dict[str, Tensor]
"""Tensors derived from parameters only, by name."""
AHEAD = 10.0
"""First λ of sources that look ahead.

With 1 or 5, agents explore so much at first that they forget their planner.
"""


SPEED = 30.0
"""How many times as fast the mixing weights of :class:`SourceWeights` learn as other parameters.

With 1 the weights of good sources end at 3, where others reach 40, and with 100 those of useless
sources do not come to rest.
"""


class PolicyOutput(NamedTuple):
    """A policy's output for a batch with B states, A slots and S mixed scores per slot.

    That of :meth:`Policy.choose` has C choices in place of the slots.

    Attributes:
        logits: β, shape (B, A): unnormalised log-probabilities, -inf for empty slots.
        value: V, shape (B,): expected discounted return.
        sources: mixed scores, shape (B, S, A): attention logits α if in use, then the knowledge
            sources' scores; None without sources.
        lambdas: mixing weights λ, shape (B, S); None without sources.
    """

    logits: Tensor
    value: Tensor
    sources: Tensor | None = None
    lambdas: Tensor | None = None


class Action(NamedTuple):
    """The choice of a table slot.

    Attributes:
        slot: index of the slot on the table.
        entity: label of the slot's entity; empty for the action to combine.
        probability: the slot's probability under the policy.
    """

    slot: int
    entity: str
    probability: float


class EntityVectors(nn.Module):
    """Entity vectors x, which training does not change; the id E (empty slot) has zeros.

    One-hot vectors are never written out, because a product with a one-hot vector is a row of the
    other factor.

    Attributes:
        num_entities: E.
        dim: length of a vector, F; E for one-hot vectors.
        is_one_hot: whether the vectors are the rows of an identity matrix.
        vectors: buffer, shape (E + 1, F), the last row zeros; empty for one-hot vectors.
    """

    vectors: Tensor

    def __init__(self, num_entities: int, vectors: Tensor | None = None):
        """Take vectors, shape (E, F), which are copied; None for one-hot vectors."""
        super().__init__()
        self.num_entities = num_entities
        self.is_one_hot = vectors is None
        if vectors is None:
            vectors = torch.empty(0, num_entities)
        else:
            vectors = nn.functional.pad(vectors.detach().to(torch.float32), (0, 0, 0, 1))
        self.dim = vectors.shape[1]
        self.register_buffer("vectors", vectors)

    def weights(self) -> Weights:
        """Return all vectors as ``vectors``, shape (E + 1, F); nothing for one-hot vectors."""
        return {} if self.is_one_hot else {"vectors": self.vectors}


def look_up(vectors: Tensor, ids: Tensor) -> Tensor:
    """Return the vectors for ids with any shape: shape (*ids, F) from vectors (E + 1, F)."""
    # `index_select` takes flat ids only, but is faster than an index, forward and backward.
    return vectors.index_select(0, ids.reshape(-1)).view(*ids.shape, vectors.shape[1])


class SourceWeights(nn.Module):
    """A mixing weight λ for each source, the same in all states: ``λ = first + c · step``.

    An optimiser such as RMSProp moves each parameter by at most about its learning rate in an
    update, and the λ of good sources are large: with :data:`SPEED` (c) they are reached in time.

    Attributes:
        step: shape (S,): the learned parameter, 0 at first.
    """

    first: Tensor

    def __init__(self, first: Tensor, num_fixed: int = 0):
        """Begin with the weights ``first``, of which the first ``num_fixed`` are not learned."""
        super().__init__()
        # Follows from the settings, so that it is made again and not saved.
        self.register_buffer("first", first, persistent=False)
        self.step = nn.Parameter(torch.zeros_like(first[num_fixed:]))

    def forward(self) -> Tensor:
        """Return λ, shape (num_fixed + S,)."""
        num_fixed = len(self.first) - len(self.step)
        return self.first + SPEED * nn.functional.pad(self.step, (num_fixed, 0))


def mix_logits(
    logits: Tensor,
    lambdas: Tensor,
    slot_mask: Tensor,
) -> Tensor:
    """Mix the sources' scores into a logit for each slot: ``β_i = Σ_s λ_s · source_s,i``.

    Empty slots become -inf *after* mixing, so no choice of λ can revive them.

    Args:
        logits: shape (B, S, A): scores, with a channel for each source in use; attention logits α
            first if in use.
        lambdas: shape (B, S): mixing weights. A source that is not in use has no entry.
        slot_mask: shape (B, A), bool: True for occupied slots.

    Returns:
        shape (B, A): exactly -inf where ``slot_mask`` is False.

    Source: Jiang et al. 2020, appendix "Learning Mixing Coefficients"; differs by masking after
    mixing.
    """
    # (1, S) by (S, A) for each state.
    mixed = torch.bmm(lambdas[:, None, :], logits)[:, 0]
    return mixed.masked_fill(~slot_mask, -torch.inf)


class Policy(nn.Module):
    """Base class of policies: ``policy(States(...))`` for batches, :meth:`act` for one state.

    Needs no trainer of this package: a policy is a plain torch module. Ids equal environment ids:
    entities 0 to E - 1, and E for an empty slot or no selection.

    A subclass defines :meth:`output`, and :meth:`weights` if need be. The split lets an actor and a
    learner share what depends on parameters only, computed once per update.

    A trainer sees *choices*: slots, or for a policy that scores pairs, the pairs of slots of a
    whole attempt. Such a policy also defines the methods from :meth:`choose` to
    :meth:`choices_with`.

    Attributes:
        steps_per_choice: environment steps that a choice takes.
        num_slots: slots of all tables; None for tables of any size.
        most_picks: S, the most selections of an attempt, if recipes have other sizes than two; 0
            for pairs.
        noise_size: random numbers that :meth:`choose` needs for each state; 0 for none.
        config: settings.
        num_entities: E, the number of entities.
        sources: knowledge sources by name; see :mod:`wordcraft_kg.models.policies.sources`.
        labels: names of the mixed scores, in order: ``alpha`` (attention) if in use, then the
            sources; empty without sources.
        entities: entity labels in id order; like ``graph_hash``, set by ``make_policy`` and
            ``load_policy``, and empty before.
        graph_hash: content hash of the recipe graph.
        lambdas: the mixing weights λ of the mixing "residual"; None for other mixings.
    """

    steps_per_choice: ClassVar[int] = 1
    num_slots: int | None = None
    most_picks: int = 0
    noise_size: int = 0

    def __init__(
        self,
        config: PolicyConfig,
        vectors: EntityVectors,
        sources: Iterable[Source] = (),
    ):
        """Store settings, entity vectors and knowledge sources.

        Args:
            config: settings.
            vectors: entity vectors.
            sources: knowledge sources in mixing order, which become submodules.
        """
        super().__init__()
        self.entities: tuple[str, ...] = ()
        self.graph_hash = ""
        self.config = config
        self.vectors = vectors
        self.num_entities = vectors.num_entities
        # As submodules, sources move to a device and are saved with the policy.
        modules = nn.ModuleDict({source.name: source for source in sources})
        self.sources = cast("Mapping[str, Source]", modules)
        self.lambdas: SourceWeights | None = None
        # Without sources nothing is mixed, and the attention logits are the policy's.
        network_labels = (ALPHA,) if self.sources and not config.kg_only else ()
        self.labels: tuple[Label, ...] = (
            *network_labels,
            *(source.label for source in self.sources.values()),
        )

    @property
    def looks_ahead(self) -> bool:
        """Whether a source looks ahead, so that states need attempts."""
        return any(source.reads_attempts for source in self.sources.values())

    def first_lambdas(self) -> Tensor:
        """Return the mixing weights λ with which training begins, shape (S,)."""
        # On the CPU, also where a policy is made without memory: they are not in its files.
        if not self.looks_ahead:
            return torch.ones(len(self.labels), device="cpu")
        # Start as the planner alone: the other sources value one pair only, and would lead away
        # from plans of several attempts.
        ahead = [source.label for source in self.sources.values() if source.reads_attempts]
        lambdas = [AHEAD if label in ahead else 0.0 for label in self.labels]
        return torch.tensor(lambdas, device="cpu")

    def source_weights(self) -> SourceWeights:
        """Return all λ as numbers, for a policy with the mixing "residual": those of sources learn.

        The network, first among the labels if in use, has 1.
        """
        num_fixed = len(self.labels) - len(self.sources)
        first = self.first_lambdas()
        first[:num_fixed] = 1
        return SourceWeights(first, num_fixed)

    def mixed(
        self,
        logits: Tensor,
        value: Tensor,
        mask: Tensor,
        external_scores: Tensor | None,
        lambdas: Tensor | None,
    ) -> PolicyOutput:
        """Return a network's output with the scores of the sources mixed in, if there are any.

        Args:
            logits: shape (B, A): the network's, finite.
            value: shape (B,).
            mask: shape (B, A), bool: True for slots that may be chosen.
            external_scores: shape (B, S, A); None without sources.
            lambdas: mixing weights, shape (B, S); None without sources.
        """
        if external_scores is None or lambdas is None:
            return PolicyOutput(logits.masked_fill(~mask, -torch.inf), value)
        sources = external_scores
        if not self.config.kg_only:
            sources = torch.cat([logits[:, None], external_scores], dim=1)
        return PolicyOutput(mix_logits(sources, lambdas, mask), value, sources, lambdas)

    @property
    def folded_sources(self) -> list[FoldedSource]:
        """Sources with a model per left-out fold, whose scores depend on the task."""
        sources = self.sources.values()
        return [each for each in sources if isinstance(each, FoldedSource) and each.reads_task]

    @property
    def reads_task(self) -> bool:
        """Whether a source's scores depend on the task, so that states need task numbers."""
        return any(source.reads_task for source in self.sources.values())

    def bind(self, tasks: TaskSet) -> None:
        """Set the tasks that ``states.task`` indexes in later calls, if :attr:`reads_task`.

        Raises:
            LeakError: if a source would score a task by a model trained on the task's recipes.
            GraphMismatchError: if the tasks belong to another graph or split.
        """
        for source in self.sources.values():
            source.bind(tasks)

    def weights(self, generator: torch.Generator | None = None) -> Weights:
        """Return tensors computed from parameters only, which :meth:`forward` calls can share.

        By default ``vectors``, see :class:`EntityVectors`, and by their names all parameters that
        no other weights are computed from: an actor that lags behind the learner keeps copies.

        Args:
            generator: draws the noise with which a policy may train; None for none.
        """
        as_they_are = {
            name: parameter
            for name, parameter in self.named_parameters()
            if not name.startswith("attention.")
        }
        weights = self.vectors.weights() | as_they_are
        # The mixing "residual": one weight for each source in all states.
        if self.lambdas is not None:
            weights["lambdas"] = self.lambdas()
        return weights

    def forward(
        self,
        states: States,
        weights: Weights | None = None,
        external_scores: Tensor | None = None,
    ) -> PolicyOutput:
        """Return logits and values for a batch of states.

        Args:
            states: states of B episodes. ``task`` may be None unless :attr:`reads_task`, and
                ``attempts`` unless a source looks ahead.
            weights: result of :meth:`weights`; computed by default.
            external_scores: result of :meth:`external_scores` for these states, (B, S, C); computed
                by default.

        Returns:
            Logits (B, A) and values (B,); with sources, also their scores and mixing weights.

        Raises:
            ConfigError: if the tables have other slots than an mlp was made for, or a policy with
                ``sees_attempts`` gets no attempts.
            LeakError: if states have task numbers before :meth:`bind`.
            ValueError: if a source that looks ahead gets no attempts.
        """
        if external_scores is None:
            external_scores = self.external_scores(states)
        return self.output(states, weights or self.weights(), external_scores)

    def best_slots(
        self,
        states: States,
        weights: Weights | None = None,
        external_scores: Tensor | None = None,
    ) -> Tensor:
        """Return the slot that a greedy player takes in each state, shape (B,).

        The first of equally good slots.

        Args:
            states: B states, as in :meth:`forward`.
            weights: result of :meth:`weights`; None computes it.
            external_scores: result of :meth:`external_scores`; None computes it.

        Raises:
            ArtefactError: if the policy's numbers overflow.
        """
        return checked_logits(self(states, weights, external_scores).logits).argmax(1)

    def output(
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        """Return the result of :meth:`forward`; to be defined by each kind of policy.

        Args:
            states: states of B episodes; only goal, selection and table are read, and attempts by
                a policy with ``sees_attempts``.
            weights: result of :meth:`weights`, perhaps of an earlier update.
            external_scores: scores of the sources, (B, S, C); None without sources.

        Raises:
            ConfigError: if a policy with ``sees_attempts`` gets no attempts.
        """
        raise NotImplementedError

    def choose(
        self,
        states: States,
        weights: Weights,
        external_scores: Tensor | None,
        noise: Tensor | None = None,
    ) -> PolicyOutput:
        """Return logits (B, C) of all choices, for a trainer; the arguments as in :meth:`output`.

        Args:
            states: states of B episodes.
            weights: result of :meth:`weights`.
            external_scores: result of :meth:`external_scores` for these states.
            noise: shape (B, :attr:`noise_size`), uniform in [0, 1): decides which hidden units are
                dropped in training; None drops none.
        """
        return self.output(states, weights, external_scores)

    def num_choices(self, slots: int) -> int:
        """Return C, the number of choices at tables with so many slots."""
        return slots

    def slots_of(self, choices: Tensor, slots: int) -> tuple[Tensor, ...]:
        """Return the slot for each environment step of B choices among ``slots``, (B,) each."""
        return (choices,)

    def pairs_of(self, states: States, choices: Tensor) -> tuple[Tensor, Tensor]:
        """Return the entities that choices (B,) combine, shape (B,) each; E where they select."""
        return states.selection, states.table.gather(1, choices[:, None])[:, 0]

    def choices_with(self, states: States, is_listed: Tensor) -> Tensor:
        """Return the choices that lead to listed slot pairs, shape (B, C), bool.

        Args:
            states: states of B episodes.
            is_listed: shape (B, A, A), bool, symmetric; False for empty slots.
        """
        selection = states.selection[:, None]
        # With a selection, its partners; without one, all slots of listed pairs.
        is_first = selection == self.num_entities
        is_selected = (states.table == selection) | is_first
        return (is_listed & is_selected[:, :, None]).any(1)

    @torch.no_grad()
    def external_scores(self, states: States, silent: Collection[str] = ()) -> Tensor | None:
        """Return the sources' scores for reuse in :meth:`forward`.

        Args:
            states: states of B episodes, as for :meth:`forward`.
            silent: names of sources whose scores are 0 instead.

        Returns:
            shape (B, S, C); None without sources.

        Raises:
            LeakError: if states have task numbers before :meth:`bind`.
            ValueError: if a source that looks ahead gets no attempts.
        """
        if not self.sources:
            return None
        scores = []
        for name, source in self.sources.items():
            source_scores = self._scores(source, states)
            scores.append(torch.zeros_like(source_scores) if name in silent else source_scores)
        return torch.stack(scores, dim=1)

    def _scores(self, source: Source, states: States) -> Tensor:
        """Return a source's scores of all choices, shape (B, C)."""
        scores: Tensor = source(states)
        return scores

    @torch.no_grad()
    def act(
        self,
        goal: Entity,
        table: Sequence[Entity | None],
        selection: Entity | Sequence[Entity] | None = None,
        *,
        attempts_left: int = 1,
        generator: torch.Generator | None = None,
    ) -> Action:
        """Choose a slot in a single state.

        Args:
            goal: entity to make; like all entities here, a label or an id.
            table: entities on the table; None for an empty slot.
            selection: the selected entity; None without a selection. If recipes have other sizes
                than two, the selected entities; the action to combine is the slot after the table.
            attempts_left: attempts left, including the current attempt, for sources that look
                ahead.
            generator: samples the slot, on the CPU. By default, the most probable slot is chosen,
                and the first of equally probable slots.

        Returns:
            The chosen slot, its entity's label and its probability.

        Raises:
            UnknownEntityError: for a label or id that the policy does not know, with the nearest
                labels.
            ConfigError: if the table is empty, or has other slots than an mlp was made for.
            ArtefactError: if the policy's numbers overflow.
        """
        if all(entity is None for entity in table):
            raise refuse("table", list(table), "at least an entity")
        device = next(self.parameters()).device

        def batch(numbers: object) -> Tensor:
            return torch.tensor([numbers], device=device)

        goal_id = self.id_of(goal)
        slots = [self.id_of(entity) for entity in table]
        selected: int | list[int]
        if self.most_picks:
            selected = [self.id_of(entity) for entity in selected_entities(selection)]
            if len(selected) >= self.most_picks:
                raise refuse("selection", selection, f"fewer than {self.most_picks} entities")
            selected += [self.num_entities] * (self.most_picks - len(selected))
            slots.append(self.num_entities)
        else:
            assert selection is None or isinstance(selection, str | int)
            selected = self.id_of(selection)
        attempts = Attempts(batch(attempts_left))
        states = States(batch(goal_id), batch(selected), batch(slots), attempts=attempts)
        # On the CPU, where the generator is: the same slot on every device.
        probabilities = torch.softmax(checked_logits(self(states).logits)[0], dim=0).cpu()
        if generator is None:
            slot = int(self.best_slots(states))
        else:
            slot = int(probabilities.multinomial(1, generator=generator))
        # The action to combine holds the id of no entity.
        return Action(slot, (*self.entities, "")[slots[slot]], float(probabilities[slot]))

    def id_of(self, entity: Entity | None) -> int:
        """Return the id for a label or id; E for None.

        Raises:
            UnknownEntityError: naming the nearest labels, or the range of ids.
        """
        if entity is None:
            return self.num_entities
        if isinstance(entity, str):
            if entity not in self.entities:
                raise UnknownEntityError(
                    f"the policy has no entity '{entity}'.{nearest(entity, self.entities)}"
                )
            return self.entities.index(entity)
        if not 0 <= entity < self.num_entities:
            raise UnknownEntityError(
                f"the policy has no entity {entity}; expected 0 .. {self.num_entities - 1}."
            )
        return int(entity)


def selected_entities(selection: Entity | Iterable[Entity] | None) -> tuple[Entity, ...]:
    """Return selected entities as a tuple: those of a set, a single one, or none."""
    if selection is None:
        return ()
    return (selection,) if isinstance(selection, str | int) else tuple(selection)


def checked_logits(logits: Tensor) -> Tensor:
    """Return logits (B, A), after a check that they are not NaN or infinite.

    Raises:
        ArtefactError: if a policy has such large weights that its numbers overflow.
    """
    if not bool((logits.amax(1) < torch.inf).all()):
        raise ArtefactError(
            "the policy's logits are not finite: its weights, or the scores that it mixes, are too "
            "large. Train again, or restore a copy."
        )
    return logits


def log_policy(logits: Tensor) -> Tensor:
    """Convert logits (B, A) to log-probabilities, slots first: (A, B); -inf for empty slots."""
    # A table has few slots and a batch has many states: along the first axis, softmax reads and
    # writes whole rows of states at a time.
    return torch.log_softmax(logits.T.contiguous(), dim=0)
