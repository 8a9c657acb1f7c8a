"""Numbers in sentences."""


def counted(number: int, one: str, more: str = "") -> str:
    """Return a number with what it counts, in singular or plural; the plural is that with an s by default.

    Example:
        >>> counted(1, "entity", "entities"), counted(1_200, "pair")
        ('1 entity', '1,200 pairs')
    """
    return f"{number:,} {one if number == 1 else more or one + 's'}"
