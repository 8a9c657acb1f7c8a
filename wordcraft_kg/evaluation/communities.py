"""Groups of entities that are crafted together."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wordcraft_kg.graphs.arrays import Ids

NAMED = 3


@dataclass(frozen=True)
class Communities:
    """Each entity's group, shape (E,), group 0 the largest, and the most typical entities in each group."""

    group_of: Ids
    names: tuple[tuple[str, ...], ...]

    @cached_property
    def sizes(self) -> list[int]:
        """Number of entities in each group."""
        return np.bincount(self.group_of, minlength=len(self.names)).tolist()


def communities_of(labels: Sequence[str], links: Ids, seed: int) -> Communities:
    """Find communities in an undirected graph by the Louvain method; ``links`` are pairs of positions, shape (L, 2).

    Typical entities have many links within their group and few to other groups: the product of the number of links
    within the group and their share of all links is high.

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
    ends = np.array([(a, b) for a, b in plain.edges if a != b], dtype=np.int64).reshape(-1, 2)
    is_within = group_of[ends[:, 0]] == group_of[ends[:, 1]]
    within, degree = (np.bincount(some.ravel(), minlength=len(labels)) for some in (ends[is_within], ends))
    typical = np.argsort(-(within**2) / np.maximum(degree, 1), kind="stable")
    return Communities(
        group_of, tuple(tuple(labels[i] for i in typical.tolist() if i in group)[:NAMED] for group in groups)
    )
