"""An own player for the reference table.

Choose the entities with the most similar names to the goal's name.

A package makes its player known to `wordcraft-kg evaluate-agent kitchen` by an entry point:
[project.entry-points."wordcraft_kg.players"], alike = "my_package.players:alike_player".
"""

from difflib import SequenceMatcher

import numpy as np

from wordcraft_kg.agents.players import PLAYERS, Player
from wordcraft_kg.cli import main
from wordcraft_kg.envs.batch import State
from wordcraft_kg.graphs import Split


def alike_player(split: Split) -> Player:
    """Return a player for a split.

    A player may learn from the split; this player compares names only.
    """
    names = split.graph.entities
    alike = np.array(
        [[SequenceMatcher(None, one, goal).ratio() for one in (*names, "")] for goal in names]
    )

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        scores = alike[state.goal[:, None], state.table] - (state.table == state.selection[:, None])
        return np.asarray(np.where(state.action_masks(), scores, -np.inf).argmax(axis=1))

    return act


PLAYERS["alike names"] = alike_player

if __name__ == "__main__":
    main(["evaluate-agent", "kitchen", "--distractors", "2,8", "--distractor-seeds", "2"])
