"""What can go wrong for a user: one class a cause, each saying what was found, what was expected and what to do."""


class WordCraftKGError(Exception):
    """Base of all errors that a user's input can cause; the command line prints them without a traceback."""


class RecipeFileError(WordCraftKGError, ValueError):
    """A recipe book cannot be read; the message names the line or the key."""


class GraphError(WordCraftKGError, ValueError):
    """A recipe graph cannot be built from what was given."""


class UnknownEntityError(WordCraftKGError, LookupError):
    """A label is not in the vocabulary; the message suggests the nearest ones."""


class SplitError(WordCraftKGError, ValueError):
    """A split cannot be drawn with these settings."""


class TaskError(WordCraftKGError, ValueError):
    """There is no such task, or no plan does what it should."""


class ConfigError(WordCraftKGError, ValueError):
    """An option has a value outside its allowed range."""


class UnknownSettingError(ConfigError, TypeError):
    """A keyword argument that there is not; a TypeError, as Python's own, because other libraries probe for that."""


class ActionError(WordCraftKGError, ValueError):
    """An action is outside the action space, or not legal where only legal actions are allowed."""


class EpisodeError(WordCraftKGError, RuntimeError):
    """An environment was asked for a step that it cannot take: before a reset or after the end of an episode."""


class ArtefactError(WordCraftKGError, ValueError):
    """A folder or file written by this package is missing a part, damaged, or of another kind."""


class GraphMismatchError(ArtefactError):
    """Two artefacts belong to different recipe graphs or different splits."""


class TrainingError(WordCraftKGError, ArithmeticError):
    """A training cannot go on, because its numbers are no longer finite."""


class OutputExistsError(WordCraftKGError, FileExistsError):
    """The output is there already and overwriting was not asked for."""


class FetchError(WordCraftKGError, OSError):
    """A published book could not be downloaded, or is not the file that was pinned."""


class MissingExtraError(WordCraftKGError, ImportError):
    """An optional dependency is needed; the message names the extra that installs it."""
