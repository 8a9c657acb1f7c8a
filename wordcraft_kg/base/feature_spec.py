"""Specifications of entity features (a vector per entity): a reserved name, or a path."""

from dataclasses import dataclass

VECTORS = ("auto", "minilm", "glove", "one-hot", "random")
LEARNED = "learned"
"""Name of the vectors that a policy learns itself, instead of given vectors."""
NAMES = (*VECTORS, LEARNED)
"""Reserved feature names; for a file with a reserved name, write a path such as ``./glove``."""
SHUFFLED = "shuffled:"


@dataclass(frozen=True)
class FeatureSpec:
    """A parsed specification: ``glove``, ``vectors.txt`` or ``shuffled:vectors.txt``.

    Attributes:
        source: a name in :data:`NAMES`, or the path to a file or folder with vectors.
        prefix: ``shuffled:`` (assign the vectors to random entities), as often as written; empty
            without shuffling.
    """

    source: str
    prefix: str = ""

    @classmethod
    def parse(cls, text: str) -> "FeatureSpec":
        """Split a specification into prefix and source; whether a file exists is not checked."""
        source = text
        # Twice shuffled is shuffled twice; a specification is kept as written.
        while source.startswith(SHUFFLED):
            source = source.removeprefix(SHUFFLED)
        return cls(source, text.removesuffix(source))

    @property
    def is_path(self) -> bool:
        """Whether the source is a path, not a name in :data:`NAMES`."""
        return self.source not in NAMES

    def __str__(self) -> str:
        return self.prefix + self.source
