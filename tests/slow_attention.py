"""Attention policies by loops, for tests of policies and of their explanations."""

import math

import torch


def dot(one, other):
    return sum(x * y for x, y in zip(one, other, strict=True))


def affine(matrix, vector, bias):
    return [dot(row, vector) + b for row, b in zip(matrix, bias, strict=True)]


def softmax(logits):
    total = sum(math.exp(x - max(logits)) for x in logits)
    return [math.exp(x - max(logits)) / total for x in logits]


class SlowAttention:
    """The paper's formulas for a single state, on lists of floats; empty slots are left out before
    anything else."""

    def __init__(self, policy):
        self.config = policy.config
        self.p = {name: tensor.double().tolist() for name, tensor in policy.named_parameters()}
        is_one_hot = policy.vectors.is_one_hot
        x = torch.eye(policy.vectors.dim) if is_one_hot else policy.vectors.vectors[:-1]
        # Behind all entities stands nothing.
        self.x = [*x.double().tolist(), [0.0] * x.shape[1]]

    def alpha(self, goal, selection, row):
        """``α_i = Q([x_g; x_s]) · K(x_i) / √d``."""
        query = self.layer("attention.query", self.x[goal] + self.x[selection])
        keys = [
            [dot(weights, self.x[entity]) for weights in self.p["attention.key.weight"]]
            for entity in row
        ]
        return [dot(query, key) / math.sqrt(len(query)) for key in keys]

    def layer(self, name, vector):
        return affine(self.p[f"{name}.weight"], vector, self.p[f"{name}.bias"])

    def head(self, name, alpha, row):
        """``MLP(Σ_i w_i W x_i)``, W applied to every slot."""
        weights = softmax(alpha) if self.config.value_readout == "softmax" else alpha
        of_slots = [[dot(w, self.x[entity]) for w in self.p[f"{name}.0.weight"]] for entity in row]
        inner = affine(list(zip(*of_slots, strict=True)), weights, self.p[f"{name}.0.bias"])
        return self.layer(f"{name}.2", [max(y, 0.0) for y in inner])

    def lambdas(self, alpha, row):
        """``λ = MLP(wᵀ x)``, perhaps brought to positive numbers of sum 1; or λα = 1 and numbers."""
        if self.config.mixing == "residual":
            return [1.0] * (not self.config.kg_only) + [1 + 30 * x for x in self.p["lambdas.step"]]
        found = self.head("mixture", alpha, row)
        return softmax(found) if self.config.mixing == "softmax" else found
