"""w: the score of a slot's recipe with the entity held or with its best partner, and which recipes
speak for it."""

import numpy as np
import pytest
import torch
from small_scorers import states as states_of

from wordcraft_kg import WordCraftConfig, World, make_sources
from wordcraft_kg.agents import states as engine_states
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.graphs.folds import OUTSIDE
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer


@pytest.fixture(scope="module")
def scorer(cross_fitted):
    return cross_fitted.whole


@pytest.fixture(scope="module")
def w(scorer):
    (source,) = make_sources(["w"], scorer)
    return source


def states(size, rows=40):
    """States in which the entity held is often on the table."""
    goal, selection, table = states_of(size, rows, 6)
    table[:, 4:] = torch.where(torch.arange(rows)[:, None] % 3 == 0, size, table[:, 4:])
    selection[::4] = table[::4, 2]
    return goal, selection, table


def slow_w(scorer, goal, held, table):
    """W by its definition, slot by slot; empty slots have 0."""
    size = len(scorer.entities)
    partners = [held] if held != size else [entity for entity in table if entity != size]
    return [
        0.0 if entity == size else float(scorer.score_recipes(entity, partners, goal).max())
        for entity in table
    ]


def test_w_is_the_score_with_the_entity_held_or_with_the_best_partner(w, scorer):
    goal, selection, table = states(w.num_entities)
    found = w(States(goal, selection, table))
    for row in range(len(goal)):
        expected = slow_w(scorer, int(goal[row]), int(selection[row]), table[row].tolist())
        torch.testing.assert_close(found[row], torch.tensor(expected), rtol=1e-4, atol=1e-4)
        single = w(States(goal[row : row + 1], selection[row : row + 1], table[row : row + 1]))
        torch.testing.assert_close(single[0], found[row], rtol=1e-4, atol=1e-4)


def test_permuting_the_slots_permutes_w(w):
    goal, selection, table = states(w.num_entities)
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    expected = w(States(goal, selection, table))[:, order]
    torch.testing.assert_close(
        w(States(goal, selection, table[:, order])), expected, rtol=1e-4, atol=1e-4
    )


def test_the_scores_that_are_kept_do_not_answer_for_another_state(scorer):
    (kept,) = make_sources(["w"], scorer)
    goal, selection, table = states(kept.num_entities)
    first = kept(States(goal, selection, table))
    changed = table.clone()
    changed[:, 0] = (changed[:, 0] + 1) % kept.num_entities
    (fresh,) = make_sources(["w"], scorer)
    torch.testing.assert_close(
        kept(States(goal, selection, changed)),
        fresh(States(goal, selection, changed)),
        rtol=0,
        atol=0,
    )
    torch.testing.assert_close(kept(States(goal, selection, table)), first, rtol=0, atol=0)
    table[:, 0] = changed[:, 0]  # in place, as an engine does
    torch.testing.assert_close(
        kept(States(goal, selection, table)), fresh(States(goal, selection, table)), rtol=0, atol=0
    )


def test_train_tasks_have_w_and_evidence_out_of_sample(cross_fitted, opened):
    """Train tasks have w and evidence of the scorer without their recipes."""
    world = World(opened, WordCraftConfig(part="all", num_distractors=3))
    (source,) = make_sources(["w"], cross_fitted, tasks=world.tasks)
    state = engine_states.states_of(
        BatchEngine(world, len(world.tasks)).pose(np.arange(len(world.tasks)))
    )
    found = source(state)
    seen = set()
    for row in range(0, len(world.tasks), 8):
        folds = {
            int(cross_fitted.of_recipe[step]) for plan in world.tasks.plans[row] for step in plan
        } - {OUTSIDE}
        one = state.rows(row, row + 1)
        evidence = source.evidence(one)
        seen.add(len(folds))
        if len(folds) > 1:  # every model has seen one of its recipes
            assert not found[row].any()
            assert evidence == (None,) * len(evidence)
            continue
        model = cross_fitted.left_out(*folds) if folds else cross_fitted.whole
        assert isinstance(model, RecipeScorer)
        table = one.table[0].tolist()
        expected = slow_w(model, int(one.goal), source.num_entities, table)
        torch.testing.assert_close(found[row], torch.tensor(expected), rtol=1e-4, atol=1e-4)
        plans = {tuple(opened.graph.recipes[plan[-1]].tolist()) for plan in world.tasks.plans[row]}
        for slot, entity in enumerate(table):
            told = evidence[slot]
            assert (told is None) == (entity == source.num_entities)
            if told is None:
                continue
            score = float(model.score_recipes(entity, told.partner, int(one.goal)))
            assert score == pytest.approx(expected[slot], abs=1e-3)
            labels = [model.entities[part] for part in (entity, told.partner, int(one.goal))]
            spoken = [
                tuple(model.entities[part] for part in supporting.recipe)
                for supporting in told.supporting
            ]
            assert spoken == [
                tuple(witness.recipe) for witness in model.supporting_recipes(*labels, limit=3)
            ]
            assert not plans & {supporting.recipe for supporting in told.supporting}
    assert seen == {0, 1, 2}


def test_the_partner_of_a_slot_is_the_entity_held(w):
    nothing = w.num_entities
    goal, selection, table = (
        torch.tensor([7]),
        torch.tensor([3]),
        torch.tensor([[3, 4, nothing, 5]]),
    )
    evidence = w.evidence(States(goal, selection, table))
    assert [told and told.partner for told in evidence] == [3, 3, None, 3]
    assert all(len(told.supporting) <= 3 for told in evidence if told)


def test_sources_of_links_have_no_evidence_and_a_scorer_of_links_has_no_w(scorer):
    links = TableScorer(
        torch.stack([scorer.table(0), scorer.table(1)]),
        scorer.entities,
        scorer.graph_hash,
        name="links",
    )
    (v,) = make_sources(["v"], links)
    goal, selection, table = states(v.num_entities, rows=1)
    assert v.evidence(States(goal, selection, table)) == (None,) * 6
    with pytest.raises(ConfigError, match="needs recipe scores"):
        BestRecipe.of_scorer(links, None)
