"""Small scorers, tensors and states for the tests of scorers and policies."""

import math

import torch

from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.factors import ComplExScorer, TableScorer
from wordcraft_kg.models.scorers.scales import scaled_table


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def labels_of(size):
    return [f"e{i:03}" for i in range(size)]


def table_scorer(scores):
    """A scorer of given scores, shape (R, E, E)."""
    return TableScorer(torch.as_tensor(scores).float(), labels_of(scores.shape[1]), "0" * 64)


def embeddings(size, dim, seed=0):
    """Embeddings of a ComplEx model."""
    generator = torch.Generator().manual_seed(seed)
    return {
        f"{kind}_{part}": torch.randn(rows, dim, generator=generator)
        for kind, rows in (("entity", size), ("relation", len(RELATIONS)))
        for part in ("real", "imag")
    }


def complex_scorer(size, dim, seed=0, scale=1.0, shift=0.0):
    drawn = embeddings(size, dim, seed)
    return ComplExScorer(
        {name: x * scale + shift for name, x in drawn.items()}, labels_of(size), "0" * 64
    )


class BareScorer:
    """The least that follows the protocol: not one of ours, asymmetric, and with scores that
    somebody trains."""

    graph_hash = "of no graph"

    def __init__(self, size, seed=0):
        self.entities = tuple("abcdefghij"[:size])
        self.scores = normal(len(RELATIONS), size, size, seed=seed).requires_grad_()

    def score(self, heads, relations, tails):
        return self.scores[
            RELATIONS.index(relations) if isinstance(relations, str) else relations, heads, tails
        ]

    def table(self, relation):
        return self.scores[RELATIONS.index(relation) if isinstance(relation, str) else relation]


def scaled_scorer(scorer, *, scale="standardise", self_edges="keep", observed=None):
    """The scaled tables of a scorer, as a scorer; self edges are those of combinesWith."""
    tables = [scaled_table(scorer, COMBINES_WITH, scale, self_edges=self_edges, observed=observed)]
    tables.append(scaled_table(scorer, COMPONENT_OF, scale))
    return TableScorer(torch.stack(tables), scorer.entities, scorer.graph_hash)


def states(num_entities, size=9, num_slots=5, seed=0):
    """Goals, selections and tables: with nothing held and something held, empty slots, full tables
    and repeats."""
    generator = torch.Generator().manual_seed(seed)
    goal = torch.randint(num_entities, (size,), generator=generator)
    selection = torch.randint(num_entities, (size,), generator=generator)
    table = torch.randint(num_entities, (size, num_slots), generator=generator)
    selection[::2] = num_entities
    table[1::3, 2:] = num_entities
    table[2::3, 0] = num_entities
    table[0, 1] = table[0, 0]
    return goal, selection, table


def cosine(one, other):
    lengths = math.sqrt(sum(x * x for x in one)) * math.sqrt(sum(y * y for y in other))
    return sum(x * y for x, y in zip(one, other, strict=True)) / lengths if lengths else 0.0
