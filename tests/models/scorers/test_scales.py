"""Scaled views of scorers, against loops over pairs."""

import math
import statistics

import numpy as np
import pytest
import torch
from helpers import refuses
from link_helpers import random_graph
from small_scorers import BareScorer, complex_scorer, scaled_scorer, table_scorer

from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers import scales
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.scales import (
    FACTORED_SCALES,
    interpolated,
    sampled_scaling,
    scaled_table,
)

GRAPH = random_graph(num_entities=9, num_recipes=20)
SIZE = GRAPH.num_entities
SCALES = ("standardise", "ranks", "log-softmax", "none")
SCALED = SCALES[:-1]
any_scale = pytest.mark.parametrize("scale", SCALES)
any_relation = pytest.mark.parametrize("relation", range(len(RELATIONS)), ids=RELATIONS)


class WholeScorer(BareScorer):
    """A scorer of the graph with equal scores, whose tables are taken as a whole."""

    graph_hash = GRAPH.hash

    def __init__(self):
        super().__init__(SIZE)
        self.entities = GRAPH.entities
        scores = self.scores.detach() * 3 + 5
        scores[COMPONENT_OF] = scores[COMPONENT_OF].round() + 0.5
        self.scores = scores.requires_grad_()

    def score(self, heads, relations, tails):
        raise AssertionError("the whole table is taken at once")


SCORER = WholeScorer()
NOISE = TableScorer(SCORER.scores.detach(), GRAPH.entities, GRAPH.hash)


def tables_of(**settings):
    scorer = scaled_scorer(SCORER, **settings)
    return torch.stack([scorer.table(name) for name in RELATIONS]).numpy()


def off_diagonal(table):
    return [float(table[i, j]) for i in range(len(table)) for j in range(len(table)) if i != j]


def slow_standardised(table):
    """Every score less the mean, over the standard deviation, both of pairs of
    different entities."""
    others = [x for i, row in enumerate(table) for j, x in enumerate(row) if i != j]
    mean, deviation = statistics.fmean(others), statistics.pstdev(others)
    return [[(x - mean) / deviation for x in row] for row in table]


def slow_ranks(table):
    """How many scores are lower, plus the middle place among equal ones."""
    whole = [x for row in table for x in row]
    return [
        [sum(other < x for other in whole) + (whole.count(x) + 1) / 2 for x in row] for row in table
    ]


def slow_log_softmax(table):
    """``log(exp score(h, t) / Σ_h' exp score(h', t))``."""
    totals = [math.log(sum(math.exp(row[t]) for row in table)) for t in range(len(table))]
    return [[x - total for x, total in zip(row, totals, strict=True)] for row in table]


SLOW = {
    "standardise": slow_standardised,
    "ranks": lambda table: slow_standardised(slow_ranks(table)),
    "log-softmax": lambda table: slow_standardised(slow_log_softmax(table)),
    "none": lambda table: table,
}


@any_scale
@any_relation
def test_each_relation_is_scaled_on_its_own_by_the_formula_of_the_scale(scale, relation):
    expected = SLOW[scale](NOISE.table(relation).tolist())
    np.testing.assert_allclose(tables_of(scale=scale)[relation], expected, atol=1e-5)


def test_log_softmax_goes_over_the_heads_of_a_tail_and_stands_large_scores():
    shifted = NOISE.scores + torch.arange(SIZE) * 1000.0  # by tail, beyond what exp can take
    scorer = scaled_scorer(table_scorer(shifted), scale="log-softmax")
    expected = scaled_scorer(NOISE, scale="log-softmax")
    torch.testing.assert_close(scorer.scores, expected.scores, atol=5e-3, rtol=1e-3)


@pytest.mark.parametrize("scale", SCALED)
@pytest.mark.parametrize("size", [3, 7, 80])
@pytest.mark.parametrize("value", [0.0, 0.1])
def test_a_scorer_that_cannot_tell_pairs_apart_scores_zero_on_any_scale(scale, size, value):
    constant = table_scorer(torch.full((len(RELATIONS), size, size), value))
    assert scaled_scorer(constant, scale=scale).scores.abs().max() < 1e-6


@pytest.mark.parametrize("scale", SCALED)
def test_rounding_is_not_blown_up_where_only_self_scores_differ(scale):
    for table in scaled_scorer(table_scorer(torch.eye(80).repeat(2, 1, 1)), scale=scale).scores:
        assert max(map(abs, off_diagonal(table.numpy()))) < 1e-6
        assert (table.diag() > 0.5).all()


