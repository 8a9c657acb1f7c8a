"""An aligned graph around the entities: tables over pairs, and triples for training.

Let S, shape (E, N), hold the confidence of each entity's node, and let A, shape (N, N), hold
weights of edges from heads to tails. All tables have values from 0 to 1, and 0 on the diagonal:
pairs of an entity with itself differ from all others, and would stand out for no reason of the
source.

The page docs/outside-knowledge.md has a row for each table, and says what triples are for.
"""

import operator
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.base.errors import KnowledgeFileError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.knowledge.knowledge_folder import TableInfo
from wordcraft_kg.models.knowledge.network import Alignment, Network, plain

IS_A = "isA"
"""WordNet's relation from a thing to its class."""
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
MOST_TRIPLES = 200_000
"""Most edges in ``triples.tsv``: first those between entities, then those with large weights."""
_WORD = re.compile(r"[a-z0-9]+")
Triple = tuple[str, str, str]
"""Names of head, relation and tail."""


def near_triples(network: Network, alignment: Alignment, entities: Sequence[str]) -> list[Triple]:
    """Return triples around entities: their labels, and names of other nodes with a prefix.

    They are the edges with an entity's node at an end, from definitions only those of entities. A
    node with several labels has a triple for each. Other nodes with a single edge are left out,
    again and again until none remains, as they link no two entities; entities stay. In a network
    with definitions, an entity has an edge to each of its classes, also to the indirect ones; in
    another one, the :data:`MOST_TRIPLES` edges with the largest weights are taken, those between
    entities first.

    Args:
        network: the graph from outside the book.
        alignment: the node of each entity.
        entities: labels in id order.

    Raises:
        KnowledgeFileError: if a label looks like the name of a node, so both would be one node in
            training.
    """
    for label in entities:
        if label.startswith(f"{network.prefix}:"):
            raise KnowledgeFileError(
                f"the label '{label}' looks like the name of a node. Rename this entity."
            )
    labels_of = defaultdict[int, list[str]](list)
    for label, node in zip(entities, alignment.nodes.tolist(), strict=True):
        if node >= 0:
            labels_of[node].append(label)
    is_entity = np.zeros(len(network.nodes), dtype=bool)
    is_entity[[*labels_of]] = True
    heads, relations, tails = network.edges.T
    # Of definitions only those of entities: each mentions entities, and there are many.
    is_definition = np.isin(relations, network.ids_of([DESCRIBED_BY]))
    is_near = is_entity[heads] | (is_entity[tails] & ~is_definition)
    edges = network.edges[is_near]
    if network.glosses:
        edges = np.unique(np.concatenate([edges, _classes(network, list(labels_of))]), axis=0)
    else:
        is_inner = is_entity[edges[:, ::2]].all(1)
        # The last key sorts first.
        order = np.lexsort((-network.weights[is_near], ~is_inner))
        # Chosen by weight, but in the order of the edges, so that files compare well.
        edges = edges[np.sort(order[:MOST_TRIPLES])]
    triples = []
    for head, relation, tail in _without_ends(edges, is_entity).tolist():
        name = f"{network.prefix}:{network.relations[relation]}"
        head_names = labels_of.get(head, [network.name_of(head)])
        tail_names = labels_of.get(tail, [network.name_of(tail)])
        triples += list(product(head_names, [name], tail_names))
    return triples


def _classes(network: Network, nodes: Sequence[int]) -> Ids:
    """Return an edge from each of some nodes to each direct or indirect class, shape (C, 3)."""
    import networkx as nx

    relation = network.relations.index(IS_A)
    is_class = network.edges[:, 1] == relation
    classes = nx.DiGraph(network.edges[is_class][:, ::2].tolist())
    classes.add_nodes_from(nodes)
    edges = [(node, relation, above) for node in nodes for above in nx.descendants(classes, node)]
    # Without any class, the reshape makes three columns all the same.
    return np.array(edges, dtype=np.int64).reshape(-1, 3)


def _without_ends(edges: Ids, is_entity: NDArray[np.bool_]) -> Ids:
    """Leave out nodes with a single edge, until none is left; entities stay."""
    while True:
        ends = edges[:, ::2]
        degrees = np.bincount(ends.ravel(), minlength=len(is_entity))
        stays = is_entity | (degrees > 1)
        is_kept = stays[ends].all(1)
        if is_kept.all():
            return edges
        edges = edges[is_kept]


