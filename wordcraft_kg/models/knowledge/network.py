"""Graphs from outside the recipe book, such as WordNet, in memory: nodes with spellings, and triples."""

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

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
"""Endings of plural nouns with their replacements; source: WordNet 3.0 manual, morphy(7)."""
_WORD = re.compile(r"[a-z0-9]+")


@dataclass(frozen=True, eq=False)
class Network:
    """A graph from outside the book.

    Attributes:
        source: display name, such as WordNet.
        prefix: beginning of names of nodes and relations in ``triples.tsv``, such as ``wn``.
        nodes: names, unique.
        relations: names of the relations, by relation id.
        edges: shape (M, 3), int64: head, relation and tail; unique.
        weights: shape (M,), positive weights of the edges.
        spellings: nodes by :func:`plain` name, likeliest first.
        exceptions: irregular plurals with their singulars.
        lemmas: names of each node, as a person would write them; empty if the node's name is all there is.
        glosses: definition of each node; empty without definitions.
        fields: broad field of each node by number, such as food or feeling; empty if unknown.
        counts: occurrences of each pair of spelling and node in sense-tagged text; empty if unknown.
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
    fields: Sequence[int] = ()
    counts: Mapping[tuple[str, int], int] = field(default_factory=dict)

    def singulars(self, text: str) -> Iterator[str]:
        """Yield possible base forms of a :func:`plain` text by the last word: exceptions, then detached endings."""
        before, blank, last = text.rpartition(" ")
        yield from (before + blank + single for single in self.exceptions.get(last, ()))
        for ending, new in _ENDINGS.items():
            if last.endswith(ending) and len(last) > len(ending) + 1:
                yield text.removesuffix(ending) + new

    def base_form(self, word: str) -> str:
        """Return a word's base form, or the word if the network has no spelling for any."""
        if word in self.exceptions:
            return self.exceptions[word][0]
        return next(
            (form for form in (word, *self.singulars(word)) if form in self.spellings), word
        )

    @cached_property
    def definitions(self) -> list[list[str]]:
        """The words of each gloss, in base forms."""
        base_form = cache(self.base_form)
        return [[base_form(word) for word in _WORD.findall(plain(gloss))] for gloss in self.glosses]

    @cached_property
    def word_counts(self) -> sparse.csr_array:
        """Numbers of the V different words in each node's definition and names, shape (N, V)."""
        places: dict[str, int] = {}
        rows, columns, counts = array("i"), array("i"), array("i")
        base_form = cache(self.base_form)
        for node, definition in enumerate(self.definitions):
            names = (base_form(word) for name in self.lemmas[node] for word in plain(name).split())
            for word, count in Counter([*definition, *names]).items():
                rows.append(node)
                columns.append(places.setdefault(word, len(places)))
                counts.append(count)
        return sparse.csr_array(
            (counts, (rows, columns)), shape=(len(self.nodes), len(places)), dtype=float
        )

    def with_edges(self, relation: str, edges: Ids, weights: NDArray[np.float64]) -> "Network":
        """Add a relation with edges, shape (M, 2): head and tail."""
        between = np.full(len(edges), len(self.relations))
        more = replace(
            self,
            relations=(*self.relations, relation),
            edges=np.concatenate(
                [self.edges, np.column_stack([edges[:, 0], between, edges[:, 1]])]
            ),
            weights=np.concatenate([self.weights, weights]),
        )
        vars(more).update(vars(self) | vars(more))  # keeps counted words: definitions are the same
        return more

    def ids_of(self, names: Sequence[str]) -> list[int]:
        """Return the ids of the relations with these names that the network has."""
        return [self.relations.index(name) for name in names if name in self.relations]

    def links(self, names: Sequence[str] = ()) -> sparse.csr_array:
        """Return edges as a matrix from heads to tails, shape (N, N), with weights; all relations without ``names``."""
        wanted = np.isin(self.edges[:, 1], self.ids_of(names))
        rows = self.edges[wanted] if names else self.edges
        weights = self.weights[wanted] if names else self.weights
        return sparse.csr_array((weights, (rows[:, 0], rows[:, 2])), shape=(len(self.nodes),) * 2)


def plain(text: str) -> str:
    """Return a spelling without differences in case, Unicode form, blanks, hyphens and apostrophes."""
    return folded(text).replace("'", "")


def unique_edges(
    edges: Ids, weights: NDArray[np.float64], sizes: tuple[int, int]
) -> tuple[Ids, NDArray[np.float64]]:
    """Sort edges (M, 3), without loops; weights (M,) of repeated edges add up. Sizes: nodes, relations."""
    nodes, relations = sizes
    head, relation, tail = edges[edges[:, 0] != edges[:, 2]].T
    keys, place = np.unique((head * relations + relation) * nodes + tail, return_inverse=True)
    rest, tails = np.divmod(keys, nodes)
    merged = np.bincount(place, weights[edges[:, 0] != edges[:, 2]], minlength=len(keys)).astype(
        np.float64
    )
    return np.column_stack([rest // relations, rest % relations, tails]), merged
