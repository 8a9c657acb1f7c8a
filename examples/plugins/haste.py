"""An own reward: the goal is worth more with more attempts left, and waste costs a little."""

from wordcraft_kg.plugins import reward


@reward("haste")
def haste(before, after, step):
    """Return rewards (N,); ``step.reward`` is 1 for the goal."""
    bonus = 0.1 * (before.attempts_left - 1)
    return step.reward * (1 + bonus) - 0.1 * step.illegal
