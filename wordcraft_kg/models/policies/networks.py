"""Networks for slots: the paper's baseline for one table size, and networks of one's own."""

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.modules.dropout import _DropoutNd

from wordcraft_kg.base import ConfigError, check_memory
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.models.policies.policy import (
    EntityVectors,
    Policy,
    PolicyOutput,
    Weights,
    look_up,
    named_weights,
)
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.sources.source import Source
from wordcraft_kg.models.policies.states import States


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

    def weights(  # noqa: D102 - inherited
        self, generator: torch.Generator | None = None
    ) -> Weights:
        layers = {
            "hidden": self.hidden,
            "logits": self.logits,
            "value": self.value,
        }
        weights = self.vectors.weights()
        for name, layer in layers.items():
            weights[name] = layer.weight.T
            weights[f"{name}.bias"] = layer.bias
        return weights

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
        # Logits and value share the hidden layer.
        inner = torch.relu(self._hidden(ids, weights))
        logits = torch.addmm(weights["logits.bias"], inner, weights["logits"])
        value = torch.addmm(weights["value.bias"], inner, weights["value"])
        is_empty = table == self.num_entities
        return PolicyOutput(logits.masked_fill(is_empty, -torch.inf), value[:, 0])

    def _hidden(self, ids: Tensor, weights: Weights) -> Tensor:
        """Return the hidden layer before the rectifier, shape (B, H), for ids (B, 2 + A)."""
        hidden = weights["hidden"]
        bias = weights["hidden.bias"]
        vectors = weights.get("vectors")
        if vectors is not None:
            return torch.addmm(bias, look_up(vectors, ids).flatten(1), hidden)
        # One-hot vectors: each input adds a row of its own block of the weights. A row of zeros
        # below each block stands for an empty slot, so blocks are E + 1 rows apart.
        inputs = ids.shape[1]
        blocks = hidden.view(inputs, self.num_entities, -1)
        rows = nn.functional.pad(blocks, (0, 0, 0, 1)).flatten(0, 1)
        offsets = torch.arange(inputs, device=ids.device) * (self.num_entities + 1)
        return bias + look_up(rows, ids + offsets).sum(1)


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
        if self.vectors.is_one_hot:
            size = self.num_entities
            what = "one-hot vectors of a network, which other `features` avoid,"
            check_memory("entities", size, what, 4 * size * (size + 1))
        self.network = network.eval()
        if self.sources:
            self.lambdas = self.source_weights()

    def weights(  # noqa: D102 - inherited
        self, generator: torch.Generator | None = None
    ) -> Weights:
        # One-hot vectors are written out here, for a network that knows no short cut.
        size = self.num_entities
        device = next(self.network.parameters()).device
        weights = self.vectors.weights() or {"vectors": torch.eye(size + 1, size, device=device)}
        # By name, so that an actor may lag behind the learner.
        weights |= named_weights("network", self.network)
        if self.sources:
            weights |= self.residual_weights(self.lambdas)
        return weights

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
