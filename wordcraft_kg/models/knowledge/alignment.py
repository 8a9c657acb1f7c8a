"""Align a recipe graph's labels with the nodes of a graph from outside the book.

A label's first method with a node counts: exact spelling, base form (lemma), head word. A head
word is a proposal that the user has to accept: a family tree is no tree, and has no wood. Among
several nodes (senses), the first of the network's order counts, which in WordNet is the most
frequent one: a choice by definitions and recipes scored no better, by any interval.

The page docs/outside-knowledge.md shows it under *WordNet, ConceptNet, any triples*.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.network import Network, plain

HEAD_WORD = "head word"
"""The method that the user has to ask for."""
METHODS = {"exact": 1.0, "lemma": 0.95, HEAD_WORD: 0.5}
"""Confidence that a method finds the right word, before a sense is chosen."""
_HEAD = re.compile(r"(.+?) (?:of|in|with|from) .+")
"""The head of a phrase comes before its preposition: glass of water."""
_SHORTEST = 4
"""Fewest letters of both words in a closed compound, such as treehouse."""


class Override(NamedTuple):
    """The node of a label, by the user.

    Attributes:
        node: its name, with or without the network's prefix; empty to leave the label out.
        is_head_word: whether this accepts the proposal of a head word, with its confidence.
    """

    node: str
    is_head_word: bool


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
    overrides: Mapping[str, Override],
) -> Alignment:
    """Replace the nodes of some labels by nodes that the user names; leave out other head words.

    Args:
        alignment: the automatic alignment.
        network: the graph from outside the book.
        entities: labels in id order.
        overrides: nodes by label.

    Returns:
        A new alignment, in which a named node has confidence 1, and an accepted head word the
        confidence of its method.

    Raises:
        KnowledgeFileError: for an unknown label or node.
    """
    nodes = alignment.nodes.copy()
    confidences = alignment.confidences.copy()
    methods = list(alignment.methods)
    for entity, method in enumerate(alignment.methods):
        if method == HEAD_WORD:
            nodes[entity] = -1
            confidences[entity] = 0.0
            methods[entity] = "none"
    numbers = {}
    # A general graph has millions of nodes: no table of them without need.
    if overrides:
        numbers = {name: node for node, name in enumerate(network.nodes)}
    for label, (name, is_head_word) in overrides.items():
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
        if is_head_word and node == alignment.nodes[entity]:
            confidences[entity] = alignment.confidences[entity]
            methods[entity] = alignment.methods[entity]
            continue
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
        HEAD_WORD: _heads(text, network),
    }
    for method, texts in forms.items():
        for form in texts:
            if form in network.spellings:
                return method, form
    return "none", ""


def _heads(text: str, network: Network) -> Iterator[str]:
    """Yield possible head words of a label, longest first, such as glass for glass of water."""
    match = _HEAD.fullmatch(text)
    if match:
        words = match[1].split()
        first = 0
    else:
        words = text.split()
        # All words together were looked up before.
        first = 1
    for start in range(first, len(words)):
        head = " ".join(words[start:])
        yield head
        yield from network.singulars(head)
    if len(words) == 1:
        # Closed compounds: the first part has to be a word, too.
        last = len(text) - _SHORTEST
        for cut in range(_SHORTEST, last + 1):
            first_part = text[:cut]
            head = text[cut:]
            if first_part in network.spellings:
                yield head
                yield from network.singulars(head)