@any_scale
@pytest.mark.parametrize("kept", [(), (2,), (0, 5)])
def test_observed_self_edges_are_kept_and_the_others_become_the_mean(scale, kept):
    loops = [[entity, COMBINES_WITH, entity] for entity in kept]
    others = [
        [3, COMPONENT_OF, 3],
        [4, COMBINES_WITH, 6],
        [6, COMBINES_WITH, 4],
        [7, COMPONENT_OF, 8],
    ]
    found = tables_of(scale=scale, self_edges="observed", observed=np.array(others + loops))
    expected = tables_of(scale=scale)
    for entity in set(range(SIZE)) - set(kept):
        assert expected[COMBINES_WITH, entity, entity] != 0
        expected[COMBINES_WITH, entity, entity] = mean_of(expected[COMBINES_WITH], scale)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def mean_of(table, scale):
    """The mean over different entities: 0 for all scales but ``none``."""
    mean = float(np.mean(off_diagonal(table)))
    assert scale == "none" or mean == pytest.approx(0, abs=1e-6)
    return mean if scale == "none" else 0.0


@pytest.mark.parametrize(
    ("setting", "options"),
    [
        ("scale", {"scale": "rank"}),
        ("self_edges", {"self_edges": "dropp"}),
        ("self_edges", {"self_edges": "observed"}),
    ],
)
def test_unknown_scales_and_self_edges_are_errors(setting, options):
    """An unknown scale or kind of self edges and observed ones without triples are errors."""
    with refuses(setting):
        tables_of(**options)


@any_scale
def test_dropped_self_edges_are_those_of_combines_with_only(scale):
    found, expected = tables_of(scale=scale, self_edges="drop"), tables_of(scale=scale)
    np.testing.assert_allclose(
        np.diag(found[COMBINES_WITH]), mean_of(found[COMBINES_WITH], scale), rtol=1e-6
    )
    assert off_diagonal(found[COMBINES_WITH]) == off_diagonal(expected[COMBINES_WITH])
    np.testing.assert_array_equal(found[COMPONENT_OF], expected[COMPONENT_OF])
    assert np.diag(found[COMPONENT_OF]).all()


def test_self_edges_are_kept_whatever_was_observed():
    np.testing.assert_array_equal(tables_of(scale="standardise", self_edges="keep"), tables_of())
    np.testing.assert_array_equal(tables_of(self_edges="keep", observed=GRAPH.triples), tables_of())
    dropped = tables_of(self_edges="drop", observed=np.array([[1, COMBINES_WITH, 1]]))
    np.testing.assert_array_equal(dropped, tables_of(self_edges="drop"))


FACTORED = complex_scorer(SIZE, 4, shift=0.3)


def scores_of(scorer, relation, scaling):
    """The scores of all pairs by a scaling, without the treatment of self edges."""
    scores = (scorer.table(relation) - scaling["shift"]) / scaling["deviation"]
    if "knots" not in scaling:
        return scores
    knots, heights = (scaling[name].expand(len(scores), -1) for name in ("knots", "heights"))
    return interpolated(scores, knots.contiguous(), heights)


@any_relation
@pytest.mark.parametrize("scale", FACTORED_SCALES)
@pytest.mark.parametrize("self_edges", ["keep", "observed", "drop"])
def test_a_scaling_gives_the_scores_of_the_scaled_table(relation, scale, self_edges):
    scorer, loops = FACTORED, np.array([[2, relation, 2], [3, relation, 4]])
    options = {"self_edges": self_edges, "observed": loops}
    expected = scaled_table(scorer, relation, scale, **options)
    scaling = sampled_scaling(scorer, relation, scale, **options)
    found = scores_of(scorer, relation, scaling)
    found[scaling["dropped"], scaling["dropped"]] = scaling["itself"]
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)
    assert scaling["dropped"].sum() == {"keep": 0, "observed": SIZE - 1, "drop": SIZE}[self_edges]


def test_scores_that_tell_no_pairs_apart_become_zero():
    scorer = complex_scorer(SIZE, 4, scale=0.0, shift=0.3)
    scaling = sampled_scaling(scorer, COMBINES_WITH)
    assert scores_of(scorer, COMBINES_WITH, scaling).abs().max() < 1e-5


@pytest.mark.parametrize("ties", [False, True])
def test_ranks_among_a_part_of_the_pairs_are_near_those_among_all(ties, monkeypatch):
    """A sample of pairs gives nearly their ranks, also where most pairs share a score."""
    size = 150
    scores = torch.randn(len(RELATIONS), size, size, generator=torch.Generator().manual_seed(1))
    if ties:  # as of entities without recipes
        scores[:, : size // 2] = 0
    scorer = table_scorer(scores)
    expected = scaled_table(scorer, COMPONENT_OF, "ranks")
    monkeypatch.setattr(scales, "SIDE", 100)
    monkeypatch.setattr(scales, "KNOTS", 32)
    found = scores_of(scorer, COMPONENT_OF, sampled_scaling(scorer, COMPONENT_OF, "ranks"))
    # Standardised ranks lie between -1.7 and 1.7. A score between the shared one and the next in
    # the sample is the exception, so no maximum.
    errors = (found - expected).abs()
    assert errors.mean() < 0.02
    assert errors.flatten().quantile(0.99) < 0.1
