"""Graphs from outside the recipe book, such as WordNet, in memory: nodes, spellings, edges.

The page docs/outside-knowledge.md says which graphs there are.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

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


_WORD = re.compile(r"[a-z0-9]+")


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
            shortest = len(ending) + 2
            if last.endswith(ending) and len(last) >= shortest:
                stem = last.removesuffix(ending)
                yield before + stem + replacement

    def base_form(self, word: str) -> str:
        """Return a word's base form, or the word if the network has no spelling for any."""
        if word in self.exceptions:
            return self.exceptions[word][0]
        for form in (word, *self.singulars(word)):
            if form in self.spellings:
                return form
        return word

    def definitions(self) -> list[list[str]]:
        """The words of each gloss, in base forms."""
        # The same words occur in most definitions.
        base_form = cache(self.base_form)
        words_of = [_WORD.findall(plain(gloss)) for gloss in self.glosses]
        return [list(map(base_form, words)) for words in words_of]

    def with_edges(self, relation: str, edges: Ids, weights: NDArray[np.float64]) -> "Network":
        """Return a network with a further relation.

        Args:
            relation: name of the relation.
            edges: its edges, shape (M', 2): head and tail.
            weights: their weights, shape (M',).

        Returns:
            A new network.
        """
        heads, tails = edges.T
        # The new relation gets the next id.
        between = np.full(len(edges), len(self.relations))
        rows = np.column_stack([heads, between, tails])
        return replace(
            self,
            relations=(*self.relations, relation),
            edges=np.concatenate([self.edges, rows]),
            weights=np.concatenate([self.weights, weights]),
        )

    def ids_of(self, names: Sequence[str]) -> list[int]:
        """Return the ids of relations by name; names that the network lacks are ignored."""
        return [self.relations.index(name) for name in names if name in self.relations]

    def links(self, names: Sequence[str] = ()) -> sparse.csr_array:
        """Return weights of edges as a matrix from heads to tails, shape (N, N).

        Weights of several edges between two nodes add up.

        Args:
            names: relations that count; all of them if it is empty. Names that the network lacks
                are ignored; without a known one, the matrix holds zeros alone.
        """
        heads, relations, tails = self.edges.T
        weights = self.weights
        if names:
            is_wanted = np.isin(relations, self.ids_of(names))
            heads = heads[is_wanted]
            tails = tails[is_wanted]
            weights = weights[is_wanted]
        size = len(self.nodes)
        return sparse.csr_array((weights, (heads, tails)), shape=(size, size))


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
    head, relation, tail = edges[is_kept].T
    # One integer for each edge sorts faster than rows of three.
    keys = (head * num_relations + relation) * num_nodes + tail
    unique_keys, place = np.unique(keys, return_inverse=True)
    # Back from the integers: the tail is the last digit, the relation the one before.
    heads_and_relations, tails = np.divmod(unique_keys, num_nodes)
    heads, relations = np.divmod(heads_and_relations, num_relations)
    sums = np.bincount(place, weights[is_kept], minlength=len(unique_keys))
    distinct_edges = np.column_stack([heads, relations, tails])
    # Without edges, bincount has counted in integers.
    return distinct_edges, sums.astype(np.float64)
