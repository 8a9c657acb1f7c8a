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


class MLPPolicy(Policy):
    """The simple baseline in Jiang et al. 2020 (Extended Discussion), for one number of slots: a hidden layer."""

    def __init__(self, config: PolicyConfig, vectors: EntityVectors, num_slots: int):
        super().__init__(config, vectors)
        self.num_slots = num_slots
        self.hidden = nn.Linear((2 + num_slots) * vectors.dim, config.hidden_size)
        self.logits = nn.Linear(config.hidden_size, num_slots)
        self.value = nn.Linear(config.hidden_size, 1)

    def weights(self) -> Weights:  # noqa: D102 - inherited
        weights = self.vectors.weights()
        for name, layer in (
            ("hidden", self.hidden),
            ("logits", self.logits),
            ("value", self.value),
        ):
            weights |= {name: layer.weight.T, f"{name}.bias": layer.bias}
        return weights

    def output(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        weights: Weights,
        external_scores: Tensor | None,
    ) -> PolicyOutput:
        if table.shape[1] != self.num_slots:
            raise ConfigError(
                f"the tables have {table.shape[1]} slots: this mlp was made for {self.num_slots}. Use the "
                "`num_distractors` from training, or an attention policy, which takes any table size."
            )
        hidden, vectors = weights["hidden"], weights.get("vectors")
        ids = torch.cat([goal[:, None], selection[:, None], table], dim=1)
        if vectors is not None:
            inner = torch.addmm(weights["hidden.bias"], look_up(vectors, ids).flatten(1), hidden)
        else:
            by_input = nn.functional.pad(
                hidden.view(ids.shape[1], self.num_entities, -1), (0, 0, 0, 1)
            ).flatten(0, 1)
            offsets = torch.arange(ids.shape[1], device=ids.device) * (self.num_entities + 1)
            inner = weights["hidden.bias"] + look_up(by_input, ids + offsets).sum(1)
        inner = torch.relu(inner)
        logits = torch.addmm(weights["logits.bias"], inner, weights["logits"])
        value = torch.addmm(weights["value.bias"], inner, weights["value"])
        return PolicyOutput(logits.masked_fill(table == self.num_entities, -torch.inf), value[:, 0])
