"""Errors that a user can cause, one class per cause; messages have the value found, the value expected and a remedy."""

import re

NAMED_SETTING = re.compile(r"`([a-z]\w*)`")


def reason(error: BaseException) -> str:
    """Return an error's kind and message in one line."""
    text = " ".join(str(error).split()) or "no reason given"
    return f"{type(error).__name__}: {text if len(text) <= 300 else text[:300] + '...'}"


class WordCraftKGError(Exception):
    """Base of all user errors; the command line prints such errors without a traceback."""

    @property
    def kind(self) -> str:
        """Name of the error's class, for `--json`."""
        return type(self).__name__

    @property
    def setting(self) -> str:
        """Python name of the refused setting, the first name in backticks in the message; "" without one."""
        named = NAMED_SETTING.search(str(self))
        return named[1] if named else ""


class RecipeFileError(WordCraftKGError, ValueError):
    """A recipe book cannot be read; the message names the line or the key."""


class QueryFileError(WordCraftKGError, ValueError):
    """A file of triples to score cannot be read; the message names the line."""


class GraphError(WordCraftKGError, ValueError):
    """A recipe graph cannot be built from the given rows or ids."""


class UnknownEntityError(WordCraftKGError, LookupError):
    """A label is not in the vocabulary; the message suggests the nearest labels."""


class SplitError(WordCraftKGError, ValueError):
    """A split cannot be drawn with these settings."""


class TaskError(WordCraftKGError, ValueError):
    """No such task exists, or a plan cannot be carried out."""


class ConfigError(WordCraftKGError, ValueError):
    """A setting has a value that is not allowed."""


class UnknownSettingError(ConfigError, TypeError):
    """An unknown keyword argument; also a TypeError, as libraries such as gymnasium expect."""


class ActionError(WordCraftKGError, ValueError):
    """An action is outside the action space, or not legal where only legal actions are allowed."""


class EpisodeError(WordCraftKGError, RuntimeError):
    """A step was requested before a reset or after the end of an episode."""


class ArtefactError(WordCraftKGError, ValueError):
    """A folder or file written by this package is incomplete, damaged, or of the wrong kind."""


class GraphMismatchError(ArtefactError):
    """Two artefacts belong to different recipe graphs or different splits."""


class LeakError(WordCraftKGError, RuntimeError):
    """A train task would be scored by a model trained on the task's recipes."""


class TrainingError(WordCraftKGError, ArithmeticError):
    """Training diverged: a loss or a parameter is not finite."""


class OutputExistsError(WordCraftKGError, FileExistsError):
    """The output exists and overwriting was not requested."""


class PlayerError(WordCraftKGError, RuntimeError):
    """A player program did not start, ended, timed out, or wrote an invalid answer."""


class FetchError(WordCraftKGError, OSError):
    """A published book could not be downloaded, or differs from the pinned file."""


class EndpointError(WordCraftKGError, ConnectionError):
    """A language model's endpoint refuses a request or does not answer; the message names the saved answers."""


class MissingExtraError(WordCraftKGError, ImportError):
    """An optional dependency is missing; the message names the extra to install."""
