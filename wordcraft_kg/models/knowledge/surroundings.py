"""An aligned graph around the entities: triples for training, and facts for explanations.

The page docs/outside-knowledge.md says what they are for.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.alignment import Alignment
from wordcraft_kg.models.knowledge.network import Network
from wordcraft_kg.models.knowledge.paths import DESCRIBED_BY, IS_A

MOST_TRIPLES = 200_000
"""Most edges in ``triples.tsv``: first those between entities, then those with large weights."""
MOST_FACTS = 5
"""Most facts about an entity."""
# They explain nothing to a reader, or say what a thing is not.
_NO_FACTS = ("relatedForm", "antonym", "attribute", "topic", "region", "similar", "pertainsTo")
_WORD_BREAK = re.compile(r"(?<=[a-z])(?=[A-Z])|[_-]+")
"""Places between the words of a relation's name: partOf, part_of, part-of."""
Triple = tuple[str, str, str]
"""Names of head, relation and tail."""


class Surroundings:
    """Edges with an entity's node at an end; from definitions only those of entities."""

    def __init__(self, network: Network, alignment: Alignment, entities: Sequence[str]):
        """Find the edges around entities.

        Args:
            network: the graph from outside the book.
            alignment: the node of each entity.
            entities: labels in id order.

        Raises:
            KnowledgeFileError: if a label looks like the name of a node, so both would be one node
                in training.
        """
        self._network = network
        # Several labels can have the same node.
        self._labels = defaultdict[int, list[str]](list)
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
        heads, relations, tails = network.edges.T
        starts_at_entity = self._is_entity[heads]
        is_near = starts_at_entity | self._is_entity[tails]
        # Of definitions only those of entities: each mentions entities, and there are many.
        is_definition = np.isin(relations, network.ids_of([DESCRIBED_BY]))
        is_foreign = is_definition & ~starts_at_entity
        (self._rows,) = np.nonzero(is_near & ~is_foreign)

    def triples(self) -> Iterator[Triple]:
        """Yield triples of names: labels of entities, and names of other nodes with a prefix.

        An entity's node with several labels has a triple for each. Other nodes with a single edge
        are left out, again and again until none remains, as they link no two entities; entities
        stay. In a network with definitions, an entity has an edge to each of its classes, also to
        the indirect ones; in another one, the :data:`MOST_TRIPLES` edges with the largest weights
        are taken, those between entities first.
        """
        network = self._network
        edges = network.edges[self._rows]
        if network.glosses:
            # Shape (C, 3), also without any class.
            classes = np.array(list(self._classes()), dtype=edges.dtype).reshape(-1, 3)
            with_classes = np.concatenate([edges, classes])
            edges = np.unique(with_classes, axis=0)
        else:
            is_inner = self._is_entity[_ends(edges)].all(1)
            weights = network.weights[self._rows]
            # The last key sorts first.
            order = np.lexsort((-weights, ~is_inner))
            # Chosen by weight, but in the order of the edges, so that files compare well.
            rows = np.sort(order[:MOST_TRIPLES])
            edges = edges[rows]
        for head, relation, tail in self._without_ends(edges).tolist():
            name = f"{network.prefix}:{network.relations[relation]}"
            for head_name in self._names(head):
                for tail_name in self._names(tail):
                    yield head_name, name, tail_name

    def facts(self) -> Iterator[Triple]:
        """Yield at most :data:`MOST_FACTS` facts about each entity.

        Classes come first, then facts with another entity, then facts with large weights.
        """
        network = self._network
        edges = network.edges[self._rows]
        weights = network.weights[self._rows]
        # Relations that explain nothing are left out before all others are put in order.
        is_fact = ~np.isin(edges[:, 1], network.ids_of(_NO_FACTS))
        edges = edges[is_fact]
        weights = weights[is_fact]
        is_class = np.isin(edges[:, 1], network.ids_of(IS_A))
        is_about_entity = self._is_entity[edges[:, 2]]
        # The last key sorts first.
        order = np.lexsort((-weights, ~is_about_entity, ~is_class))
        facts = defaultdict[int, list[tuple[str, str]]](list)
        for head, relation, tail in edges[order].tolist():
            if network.lemmas:
                name = network.lemmas[tail][0]
            else:
                name = network.nodes[tail]
            relation_name = network.relations[relation]
            phrase = _phrase(relation_name)
            for label in self._labels.get(tail, [name]):
                facts[head].append((phrase, label))
        for node, labels in self._labels.items():
            first_facts = facts[node][:MOST_FACTS]
            for label in labels:
                for phrase, object_label in first_facts:
                    yield label, phrase, object_label

    def _classes(self) -> Iterator[tuple[int, int, int]]:
        """Yield an edge from each entity's node to each direct or indirect class."""
        import networkx as nx

        (relation,) = self._network.ids_of(IS_A)
        edges = self._network.edges
        classes = nx.DiGraph()
        classes.add_nodes_from(self._labels)
        classes.add_edges_from(edges[edges[:, 1] == relation][:, ::2].tolist())
        for node in self._labels:
            for ancestor in nx.descendants(classes, node):
                yield node, relation, ancestor

    def _names(self, node: int) -> Iterable[str]:
        if node in self._labels:
            return self._labels[node]
        network = self._network
        return (f"{network.prefix}:{network.nodes[node]}",)

    def _without_ends(self, edges: Ids) -> Ids:
        """Leave out nodes with a single edge, until none is left; entities stay."""
        while True:
            ends = _ends(edges)
            degrees = np.bincount(ends.ravel(), minlength=len(self._is_entity))
            stays = self._is_entity | (degrees > 1)
            is_kept = stays[ends].all(1)
            if is_kept.all():
                return edges
            edges = edges[is_kept]


def _ends(edges: Ids) -> Ids:
    """Return head and tail of each edge, shape (n, 2)."""
    return edges[:, ::2]


def _phrase(relation: str) -> str:
    """Return a relation's name in words with a verb, such as ``is part of`` for partOf."""
    separate = _WORD_BREAK.sub(" ", relation)
    words = separate.lower().strip()
    # "makes dough" has a verb, "part of dough" none.
    has_verb = re.match(r"\w*[^s]s\b", words)
    return words if has_verb else f"is {words}"
