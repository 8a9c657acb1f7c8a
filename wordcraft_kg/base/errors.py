"""Errors that a user can cause, one class per cause; messages have the value found, the value expected and a remedy."""

import re

NAMED_SETTING = re.compile(r"`([a-z]\w*)`")


def reason(error: BaseException) -> str:
    """Return an exception's class name and message in one line; a message is cut after 300 characters."""
    text = " ".join(str(error).split()) or "no reason given"
    return f"{type(error).__name__}: {text if len(text) <= 300 else text[:300] + '...'}"


class WordCraftKGError(Exception):
    """Base class for all errors that a user can cause; the command line prints such errors without a traceback."""

    @property
    def kind(self) -> str:
        """Name of the error class, for the JSON output by commands (``--json``)."""
        return type(self).__name__

    @property
    def setting(self) -> str:
        """Python name for the setting with the invalid value: the first name in backticks in the message, or ""."""
        named = NAMED_SETTING.search(str(self))
        return named[1] if named else ""


class RecipeFileError(WordCraftKGError, ValueError):
    """A recipe book (a file with recipes) cannot be read; the message names the line or the key."""


class QueryFileError(WordCraftKGError, ValueError):
    """A file of triples to score cannot be read; the message names the line."""


class KnowledgeFileError(WordCraftKGError, ValueError):
    """A file of knowledge from outside the book cannot be read or does not fit; the message names the line."""


class GraphError(WordCraftKGError, ValueError):
    """A recipe graph cannot be built from the given recipe rows or entity ids."""


class UnknownEntityError(WordCraftKGError, LookupError):
    """A label names no entity in the graph; the message suggests the most similar labels."""


class SplitError(WordCraftKGError, ValueError):
    """The recipes cannot be split into train, valid and test recipes with the given settings."""


class TaskError(WordCraftKGError, ValueError):
    """A requested task does not exist, or a task's plan (recipes that make the goal) cannot be carried out."""


class ConfigError(WordCraftKGError, ValueError):
    """A setting has a value that is not allowed."""


class UnknownSettingError(ConfigError, TypeError):
    """A keyword argument names no known setting; also a TypeError, as libraries such as gymnasium expect."""


class ActionError(WordCraftKGError, ValueError):
    """An action is outside the action space, illegal where only legal actions are allowed, or an unreadable text."""


class EpisodeError(WordCraftKGError, RuntimeError):
    """A step was requested before the environment's first reset, or after the end of the episode."""


class ArtefactError(WordCraftKGError, ValueError):
    """A folder or file written by this package is incomplete, damaged, or of the wrong kind."""


class GraphMismatchError(ArtefactError):
    """Two artefacts, such as a model and an environment, belong to different recipe graphs or different splits."""


class LeakError(WordCraftKGError, RuntimeError):
    """A train task would be scored by a model trained on the recipes in this task's plan."""


class TrainingError(WordCraftKGError, ArithmeticError):
    """Training diverged: a loss or a parameter is not finite."""


class OutputExistsError(WordCraftKGError, FileExistsError):
    """The output file or folder exists, and overwriting (``force``) was not requested."""


class StdoutError(WordCraftKGError, OSError):
    """A result could not be printed on stdout, for example on a full disk; files written before remain."""


class PlayerError(WordCraftKGError, RuntimeError):
    """An external program that plays games did not start, ended early, timed out, or wrote an invalid answer."""


class FetchError(WordCraftKGError, OSError):
    """A download or upload failed, or a downloaded book differs from the expected file."""


class MissingExtraError(WordCraftKGError, ImportError):
    """An optional dependency is missing; the message names the extra (package group) to install."""
