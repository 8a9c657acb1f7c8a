"""The player that learns from its attempts, in a book that its recipe scorer does not have."""

import itertools
import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

from wordcraft_kg.agents import recipe_discovery
from wordcraft_kg.agents.recipe_discovery import (
    CANDIDATES,
    COVER,
    DOUBT,
    FREE,
    PRIOR,
    RecipeDiscoverer,
)
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.graphs import RecipeGraph
from wordcraft_kg.models.recipes.inductive import for_labels
from wordcraft_kg.models.scorers.folder import load_scorer

NEW = ("castle", "dragon", "river")
"""Entities that the kitchen lacks."""


@pytest.fixture(scope="module")
def world(kitchen):
    """Another book: shared and new entities, results drawn at random."""
    rng = np.random.default_rng(0)
    labels = sorted((*rng.permutation(kitchen.entities)[:15].tolist(), *NEW))
    pairs = np.array(list(itertools.combinations_with_replacement(range(len(labels)), 2)))
    rows = np.column_stack([pairs, rng.integers(len(labels), size=len(pairs))])[
        rng.random(len(pairs)) < 0.4
    ]
    base = [0, 1, 2, labels.index("dragon")]
    return RecipeGraph(labels, rows[~(rows[:, :2] == rows[:, 2:]).any(axis=1)], base)


@pytest.fixture(scope="module")
def labelled(recipes_folder, world):
    return for_labels(recipes_folder, load_scorer(recipes_folder), world.entities)


def play(player, graph, attempts, seed=0):
    """Return the tried pairs and whether each made something new."""
    game, log = Discovery(graph), []
    player.begin(game.base, np.random.default_rng(seed))
    while len(log) < attempts and not game.is_complete:
        pair = player.choose()
        new, repeated = game.combine(*pair)
        assert not repeated
        player.observe(pair, new)
        log.append((pair, len(new) > 0))
    return log


class Slow:
    """The documented formulas, with loops and a general optimiser."""

    def __init__(self, labelled, graph):
        self.scorer, self.own, self.rows = labelled
        self.entities = graph.entities
        self.recipes = self.scorer.recipes.tolist()
        self.scores, self.uses = cache(self._scores), cache(self._uses)
        self.failures = Counter()

    def _scores(self, a, b):
        return self.scorer.score_recipes(a, b, range(self.own)).tolist()

    def _uses(self, entity):
        """log(1 + recipes that use an entity); a + a is one recipe."""
        if entity >= self.own:
            return 0
        return math.log1p(sum(entity in recipe[:2] for recipe in self.recipes))

    def features_and_worth(self, pair, known):
        a, b = (int(self.rows[entity]) for entity in pair)
        scores = self.scores(a, b)
        likely = sorted(range(self.own), key=lambda c: -scores[c])[:CANDIDATES]
        known_rows = {int(self.rows[k]) for k in known}
        chances = {}
        for c in likely:
            doubt = DOUBT * math.log1p(self.failures[c])
            chances[c] = math.exp(-12 if c in known_rows else scores[c] - doubt)
        self.shares = {c: chance / sum(chances.values()) for c, chance in chances.items()}
        total = sum(chances.values())
        words = float(self.scorer.knowledge.word_cosines(a, torch.tensor([b])))
        recorded = any(sorted(recipe[:2]) == sorted((a, b)) for recipe in self.recipes)
        strange = (a >= self.own) + (b >= self.own)
        features = [
            1,
            math.log(total),
            self.uses(a) + self.uses(b),
            strange,
            words,
            recorded,
            a == b,
        ]
        return np.array(features, dtype=float), 1 + sum(
            p * self.uses(c) for c, p in chances.items()
        ) / total

    def weights(self, features, made):
        mean, variance = np.array(list(PRIOR.values())).T
        signs = np.where(made, 1, -1)

        def loss(weights):
            return (
                np.logaddexp(0, -signs * (features @ weights)).sum()
                + ((weights - mean) ** 2 / variance).sum() / 2
            )

        return minimize(loss, mean, method="BFGS").x


