import itertools
import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
import torch
from helpers import refuses
from scipy.optimize import minimize
from scipy.spatial import distance

from wordcraft_kg import load_scorer
from wordcraft_kg.agents import recipe_discovery
from wordcraft_kg.agents.discovery import (
    DISCOVERERS,
    BookDiscoverer,
    GreedyDiscoverer,
    make_discoverers,
    play_runs,
)
from wordcraft_kg.agents.recipe_discovery import (
    CANDIDATES,
    COVER,
    DOUBT,
    FREE,
    PRIOR,
    RecipeDiscoverer,
)
from wordcraft_kg.envs.open_ended import Discovery, OpenEndedEnv
from wordcraft_kg.evaluation import discovery
from wordcraft_kg.evaluation.discovery import open_guide, view_discovery
from wordcraft_kg.graphs import Recipe, RecipeGraph
from wordcraft_kg.models.recipes.inductive import for_labels
from wordcraft_kg.models.scorers.features import glove_features

ATTEMPTS = 30

PLAYERS = [name for name in DISCOVERERS if name not in ("recipe-learner", "book-votes")]
"""Both others have tests of their own."""


def everybody(graph):
    return make_discoverers(PLAYERS, graph)


@pytest.fixture(scope="module")
def curves(kitchen):
    return play_runs(kitchen, everybody(kitchen), ATTEMPTS, runs=20)


@pytest.mark.parametrize("has_scorer", [False, True])
def test_nearest_words_tries_the_most_similar_untried_pair(kitchen, recipes_folder, has_scorer):
    """By GloVe's vectors, or by those of the scorer beside it."""
    vectors, unit_vectors = glove_features(kitchen.entities).vectors, None
    if has_scorer:
        guide = open_guide(recipes_folder, kitchen)
        unit_vectors = guide.unit_vectors()
        scorer = guide.recipes.scorer
        rows = [scorer.entities.index(label) for label in kitchen.entities]
        vectors = scorer.knowledge.vectors[rows].float().numpy()
        assert vectors.shape[1] == 384  # MiniLM's
    player = make_discoverers(["nearest-words"], kitchen, unit_vectors=unit_vectors)[
        "nearest-words"
    ]
    game, tried = Discovery(kitchen), set()
    player.begin(game.base, np.random.default_rng(0))
    for _ in range(ATTEMPTS):
        pairs = set(itertools.combinations_with_replacement(sorted(game.known), 2)) - tried
        cosine = {(a, b): 1 - distance.cosine(vectors[a], vectors[b]) for a, b in pairs}
        pair = player.choose()
        chosen = (min(pair), max(pair))
        assert cosine[chosen] >= max(cosine.values()) - 1e-5
        tried.add(chosen)
        player.observe(pair, game.combine(*pair)[0])


@pytest.mark.parametrize("name", PLAYERS)
def test_a_player_in_the_environment_has_the_same_curve(kitchen, curves, name):
    """A player in the environment draws the same curve, is never illegal and repeats no pair."""
    player = everybody(kitchen)[name]
    env = OpenEndedEnv(kitchen, max_attempts=ATTEMPTS)
    for run in range(3):
        _, info = env.reset()
        player.begin(kitchen.base_ids.tolist(), np.random.default_rng([0, run]))
        seen, terminated = [info["known"]], False
        while not terminated:
            pair = player.choose()
            observation, _, terminated, _, info = env.step(pair)
            player.observe(pair, info["new_entities"])
            seen.append(info["known"])
            assert not info["repeated"]
            assert not info["illegal_action"]
            assert set(player.known) == set(np.flatnonzero(observation["known"]).tolist())
        curve = curves[name][run]
        assert seen == curve.tolist()[: len(seen)]
        assert (curve[len(seen) :] == info["known"]).all()


def test_a_curve_depends_on_the_seed_and_not_on_who_else_plays(kitchen, curves):
    alone = play_runs(kitchen, make_discoverers(["greedy"], kitchen), ATTEMPTS, runs=20)
    np.testing.assert_array_equal(alone["greedy"], curves["greedy"])
    again, other = (
        play_runs(
            kitchen, make_discoverers(["random-no-repeat"], kitchen), ATTEMPTS, runs=20, seed=seed
        )["random-no-repeat"]
        for seed in (0, 1)
    )
    np.testing.assert_array_equal(again, curves["random-no-repeat"])
    assert (again != other).any()


def best_pairs(values):
    highest = max(values.values())
    return {pair for pair, value in values.items() if math.isclose(value, highest, rel_tol=1e-9)}