# --- tables ---------------------------------------------------------------------------------------


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
    # The same words occur in most definitions.
    base_form = cache(network.base_form)
    # The entities' nodes by their names in base forms, with blanks between words.
    phrases = defaultdict[str, set[int]](set)
    for label, entity_node in zip(entities, alignment.nodes.tolist(), strict=True):
        if entity_node >= 0:
            for name in (*network.lemmas[entity_node], label):
                base_forms = map(base_form, plain(name).split())
                phrases[" ".join(base_forms)].add(entity_node)
    longest = max((phrase.count(" ") + 1 for phrase in phrases), default=0)
    mentions: set[tuple[int, int]] = set()
    for node, gloss in enumerate(network.glosses):
        words = [base_form(word) for word in _WORD.findall(plain(gloss))]
        for start, size in product(range(len(words)), range(1, longest + 1)):
            for entity_node in phrases.get(" ".join(words[start : start + size]), ()):
                # A definition that names its own node says nothing.
                if entity_node != node:
                    mentions.add((node, entity_node))
    # Without mentions, the reshape makes two columns all the same.
    # Sorted, because sets have no order that is the same in every process.
    edges = np.array(sorted(mentions), dtype=np.int64).reshape(-1, 2)
    num_nodes = len(network.nodes)
    tail = edges[:, 1]
    log_counts = np.log1p(np.bincount(tail, minlength=num_nodes))
    weights = 1 - log_counts[tail] / np.log1p(num_nodes)
    # The new relation gets the next id.
    relations = np.full(len(edges), len(network.relations))
    rows = np.column_stack([edges[:, 0], relations, tail])
    return replace(
        network,
        relations=(*network.relations, DESCRIBED_BY),
        edges=np.concatenate([network.edges, rows]),
        weights=np.concatenate([network.weights, weights]),
    )


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
    links = network.links(network.relations).astype(np.float32)
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
        block = first[start : start + _BLOCK].T.toarray()
        two_of_block = inner @ block
        blocks.append((first @ two_of_block).T)
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
        links = network.links(network.relations)
        links = _divided(links, (links + links.T).sum(1))
        first = confidences @ links
        last = links @ confidences.T
        walks = [(first @ confidences.T).toarray(), (first @ last).toarray()]
        tables.append(_named("forward", _damped(walks), "{ingredient} leads to {result}"))
    return tables


def _divided(links: sparse.csr_array, degrees: Floats) -> sparse.csr_array:
    """Divide each edge by the roots of its nodes' degrees."""
    factors = 1 / np.sqrt(np.maximum(degrees, 1e-12))
    roots = sparse.diags_array(factors.astype(links.dtype))
    return sparse.csr_array(roots @ links @ roots)


def _damped(walks: Sequence[Floats]) -> Floats:
    """Return ``log(1 + 1000 w) / log(1001)`` of the mean walk w; each step halves the weight."""
    weights = [0.5**step for step in range(len(walks))]
    # One product at a time: each has a cell for every pair of entities.
    mean = sum(map(operator.mul, weights, walks)) / sum(weights)
    # The largest value, 1, stays 1.
    return np.asarray(np.log1p(_DAMPING * mean) / np.log1p(_DAMPING))


def _named(name: str, values: Floats, phrase: str) -> Table:
    """Return a table of the role ``part``, with values from 0 to 1 and an empty diagonal."""
    values = np.clip(values, 0, 1)
    np.fill_diagonal(values, 0)
    return TableInfo(name=name, role="part", phrase=phrase), values


def _parts(network: Network, confidences: sparse.csr_array) -> Floats:
    """Return how directly a row is part of a column, shape (E, E).

    In WordNet, parts are inherited from classes, with half the weight for each step.
    """
    upward = (network.links([IS_A]) != 0).astype(float)
    reach = step = confidences
    for _ in range(_STEPS if network.glosses else 0):
        step = step @ upward / 2
        reach = reach + step
    # Relations from the whole to the part are turned round.
    to_whole = network.links(PART_OF) + network.links(HAS_PART).T
    is_part = (to_whole != 0).astype(float)
    return (reach @ is_part @ reach.T).toarray()
