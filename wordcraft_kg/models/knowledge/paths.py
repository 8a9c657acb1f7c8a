"""Tables over pairs of entities from an aligned graph: paths and parts.

Let S, shape (E, N), hold the confidence of each entity's node, and let A, shape (N, N), hold
weights of edges from heads to tails. All tables have values from 0 to 1, and 0 on the diagonal:
pairs of an entity with itself differ from all others, and would stand out for no reason of the
source.

The page docs/outside-knowledge.md has a row for each table.
"""

import operator
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.models.knowledge.alignment import Alignment
from wordcraft_kg.models.knowledge.knowledge_folder import TableInfo
from wordcraft_kg.models.knowledge.network import Network, plain

IS_A = ("isA", "IsA")
"""Relations from a thing to its class, in the spellings of WordNet and ConceptNet."""
DESCRIBED_BY = "describedBy"
"""The relation that :func:`with_descriptions` adds."""
PART_OF = ("partOf", "substanceOf", "memberOf", "PartOf")
"""Relations from a part to the whole."""
HAS_PART = ("HasA", "MadeOf")
"""Relations from a whole to a part."""
_STEPS = 2
"""Most steps to classes from which parts are inherited."""
_DAMPING = 1_000.0
"""Scale of the logarithm: weights below 1 / 1000 stay about proportional."""
_BLOCK = 32
"""Entities in a block of dense walks."""
Floats = NDArray[np.float64]
Table = tuple[TableInfo, Floats]


def with_descriptions(network: Network, alignment: Alignment, entities: Sequence[str]) -> Network:
    """Add an edge from each node to each entity in its definition.

    An entity in n of N definitions has edges of weight ``1 - log(1 + n) / log(1 + N)``: a word in
    most definitions says little.

    Args:
        network: a network with definitions.
        alignment: the node of each entity.
        entities: labels in id order.

    Returns:
        The network with the further relation :data:`DESCRIBED_BY`; the given one stays as it is.
    """
    phrases = _phrases(network, alignment, entities)
    # Sorted, because sets have no order that is the same in every process.
    mentions = sorted(_mentions(network.definitions(), phrases))
    rows = np.array(mentions, dtype=np.int64)
    # Without mentions, the reshape makes two columns all the same.
    edges = rows.reshape(-1, 2)
    num_nodes = len(network.nodes)
    tail = edges[:, 1]
    counts = np.bincount(tail, minlength=num_nodes)
    log_counts = np.log1p(counts)
    commonness = log_counts[tail] / np.log1p(num_nodes)
    weights = 1 - commonness
    return network.with_edges(DESCRIBED_BY, edges, weights)


def _phrases(
    network: Network,
    alignment: Alignment,
    entities: Sequence[str],
) -> dict[str, set[int]]:
    """Return the entities' nodes by their names in base forms, with blanks between words."""
    phrases = defaultdict[str, set[int]](set)
    for entity, node in enumerate(alignment.nodes.tolist()):
        if node < 0:
            continue
        for name in (*network.lemmas[node], entities[entity]):
            words = plain(name).split()
            base_forms = map(network.base_form, words)
            phrases[" ".join(base_forms)].add(node)
    return phrases


def _mentions(
    definitions: Sequence[Sequence[str]],
    phrases: dict[str, set[int]],
) -> Iterator[tuple[int, int]]:
    """Yield pairs of a node and another one that its definition names."""
    numbers_of_words = (phrase.count(" ") + 1 for phrase in phrases)
    longest = max(numbers_of_words, default=0)
    sizes = range(1, longest + 1)
    for head, words in enumerate(definitions):
        tails: set[int] = set()
        for start in range(len(words)):
            for size in sizes:
                end = start + size
                phrase = " ".join(words[start:end])
                tails |= phrases.get(phrase, set())
        # A definition that names its own node says nothing.
        tails.discard(head)
        for tail in tails:
            yield head, tail


