"""Groups of entities that are crafted together."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wordcraft_kg.graphs.arrays import Ids


@dataclass(frozen=True)
class Communities:
    """Groups of entities that are crafted together.

    Attributes:
        group_of: each entity's group number, shape (E,); group 0 is the largest group.
        names: most used entity in each group.
    """

    group_of: Ids
    names: tuple[str, ...]

    @cached_property
    def sizes(self) -> list[int]:
        """Number of entities in each group."""
        return np.bincount(self.group_of, minlength=len(self.names)).tolist()


def communities_of(labels: Sequence[str], links: Ids, uses: Ids, seed: int) -> Communities:
    """Find communities in an undirected graph by the Louvain method.

    Args:
        labels: labels for entities.
        links: shape (L, 2), pairs of linked entities as positions in ``labels``; repetitions count once.
        uses: shape (E,), number of recipes that use each entity.
        seed: seed for the entity order.

    Source: Blondel et al. 2008, "Fast unfolding of communities in large networks".
    """
    import networkx as nx

    plain = nx.Graph()
    plain.add_nodes_from(range(len(labels)))
    plain.add_edges_from(links.tolist())
    groups = sorted(nx.community.louvain_communities(plain, seed=seed), key=lambda group: (-len(group), min(group)))
    group_of = np.zeros(len(labels), dtype=np.int64)
    for number, group in enumerate(groups):
        group_of[list(group)] = number
    most_used = [max(sorted(group), key=uses.__getitem__) for group in groups]
    return Communities(group_of, tuple(labels[i] for i in most_used))
