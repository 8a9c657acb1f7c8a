"""Formatting for numbers in sentences."""

import math


def counted(number: int, one: str, more: str = "") -> str:
    """Return a number with a noun in the singular or plural.

    Args:
        number: the number.
        one: the noun in the singular.
        more: the noun in the plural; empty for the singular with an s.

    Example:
        >>> counted(1, "entity", "entities"), counted(1_200, "pair")
        ('1 entity', '1,200 pairs')
    """
    noun = one if number == 1 else more or f"{one}s"
    return f"{number:,} {noun}"


def quoted(label: str) -> str:
    """Return a label for a list with commas.

    It is in quotes if it holds a comma, or begins or ends blank.

    Example:
        >>> ", ".join(map(quoted, ["water", "salt, pepper"]))
        "water, 'salt, pepper'"
    """
    is_clear = "," not in label and label == label.strip()
    return label if is_clear else f"'{label}'"


def approximate(number: int) -> str:
    """Return a natural number as text: digits such as ``1,200``, or from 10^12 a power of ten."""
    if number < 10**12:
        return f"{number:,}"
    # Python does not print more than 4,300 digits, and such a number exceeds a float.
    exponent = math.floor(math.log10(number))
    leading = round(10 ** (math.log10(number) - exponent), 1)
    if leading >= 10:  # 9.96 is rounded to 10.0
        return f"about 1 × 10^{exponent + 1}"
    return f"about {leading:g} × 10^{exponent}"
