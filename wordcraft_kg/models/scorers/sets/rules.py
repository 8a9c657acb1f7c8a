"""A user's own rule: which sets of ingredients are allowed for a goal.

The user names the function each time. No folder stores a rule or loads one.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name

import numpy as np

from wordcraft_kg.base.errors import RuleError, reason

Rule = Callable[[tuple[str, ...], str], bool]
"""Returns whether a set of ingredients, by labels, is allowed for a goal."""


def read_rule(name: str) -> Rule:
    """Import a rule, and check all that it returns.

    Args:
        name: ``module:function``; the module is installed, or a file in the current folder.

    Returns:
        The rule. It raises RuleError if the function fails, or returns no bool.

    Raises:
        RuleError: if there is no such function.

    Example:
        >>> read_rule("operator:contains")(("earth", "water"), "mud")
        False
    """
    folder = str(Path.cwd())
    # Behind all others, so that no file in the folder replaces a library.
    sys.path.append(folder)
    try:
        function = resolve_name(name)
    # A module of the user's may raise anything.
    except Exception as error:
        raise RuleError(
            f"`rule` {name!r}: cannot import it ({reason(error)}); expected module:function, such "
            "as my_rules:is_allowed, of a module that is installed, or a file in the current "
            "folder. Correct the name or the file."
        ) from error
    finally:
        sys.path.remove(folder)
    if not callable(function):
        raise RuleError(
            f"`rule` {name!r} is a {type(function).__name__}; expected a function of a tuple of "
            "ingredients and a goal. Correct the name."
        )

    def is_allowed(ingredients: tuple[str, ...], goal: str) -> bool:
        recipe = f"{' + '.join(ingredients)} -> {goal}"
        try:
            answer = function(ingredients, goal)
        except Exception as error:
            raise RuleError(
                f"`rule` {name!r} failed for {recipe} ({reason(error)}); expected True or False. "
                "Correct the function."
            ) from error
        if not isinstance(answer, bool | np.bool_):
            raise RuleError(
                f"`rule` {name!r} returned {answer!r:.80} for {recipe}; expected True or False. "
                "Correct the function."
            )
        return bool(answer)

    return is_allowed
