"""The recipe scorer as others use it: scores of recipes and of links, and the recipes that speak
for one."""

from itertools import product

import numpy as np
import pytest
import torch
from helpers import refuses
from kernel_oracles import (
    explicit_ridge,
    link_tables,
    slow_completion,
    slow_profiles,
    slow_similarity,
)
from link_helpers import random_graph
from small_scorers import normal

from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    RELATIONS,
    Recipe,
    RecipeGraph,
    SplitConfig,
    make_folds,
    make_split,
    open_book,
    recipe_triples,
)
from wordcraft_kg.models.scorers import probabilities, recipes
from wordcraft_kg.models.scorers.baselines import KernelScorer, NeighbourScorer
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.kernel import completion, profiles
from wordcraft_kg.models.scorers.link_evidence import POWER, RECIPES, LinkEvidence
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples


@pytest.fixture(scope="module")
def scorer(cross_fitted):
    found = whole_of(cross_fitted)
    assert isinstance(found, recipes.RecipeScorer)
    assert whole_of(found) is found
    return found


def test_a_recipe_has_one_score_however_it_is_asked(scorer):
    size = len(scorer.entities)
    rng = np.random.default_rng(0)
    a, b, results = (torch.from_numpy(rng.integers(size, size=50)) for _ in range(3))
    b[:5] = a[:5]
    scores = scorer.score_recipes(a, b, results)
    assert (scores.shape, scores.dtype) == ((50,), torch.float32)
    torch.testing.assert_close(scorer.score_recipes(b, a, results), scores, rtol=0, atol=0)
    for row in range(0, 50, 7):
        labels = [scorer.entities[int(ids[row])] for ids in (a, b, results)]
        torch.testing.assert_close(scorer.score_recipes(*labels), scores[row], rtol=1e-4, atol=1e-4)
    everything = torch.arange(size)
    grid = scorer.score_recipes(a[:3, None], b[:3, None], everything)
    assert grid.shape == (3, size)
    torch.testing.assert_close(grid[torch.arange(3), results[:3]], scores[:3], rtol=1e-4, atol=1e-4)
    assert scorer.score_recipes([], [], []).shape == (0,)
    with pytest.raises(UnknownEntityError, match="no entity 'waater' in kitchen-recipes"):
        scorer.score_recipes("waater", "flour", "dough")


def test_no_links_have_no_scores(scorer):
    assert scorer.score(np.array([], dtype=str), 0, "water").shape == (0,)
    some = torch.arange(2)
    assert scorer.knowledge.slot_scores(0, some, some[:, None][:, :0], some * 0).shape == (2, 0)


def test_a_loaded_cross_fitted_scorer_scores_as_its_whole(cross_fitted, scorer):
    """A loaded cross fitted scorer scores recipes as the scorer of all recipes."""
    recipe = "flour", "water", "dough"
    assert torch.equal(cross_fitted.score_recipes(*recipe), scorer.score_recipes(*recipe))
    assert cross_fitted.supporting_recipes(*recipe) == scorer.supporting_recipes(*recipe)
    assert torch.equal(cross_fitted.recipes, scorer.recipes)


def test_scores_of_links_are_those_of_the_link_ranker(scorer, cross_fitted):
    everything = torch.arange(len(scorer.entities))
    for relation in (COMBINES_WITH, COMPONENT_OF):
        table = scorer.table(relation)
        torch.testing.assert_close(
            table, scorer.score(everything[:, None], relation, everything), rtol=0, atol=0
        )
        torch.testing.assert_close(cross_fitted.table(relation), table, rtol=0, atol=0)
    pairs = scorer.table(COMBINES_WITH)
    torch.testing.assert_close(pairs, pairs.T, rtol=2e-3, atol=1e-4)
    assert not torch.equal(pairs, scorer.table(COMPONENT_OF))


@pytest.mark.parametrize("has_table", [True, False])
def test_queries_of_both_relations_have_the_scores_of_each(scorer, has_table, monkeypatch):
    everything = torch.arange(len(scorer.entities))
    relations = torch.tensor([COMBINES_WITH, COMPONENT_OF, COMPONENT_OF, COMBINES_WITH])[:, None]
    some = torch.tensor([3, 3, 7, 0])[:, None]
    expected = [scorer.table(relation)[row] for relation, row in zip(relations, some, strict=True)]
    reversed_ = [
        scorer.table(relation)[:, row].T for relation, row in zip(relations, some, strict=True)
    ]
    monkeypatch.setattr(scorer, "_has_table", lambda *_: has_table)
    tails = scorer.score(some, relations, everything[None])
    torch.testing.assert_close(tails, torch.cat(expected), rtol=1e-4, atol=1e-4)
    heads = scorer.score(everything[None], relations, some)
    torch.testing.assert_close(heads, torch.cat(reversed_), rtol=2e-3, atol=1e-3)
    # A table of a single link: its row and its column are both a head and a tail.
    single = scorer.score(some[:1], COMPONENT_OF, some[2:3])
    torch.testing.assert_close(
        single, scorer.table(COMPONENT_OF)[3, 7].view(1, 1), rtol=1e-4, atol=1e-4
    )


