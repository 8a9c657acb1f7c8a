"""Align a recipe graph's labels with the nodes of a graph from outside the book.

A label's first method with a node counts: exact spelling, base form (lemma), head word. Among several nodes (senses),
texts decide: a sense's text is its definition with the names and definitions of its direct neighbours, and the
context is the mean text of the entities that share a train recipe::

    log p(s | e) = log prior(s) + 25 cos(text(s), context(e)) + 1.5 log(field's share in the book / among all senses)

The prior follows the counts in sense-tagged text. Contexts and the book's fields are weighted by p of the last round,
in three rounds. The constants were chosen on the book ``everyday``.

Source: Banerjee and Pedersen 2003, "Extended gloss overlaps", for the texts; the rest is our own.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.network import Network, plain

METHODS = {"exact": 1.0, "lemma": 0.95, "head word": 0.5}
"""Confidence that a method finds the right word, before a sense is chosen."""
_CONTEXT, _FIELD, _ROUNDS = 25.0, 1.5, 3
_HEAD = re.compile(r"(.+?) (?:of|in|with|from) .+")
_SHORTEST = 4
"""Fewest letters of both words in a closed compound, such as treehouse."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Each entity's node (-1: none), method (:data:`METHODS`, ``override``, ``left out``, ``none``) and confidence."""

    nodes: Ids
    methods: tuple[str, ...]
    confidences: NDArray[np.float64]

    def matrix(self, num_nodes: int) -> sparse.csr_array:
        """Return the confidence of each entity's node, shape (E, num_nodes)."""
        (known,) = np.nonzero(self.nodes >= 0)
        values = self.confidences[known], (known, self.nodes[known])
        return sparse.csr_array(values, shape=(len(self.nodes), num_nodes))


def align(network: Network, entities: Sequence[str], recipes: Ids) -> Alignment:
    """Align entity labels with nodes of a network; train recipes, shape (n, 3), are contexts of senses."""
    joined = _joined(network, entities)
    spelled = [_spelling(label, network, joined) for label in entities]
    senses_of = [network.spellings.get(text, ()) for _, text in spelled]
    # Two labels seldom mean the same: pirate is not the pirate ship, if both are entities.
    taken = {
        senses[0]
        for (method, _), senses in zip(spelled, senses_of, strict=True)
        if method != "head word" and len(senses) == 1
    }
    senses_of = [[node for node in senses if node not in taken] or senses for senses in senses_of]
    rows = [(entity, node) for entity, senses in enumerate(senses_of) for node in senses]
    nodes, confidences = np.full(len(entities), -1), np.zeros(len(entities))
    if rows:
        owner, senses = np.array(rows).T
        first = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1])
        place = np.arange(len(owner)) - np.repeat(first, np.diff([*first, len(owner)]))
        counts = np.array(
            [network.counts.get((spelled[entity][1], node), 0) for entity, node in rows]
        )
        prior = counts + 1 / (1 + place)
        if network.glosses:
            chances = _sense_chances(network, owner, senses, prior, _neighbours(recipes, spelled))
        else:
            chances = _shares(np.log(prior), owner)
        for row in np.lexsort((chances, owner)):  # the likeliest sense of an entity comes last
            nodes[owner[row]], confidences[owner[row]] = senses[row], chances[row]
    methods = tuple(method for method, _ in spelled)
    return Alignment(nodes, methods, confidences * [METHODS.get(method, 0.0) for method in methods])


def with_overrides(
    alignment: Alignment, network: Network, entities: Sequence[str], overrides: Mapping[str, str]
) -> Alignment:
    """Replace nodes by named nodes, or by none for an empty name; KnowledgeFileError for an unknown one."""
    nodes, confidences, methods = (
        alignment.nodes.copy(),
        alignment.confidences.copy(),
        list(alignment.methods),
    )
    numbers = {name: node for node, name in enumerate(network.nodes)} if overrides else {}
    for label, name in overrides.items():
        if label not in entities:
            raise KnowledgeFileError(
                f"`overrides` names '{label}', which is not a label of the graph.{nearest(label, entities)} Expected a "
                "label as in the first column of alignment.tsv."
            )
        node = numbers.get(name.removeprefix(f"{network.prefix}:"), -1)
        if name and node < 0:
            raise KnowledgeFileError(
                f"{network.source} has no node '{name}' (for '{label}'). Expected a node as in the second column of "
                "alignment.tsv, or nothing to leave the label out."
            )
        place = entities.index(label)
        nodes[place], confidences[place], methods[place] = (
            node,
            float(node >= 0),
            "override" if name else "left out",
        )
    return Alignment(nodes, tuple(methods), confidences)


