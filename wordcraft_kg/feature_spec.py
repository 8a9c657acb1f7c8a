"""How entity features are asked for: by a name, or by the path of a file of vectors."""

from dataclasses import dataclass

VECTORS = ("glove", "one-hot", "random")
LEARNED = "learned"
"""Not vectors that are given, but some that the policy learns."""
NAMES = (*VECTORS, LEARNED)
"""Names take precedence over files: ``./glove`` is a file called glove."""
SHUFFLED = "shuffled:"


@dataclass(frozen=True)
class FeatureSpec:
    """A spec such as ``glove``, ``vectors.txt`` or ``shuffled:vectors.txt``, in its parts.

    Attributes:
        source: a name of :data:`NAMES`, or a path.
        prefix: ``shuffled:``, as often as it was written, or nothing.
    """

    source: str
    prefix: str = ""

    @classmethod
    def parse(cls, text: str) -> "FeatureSpec":
        """Split a spec; that there is such a file is not checked."""
        source = text
        while source.startswith(SHUFFLED):
            source = source.removeprefix(SHUFFLED)
        return cls(source, text.removesuffix(source))

    @property
    def is_path(self) -> bool:
        """Whether a file is asked for."""
        return self.source not in NAMES

    def __str__(self) -> str:
        return self.prefix + self.source