def test_the_player_tries_the_pair_of_the_highest_value_given_its_outcomes(
    labelled, world, monkeypatch
):
    monkeypatch.setattr(recipe_discovery, "_LIKELY", labelled.own)
    slow, player = Slow(labelled, world), RecipeDiscoverer(labelled)
    game, tried, seen, made = Discovery(world), set(), [], []
    attempts = Counter()
    player.begin(game.base, np.random.default_rng(1))
    for attempt in range(30):
        known = list(game.known)
        pair = player.choose()
        features = player._seen[-1]
        found = {
            p: slow.features_and_worth(p, known)
            for p in itertools.combinations_with_replacement(sorted(known), 2)
            if p not in tried
        }
        chosen = (min(pair), max(pair))
        np.testing.assert_allclose(features, found[chosen][0], atol=1e-3)
        is_cover = (attempt + 1) % COVER == 0
        if attempt >= FREE and (is_cover or attempt % 5 == 0):
            weights = slow.weights(np.array(seen), np.array(made))
            values = {
                pair: worth / (1 + math.exp(-x @ weights)) for pair, (x, worth) in found.items()
            }
            if is_cover:
                least = min(min(attempts[one], attempts[other]) for one, other in values)
                values = {
                    p: value
                    for p, value in values.items()
                    if min(attempts[p[0]], attempts[p[1]]) == least
                }
            assert values.get(chosen, 0) >= 0.97 * max(values.values())
        tried.add(chosen)
        attempts.update(set(pair))
        new, _ = game.combine(*pair)
        player.observe(pair, new)
        if not new:
            slow.features_and_worth(chosen, known)
            slow.failures.update(slow.shares)
        seen.append(found[chosen][0])
        made.append(len(new) > 0)
    assert any(made[FREE:])
    assert not all(made)


def test_no_attempt_depends_on_recipes_that_were_not_tried(labelled, world):
    player, rng = RecipeDiscoverer(labelled), np.random.default_rng(5)
    log = play(player, world, 25)
    tried = {(min(pair), max(pair)) for pair, _ in log}
    is_tried = np.array([(min(a, b), max(a, b)) in tried for a, b, _ in world.recipes.tolist()])
    others = np.column_stack(
        [np.sort(rng.integers(len(world.entities), size=(90, 2))), rng.integers(18, size=90)]
    )
    others = others[[(a, b) not in tried and c not in (a, b) for a, b, c in others.tolist()]]
    assert (~is_tried).sum() > 20
    replaced = RecipeGraph(
        world.entities, np.concatenate([world.recipes[is_tried], others]), world.base_ids
    )
    assert replaced.hash != world.hash
    assert play(player, replaced, 25) == log


def test_outcomes_change_later_attempts_and_runs_start_afresh(labelled, world):
    player = RecipeDiscoverer(labelled)
    log = play(player, world, 25)
    assert play(player, world, 25) == log
    assert play(player, world, 25, seed=1) != log
    barren = RecipeGraph(
        world.entities,
        np.array([[*sorted(log[FREE][0]), 17], [0, 1, 5], [1, 2, 6]]),
        world.base_ids,
    )
    assert [pair for pair, _ in play(player, barren, 25)] != [pair for pair, _ in log]


def test_labels_are_shared_described_by_words_or_without_any_word(recipes_folder, world):
    scorer = load_scorer(recipes_folder)
    found = for_labels(recipes_folder, scorer, (*world.entities, "zzqx"))
    assert found.own == len(scorer.entities)
    for label, row in zip((*world.entities, "zzqx"), found.rows.tolist(), strict=True):
        assert found.scorer.entities[row] == label
        assert (row >= found.own) == (label in (*NEW, "zzqx"))
    assert not found.scorer.knowledge.vectors[int(found.rows[-1])].any()
    assert math.isfinite(float(found.scorer.score_recipes("zzqx", "water", "plant")))


def test_a_thought_names_the_rule_the_chance_and_the_expected_result(labelled, world):
    player, game = RecipeDiscoverer(labelled), Discovery(world)
    slow = Slow(labelled, world)
    player.begin(game.base, np.random.default_rng(1))
    reasons = []
    for attempt in range(20):
        known = {int(labelled.rows[entity]) for entity in game.known}
        weights = player._weights.copy()
        pair = player.choose()
        thought = player.thought
        reasons.append(thought.reason)
        features, _ = slow.features_and_worth(pair, list(game.known))
        # The product's candidates are the likeliest of a shortlist, as in the documented formula.
        np.testing.assert_allclose(player._seen[-1][2:], features[2:], atol=1e-3)
        chance = 1 / (1 + math.exp(-player._seen[-1] @ weights))
        assert thought.chance == pytest.approx(chance, abs=1e-9)
        assert thought.expected not in known
        assert 0 < thought.share <= 1
        player.observe(pair, game.combine(*pair)[0])
        if attempt >= FREE:
            is_cover = (attempt + 1) % COVER == 0
            assert thought.reason == ("cover" if is_cover else "value")
    assert reasons[:FREE] == ["random start"] * FREE


def test_a_variant_shares_scores_and_has_other_numbers(labelled, world):
    player = RecipeDiscoverer(labelled)
    log = play(player, world, 25)
    trusting = player.variant(0)
    assert play(trusting, world, 25) == play(RecipeDiscoverer(labelled, doubt=0), world, 25)
    assert play(player, world, 25) == log
    assert play(player.variant(20 * DOUBT), world, 25) != log
    assert trusting._scored is player._scored
