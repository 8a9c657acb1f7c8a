"""The links and recipes that speak for a link, against loops over all links of training."""

from itertools import product

import numpy as np
import pytest
from link_helpers import random_graph
from small_scorers import normal

from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, Recipe, RecipeGraph
from wordcraft_kg.graphs.train_samples import draw_train_sample
from wordcraft_kg.models.scorers.baselines import NeighbourScorer
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.link_evidence import POWER, RECIPES, LinkEvidence

GRAPH = random_graph(num_entities=9, num_recipes=40)
SIZE = GRAPH.num_entities
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
    for head, relation, tail in product(range(SIZE), range(len(RELATIONS)), range(SIZE)):
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
    for head, relation, tail in product(range(SIZE), range(len(RELATIONS)), range(SIZE)):
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
    for head, relation, tail in product(range(SIZE), range(len(RELATIONS)), range(SIZE)):
        reason = evidence.reason(head, relation, tail)
        own = [
            Recipe.of(*GRAPH.labels(KNOWN[row])) for row in links.get((head, relation, tail), [])
        ]
        assert list(reason.learned_from) == own[:RECIPES]
        assert reason.more == max(len(own) - RECIPES, 0)
        assert reason.is_in_sample == ((head, relation, tail) in links)
        learned += reason.is_in_sample
        for witness in reason.witnesses:
            link = (of_label[witness.head], relation, of_label[witness.tail])
            rows = links[link]
            assert len(witness.recipes) + witness.more == len(rows)
            assert set(witness.recipes) <= {Recipe.of(*GRAPH.labels(KNOWN[row])) for row in rows}
    assert 0 < learned < 2 * SIZE**2


def test_a_link_that_many_recipes_give_names_some_and_counts_the_others():
    graph = RecipeGraph.from_recipes(
        [("water", other, "ice") for other in ("air", "cold", "snow", "time", "winter")]
    )
    water, ice = graph.id_of("water"), graph.id_of("ice")
    reason = LinkEvidence(scorer_of(graph), graph.recipes).reason(water, COMPONENT_OF, ice)
    assert [recipe.ingredients[0] for recipe in reason.learned_from] == ["air", "cold", "snow"]
    assert reason.more == 2


def test_recipes_of_a_dose_speak_as_they_were_taught(opened_kitchen):
    graph = opened_kitchen.graph
    train_sample = draw_train_sample(opened_kitchen.split, train_fraction=0.5, label_noise=0.5)
    evidence = LinkEvidence(NeighbourScorer(graph, train_sample.triples), train_sample.recipes)
    a, _, result = train_sample.among(train_sample.is_wrong)[0].tolist()
    assert evidence.reason(a, COMPONENT_OF, result).is_in_sample
    right = graph.recipes[np.flatnonzero(train_sample.is_wrong)[0], 2]
    assert not evidence.reason(a, COMPONENT_OF, int(right)).is_in_sample


def test_without_recipes_nothing_speaks():
    reason = LinkEvidence(scorer_of(GRAPH), KNOWN[:0]).reason(0, COMBINES_WITH, 1)
    assert (reason.evidence, reason.witnesses, reason.learned_from) == (0, (), ())
