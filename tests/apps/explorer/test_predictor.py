"""Open slots: truth, training status, ranks and reasons, against loops and the
ranking of reports."""

from itertools import product

import numpy as np
import pytest

from wordcraft_kg import ComplExConfig, LinksConfig, open_model, train_links
from wordcraft_kg.apps.explorer.predictor import NEW, LinkPredictor, recipes_giving
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS, is_in
from wordcraft_kg.models.scorers.ranking import rank_triples

SLOTS = list(product(range(0, 80, 9), range(len(RELATIONS)), ("head", "tail")))


def test_each_entity_of_a_slot_has_its_part_and_learned_mark(neighbours):
    """Each entity of a slot has the part of its triple and whether it was learned."""
    seen = set()
    for entity, relation, side in SLOTS:
        slot = neighbours.slot(entity, relation, side)
        triples = slot.triples(np.arange(neighbours.graph.num_entities))
        part = neighbours.split.part_of(triples)
        assert np.where(part < 0, NEW, part).tolist() == slot.part.tolist()
        assert (
            is_in(triples, neighbours.split.partial, neighbours.graph.num_entities).tolist()
            == slot.learned.tolist()
        )
        scores = neighbours.model.scorer.score(*triples.T[:1], relation, triples[:, 2])
        assert slot.scores.tolist() == pytest.approx(scores.flatten().tolist())
        seen |= set(slot.part.tolist())
    assert seen == {0, 1, 2, NEW}


def test_ranks_are_those_of_reports_whether_a_link_is_true_or_not(neighbours):
    graph = neighbours.graph
    for entity, relation, side in SLOTS:
        slot = neighbours.slot(entity, relation, side)
        triples = slot.triples(np.arange(graph.num_entities))
        ranked = rank_triples(neighbours.model.scorer, triples, graph.triples)
        expected = ranked[ranked["side"] == side]
        assert slot.ranks(np.arange(graph.num_entities)).tolist() == expected["rank"].tolist()
        for other in (0, 17, 40):
            found = slot.rank(other)
            assert (found.rank, found.candidates) == (
                expected["rank"].iloc[other],
                expected["candidates"].iloc[other],
            )


def test_the_best_leave_out_what_was_learned_unless_it_is_asked_for(neighbours):
    flour = neighbours.graph.id_of("flour")
    slot = neighbours.slot(flour, COMBINES_WITH, "tail")
    labels = neighbours.graph.entities
    by_score = sorted(range(len(labels)), key=lambda i: (-slot.scores[i], i))
    for with_learned in (False, True):
        answers = neighbours.best(slot, with_learned=with_learned, top=12)
        listed = [labels[i] for i in by_score if with_learned or not slot.learned[i]]
        assert [(row.entity, row.position) for row in answers.best] == list(
            zip(listed, range(1, 13), strict=False)
        )
        assert ("learned" in {row.status for row in answers.best}) == with_learned
        assert (answers.head, answers.relation, answers.tail) == ("flour", "combinesWith", None)


def test_beside_the_best_stands_what_is_true_and_was_not_learned(neighbours):
    compared = 0
    for entity, relation, side in SLOTS:
        slot = neighbours.slot(entity, relation, side)
        found = neighbours.best(slot, truth=1_000)
        true = [
            i
            for i in range(neighbours.graph.num_entities)
            if slot.part[i] != NEW and not slot.learned[i]
        ]
        assert {row.entity for row in found.truth} == {neighbours.graph.entities[i] for i in true}
        assert found.true_unlearned == len(true)
        assert found.true_learned == int(slot.learned.sum())
        assert [row.rank for row in found.truth] == sorted(row.rank for row in found.truth)
        assert {(row.status, row.known) for row in found.truth} <= {
            ("held out", "valid"),
            ("held out", "test"),
        }
        assert neighbours.best(slot, truth=2).truth == found.truth[:2]
        compared += len(true)
    assert compared > 20


@pytest.mark.parametrize("has_self_results", [False, True])
def test_an_entity_in_its_own_slot_is_marked_and_no_component_of_itself(
    neighbours, monkeypatch, has_self_results
):
    """Reading drops recipes that make their ingredient, unless a book is told to keep them."""
    monkeypatch.setattr(RecipeGraph, "has_self_results", has_self_results)
    for relation in (COMBINES_WITH, COMPONENT_OF):
        statuses = set()
        for label in neighbours.graph.entities:
            entity = neighbours.graph.id_of(label)
            slot = neighbours.slot(entity, relation, "tail")
            found = neighbours.best(slot, with_learned=True, top=1_000, witnesses=0)
            statuses |= {row.status for row in found.best if row.entity == label}
            assert "itself" not in {row.status for row in found.best if row.entity != label}
        is_proposed = relation == COMBINES_WITH or has_self_results
        assert ("itself" in statuses) == is_proposed


def test_each_prediction_names_links_of_training_that_speak_for_it(neighbours):
    known, named = {(a, b) for a, b, _ in neighbours.split.recipes("train").tolist()}, 0
    slot = neighbours.slot(3, COMBINES_WITH, "tail")
    for row in neighbours.best(slot, witnesses=3).best:
        assert not row.reason.is_in_sample
        for witness in row.reason.witnesses:
            pair = sorted(neighbours.graph.id_of(label) for label in (witness.head, witness.tail))
            assert tuple(pair) in known
            assert witness.recipes
            named += 1
    assert named > 10
    assert neighbours.best(slot, witnesses=0).best[0].reason is None


@pytest.fixture
def with_train_sample(parted_kitchen, tmp_path):
    """Train a tiny ComplEx on a dose of the train recipes."""

    def with_train_sample(**settings):
        config = LinksConfig(
            parted_kitchen.source, ComplExConfig(dim=2, epochs=1, n3=0.1, **settings)
        )  # type: ignore[arg-type]
        return LinkPredictor(
            "with_train_sample",
            tmp_path,
            open_model(train_links(config, tmp_path / "model").folder),
        )

    return with_train_sample


def test_what_a_dose_left_out_is_true_but_not_learned(with_train_sample):
    predictor = with_train_sample(folds=0, train_fraction=0.5)
    slots = [
        predictor.best(predictor.slot(*slot), with_learned=True, top=80, witnesses=0)
        for slot in SLOTS
    ]
    statuses = {(row.status, row.known) for slot in slots for row in slot.best}
    assert {("not learned", "train"), ("learned", "train"), ("held out", "test")} <= statuses
    assert ("learned", "test") not in statuses


def test_what_was_taught_wrong_is_learned_and_has_no_probability(with_train_sample):
    predictor = with_train_sample(folds=2, label_noise=0.5)
    train_sample = predictor.model.train_sample
    a, _, result = train_sample.among(train_sample.is_wrong)[0].tolist()
    found = predictor.best(
        predictor.slot(a, COMPONENT_OF, "tail"), with_learned=True, top=80, witnesses=0
    )
    (wrong,) = [row for row in found.best if row.entity == predictor.graph.entities[result]]
    assert (wrong.status, wrong.known, wrong.probability) == ("learned", "new", None)
    assert any(row.probability is not None for row in found.best)


def test_the_recipes_of_a_link_are_those_that_give_its_triple(neighbours):
    graph = neighbours.graph
    for head, relation, tail in graph.triples[::11].tolist():
        expected = [
            row
            for row, (a, b, c) in enumerate(graph.recipes.tolist())
            if (relation == COMBINES_WITH and (head, tail) in {(a, b), (b, a)})
            or (relation == COMPONENT_OF and head in (a, b) and tail == c)
        ]
        assert recipes_giving(graph, head, relation, tail).tolist() == expected
