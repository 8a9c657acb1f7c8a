"""An own policy: an item is worth as much as its words fit those of goal and selection."""

import torch
from torch import nn

from wordcraft_kg.plugins import policy


@policy("bilinear")
class Bilinear(nn.Module):
    """A query from goal and selection, and its product with the vector of each item."""

    def __init__(self, dim: int):
        super().__init__()
        self.query = nn.Sequential(nn.Linear(2 * dim, 128), nn.ReLU(), nn.Linear(128, dim))
        self.value = nn.Linear(dim, 1)

    def forward(self, states, vectors):
        """Return logits (B, A) and values (B,); the vector of an empty slot is 0."""
        goal, selection = vectors[states.goal], vectors[states.selection]
        query = self.query(torch.cat([goal, selection], dim=1))
        logits = (vectors[states.table] @ query[:, :, None])[..., 0]
        return logits, self.value(goal)[:, 0]
