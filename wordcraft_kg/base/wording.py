"""Formatting for numbers in sentences."""

import math


def duration(hours: float) -> str:
    """Format a duration in hours, or in minutes below one hour: 3 minutes, 1.2 hours."""
    if hours >= 1:
        return f"{hours:.1f} hours"
    return counted(max(round(60 * hours), 1), "minute")


def counted(number: int, one: str, more: str = "") -> str:
    """Return a number with a noun: ``one`` is the singular, ``more`` the plural (default: the singular with an s).

    Example:
        >>> counted(1, "entity", "entities"), counted(1_200, "pair")
        ('1 entity', '1,200 pairs')
    """
    return f"{number:,} {one if number == 1 else more or one + 's'}"


def approximate(number: int) -> str:
    """Return a natural number as text: digits such as ``1,200``, or from 10^12 a power of ten."""
    if number < 10**12:
        return f"{number:,}"
    # Python does not print more than 4,300 digits, and such a number exceeds a float.
    exponent = math.floor(math.log10(number))
    leading = round(10 ** (math.log10(number) - exponent), 1)
    return f"about {leading:g} × 10^{exponent}" if leading < 10 else f"about 1 × 10^{exponent + 1}"
