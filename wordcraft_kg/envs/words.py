"""Crafting games as text, for people, programs and language models.

Entities are numbered from 1 in table order; :mod:`wordcraft_kg.base.labels` parses answers. All
texts come from :data:`PROMPTS`, whose hash is in each result, because different prompts make a
different experiment: a changed character there makes earlier results incomparable.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence

from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph

NOTHING = "nothing"
"""The word for an empty list or no selection."""
PROMPTS = {
    "rules": (
        "This is a crafting game. In each attempt, you combine two items, or one item with itself. "
        "Any item you make becomes available, and ingredients are never used up. "
        "Most combinations make nothing."
    ),
    "goal": (
        "Make the goal item before you run out of attempts. "
        "It can always be made from the items on the table."
    ),
    "discover": (
        "There is no goal item. You start with a few known items, and every item you make becomes "
        "known. Discover as many different items as you can before you run out of attempts."
    ),
    # An example in place of a pattern, since small language models copy the words of a pattern: on
    # 30 train tasks of everyday, Qwen2.5-Coder-0.5B-Instruct gave a legal first answer in 8 games
    # with the first wording, "Answer with the two items in this format: first + second.", and in 22
    # with this one (greedy, at most 16 tokens).
    "answer": (
        "Choose two of the listed items, by name or number, and write them with a plus sign "
        'between them. For example, "water + earth" combines water with earth. '
        "Only listed items can be combined. "
        "You may reason first, but only the last line of your answer counts."
    ),
    "look_up": (
        "Instead of making an attempt, you may look up an item in this format: look up water. "
        "A look-up does not use up an attempt. You have {look_ups}."
    ),
    "task": "Goal: {goal}\nTable: {table}\nAttempts left: {attempts_left}",
    # No longer shown; frozen results have the hash of all texts.
    "selection": (
        "Goal: {goal}\nTable: {table}\nFirst pick: {selection}\nAttempts left: {attempts_left}"
    ),
    "world": "Known items ({known}): {table}\nAttempts left: {attempts_left}",
    "made": "{first} + {second} -> {made}",
    "nothing_new": "nothing new",
    "tried": " (already tried)",
    "goal_made": "You made the goal: {goal}.",
    "not_made": "You have no attempts left. You did not make {goal}.",
    "all_known": "You have discovered every item.",
    "no_attempt_left": "You have no attempts left. You know {known}.",
    "ended": "The game was ended early.",
    "invalid": "Invalid answer: {reason} This did not use up an attempt. Please answer again.",
    "attempt_lost": "Invalid answer: {reason} This used up an attempt.",
    "known_recipes": "Known recipes with {entity}:\n{facts}",
    "more_recipes": "and {more}",
    "likely_links": "Likely links of {entity}:\n{facts}",
    "likely_partners": "on this table, most likely combines with: {entities}",
    "likely_results": "most likely an ingredient of: {entities}",
    "likely_ingredients": "most likely ingredients: {entities}",
    "no_facts": "Nothing is known about {entity}.",
    "no_look_ups": "You have no look-ups left. Combine two items.",
}
"""The prompt template: all texts for players, except errors and tool descriptions."""
SET_PROMPTS = {
    **PROMPTS,
    "rules": (
        "This is a crafting game. In each attempt, you combine items, from one to {most} of them; "
        "an item that is needed twice is written twice. "
        "Any item you make becomes available, and ingredients are never used up. "
        "Most combinations make nothing."
    ),
    "answer": (
        "Choose the listed items to combine, by name or number, and write them with plus signs "
        'between them. For example, "water + earth + fire" combines these three. '
        "Only listed items can be combined. "
        "You may reason first, but only the last line of your answer counts."
    ),
    "no_look_ups": "You have no look-ups left. Combine items.",
}
"""The template where recipes have other sizes than two."""


def prompt_hash(*, sets: bool = False) -> str:
    """Return the SHA-256 of the prompt template, in hexadecimal; with ``sets`` of the other one."""
    texts = SET_PROMPTS if sets else PROMPTS
    return hashlib.sha256(json.dumps(texts, sort_keys=True).encode()).hexdigest()


def prompt_text(name: str, *, sets: bool = False, **values: object) -> str:
    """Return a text of :data:`PROMPTS`, or with ``sets`` of :data:`SET_PROMPTS`, with values."""
    return (SET_PROMPTS if sets else PROMPTS)[name].format(**values)


def numbered(labels: Iterable[str]) -> str:
    """Return labels as one text, numbered from 1; :data:`NOTHING` without labels.

    Example:
        >>> numbered(["water", "earth"])
        '1 water, 2 earth'
    """
    return ", ".join(f"{place} {label}" for place, label in enumerate(labels, start=1)) or NOTHING


def combined(
    pair: Sequence[str],
    results: Sequence[str],
    otherwise: str = NOTHING,
) -> str:
    """Return an attempt as one text, such as ``water + earth -> mud``.

    Args:
        pair: labels of the combined entities, two or more, or one, in the order of the player.
        results: labels of the results.
        otherwise: text in place of results if there are none.
    """
    *firsts, last = pair
    made = ", ".join(results) or otherwise
    text = prompt_text("made", first=" + ".join(firsts), second=last, made=made)
    return text if firsts else text.removeprefix(" + ")


def results_of(world: World, *ingredients: Entity) -> tuple[str, ...]:
    """Return the labels of all results of a pair or set of entities.

    Args:
        world: world whose recipes count.
        ingredients: labels or ids, in any order.

    Returns:
        Labels in alphabetical order; empty if they make nothing.

    Raises:
        UnknownEntityError: for a label or id that the graph lacks.
    """
    ids = tuple(sorted(map(world.graph.id_of, ingredients)))
    return world.graph.labels(world.outcomes.get(ids, ()))


def characters(graph: RecipeGraph) -> frozenset[str]:
    """Return all characters that prompts about a graph may contain, for a space of texts."""
    return frozenset("0123456789").union(*SET_PROMPTS.values(), *PROMPTS.values(), *graph.entities)
