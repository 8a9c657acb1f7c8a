"""What scripted players pick, so that players that use words can be made to play like them."""

import numpy as np

from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import Player
from wordcraft_kg.envs.batch import State
from wordcraft_kg.envs.world import World


def picks_of(player: Player, world: World, draws: int) -> dict[tuple[int, int], list[int]]:
    """Return the slots that a scripted player picks, by task and draw, as an evaluation has them."""
    found: dict[tuple[int, int], list[int]] = {}
    evaluator = Evaluator(world, draws=draws)
    episode = -1

    def recording(state: State, rng: np.random.Generator) -> np.ndarray:
        nonlocal episode
        slots = player(state, rng)
        if (state.selection == state.nothing).all() and (state.attempts_left == world.config.attempts).all():
            episode += 1
        for row in np.flatnonzero(state.attempts_left > 0):
            found.setdefault((int(evaluator.tasks[row]), episode), []).append(int(slots[row]))
        return slots

    evaluator(recording)
    return found
