"""Labels that may mean one thing: a slip of the pen, or a thing used under a shorter name.

Only letters are compared: signs, digits and short words carry meaning (C and C-, boat and goat).
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator

from wordcraft_kg.graphs.recipe_graph import RecipeGraph

_SHORTEST = 6
"""Fewest letters of the longer label: of shorter words, many differ in a letter by chance."""
_DERIVED = "dnrsy"
"""Letters that make another word at the end: baked, american, baker, cakes, bakery."""
_MOST_MADE = 3
"""Most made things that end in one word; of more, such as trees, the word is a class."""


def alike_by_a_letter(labels: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of labels that differ in one letter more, or in two letters that changed places.

    The first letter is equal in both, as in yogurt and yoghurt; endings of plurals and the like are
    left out.

    Args:
        labels: labels in order; the pairs keep it.
    """
    rank_by_label = {label: place for place, label in enumerate(labels) if _is_word(label)}
    # Labels by the text without one of its letters: a pair shares such a text, or one label is it.
    shorter = defaultdict[str, set[str]](set)
    for label in rank_by_label:
        for cut in range(1, len(label)):
            shorter[label[:cut] + label[cut + 1 :]].add(label)
    pairs: set[tuple[str, str]] = set()
    for text, longer in shorter.items():
        if text in rank_by_label:
            pairs.update((text, label) for label in longer if _is_slip(text, label))
        several = sorted(longer)
        for number, label in enumerate(several):
            swapped = (
                swapped_label
                for swapped_label in several[number + 1 :]
                if _is_swapped(label, swapped_label)
            )
            pairs.update((label, swapped_label) for swapped_label in swapped)
    yield from sorted(pairs, key=lambda pair: sorted(rank_by_label[label] for label in pair))


def used_and_made(graph: RecipeGraph) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield things without a recipe, each with the made things that end in its name.

    Jam is only used, and strawberry jam is made: perhaps one of both names is meant.
    """
    labels_by_last_word = defaultdict[str, list[str]](list)
    for label, is_made in zip(graph.entities, graph.recipe_counts > 0, strict=True):
        _, blank, last = label.rpartition(" ")
        if is_made and blank:
            labels_by_last_word[last].append(label)
    is_only_used = (graph.recipe_counts == 0) & (graph.use_counts > 0)
    for label in graph.labels(is_only_used.nonzero()[0]):
        longer_labels = labels_by_last_word.get(label, [])
        if 0 < len(longer_labels) <= _MOST_MADE:
            yield label, tuple(longer_labels)


def _is_word(label: str) -> bool:
    return len(label) + 1 >= _SHORTEST and label.replace(" ", "").isalpha()


def _is_slip(text: str, longer: str) -> bool:
    """Return whether a label has a letter more than another, and is not derived from it."""
    is_derived = longer.startswith(text) and longer[-1] in _DERIVED
    return len(longer) >= _SHORTEST and not is_derived


def _is_swapped(label: str, second_label: str) -> bool:
    """Return whether two labels differ by two neighbouring letters that changed places."""
    if len(label) != len(second_label) or len(label) < _SHORTEST:
        return False
    first = next(place for place, letter in enumerate(label) if letter != second_label[place])
    swapped = label[:first] + label[first : first + 2][::-1] + label[first + 2 :]
    return swapped == second_label
