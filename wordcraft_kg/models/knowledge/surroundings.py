"""An aligned graph around the entities: triples for joint training, facts for explanations, and a datasheet."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.alignment import Alignment
from wordcraft_kg.models.knowledge.network import Network
from wordcraft_kg.models.knowledge.paths import DESCRIBED_BY, IS_A

MOST_TRIPLES = 200_000
"""Most edges in ``triples.tsv``; edges between entities, then edges with large weights come first."""
MOST_FACTS = 5
"""Most facts about an entity."""
_NO_FACTS = ("relatedForm", "antonym", "attribute", "topic", "region", "similar", "pertainsTo")
Triple = tuple[str, str, str]


class Reach(Record):
    """Shares of recipes, and of random triples of entities, with both ingredients within 1, 2, 3 hops of the result."""

    recipes: tuple[Share, Share, Share]
    random: tuple[Share, Share, Share]


class Surroundings:
    """Edges with an entity's node at an end; from definitions only those of entities."""

    def __init__(self, network: Network, alignment: Alignment, entities: Sequence[str]):
        """Find the edges around ``entities`` by their nodes in ``alignment``."""
        self._network, self._labels = network, defaultdict[int, list[str]](list)
        for entity, node in enumerate(alignment.nodes.tolist()):
            if node >= 0:
                self._labels[node].append(entities[entity])
        self._is_entity = np.zeros(len(network.nodes), dtype=bool)
        self._is_entity[[*self._labels]] = True
        for label in entities:
            if label.startswith(f"{network.prefix}:"):
                raise KnowledgeFileError(
                    f"the label '{label}' looks like the name of a node. Rename this entity."
                )
        heads, _, tails = network.edges.T
        has_definition = self._is_entity[heads] | ~np.isin(
            network.edges[:, 1], network.ids_of([DESCRIBED_BY])
        )
        (self._rows,) = np.nonzero(
            (self._is_entity[heads] | self._is_entity[tails]) & has_definition
        )

    def triples(self) -> Iterator[Triple]:
        """Yield triples of names: an entity's label for its node, one triple for each label; else a node with prefix.

        Nodes with a single edge are left out, as they link no two entities. In a network with definitions, an entity
        has an edge to each of its classes, also to the indirect ones.
        """
        network = self._network
        edges = network.edges[self._rows]
        if network.glosses:
            edges = np.unique(np.concatenate([edges, [*self._classes()]]), axis=0)
        else:
            is_inner = self._is_entity[edges[:, ::2]].all(1)
            order = np.lexsort((-network.weights[self._rows], ~is_inner))
            edges = edges[np.sort(order[:MOST_TRIPLES])]
        for head, relation, tail in self._without_ends(edges).tolist():
            for one in self._names(head):
                for other in self._names(tail):
                    yield one, f"{network.prefix}:{network.relations[relation]}", other

    def facts(self) -> Iterator[Triple]:
        """Yield at most :data:`MOST_FACTS` facts about each entity: classes first, then facts with another entity."""
        network = self._network
        edges, weights = network.edges[self._rows], network.weights[self._rows]
        is_class, is_left_out = (
            np.isin(edges[:, 1], network.ids_of(names)) for names in (IS_A, _NO_FACTS)
        )
        order = np.lexsort((-weights, ~self._is_entity[edges[:, 2]], ~is_class))
        facts = defaultdict[int, list[tuple[str, str]]](list)
        for head, relation, tail in edges[order[~is_left_out[order]]].tolist():
            names = self._labels.get(tail) or [
                network.lemmas[tail][0] if network.lemmas else network.nodes[tail]
            ]
            facts[head] += [(_phrase(network.relations[relation]), name) for name in names]
        for node, labels in self._labels.items():
            for label in labels:
                yield from ((label, *fact) for fact in facts[node][:MOST_FACTS])

    def _classes(self) -> Iterator[tuple[int, int, int]]:
        """Yield an edge from each entity's node to each direct or indirect class."""
        (relation,) = self._network.ids_of(IS_A)
        above = defaultdict[int, list[int]](list)
        for head, _, tail in self._network.edges[self._network.edges[:, 1] == relation].tolist():
            above[head].append(tail)
        for node in self._labels:
            classes = list(above[node])
            for one in classes:
                classes += [tail for tail in above[one] if tail not in classes]
            yield from ((node, relation, tail) for tail in classes)

    def _names(self, node: int) -> Iterable[str]:
        return self._labels.get(node) or (f"{self._network.prefix}:{self._network.nodes[node]}",)

    def _without_ends(self, edges: Ids) -> Ids:
        while True:
            degrees = np.bincount(edges[:, ::2].ravel(), minlength=len(self._is_entity))
            is_kept = (self._is_entity | (degrees > 1))[edges[:, ::2]].all(1)
            if is_kept.all():
                return edges
            edges = edges[is_kept]


def _phrase(relation: str) -> str:
    words = re.sub("(?<=[a-z])(?=[A-Z])|[_-]+", " ", relation).lower().strip()
    return (
        words if re.match(r"\w*[^s]s\b", words) else f"is {words}"
    )  # "makes dough" has a verb, "part of dough" none


def reach_of(walks: Sequence[NDArray[np.floating]], recipes: Ids, seed: int = 0) -> Reach:
    """Return the shares of recipes, shape (n, 3), and of as many random triples, at least 10,000, by number of hops."""
    random = np.random.default_rng(seed).integers(
        len(walks[0]), size=(max(len(recipes), 10_000), 3)
    )
    reached = np.cumsum([walk > 0 for walk in walks], axis=0) > 0

    def shares(rows: Ids) -> tuple[float, float, float]:
        a, b, result = rows.T
        one, two, three = (
            float((near[a, result] & near[b, result]).mean()) if len(rows) else 0.0
            for near in reached
        )
        return one, two, three

    return Reach(shares(recipes), shares(random))
