"""An own split: goals with the same first letter stay together."""

import numpy as np

from wordcraft_kg.plugins import split


@split("by-initial")
def initials(graph):
    """Return the number of each recipe's group, shape (num_recipes,)."""
    goals = graph.sets[:, -1]
    return np.array([ord(graph.entities[goal][0]) for goal in goals])
