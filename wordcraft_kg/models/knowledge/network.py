"""Graphs from outside the recipe book, such as WordNet, in memory, and the nodes of labels.

A label's first method with a node counts: exact spelling, then base form (lemma). A head word does
not: a family tree is no tree, and has no wood. Among several nodes (senses), the first of the
network's order counts, which in WordNet is the most frequent one: a choice by definitions and
recipes scored no better.

The page docs/outside-knowledge.md says which graphs there are, and shows the alignment under
*WordNet, ConceptNet, any triples*.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base.labels import folded
from wordcraft_kg.graphs.arrays import Ids

_ENDINGS = {
    "s": "",
    "ses": "s",
    "xes": "x",
    "zes": "z",
    "ches": "ch",
    "shes": "sh",
    "men": "man",
    "ies": "y",
}
"""Endings of plural nouns with their replacements, tried in this order.

Source: WordNet 3.0 manual, morphy(7).
"""


@dataclass(frozen=True, eq=False)
class Network:
    """A graph from outside the book, with N nodes and M edges.

    Attributes:
        source: display name, such as WordNet.
        prefix: beginning of names of nodes and relations in ``triples.tsv``, such as ``wn``.
        nodes: names, unique.
        relations: names of the relations, by relation id.
        edges: shape (M, 3), int64: head, relation and tail; unique.
        weights: shape (M,), positive weights of the edges.
        spellings: nodes by :func:`plain` name, likeliest first.
        exceptions: irregular plurals with their singulars.
        lemmas: names of each node, as a person would write them; empty if the node's name is all
            there is.
        glosses: definition of each node; empty without definitions.
    """

    source: str
    prefix: str
    nodes: Sequence[str]
    relations: Sequence[str]
    edges: Ids
    weights: NDArray[np.float64]
    spellings: Mapping[str, Sequence[int]]
    exceptions: Mapping[str, Sequence[str]] = field(default_factory=dict)
    lemmas: Sequence[Sequence[str]] = ()
    glosses: Sequence[str] = ()

    def singulars(self, text: str) -> Iterator[str]:
        """Yield possible base forms of a :func:`plain` text, by its last word: exceptions first."""
        words_before, blank, last = text.rpartition(" ")
        before = words_before + blank
        for singular in self.exceptions.get(last, ()):
            yield before + singular
        for ending, replacement in _ENDINGS.items():
            # A stem of one letter is no word: as is no plural of a.
            if last.endswith(ending) and len(last) >= len(ending) + 2:
                yield before + last.removesuffix(ending) + replacement

    def base_form(self, word: str) -> str:
        """Return a word's base form, or the word if the network has no spelling for any."""
        if word in self.exceptions:
            return self.exceptions[word][0]
        for form in (word, *self.singulars(word)):
            if form in self.spellings:
                return form
        return word

    def name_of(self, node: int) -> str:
        """Return a node's name with the network's prefix."""
        return f"{self.prefix}:{self.nodes[node]}"

    def ids_of(self, names: Sequence[str]) -> list[int]:
        """Return the ids of relations by name; names that the network lacks are ignored."""
        return [self.relations.index(name) for name in names if name in self.relations]

    def links(self, names: Sequence[str]) -> sparse.csr_array:
        """Return weights of edges as a matrix from heads to tails, shape (N, N).

        Weights of several edges between two nodes add up.

        Args:
            names: relations that count; names that the network lacks are ignored.
        """
        is_wanted = np.isin(self.edges[:, 1], self.ids_of(names))
        heads, _, tails = self.edges[is_wanted].T
        size = len(self.nodes)
        return sparse.csr_array((self.weights[is_wanted], (heads, tails)), shape=(size, size))


def plain(text: str) -> str:
    """Fold differences in case, Unicode form, blanks, hyphens and apostrophes."""
    return folded(text).replace("'", "")


def unique_edges(
    edges: Ids,
    weights: NDArray[np.float64],
    sizes: tuple[int, int],
) -> tuple[Ids, NDArray[np.float64]]:
    """Sort edges, merge repeated edges, and leave out loops.

    Args:
        edges: shape (M, 3): head, relation and tail.
        weights: shape (M,); weights of repeated edges add up.
        sizes: numbers of nodes and of relations.

    Returns:
        Distinct edges, sorted by head, relation and tail, and their weights.
    """
    num_nodes, num_relations = sizes
    is_kept = edges[:, 0] != edges[:, 2]
    shape = (num_nodes, num_relations, num_nodes)
    # One integer for each edge sorts faster than rows of three.
    keys = np.ravel_multi_index(tuple(edges[is_kept].T), shape)
    unique_keys, place = np.unique(keys, return_inverse=True)
    sums = np.bincount(place, weights[is_kept], minlength=len(unique_keys))
    distinct_edges = np.column_stack(np.unravel_index(unique_keys, shape))
    # Without edges, bincount has counted in integers.
    return distinct_edges, sums.astype(np.float64)


# --- alignment ------------------------------------------------------------------------------------

METHODS = {"exact": 1.0, "lemma": 0.95}
"""Confidence that a method finds the right word, before a sense is chosen."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """The node of each entity.

    Attributes:
        nodes: shape (E,), int64: node ids, -1 without a node.
        methods: how each node was found: a key of :data:`METHODS`, ``override`` or ``left out``
            (both by the user), or ``none``.
        confidences: shape (E,), from 0 to 1: the method's confidence times the chance of the
            sense.
    """

    nodes: Ids
    methods: tuple[str, ...]
    confidences: NDArray[np.float64]

    def matrix(self, num_nodes: int) -> sparse.csr_array:
        """Return the confidence of each entity's node, shape (E, num_nodes)."""
        (entities,) = np.nonzero(self.nodes >= 0)
        cells = (entities, self.nodes[entities])
        shape = (len(self.nodes), num_nodes)
        return sparse.csr_array((self.confidences[entities], cells), shape=shape)


def align(network: Network, entities: Sequence[str]) -> Alignment:
    """Align entity labels with nodes of a network; no recipe is read.

    Args:
        network: the graph from outside the book.
        entities: labels in id order.

    Returns:
        The first sense of each entity, with less confidence where there are further ones.
    """
    # Spellings in several words by the label that joins them: "fire truck" by firetruck.
    joined = {text.replace(" ", ""): text for text in network.spellings if " " in text}
    spelled = [_spelling(label, network, joined) for label in entities]
    nodes = np.full(len(entities), -1)
    confidences = np.zeros(len(entities))
    for entity, (method, spelling) in enumerate(spelled):
        senses = network.spellings.get(spelling, ())
        if senses:
            nodes[entity] = senses[0]
            # The n-th sense is 1 / n times as likely.
            chance = 1 / sum(1 / place for place in range(1, len(senses) + 1))
            confidences[entity] = METHODS[method] * chance
    methods = tuple(method for method, _ in spelled)
    return Alignment(nodes, methods, confidences)


def _spelling(label: str, network: Network, joined: dict[str, str]) -> tuple[str, str]:
    """Return the method and the network's spelling for a label, or ``none`` and ""."""
    text = plain(label).rstrip("!?. ")
    short = text.replace(" ", "")
    # The first form that the network has decides, so the surest ones come first.
    for form in (text, *network.singulars(text), joined.get(short, ""), short):
        if form in network.spellings:
            return ("exact" if form == text else "lemma"), form
    return "none", ""
