"""Tables over pairs of entities from an aligned graph: paths, parts and definitions.

Let S, shape (E, N), hold the confidence of each entity's node, and let A, shape (N, N), hold weights of edges from
heads to tails. All tables have values from 0 to 1, and 0 on the diagonal.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.models.knowledge.alignment import Alignment, sense_texts
from wordcraft_kg.models.knowledge.folder import TableInfo
from wordcraft_kg.models.knowledge.network import Network, plain

IS_A, DESCRIBED_BY = ("isA", "IsA"), "describedBy"
PART_OF = ("partOf", "substanceOf", "memberOf", "PartOf")
"""Relations from a part to the whole."""
HAS_PART = ("HasA", "MadeOf")
"""Relations from a whole to a part."""
_STEPS = 2
"""Most steps to classes from which parts are inherited."""
_DAMPING = 1_000.0
_BLOCK = 32
Floats = NDArray[np.float64]
Table = tuple[TableInfo, Floats]


def with_descriptions(network: Network, alignment: Alignment, entities: Sequence[str]) -> Network:
    """Add an edge to each entity in a node's definition; weight 1 - log(1 + n) / log(1 + N) if in n of N."""
    phrases = defaultdict(set)
    for entity, node in enumerate(alignment.nodes.tolist()):
        if node >= 0:
            label = [entities[entity]] if alignment.methods[entity] != "head word" else []
            for name in (*label, *network.lemmas[node]):
                phrases[" ".join(map(network.base_form, plain(name).split()))].add(node)
    longest = max((phrase.count(" ") + 1 for phrase in phrases), default=0)
    mentions = []
    for head, words in enumerate(network.definitions):
        spans = (
            words[start : start + size]
            for start in range(len(words))
            for size in range(1, longest + 1)
        )
        tails = set().union(*(phrases.get(" ".join(span), ()) for span in spans))
        mentions += [(head, tail) for tail in tails - {head}]
    edges = np.array(sorted(mentions), dtype=np.int64).reshape(-1, 2)
    size = len(network.nodes)
    counts = np.bincount(edges[:, 1], minlength=size)
    return network.with_edges(
        DESCRIBED_BY, edges, 1 - np.log1p(counts[edges[:, 1]]) / np.log1p(size)
    )


def hops(network: Network, alignment: Alignment) -> tuple[Floats, Floats, Floats]:
    """Return walks of 1, 2, 3 steps, (E, E) each: ``S W^k S'``, ``W = D^-1/2 (A + A') D^-1/2``, degrees D."""
    size = len(network.nodes)
    links = network.links().astype(np.float32)
    links = links + links.T
    links = _divided(links, links.sum(1))
    own = alignment.matrix(size).astype(np.float32)
    first = sparse.csr_array(own @ links)
    near = np.unique(first.indices)
    first, inner = first[:, near], links[near][:, near]
    starts = range(0, first.shape[0], _BLOCK)
    # Dense blocks: a third step from all entities at once fills a large matrix, sparse or not.
    third = np.concatenate(
        [(first @ (inner @ first[start : start + _BLOCK].T.toarray())).T for start in starts]
    )
    return (own @ links @ own.T).toarray(), (first @ first.T).toarray(), third


def make_tables(network: Network, alignment: Alignment, walks: Sequence[Floats]) -> list[Table]:
    """Return the tables that a network allows: ``paths`` and ``part``, with definitions ``texts`` and ``mentions``.

    A network without definitions has ``forward`` instead: walks of 1 and 2 steps from the ingredient to the result
    along the edges' directions. A network with definitions needs edges :data:`DESCRIBED_BY`; ``walks`` come from
    :func:`hops`.
    """
    own = alignment.matrix(len(network.nodes))
    tables = [_named("paths", _damped(walks), "{ingredient} is related to {result}")]
    if set(network.relations) & {*PART_OF, *HAS_PART}:
        tables.append(_named("part", _parts(network, own), "{ingredient} is part of {result}"))
    if network.glosses:
        named = (own @ network.links([DESCRIBED_BY]) @ own.T).toarray()
        is_known = alignment.nodes >= 0
        texts = sense_texts(network, np.maximum(alignment.nodes, 0), power=2)
        alike = (texts @ texts.T).toarray() * is_known * is_known[:, None]
        tables.append(_named("texts", alike, "{ingredient} is defined similarly to {result}"))
        tables.append(_named("mentions", named.T, "{result} is described by {ingredient}"))
    else:
        links = network.links()
        links = _divided(links, (links + links.T).sum(1))
        first, second = own @ links, links @ own.T
        steps = [(first @ own.T).toarray(), (first @ second).toarray()]
        tables.append(_named("forward", _damped(steps), "{ingredient} leads to {result}"))
    return tables


def _divided(links: sparse.csr_array, degrees: Floats) -> sparse.csr_array:
    roots = sparse.diags_array((1 / np.sqrt(np.maximum(degrees, 1e-12))).astype(links.dtype))
    return sparse.csr_array(roots @ links @ roots)


def _damped(walks: Sequence[Floats]) -> Floats:
    """Return ``log(1 + 1000 w) / log(1001)`` for the mean walk w, where each step halves the weight."""
    weights = [0.5**step for step in range(len(walks))]
    mean = sum(weight * walk for weight, walk in zip(weights, walks, strict=True)) / sum(weights)
    return np.asarray(np.log1p(_DAMPING * mean) / np.log1p(_DAMPING))


def _named(name: str, values: Floats, phrase: str) -> Table:
    values = np.clip(values, 0, 1)
    np.fill_diagonal(values, 0)
    return TableInfo(name=name, role="part", phrase=phrase), values


def _parts(network: Network, own: sparse.csr_array) -> Floats:
    """Return how directly a row is part of a column; with definitions also by classes, half for each step."""
    upward = (network.links(IS_A) != 0).astype(float)
    reach = step = own
    for _ in range(_STEPS if network.glosses else 0):
        step = step @ upward / 2
        reach = reach + step
    to_whole = network.links(PART_OF) + network.links(HAS_PART).T
    return (reach @ (to_whole != 0).astype(float) @ reach.T).toarray()
