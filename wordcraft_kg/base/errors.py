"""Errors that a user can cause: one class per cause; messages say what was found, what was expected, what to do."""

import re

NAMED_SETTING = re.compile(r"`([a-z]\w*)`")
"""A setting in a message, as Python spells it."""


def reason(error: BaseException) -> str:
    """Return an error's kind and message in one line; those of torch may take many."""
    text = " ".join(str(error).split()) or "no reason given"
    return f"{type(error).__name__}: {text if len(text) <= 300 else text[:300] + '...'}"


class WordCraftKGError(Exception):
    """Base of all errors that a user's input can cause; the command line prints them without a traceback."""

    @property
    def kind(self) -> str:
        """Name of the error's class; `--json` prints it."""
        return type(self).__name__

    @property
    def setting(self) -> str:
        """Python name of the refused setting, which the message names first in backticks; "" if it names none."""
        named = NAMED_SETTING.search(str(self))
        return named[1] if named else ""


class RecipeFileError(WordCraftKGError, ValueError):
    """A recipe book cannot be read; the message names the line or the key."""


class QueryFileError(WordCraftKGError, ValueError):
    """A file of triples to score cannot be read; the message names the line."""


class GraphError(WordCraftKGError, ValueError):
    """A recipe graph cannot be built from what was given."""


class UnknownEntityError(WordCraftKGError, LookupError):
    """A label is not in the vocabulary; the message suggests the nearest ones."""


class SplitError(WordCraftKGError, ValueError):
    """A split cannot be drawn with these settings."""


class TaskError(WordCraftKGError, ValueError):
    """There is no such task, or a plan cannot be carried out."""


class ConfigError(WordCraftKGError, ValueError):
    """A setting has a value that is not allowed."""


class UnknownSettingError(ConfigError, TypeError):
    """An unknown keyword argument; a TypeError, like Python's own, because other libraries check for that."""


class ActionError(WordCraftKGError, ValueError):
    """An action is outside the action space, or not legal where only legal actions are allowed."""


class EpisodeError(WordCraftKGError, RuntimeError):
    """An environment was asked for a step that it cannot take: before a reset or after the end of an episode."""


class ArtefactError(WordCraftKGError, ValueError):
    """A folder or file written by this package is incomplete, damaged, or of the wrong kind."""


class GraphMismatchError(ArtefactError):
    """Two artefacts belong to different recipe graphs or different splits."""


class LeakError(WordCraftKGError, RuntimeError):
    """A train task would be scored by a model that has been trained on its recipes."""


class TrainingError(WordCraftKGError, ArithmeticError):
    """A training cannot continue, because its numbers are no longer finite."""


class OutputExistsError(WordCraftKGError, FileExistsError):
    """The output exists already and overwriting was not requested."""


class PlayerError(WordCraftKGError, RuntimeError):
    """A program that plays could not be started, has ended, kept silent, or wrote what is no answer."""


class FetchError(WordCraftKGError, OSError):
    """A published book could not be downloaded, or is not the pinned file."""


class EndpointError(WordCraftKGError, ConnectionError):
    """The endpoint of a language model refuses what it is asked, or does not answer; the message says what is kept."""


class MissingExtraError(WordCraftKGError, ImportError):
    """An optional dependency is needed; the message names the extra that installs it."""
