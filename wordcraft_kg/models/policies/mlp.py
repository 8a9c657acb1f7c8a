"""The paper's simple baseline: a policy for one table size, without knowledge."""

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.policy import (
    EntityVectors,
    Policy,
    PolicyOutput,
    Weights,
    look_up,
)
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
