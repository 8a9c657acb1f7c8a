"""Specification of entity features: a name, or the path of a file with vectors."""

from dataclasses import dataclass

VECTORS = ("glove", "one-hot", "random")
LEARNED = "learned"  # by the policy
NAMES = (*VECTORS, LEARNED)
"""Reserved names; write ``./glove`` for a file of such a name."""
SHUFFLED = "shuffled:"


@dataclass(frozen=True)
class FeatureSpec:
    """The parts of a spec such as ``glove``, ``vectors.txt`` or ``shuffled:vectors.txt``.

    Attributes:
        source: a name in :data:`NAMES`, or a path.
        prefix: ``shuffled:``, repeated as written, or empty.
    """

    source: str
    prefix: str = ""

    @classmethod
    def parse(cls, text: str) -> "FeatureSpec":
        """Split a spec; files are not checked."""
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
