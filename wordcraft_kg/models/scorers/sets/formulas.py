"""Chemical formulas as parts: elements with their amounts, by the library ``periodictable``."""

import re
from collections.abc import Mapping
from functools import cache

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.extras import check_extra

_HYDRATE = re.compile(r"[·•∙⋅*]\s*")
"""Signs before the water of a hydrate; the library writes a plus."""
_NOT_OF_FORMULAS = re.compile(r"[/%:@]|\[\d+\]")
"""Signs of mixtures, densities and isotopes, which the library reads as something else."""
_BRACKETS = str.maketrans("[]", "()")


@cache
def parse_formula(label: str) -> Mapping[str, float]:
    """Return the elements in a formula and their amounts.

    Args:
        label: a formula, with brackets of both kinds, decimals and hydrates.

    Raises:
        ConfigError: if the library cannot read it, as with ``x`` for an amount.
        MissingExtraError: if the library is not installed.

    Example:
        >>> parse_formula("BaTi0.9Zr0.1O3")
        {'Ba': 1, 'Ti': 0.9, 'Zr': 0.1, 'O': 3}
    """
    sign = _NOT_OF_FORMULAS.search(label)
    if sign:
        raise _unreadable(label, f"it has {sign[0]}")
    text = _HYDRATE.sub("+", label.translate(_BRACKETS))
    # Not within: a missing library is no fault of the formula.
    check_extra("chemistry")
    from periodictable import formula

    # Its parser raises errors of several kinds, some of which are plain ones.
    try:
        atoms = formula(text).atoms
    except Exception as error:
        raise _unreadable(label, str(error)) from None
    # Ions and isotopes are parts of their own names; amounts may be anything that was typed.
    amounts = {str(atom): float(amount) for atom, amount in atoms.items() if amount > 0}
    if not amounts:
        raise _unreadable(label, "no element")
    return amounts


def _unreadable(label: str, fault: str) -> ConfigError:
    return ConfigError(
        f"'{label}' is no chemical formula ({fault.splitlines()[0][:80]}); expected one such as "
        "BaTi0.9Zr0.1O3, without x or y. Write amounts as numbers, or give `parts` as a table."
    )
