"""A player for `wordcraft-kg evaluate-words`: the two things whose words lie nearest to the goal's, by GloVe vectors.

    wordcraft-kg evaluate-words everyday --player "python examples/line_player.py"

It needs no account and no download. Replace `choose` by anything: a rule, a model, a person at another screen.
"""

import json
import sys
from itertools import combinations

from wordcraft_kg.models.scorers.features import glove_features


def choose(goal: str | None, table: list[str], turn: int) -> tuple[int, int]:
    """Return the places of the two things to combine; without a goal, one pair after the other."""
    pairs = list(combinations(range(len(table)), 2))
    if goal is None:
        return pairs[turn % len(pairs)]
    *things, wanted = glove_features([*table, goal]).unit_vectors
    nearness = [float(thing @ wanted) for thing in things]
    return max(pairs, key=lambda pair: nearness[pair[0]] + nearness[pair[1]])


for turn, line in enumerate(sys.stdin):
    told = json.loads(line)
    one, other = choose(told["goal"], told["table"], turn)
    print(f"{one + 1} + {other + 1}", flush=True)