def hops(network: Network, alignment: Alignment) -> tuple[Floats, Floats, Floats]:
    """Return weights of walks with 1, 2 and 3 steps between entities, shape (E, E) each.

    ``S W^k S'`` for k steps, with ``W = D^-1/2 (A + A') D^-1/2`` and the nodes' degrees D: an edge
    of a node with many edges says less.

    Args:
        network: the graph from outside the book.
        alignment: the node of each entity, with its confidence.
    """
    size = len(network.nodes)
    # Half the memory of 64 bits; walks are rounded to 16 bits later.
    links = network.links().astype(np.float32)
    links = links + links.T
    links = _divided(links, links.sum(1))
    confidences = alignment.matrix(size).astype(np.float32)
    first = sparse.csr_array(confidences @ links)
    # Walks of three steps between entities have their inner nodes next to entities.
    near = np.unique(first.indices)
    first = first[:, near]
    # Both ends of an inner edge are among them: rows first, then columns.
    inner = links[near][:, near]
    # Dense blocks: a third step from all entities at once fills a large matrix, sparse or not.
    blocks = []
    for start in range(0, first.shape[0], _BLOCK):
        end = start + _BLOCK
        block = first[start:end].T.toarray()
        two_of_block = inner @ block
        three_of_block = first @ two_of_block
        blocks.append(three_of_block.T)
    three_steps = np.concatenate(blocks)
    # W is symmetric, so two steps are the product of one step from both ends.
    two_steps = first @ first.T
    one_step = confidences @ links @ confidences.T
    return one_step.toarray(), two_steps.toarray(), three_steps


def make_tables(network: Network, alignment: Alignment) -> list[Table]:
    """Return the tables of a network: ``paths``, and ``part`` if it tells of parts.

    A network without definitions has ``forward`` besides: walks of 1 and 2 steps from the
    ingredient to the result along the edges' directions.

    Args:
        network: the network; if it has definitions, also with edges :data:`DESCRIBED_BY`.
        alignment: the node of each entity.

    Returns:
        Descriptions and values, shape (E, E), from 0 to 1.
    """
    confidences = alignment.matrix(len(network.nodes))
    paths = _damped(hops(network, alignment))
    tables = [_named("paths", paths, "{ingredient} is related to {result}")]
    if network.ids_of([*PART_OF, *HAS_PART]):
        parts = _parts(network, confidences)
        tables.append(_named("part", parts, "{ingredient} is part of {result}"))
    if not network.glosses:
        forward = _damped(_forward_walks(network, confidences))
        tables.append(_named("forward", forward, "{ingredient} leads to {result}"))
    return tables


def _forward_walks(network: Network, confidences: sparse.csr_array) -> list[Floats]:
    """Return weights of walks with 1 and 2 steps along the edges' directions, (E, E) each."""
    links = network.links()
    both_ways = links + links.T
    links = _divided(links, both_ways.sum(1))
    first = confidences @ links
    last = links @ confidences.T
    one_step = first @ confidences.T
    two_steps = first @ last
    return [one_step.toarray(), two_steps.toarray()]


def _divided(links: sparse.csr_array, degrees: Floats) -> sparse.csr_array:
    """Divide each edge by the roots of its nodes' degrees."""
    factors = 1 / np.sqrt(np.maximum(degrees, 1e-12))
    roots = sparse.diags_array(factors.astype(links.dtype))
    return sparse.csr_array(roots @ links @ roots)


def _damped(walks: Sequence[Floats]) -> Floats:
    """Return ``log(1 + 1000 w) / log(1001)`` of the mean walk w; each step halves the weight."""
    weights = [0.5**step for step in range(len(walks))]
    # One product at a time: each has a cell for every pair of entities.
    products = map(operator.mul, weights, walks)
    mean = sum(products) / sum(weights)
    # The largest value, 1, stays 1.
    highest = np.log1p(_DAMPING)
    return np.asarray(np.log1p(_DAMPING * mean) / highest)


def _named(name: str, values: Floats, phrase: str) -> Table:
    """Return a table of the role ``part``, with values from 0 to 1 and an empty diagonal."""
    values = np.clip(values, 0, 1)
    np.fill_diagonal(values, 0)
    return TableInfo(name=name, role="part", phrase=phrase), values


def _parts(network: Network, confidences: sparse.csr_array) -> Floats:
    """Return how directly a row is part of a column, shape (E, E).

    In WordNet, parts are inherited from classes, with half the weight for each step.
    """
    upward = (network.links(IS_A) != 0).astype(float)
    reach = confidences
    step = confidences
    steps = _STEPS if network.glosses else 0
    for _ in range(steps):
        step = step @ upward / 2
        reach = reach + step
    # Relations from the whole to the part are turned round.
    to_whole = network.links(PART_OF) + network.links(HAS_PART).T
    is_part = (to_whole != 0).astype(float)
    return (reach @ is_part @ reach.T).toarray()
