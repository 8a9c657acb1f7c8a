"""A player for `wordcraft-kg bench run` and `evaluate-agent`.

The two things whose words lie nearest to the goal's, by GloVe vectors.

    wordcraft-kg evaluate-agent everyday --player "program:python examples/line_player.py"

It needs no account and no download. Replace `choose` by anything: a rule, a model, a person at
another screen.
"""

import json
import sys
from itertools import combinations

import numpy as np

from wordcraft_kg.models.scorers.features import glove_features

VECTORS: dict[str, np.ndarray] = {}
"""Unit vectors of the words so far; each look-up reads GloVe's whole vocabulary."""


def choose(goal: str | None, table: list[str], turn: int) -> tuple[int, int]:
    """Return the places of the two things to combine; without a goal, one pair after the other."""
    pairs = list(combinations(range(len(table)), 2))
    if goal is None:
        return pairs[turn % len(pairs)]
    if unknown := [word for word in (*table, goal) if word not in VECTORS]:
        VECTORS.update(zip(unknown, glove_features(unknown).unit_vectors, strict=True))
    nearness = [float(VECTORS[thing] @ VECTORS[goal]) for thing in table]
    return max(pairs, key=lambda pair: nearness[pair[0]] + nearness[pair[1]])


for turn, line in enumerate(sys.stdin):
    message = json.loads(line)
    one, other = choose(message["goal"], message["table"], turn)
    print(f"{one + 1} + {other + 1}", flush=True)
