"""An own source: the share of an item's letters that the goal has, too."""

from wordcraft_kg.plugins import source


@source("letters")
def shared_letters(labels):
    """Return scores by goal and entity; NaN would mean that nothing is known."""
    letters = [set(label) for label in labels]
    return [[len(item & goal) / len(item) for item in letters] for goal in letters]