def test_a_sample_of_a_fold_stands_for_all_its_recipes(cross_fitted, opened_kitchen, monkeypatch):
    folds = make_folds(opened_kitchen.split, cross_fitted.count)
    left_out = cross_fitted.left_out(0)
    everything = probabilities.recipe_histogram(left_out, folds, 0)[:, 1]
    assert everything.sum() == len(folds.recipes_of(0)) > 10
    monkeypatch.setattr(probabilities, "MOST_OF_FOLD", 10)
    sample = probabilities.recipe_histogram(left_out, folds, 0)[:, 1]
    assert sample.sum() == pytest.approx(everything.sum())
    assert 0 < np.count_nonzero(sample) <= 10


def test_a_large_book_proposes_results_of_neighbours(scorer, cross_fitted, monkeypatch):
    """Neighbours make them, their order is that of recipe scores, and shares are over them."""
    a, b = scorer.entity_ids(["flour", "milk"]), scorer.entity_ids(["water", "tomato"])
    assert not scorer.proposes_results
    monkeypatch.setattr(recipes, "ALL_RESULTS", 5)
    assert scorer.proposes_results
    size = len(scorer.entities)
    ids, scores = scorer.candidate_results(a, b)
    everything = scorer.score_recipes(a[:, None], b[:, None], torch.arange(size))
    for row in range(2):
        proposed = ids[row][ids[row] < size]
        assert 0 < len(proposed) < size
        assert len(proposed.unique()) == len(proposed)
        of_proposed = scores[row, : len(proposed)]
        torch.testing.assert_close(of_proposed, everything[row, proposed], rtol=1e-4, atol=1e-4)
        assert torch.equal(of_proposed, of_proposed.sort(descending=True).values)
        assert torch.isneginf(scores[row, len(proposed) :]).all()
    assert scorer.entities.index("dough") in ids[0].tolist()
    shares = cross_fitted.result_probabilities(a, b)
    is_proposed = torch.zeros(2, size + 1, dtype=torch.bool).scatter_(1, ids, True)[:, :size]
    assert torch.equal(shares > 0, is_proposed)
    torch.testing.assert_close(shares.sum(1), torch.ones(2))


def test_a_known_recipe_is_its_own_evidence(scorer, cross_fitted, kitchen):
    """A known recipe speaks for itself and the scorer without it names others."""
    known = {Recipe.of(*kitchen.labels(row)) for row in scorer.recipes.tolist()}
    row = next(row for row, fold in enumerate(cross_fitted.of_recipe) if fold == 1)
    a, b, result = kitchen.labels(kitchen.recipes[row])
    first, *others = scorer.supporting_recipes(a, b, result)
    assert (first.recipe, first.weight) == ((a, b, result), 1)
    for is_for_result in (True, False):
        shares = [one.share for one in others if (one.recipe.result == result) == is_for_result]
        assert shares == sorted(shares, reverse=True)
    assert scorer.supporting_recipes(b, a, result) == [first, *others]
    found = cross_fitted.left_out(1).supporting_recipes(a, b, result, limit=100)
    assert found
    assert {one.recipe for one in found} <= known - {Recipe.of(a, b, result)}
    assert all(0 < one.weight <= 1 and 0 < one.share <= 1 for one in found)
    # Shares and strengths tell the same, beside all evidence or beside the strongest.
    assert max(one.strength for one in found) == 1
    ratios = [one.share / one.strength for one in found]
    assert ratios == pytest.approx([ratios[0]] * len(ratios))
    with pytest.raises(UnknownEntityError, match="waater"):
        scorer.supporting_recipes("waater", b, result)


SIZE = 9
"""Entities; the last one is in no recipe."""


def drawn_recipes(seed, count=14):
    rng = np.random.default_rng(seed)
    rows = rng.integers(SIZE - 1, size=(count, 3))
    rows[0, 1] = rows[0, 0]  # a recipe of one entity twice
    rows[1] = rows[2]  # and one that is there twice
    return rows


