"""The features of a pair and a goal, and the scores that a ranker makes of them: against loops, and
in any order."""

import math
from itertools import product

import numpy as np
import pytest
import torch
from link_helpers import random_graph

from wordcraft_kg.models.recipes.base import Base
from wordcraft_kg.models.scorers.kernel import cosines, normalised
from wordcraft_kg.models.scorers.pair_features import (
    EVIDENCE,
    FEATURES,
    FLOOR,
    RecipeKnowledge,
    knowledge_of,
)
from wordcraft_kg.models.scorers.pair_knowledge import LEAST_SHARE, pairs_of
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker

SIZE = 12


def knowledge(seed, num_recipes=70):
    """What random recipes of 12 entities say, with a random ranker; more of them than may speak for
    a goal."""
    graph = random_graph(seed, SIZE, num_recipes)
    draws = torch.Generator().manual_seed(seed)
    text = cosines(torch.randn(SIZE, 6, generator=torch.Generator().manual_seed(99)))
    base = Base.of(graph.recipes, text)
    pairs, parts = torch.randn(2, SIZE, SIZE, generator=draws)
    links = (pairs + pairs.T, parts)  # combinesWith is symmetric
    found = knowledge_of(base.recipes, base.kernel, text, (base.pairs, base.parts), links)
    shapes = {"first": (len(FEATURES), 8), "first_bias": (8,), "second": (8,), "bias": ()}
    drawn = {name: torch.randn(shapes[name], generator=draws) for name in RANKER}
    return found.with_ranker(Ranker(**drawn))


@pytest.fixture(scope="module")
def known():
    return knowledge(0)


def tables(rows=30, slots=6, seed=0):
    """Goals and tables with the same entity twice, goals on the table, and empty slots between
    others."""
    rng = np.random.default_rng(seed)
    table = torch.from_numpy(rng.integers(SIZE + 1, size=(rows, slots)))
    table[:3, 1] = table[:3, 0]
    table[3:6, 2] = SIZE
    goal = torch.from_numpy(rng.integers(SIZE, size=rows))
    table[6:9, 3] = goal[6:9]
    return goal, table


def slow_features(known, a, b, goal, model):
    """Every feature of a pair, by its definition."""
    parts, pairs = known.parts[model].double(), known.pairs[model].double()
    words, alike, counts = (
        known.words.double(),
        known.alike[model].double(),
        known.counts[model].double(),
    )
    results = known.results[model, int(known.numbers[model, a, b])].tolist()
    evidence = words_evidence = 0.0
    for one, other, result in known.supporting[model, goal].tolist():
        k, t = (lambda x, y: float(alike[x, y])), (lambda x, y: max(float(words[x, y]), 0) ** 4)
        evidence += k(goal, result) * (k(a, one) * k(b, other) + k(b, one) * k(a, other))
        words_evidence += t(goal, result) * (t(a, one) * t(b, other) + t(b, one) * t(a, other))
    of_a, of_b = (
        [
            float(parts[x, goal, 0]),
            float(parts[x, goal, 1]),
            float(words[x, goal]),
            float(counts[x, 0]),
        ]
        for x in (a, b)
    )
    of_slots = list(zip(("part", "link", "words", "uses"), of_a, of_b, strict=True))
    return {
        **{f"{name}_sum": x + y for name, x, y in of_slots},
        **{f"{name}_min": min(x, y) for name, x, y in of_slots},
        "pair": float(pairs[a, b, 0]),
        "pair_link": float(pairs[a, b, 1]),
        "known": float(bool(set(results) - {SIZE})),
        "makes": float(goal in results),
        "words_pair": float(words[a, b]),
        "itself": float(a == b),
        "made": float(counts[goal, 1]),
        "evidence": math.log(evidence + FLOOR),
        "words_evidence": math.log(words_evidence + FLOOR),
    }


def test_every_feature_is_what_its_definition_says():
    stack = RecipeKnowledge.stacked([knowledge(0), knowledge(1)])
    goal, table = tables()
    model = torch.arange(len(goal)) % 2
    found = stack.features(goal, table, model)
    one, other = pairs_of(table.shape[1], table.device)
    assert found.shape == (len(FEATURES), len(goal), len(one))
    for row in range(len(goal)):
        for pair, (i, j) in enumerate(zip(one.tolist(), other.tolist(), strict=True)):
            slow = slow_features(
                stack, int(table[row, i]), int(table[row, j]), int(goal[row]), int(model[row])
            )
            assert tuple(slow) == FEATURES
            torch.testing.assert_close(
                found[:, row, pair], torch.tensor(list(slow.values())), rtol=1e-3, atol=1e-3
            )


def test_the_tables_count_recipes_that_speak_for_a_goal(known):
    """The tables count recipes and say which of them may speak for a goal."""
    graph = random_graph(0, SIZE, 70)
    recipes = graph.recipes.tolist()
    alike = normalised(Base.of(graph.recipes, known.words[:-1, :-1].float()).kernel) ** 2
    assert len(recipes) > EVIDENCE
    for entity in range(SIZE):
        uses = sum((a == entity) + (b == entity) for a, b, _ in recipes)
        made = sum(result == entity for _, _, result in recipes)
        assert known.counts[0, entity].tolist() == pytest.approx(
            [math.log1p(uses), math.log1p(made)]
        )
        supporting = [tuple(recipe) for recipe in known.supporting[0, entity].tolist()]
        assert len(set(supporting)) == EVIDENCE
        # The recipes of the results most like it; there are more recipes of some entities than may
        # speak.
        likeness = {tuple(recipe): float(alike[entity, recipe[2]]) for recipe in recipes}
        left_out = [likeness[recipe] for recipe in likeness if recipe not in supporting]
        assert max(left_out) <= min(likeness[recipe] for recipe in supporting) + 1e-3
        assert sum(recipe[2] == entity for recipe in supporting) == min(made, EVIDENCE)
    for a, b in product(range(SIZE), repeat=2):
        made_of = {result for one, other, result in recipes if {a, b} == {one, other}}
        assert set(known.results[0, known.numbers[0, a, b]].tolist()) - {SIZE} == made_of


