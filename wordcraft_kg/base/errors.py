"""Errors that a user can cause, one class per cause.

A message has the value found, the value expected and a remedy. Each class also derives from a
builtin, so that a program may catch ``ValueError`` without knowing this package.
"""

import re

# A message names settings as Python spells them; the command line shows its options instead.
NAMED_SETTING = re.compile(r"`([a-z]\w*)`")


def reason(error: BaseException) -> str:
    """Return an exception's class name and message in one line.

    The message is cut after 300 characters, because those of torch may take many lines.
    """
    text = " ".join(str(error).split()) or "no reason given"
    shown = text if len(text) <= 300 else text[:300] + "..."
    return f"{type(error).__name__}: {shown}"


class WordCraftKGError(Exception):
    """Base class for all errors that a user can cause.

    The command line prints such errors without a traceback and exits with code 1; any other
    exception is a fault of this package.
    """

    @property
    def kind(self) -> str:
        """Name of the error class, for the JSON output by commands (``--json``)."""
        return type(self).__name__

    @property
    def setting(self) -> str:
        """The setting with the invalid value: the first name in backticks in the message, or ""."""
        match = NAMED_SETTING.search(str(self))
        return match[1] if match else ""


class RecipeFileError(WordCraftKGError, ValueError):
    """A recipe book (a file with recipes) cannot be read; the message names the line or the key."""


class QueryFileError(WordCraftKGError, ValueError):
    """A file of triples to score cannot be read; the message names the line."""


class KnowledgeFileError(WordCraftKGError, ValueError):
    """A file of outside knowledge cannot be read or does not fit; the message names the line."""


class RuleError(WordCraftKGError, ValueError):
    """A user's own rule cannot be imported, fails, or returns no bool."""


class GraphError(WordCraftKGError, ValueError):
    """A recipe graph cannot be built from the given recipe rows or entity ids."""


class UnknownEntityError(WordCraftKGError, LookupError):
    """A label names no entity in the graph; the message suggests the most similar labels."""


class SplitError(WordCraftKGError, ValueError):
    """The recipes cannot be split into train, valid and test recipes with the given settings."""


class TaskError(WordCraftKGError, ValueError):
    """A requested task does not exist, or a task's plan cannot be carried out."""


class ConfigError(WordCraftKGError, ValueError):
    """A setting has a value that is not allowed."""


class UnknownSettingError(ConfigError, TypeError):
    """A keyword argument names no known setting.

    Also a TypeError, like Python's own error, because libraries such as gymnasium check for that.
    """


class ActionError(WordCraftKGError, ValueError):
    """An action is outside the action space, an unreadable text, or illegal.

    Illegal actions are errors only where the environment allows legal actions alone.
    """


class EpisodeError(WordCraftKGError, RuntimeError):
    """A step was requested before the environment's first reset, or after the episode's end."""


class ArtefactError(WordCraftKGError, ValueError):
    """A folder or file written by this package is incomplete, damaged, or of the wrong kind."""


class GraphMismatchError(ArtefactError):
    """Two artefacts, such as a model and an environment, belong to different graphs or splits."""


class NotRegisteredError(ConfigError, ArtefactError):
    """A setting or a folder names a part, such as a source or a split, that this process lacks.

    The folder is whole: after the part's package is installed, or its class registered, it opens.
    """


class LeakError(WordCraftKGError, RuntimeError):
    """A train task would be scored by a model trained on the recipes in this task's plan.

    Such a score is better than any score of a test task, and an agent would learn to trust it.
    """


class TrainingError(WordCraftKGError, ArithmeticError):
    """Training diverged: a loss or a parameter is not finite."""


class OutputExistsError(WordCraftKGError, FileExistsError):
    """The output file or folder exists, and overwriting (``force``) was not requested."""


class StdoutError(WordCraftKGError, OSError):
    """A result could not be printed on stdout, for example on a full disk.

    Files written before remain.
    """


class PlayerError(WordCraftKGError, RuntimeError):
    """An external program did not start, ended early, timed out, or wrote an invalid answer."""


class FetchError(WordCraftKGError, OSError):
    """A download or upload failed, or a downloaded book differs from the expected file."""


class MissingExtraError(WordCraftKGError, ImportError):
    """An optional dependency is missing; the message names the extra (package group) to install."""