def drawn_vectors(seed):
    vectors = np.random.default_rng([seed, 1]).standard_normal((SIZE, 4)).astype(np.float32)
    vectors[3] = 0  # a word without a vector
    return vectors


CASES = [
    pytest.param(drawn_recipes(0), id="drawn"),
    pytest.param(drawn_recipes(1, 40), id="many"),
    pytest.param(np.array([[2, 2, 2]]), id="one entity makes itself"),
    pytest.param(np.zeros((0, 3), dtype=np.int64), id="none"),
]

any_recipes = pytest.mark.parametrize("recipes", CASES)


def graph_of(recipes):
    """A graph whose ids are those of the rows, with every entity in it."""
    rows = np.concatenate([recipes, [[i, i, i] for i in range(SIZE)]])
    return RecipeGraph.from_recipes([tuple(f"e{i}" for i in row) for row in rows], name="drawn")


@any_recipes
def test_profiles_are_the_damped_rows_of_links_and_contexts(recipes):
    found = profiles(recipes, SIZE)
    expected = slow_profiles(recipes.tolist(), SIZE)
    gram = [
        [sum(v * other.get(c, 0) for c, v in row.items()) for other in expected] for row in expected
    ]
    np.testing.assert_allclose((found @ found.T).toarray(), gram, atol=1e-12)
    # The contexts, and with them all that has no counterpart elsewhere, have the right lengths too.
    lengths = sorted(round(v, 9) for row in expected for v in row.values())
    np.testing.assert_allclose(sorted(found.data), lengths, atol=1e-8)


@any_recipes
def test_completion_counts_paths_of_three_pairs_of_the_same_result(recipes):
    np.testing.assert_allclose(
        completion(recipes, SIZE), slow_completion(recipes.tolist(), SIZE), atol=1e-6
    )


def test_the_kernel_scorer_is_the_sum_of_standardised_parts():
    recipes, vectors = drawn_recipes(1, 40), drawn_vectors(0)
    graph = graph_of(recipes)
    scorer = KernelScorer(graph, recipes, vectors)
    kernel = slow_similarity(recipes.tolist(), vectors)
    combines, component = (
        standardised(explicit_ridge(kernel, links, np.unique(recipes)))
        for links in link_tables(recipe_triples(recipes), SIZE)
    )
    combines = combines + 0.5 * standardised(slow_completion(recipes.tolist(), SIZE))
    np.testing.assert_allclose(scorer.table("combinesWith").numpy(), combines, atol=1e-3)
    np.testing.assert_allclose(scorer.table("componentOf").numpy(), component, atol=1e-3)
    assert (scorer.name, scorer.graph_hash) == ("recipe kernel", graph.hash)


def test_large_tables_and_foreign_vectors_are_refused(kitchen, monkeypatch):
    """A table that is too large and vectors of another graph are refused."""
    with refuses("vectors"):
        KernelScorer(kitchen, kitchen.recipes, np.zeros((3, 4)))
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1_000)
    with pytest.raises(ConfigError, match="the recipe kernel needs"):
        KernelScorer(kitchen, kitchen.recipes)


def validation_mrrs(graph, seed):
    """Validation MRR of the recipe kernel and of the neighbour rule."""
    split = make_split(graph, SplitConfig(seed=seed, valid_ratio=0.1))
    vectors = glove_features(graph.entities).vectors
    scorers = (
        KernelScorer(graph, split.recipes("train"), vectors),
        NeighbourScorer(graph, split.partial),
    )
    ranks = [rank_triples(scorer, split.held_out("valid"), graph.triples) for scorer in scorers]
    return mean_reciprocal_rank(ranks[0]), mean_reciprocal_rank(ranks[1])


@pytest.mark.slow
def test_the_kernel_beats_neighbours_on_everyday_1():
    """The kernel predicts unseen links of everyday 1 better than neighbours."""
    found = validation_mrrs(RecipeGraph.from_book(open_book("everyday-1")), seed=10)
    assert found == pytest.approx((0.247, 0.163), abs=0.003)


@pytest.mark.slow
def test_the_kernel_predicts_unseen_links_of_little_alchemy(alchemy):
    assert validation_mrrs(alchemy, seed=11) == pytest.approx((0.349, 0.216), abs=0.003)


GRAPH = random_graph(num_entities=9, num_recipes=40)

LINK_EVIDENCE_SIZE = GRAPH.num_entities

KNOWN = GRAPH.recipes[::2]


def scorer_of(graph, seed=0):
    return TableScorer(
        normal(2, graph.num_entities, graph.num_entities, seed=seed), graph.entities, graph.hash
    )