def test_the_order_of_a_pair_and_of_the_slots_does_not_matter(known):
    goal, table = tables()
    model = torch.zeros_like(goal)
    scores = known(goal, table, model)
    torch.testing.assert_close(scores, scores.transpose(1, 2), rtol=0, atol=0)
    order = torch.from_numpy(np.random.default_rng(3).permutation(table.shape[1]))
    moved = known(goal, table[:, order], model)
    torch.testing.assert_close(moved, scores[:, order][:, :, order], rtol=1e-4, atol=1e-4)


def test_a_pair_with_an_empty_slot_has_no_score_and_changes_none(known):
    goal, table = tables()
    model = torch.zeros_like(goal)
    scores = known(goal, table, model)
    is_empty = table == SIZE
    assert is_empty.any()
    assert torch.equal(torch.isneginf(scores), is_empty[:, :, None] | is_empty[:, None])
    wider = known(goal, torch.cat([table, torch.full_like(table, SIZE)], dim=1), model)
    torch.testing.assert_close(wider[:, :6, :6], scores, rtol=1e-4, atol=1e-4)


def test_a_stack_answers_as_each_of_its_models_does():
    models = [knowledge(seed) for seed in range(3)]
    stack, (goal, table) = RecipeKnowledge.stacked(models), tables()
    answers = []
    for number, one in enumerate(models):
        alone = one(goal, table, torch.zeros_like(goal))
        torch.testing.assert_close(
            stack(goal, table, torch.full_like(goal, number)), alone, rtol=1e-5, atol=1e-5
        )
        answers.append(alone)
    model = torch.arange(len(goal)) % 3
    expected = torch.stack(answers)[model, torch.arange(len(goal))]
    torch.testing.assert_close(stack(goal, table, model), expected, rtol=1e-5, atol=1e-5)


def _reason_order(one, goal):
    is_for_goal = one.recipe[2] == goal and one.share >= LEAST_SHARE
    return not is_for_goal, -one.share


def test_reasons_for_the_goal_come_before_stronger_others():
    """Reasons for the goal itself come before stronger ones for other results."""
    known, goals_first, weak = knowledge(0), 0, 0
    for a, b, goal in product(range(SIZE), repeat=3):
        found = known.supporting_recipes(a, b, goal, limit=EVIDENCE)
        if not found:
            continue
        strongest = max(found, key=lambda one: one.share)
        for_goal = [one for one in found if one.recipe[2] == goal]
        if any(one.share >= LEAST_SHARE for one in for_goal):
            assert found[0].recipe[2] == goal
            goals_first += strongest.recipe[2] != goal
        else:  # a recipe for the goal that hardly counts is no reason
            assert found[0].share == strongest.share
            weak += bool(for_goal)
    assert goals_first > 10
    assert weak > 0


@pytest.mark.parametrize("num_recipes", [70, 3])
def test_those_who_speak_are_the_terms_of_the_evidence(num_recipes):
    stack = RecipeKnowledge.stacked([knowledge(0, num_recipes), knowledge(1, num_recipes)])
    recipes = {tuple(row) for row in random_graph(1, SIZE, num_recipes).recipes.tolist()}
    for a, b, goal in ((0, 1, 2), (3, 3, 4), (5, 6, 5), *list(recipes)[:3]):
        terms = {}
        for one, other, result in stack.supporting[1, goal].tolist():
            k = [
                float(stack.alike[1][cell])
                for cell in ((a, one), (b, other), (a, other), (b, one), (goal, result))
            ]
            k = [max(cell, 0) for cell in k]
            both = max(min(k[0], 1) * min(k[1], 1), min(k[2], 1) * min(k[3], 1))
            terms[one, other, result] = (k[4] * (k[0] * k[1] + k[2] * k[3]), min(k[4], 1) * both)
        total = sum(term for term, _ in terms.values())
        found = stack.supporting_recipes(a, b, goal, model=1, limit=EVIDENCE)
        assert stack.supporting_recipes(b, a, goal, model=1, limit=EVIDENCE) == found
        assert [one.recipe for one in found] == [
            one.recipe for one in sorted(found, key=lambda one: _reason_order(one, goal))
        ]
        assert {one.recipe for one in found} == {
            recipe for recipe, (_, weight) in terms.items() if weight > 0
        }
        for one in found:
            assert one.recipe in recipes
            assert one.share == pytest.approx(terms[one.recipe][0] / total, rel=1e-4)
            assert one.weight == pytest.approx(terms[one.recipe][1], rel=1e-4)
        assert sum(one.share for one in found) == pytest.approx(1 if found else 0, abs=1e-4)
        if (a, b, goal) in recipes:
            assert (found[0].recipe, found[0].weight) == ((a, b, goal), 1)
        assert stack.supporting_recipes(a, b, goal, model=1, limit=2) == found[:2]
