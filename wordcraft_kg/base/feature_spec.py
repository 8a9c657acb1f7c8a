"""How entity features are specified: by name, or by the path of a file of vectors."""

from dataclasses import dataclass

VECTORS = ("glove", "one-hot", "random")
LEARNED = "learned"
"""Vectors that the policy learns."""
NAMES = (*VECTORS, LEARNED)
"""Names take precedence over files: ``./glove`` is a file named glove."""
SHUFFLED = "shuffled:"


@dataclass(frozen=True)
class FeatureSpec:
    """The parts of a spec such as ``glove``, ``vectors.txt`` or ``shuffled:vectors.txt``.

    Attributes:
        source: a name of :data:`NAMES`, or a path.
        prefix: ``shuffled:``, as many times as it was written; may be empty.
    """

    source: str
    prefix: str = ""

    @classmethod
    def parse(cls, text: str) -> "FeatureSpec":
        """Split a spec into its parts; whether a file exists is not checked."""
        source = text
        while source.startswith(SHUFFLED):
            source = source.removeprefix(SHUFFLED)
        return cls(source, text.removesuffix(source))

    @property
    def is_path(self) -> bool:
        """Whether the source is a file."""
        return self.source not in NAMES

    def __str__(self) -> str:
        return self.prefix + self.source