def slow_links(recipes):
    """Every link of some recipes, and the rows of those that give it."""
    found = {}
    for row, (a, b, c) in enumerate(recipes):
        for link in {
            (a, COMBINES_WITH, b),
            (b, COMBINES_WITH, a),
            (a, COMPONENT_OF, c),
            (b, COMPONENT_OF, c),
        }:
            found.setdefault(link, []).append(row)
    return found


@pytest.fixture(scope="module")
def evidence():
    return LinkEvidence(scorer_of(GRAPH), KNOWN)


def test_links_speak_that_share_an_end_as_much_as_the_others_are_alike(evidence):
    links = slow_links(KNOWN.tolist())
    kinds = set()
    for head, relation, tail in product(
        range(LINK_EVIDENCE_SIZE), range(len(RELATIONS)), range(LINK_EVIDENCE_SIZE)
    ):
        others = [(h, t) for h, r, t in links if r == relation and (h, t) != (head, tail)]
        likeness = {
            (h, t): evidence.roles.alike(head, relation, "head")[h] for h, t in others if t == tail
        }
        if relation != COMBINES_WITH or head != tail:
            likeness |= {
                (h, t): evidence.roles.alike(tail, relation, "tail")[t]
                for h, t in others
                if h == head
            }
        expected = {
            (h, relation, t): max(float(value), 0.0) ** POWER for (h, t), value in likeness.items()
        }
        triples, weights = evidence.weights(head, relation, tail)
        found = dict(zip(map(tuple, triples.tolist()), weights.tolist(), strict=True))
        assert found == pytest.approx(expected, abs=1e-6)
        assert len(found) == len(triples)
        kinds.add((relation, head == tail, (head, relation, tail) in links, bool(found)))
    assert len(kinds) > 6, "the graph has too few kinds of links"


def test_those_that_say_most_come_first_with_their_share_of_all_evidence(evidence):
    for head, relation, tail in product(
        range(LINK_EVIDENCE_SIZE), range(len(RELATIONS)), range(LINK_EVIDENCE_SIZE)
    ):
        everything = evidence.reason(head, relation, tail, limit=1_000)
        weights = [witness.weight for witness in everything.witnesses]
        assert weights == sorted(weights, reverse=True)
        assert all(weight > 0 for weight in weights)
        assert everything.evidence == pytest.approx(sum(weights))
        assert sum(witness.share for witness in everything.witnesses) == pytest.approx(
            1.0 if weights else 0.0
        )
        assert evidence.reason(head, relation, tail, limit=2).witnesses == everything.witnesses[:2]


def test_a_witness_names_its_recipes_and_a_learned_link_its_own(evidence):
    """A witness names the recipes that give it and a learned link its own."""
    links = slow_links(KNOWN.tolist())
    of_label = {label: i for i, label in enumerate(GRAPH.entities)}
    learned = 0
    for head, relation, tail in product(
        range(LINK_EVIDENCE_SIZE), range(len(RELATIONS)), range(LINK_EVIDENCE_SIZE)
    ):
        reason = evidence.reason(head, relation, tail)
        own = [
            Recipe.of(*GRAPH.labels(KNOWN[row])) for row in links.get((head, relation, tail), [])
        ]
        assert list(reason.learned_from) == own[:RECIPES]
        assert reason.more == max(len(own) - RECIPES, 0)
        assert bool(reason.learned_from) == ((head, relation, tail) in links)
        learned += bool(reason.learned_from)
        for witness in reason.witnesses:
            link = (of_label[witness.head], relation, of_label[witness.tail])
            rows = links[link]
            assert len(witness.recipes) + witness.more == len(rows)
            assert set(witness.recipes) <= {Recipe.of(*GRAPH.labels(KNOWN[row])) for row in rows}
    assert 0 < learned < 2 * LINK_EVIDENCE_SIZE**2


def test_a_link_that_many_recipes_give_names_some_and_counts_the_others():
    graph = RecipeGraph.from_recipes(
        [("water", other, "ice") for other in ("air", "cold", "snow", "time", "winter")]
    )
    water, ice = graph.id_of("water"), graph.id_of("ice")
    reason = LinkEvidence(scorer_of(graph), graph.recipes).reason(water, COMPONENT_OF, ice)
    assert [recipe.ingredients[0] for recipe in reason.learned_from] == ["air", "cold", "snow"]
    assert reason.more == 2


def test_without_recipes_nothing_speaks():
    reason = LinkEvidence(scorer_of(GRAPH), KNOWN[:0]).reason(0, COMBINES_WITH, 1)
    assert (reason.evidence, reason.witnesses, reason.learned_from) == (0, (), ())