def slow_oracle_values(graph, known, worth):
    """Return the value of every pair of known entities."""
    values = dict.fromkeys(itertools.product(known, repeat=2), 0)
    for pair in values:
        values[pair] = sum(
            worth(c)
            for c in {r for a, b, r in graph.recipes.tolist() if (a, b) == pair} - set(known)
        )
    return values


def slow_out_degree(graph):
    return lambda c: 1 + sum(c in (a, b) for a, b, _ in graph.recipes.tolist())


def test_the_oracle_takes_the_pair_of_the_highest_value(kitchen):
    game, player = Discovery(kitchen), GreedyDiscoverer(kitchen)
    player.begin(game.base, np.random.default_rng(0))
    for _ in range(12):
        values = slow_oracle_values(kitchen, list(game.known), slow_out_degree(kitchen))
        pair = player.choose()
        assert pair in best_pairs(values)
        player.observe(pair, game.combine(*pair)[0])


def test_the_summary_gives_means_and_intervals():
    # The standard deviation of 6, 8, 10 is 2; no run knows less than the 5 of its start.
    known = discovery._known(np.array([6, 8, 10]), (5.0, math.inf))
    assert (known.mean, known.low) == (8, 5)
    assert known.high == pytest.approx(8 + 4.30265273 * 2 / math.sqrt(3))
    single = discovery._known(np.array([6]), (5.0, math.inf))
    assert (single.mean, single.low, single.high) == (6, None, None)


def test_book_votes_tries_the_pair_of_the_highest_value():
    """The documented value, with loops, in a world whose labels the other book knows in part."""
    rng = np.random.default_rng(3)
    labels = [f"thing {number}" for number in range(14)]

    def drawn(some, share):
        rows = []
        for a, b in itertools.combinations_with_replacement(some, 2):
            rows += [(a, b, c) for c in some if c not in (a, b) and rng.random() < share]
        return rows

    world = RecipeGraph.from_recipes(drawn(labels, 0.03), labels[:5])
    other = RecipeGraph.from_recipes(drawn([*labels[2:10], "strange"], 0.08))
    book = [other.labels(row) for row in other.recipes.tolist()]

    def votes(x, c):
        return sum(x in recipe[:2] and recipe[2] == c for recipe in book)

    def value(a, b, known):
        total = 0.0
        for c in set(other.entities) - known:
            total += (*sorted((a, b)), c) in book
            made = sum(recipe[2] == c for recipe in book)
            if a != b:
                total += votes(a, c) * votes(b, c) / (1 + made) ** 2
        return total

    player = BookDiscoverer(world, other)
    game = Discovery(world)
    player.begin(game.base, np.random.default_rng(0))
    tried = set()
    values = []
    while len(tried) < 40 and not game.is_complete:
        known = list(game.known)
        names = set(world.labels(known))
        pairs = set(itertools.combinations_with_replacement(sorted(known), 2)) - tried
        expected = {pair: value(*world.labels(pair), names) for pair in pairs}
        pair = player.choose()
        chosen = (min(pair), max(pair))
        assert expected[chosen] == pytest.approx(max(expected.values()), abs=1e-5)
        values.append(expected[chosen])
        tried.add(chosen)
        new, repeated = game.combine(*pair)
        assert not repeated
        player.observe(pair, new)
    assert max(values) > 1 > min(values)
    with refuses("book"):
        make_discoverers(["book-votes"], world)


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


def test_recipes_that_a_scorer_has_seen_are_counted(recipes_folder, kitchen):
    # Each result is a made entity, and every second recipe takes the one of the next.
    rows = kitchen.recipe_labels()
    turned = [*rows[1:], rows[0]]
    changed = [
        row if place % 2 else Recipe(row.ingredients, following.result)
        for place, (row, following) in enumerate(zip(rows, turned, strict=True))
    ]
    wrong = RecipeGraph.from_recipes(changed, kitchen.base)
    guide = open_guide(recipes_folder, wrong)
    trained = {tuple(kitchen.labels(row)) for row in guide.recipes.scorer.recipes.tolist()}
    recipes = {tuple(wrong.labels(row)) for row in wrong.recipes.tolist()}
    assert guide.shared == len(trained & recipes)


def test_a_world_of_one_entity_or_of_thousands_of_results_of_a_pair():
    one = RecipeGraph(["water"], np.empty((0, 3), dtype=np.int64), [0], "one")
    with refuses("base"):
        view_discovery(one, ["greedy"])
    rows = [("a", "b", f"thing {number}") for number in range(5_000)]
    many = RecipeGraph.from_recipes(rows, ["a", "b"])
    view = view_discovery(many, ["random-no-repeat", "greedy"], attempts=4, runs=1)
    assert view.players["greedy"]["1"].mean == 5_002
