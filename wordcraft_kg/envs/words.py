"""The crafting worlds in words, for people, programs and language models.

Entities are numbered from 1 in table order; :mod:`wordcraft_kg.base.labels` reads answers. Results record the hash of
:data:`TEXTS`, because other prompts make another experiment.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence

from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph

NOTHING = "nothing"
TEXTS = {
    "rules": (
        "This is a game of crafting. An attempt combines two things, or one thing with itself; what they make comes to "
        "the table, and nothing is used up. Most pairs make nothing."
    ),
    "goal": "Make the goal within the attempts. The goal can be made from what is on the table.",
    "discover": (
        "There is no goal: you know a few things at the start, and whatever you make becomes known for good. Discover "
        "as many different things as you can within the attempts."
    ),
    "answer": (
        "Answer with the two things, as in: first + second. You may think aloud before, but only the last line of an "
        "answer counts."
    ),
    "pick": "An attempt is two picks: answer with one thing at a time, by its word or its number.",
    "look_up": (
        "Instead of an attempt you may look a thing up, as in: look up water. It costs no attempt; you may do it "
        "{look_ups} times."
    ),
    "task": "Make: {goal}\nOn the table: {table}\nAttempts left: {attempts_left}",
    "held": "Make: {goal}\nOn the table: {table}\nIn hand: {held}\nAttempts left: {attempts_left}",
    "world": "Known, {known} things: {table}\nAttempts left: {attempts_left}",
    "made": "{one} + {other} -> {made}",
    "tried": " (tried before)",
    "goal_made": "You made {goal}.",
    "not_made": "No attempt is left; {goal} was not made.",
    "all_known": "Everything that can be made is known.",
    "no_attempt_left": "No attempt is left; {known} things are known.",
    "ended": "The game was ended.",
    "refused": "Not understood: {why} Nothing was lost; answer again.",
    "lost": "Not understood: {why} The attempt is lost.",
    "found": "Of {entity} is known:\n{facts}",
    "nothing_found": "Of {entity} nothing is known.",
    "no_look_ups": "No look-up is left; combine two things.",
}
"""All texts for players."""


def texts_hash() -> str:
    """Return the hash of the texts, the prompt version."""
    return hashlib.sha256(json.dumps(TEXTS, sort_keys=True).encode()).hexdigest()


def told(name: str, **values: object) -> str:
    """Return a text of :data:`TEXTS`, filled with values."""
    return TEXTS[name].format(**values)


def numbered(labels: Iterable[str]) -> str:
    """Return labels with numbers.

    Example:
        >>> numbered(["water", "earth"])
        '1 water, 2 earth'
    """
    return ", ".join(f"{place} {label}" for place, label in enumerate(labels, start=1)) or NOTHING


def combined(picks: Sequence[str], made: Sequence[str], otherwise: str = NOTHING) -> str:
    """Return an attempt in words.

    Example:
        >>> combined(("water", "earth"), ("mud",))
        'water + earth -> mud'
    """
    one, other = picks
    return told("made", one=one, other=other, made=", ".join(made) or otherwise)


def table_labels(env: WordCraftEnv, observation: Observation) -> tuple[str, ...]:
    """Return the labels on the table, slot by slot."""
    return env.world.graph.labels(observation["table"][observation["action_mask"] == 1])


def results_of(env: WordCraftEnv, one: Entity, other: Entity) -> tuple[str, ...]:
    """Return the results of a pair in an environment, possibly empty."""
    a, b = sorted(map(env.world.graph.id_of, (one, other)))
    return env.world.graph.labels(env.world.outcomes.get((a, b), ()))


def characters(graph: RecipeGraph) -> frozenset[str]:
    """Return all characters in texts about a graph."""
    return frozenset("0123456789").union(*TEXTS.values(), *graph.entities)
