"""Align a recipe graph's labels with the nodes of a graph from outside the book.

A label's first method with a node counts: exact spelling, then base form (lemma). A head word does
not: a family tree is no tree, and has no wood. Among several nodes (senses), the first of the
network's order counts, which in WordNet is the most frequent one: a choice by definitions and
recipes scored no better.

The page docs/outside-knowledge.md shows it under *WordNet, ConceptNet, any triples*.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base import KnowledgeFileError, nearest
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.network import Network, plain

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
    joined = _joined(network, entities)
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


def with_overrides(
    alignment: Alignment,
    network: Network,
    entities: Sequence[str],
    overrides: Mapping[str, str],
) -> Alignment:
    """Replace the nodes of some labels by nodes that the user names.

    Args:
        alignment: the automatic alignment.
        network: the graph from outside the book.
        entities: labels in id order.
        overrides: names of nodes by label, with or without the network's prefix; empty to leave
            the label out.

    Returns:
        A new alignment, in which a named node has confidence 1.

    Raises:
        KnowledgeFileError: for an unknown label or node.
    """
    nodes = alignment.nodes.copy()
    confidences = alignment.confidences.copy()
    methods = list(alignment.methods)
    numbers = {}
    # A general graph has millions of nodes: no table of them without need.
    if overrides:
        numbers = {name: node for node, name in enumerate(network.nodes)}
    for label, name in overrides.items():
        if label not in entities:
            raise KnowledgeFileError(
                f"`overrides` names '{label}', which is not a label of the "
                f"graph.{nearest(label, entities)} Expected a label as in the first column of "
                "alignment.tsv."
            )
        bare_name = name.removeprefix(f"{network.prefix}:")
        node = numbers.get(bare_name, -1)
        if name and node < 0:
            raise KnowledgeFileError(
                f"{network.source} has no node '{name}' (for '{label}'). Expected a node as in "
                "the second column of alignment.tsv, or nothing to leave the label out."
            )
        entity = entities.index(label)
        nodes[entity] = node
        confidences[entity] = 1.0 if name else 0.0
        methods[entity] = "override" if name else "left out"
    return Alignment(nodes, tuple(methods), confidences)


def _joined(network: Network, entities: Sequence[str]) -> dict[str, str]:
    """Return spellings in several words by the label that joins them: "fire truck" by firetruck."""
    joined_labels = {plain(label).replace(" ", "") for label in entities}
    joined = {}
    for text in network.spellings:
        short = text.replace(" ", "")
        if " " in text and short in joined_labels:
            joined[short] = text
    return joined


def _spelling(label: str, network: Network, joined: dict[str, str]) -> tuple[str, str]:
    """Return the method and the network's spelling for a label, or ``none`` and ""."""
    text = plain(label).rstrip("!?. ")
    short = text.replace(" ", "")
    base_forms = list(network.singulars(text))
    # The first form that the network has decides, so the surest methods come first.
    forms: dict[str, Iterable[str]] = {
        "exact": [text],
        "lemma": [*base_forms, joined.get(short, ""), short],
    }
    for method, texts in forms.items():
        for form in texts:
            if form in network.spellings:
                return method, form
    return "none", ""
