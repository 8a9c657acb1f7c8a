"""What a person sees and picks: the labels on a table, the slot that a typed word means, what a pair makes."""

from collections.abc import Sequence

from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
from wordcraft_kg.errors import ActionError
from wordcraft_kg.settings import nearest

MOST_CHOICES = 8
"""How many of the things that a beginning could mean are named."""


def table_labels(env: WordCraftEnv, observation: Observation) -> tuple[str, ...]:
    """Return what is on the table, slot by slot."""
    return env.world.graph.labels(observation["table"][observation["action_mask"] == 1])


def results_of(env: WordCraftEnv, one: str, other: str) -> tuple[str, ...]:
    """Return the results of a pair in an environment; most pairs have none."""
    a, b = sorted(map(env.world.graph.id_of, (one, other)))
    return env.world.graph.labels(env.world.outcomes.get((a, b), ()))


def read_pick(typed: str, table: Sequence[str]) -> int:
    """Return the slot that a player means: by its number from 1, by its entity's word, or by the word's beginning.

    A number takes precedence over a word, a whole word over a beginning, and equal case over different case.

    Raises:
        ActionError: if the input means no slot or several.
    """
    typed = " ".join(typed.split())
    expected = f"expected 1 to {len(table)}, a word on the table, or its beginning"
    if not typed:
        raise ActionError(f"nothing typed: {expected}.")
    numbers = {str(slot + 1): slot for slot in range(len(table))}
    if typed in numbers:
        return numbers[typed]
    folded = [label.casefold() for label in table]
    for found in (
        [slot for slot, label in enumerate(table) if label == typed],
        [slot for slot, label in enumerate(folded) if label == typed.casefold()],
        [slot for slot, label in enumerate(folded) if label.startswith(typed.casefold())],
    ):
        if len(found) == 1:
            return found[0]
        if found:
            choices = ", ".join(f"{table[slot]} ({slot + 1})" for slot in found[:MOST_CHOICES])
            more = f" and {len(found) - MOST_CHOICES} more" if len(found) > MOST_CHOICES else ""
            raise ActionError(f"'{typed}' could be {choices}{more}; type more of the word, or the number.")
    shown = typed if len(typed) <= 40 else f"{typed[:40]}..."
    raise ActionError(f"{shown!r}: {expected}.{nearest(typed, table)}")