def _joined(network: Network, entities: Sequence[str]) -> dict[str, str]:
    """Return spellings in several words by the label that joins them: "fire truck" by firetruck."""
    wanted = {plain(label).replace(" ", "") for label in entities}
    return {
        short: text
        for text in network.spellings
        if " " in text and (short := text.replace(" ", "")) in wanted
    }


def _spelling(label: str, network: Network, joined: dict[str, str]) -> tuple[str, str]:
    """Return the method and the network's spelling for a label, or ``none`` and ""."""
    text = plain(label).rstrip("!?. ")
    short = text.replace(" ", "")
    forms = {"exact": [text], "lemma": [*network.singulars(text), joined.get(short, ""), short]}
    for method, texts in {**forms, "head word": _heads(text, network)}.items():
        for form in texts:
            if form in network.spellings:
                return method, form
    return "none", ""


def _heads(text: str, network: Network) -> Iterator[str]:
    match = _HEAD.fullmatch(text)
    words = (match[1] if match else text).split()
    for start in range(0 if match else 1, len(words)):
        yield from (head := " ".join(words[start:]), *network.singulars(head))
    if len(words) == 1:
        for cut in range(_SHORTEST, len(text) - _SHORTEST + 1):
            if text[:cut] in network.spellings:
                yield from (text[cut:], *network.singulars(text[cut:]))


def _neighbours(recipes: Ids, spelled: Sequence[tuple[str, str]]) -> sparse.csr_array:
    """Return means over entities with a shared recipe, (E, E); a head word says nothing about the sense."""
    size = len(spelled)
    a, b, result = recipes.T
    ends = np.concatenate([a, a, b]), np.concatenate([b, result, result])
    links = sparse.csr_array((np.ones(len(ends[0])), ends), shape=(size, size))
    links = ((links + links.T) > 0).astype(float)
    links.setdiag(0)
    links = links @ sparse.diags_array([float(method != "head word") for method, _ in spelled])
    links.eliminate_zeros()
    return _scaled(links, 1 / np.maximum(links.sum(1), 1))


def _sense_chances(
    network: Network,
    owner: Ids,
    senses: Ids,
    prior: NDArray[np.float64],
    neighbours: sparse.csr_array,
) -> NDArray[np.float64]:
    """Return the probability of each sense among the senses of its entity."""
    texts, fields = sense_texts(network, senses), np.array(network.fields)[senses]
    chances = _shares(np.log(prior), owner)
    for _ in range(_ROUNDS):
        weights = sparse.csr_array(
            (chances, (owner, np.arange(len(owner)))), shape=(neighbours.shape[0], len(owner))
        )
        contexts = _units(neighbours @ (weights @ texts))
        overlap = texts.multiply(contexts[owner]).sum(1)
        in_book, in_all = (1 + np.bincount(fields, share) for share in (chances, None))
        field = np.log(in_book / in_book.sum() * in_all.sum() / in_all)
        chances = _shares(np.log(prior) + _CONTEXT * overlap + _FIELD * field[fields], owner)
    return chances


def sense_texts(network: Network, senses: Ids, power: float = 1) -> sparse.csr_array:
    """Return unit word vectors of senses, (S, V), by log count and idf: own text twice, then neighbours' texts."""
    words, size = network.word_counts, len(network.nodes)
    links = (network.links() != 0).astype(float)
    own = sparse.csr_array(
        (np.ones(len(senses)), (np.arange(len(senses)), senses)), shape=(len(senses), size)
    )
    texts = (2 * own + own @ (links + links.T)) @ words
    texts.data = np.log1p(texts.data)
    idf = np.log(size / (1 + np.bincount(words.indices)))
    texts.data *= idf[texts.indices] ** power
    return _units(texts)


def _shares(logs: NDArray[np.float64], owner: Ids) -> NDArray[np.float64]:
    """Return the softmax over the rows of each owner."""
    highest = np.full(owner.max() + 1, -np.inf)
    np.maximum.at(highest, owner, logs)
    values = np.exp(logs - highest[owner])
    return values / np.bincount(owner, values)[owner]


def _units(matrix: sparse.csr_array) -> sparse.csr_array:
    return _scaled(matrix, 1 / np.maximum(np.sqrt(matrix.multiply(matrix).sum(1)), 1e-12))


def _scaled(matrix: sparse.csr_array, factors: NDArray[np.float64]) -> sparse.csr_array:
    return sparse.csr_array(sparse.diags_array(factors) @ matrix)
