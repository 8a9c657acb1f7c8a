import itertools
import math

import numpy as np
import pandas as pd
import pytest
from refusals import refuses
from scipy.spatial import distance

from wordcraft_kg.agents.discovery import (
    DISCOVERERS,
    NEVER,
    BookDiscoverer,
    EmpowermentDiscoverer,
    GreedyDiscoverer,
    make_discoverers,
    play_runs,
    summarise_curves,
)
from wordcraft_kg.envs.open_ended import Discovery, OpenEndedEnv
from wordcraft_kg.graphs import RecipeGraph
from wordcraft_kg.models.scorers.features import glove_features

ATTEMPTS = 30
PLAYERS = [name for name in DISCOVERERS if name not in ("recipe-learner", "book-votes")]
"""Both others have tests of their own."""


def curves_of(*arguments, **settings):
    """The curves of all runs."""
    return play_runs(*arguments, **settings).frame()


def everybody(graph):
    return make_discoverers(PLAYERS, graph)


@pytest.fixture(scope="module")
def curves(kitchen):
    return curves_of(kitchen, everybody(kitchen), ATTEMPTS, runs=20)


def test_nearest_words_tries_the_most_similar_untried_pair(kitchen):
    vectors, player = glove_features(kitchen.entities).vectors, everybody(kitchen)["nearest-words"]
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
    """A player in the environment draws the same curve and is never illegal."""
    player = everybody(kitchen)[name]
    env = OpenEndedEnv(kitchen, max_attempts=ATTEMPTS, illegal_action="raise")
    for run in range(3):
        _, info = env.reset()
        player.begin(kitchen.base_ids.tolist(), np.random.default_rng([0, run]))
        seen, terminated = [(info["known"], False)], False
        while not terminated:
            pair = player.choose()
            observation, _, terminated, _, info = env.step(pair)
            player.observe(pair, info["new_entities"])
            seen.append((info["known"], info["repeated"]))
            assert set(player.known) == set(np.flatnonzero(observation["known"]).tolist())
        rows = curves[(curves["player"] == name) & (curves["run"] == run)]
        assert seen == list(zip(rows["known"], rows["repeated"], strict=True))[: len(seen)]
        assert (rows["known"][len(seen) :] == info["known"]).all()


def test_curves_begin_with_the_base_and_never_fall(kitchen, curves):
    """Curves begin with the base and never fall and only the plain random player repeats a pair."""
    assert set(curves[curves["repeated"]]["player"]) == {"random"}
    for _, run in curves.groupby(["player", "run"]):
        assert run["attempt"].tolist() == list(range(ATTEMPTS + 1))
        assert run["known"].iloc[0] == len(kitchen.base_ids)
        assert run["known"].is_monotonic_increasing
        assert run["known"].max() <= Discovery(kitchen).reachable


def test_when_everything_is_known_the_curve_stays_there():
    graph = RecipeGraph.from_recipes(
        [("a", "a", "b"), ("a", "b", "c"), ("d", "a", "e")], base=["a"]
    )
    curves = curves_of(graph, everybody(graph), attempts=40, runs=2)
    at_end = curves[curves["attempt"] == 40]
    assert (at_end["known"] == 3).all()
    assert not at_end["repeated"].any()


def test_a_curve_depends_on_the_seed_and_not_on_who_else_plays(kitchen, curves):
    alone = curves_of(kitchen, make_discoverers(["greedy"], kitchen), ATTEMPTS, runs=20)
    both = curves[curves["player"] == "greedy"].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, both)
    again, other = (
        curves_of(kitchen, make_discoverers(["random"], kitchen), ATTEMPTS, runs=20, seed=seed)
        for seed in (0, 1)
    )
    pd.testing.assert_frame_equal(
        again, curves[curves["player"] == "random"].reset_index(drop=True)
    )
    assert not again["known"].equals(other["known"])


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


def slow_empowerment(graph, known):
    def worth(c):
        recipes = [(a, b, d) for a, b, d in graph.recipes.tolist() if d not in known]
        return 1 + len(
            {d for a, b, d in recipes if (a == c and b in known) or (b == c and a in known)}
        )

    return worth


@pytest.mark.parametrize("kind", [GreedyDiscoverer, EmpowermentDiscoverer])
def test_an_oracle_takes_the_pair_of_the_highest_value(kitchen, kind):
    game, player = Discovery(kitchen), kind(kitchen)
    player.begin(game.base, np.random.default_rng(0))
    for _ in range(12):
        known = list(game.known)
        worth = (
            slow_out_degree(kitchen)
            if kind is GreedyDiscoverer
            else slow_empowerment(kitchen, known)
        )
        pair = player.choose()
        assert pair in best_pairs(slow_oracle_values(kitchen, known, worth))
        player.observe(pair, game.combine(*pair)[0])


def test_equal_values_are_drawn_alike(kitchen):
    class Free(GreedyDiscoverer):
        def worth(self, entities):
            return np.ones(len(entities))

    player, drawn = Free(kitchen), set()
    for seed in range(60):
        player.begin(kitchen.base_ids.tolist(), np.random.default_rng(seed))
        drawn.add(player.choose())
    values = slow_oracle_values(kitchen, kitchen.base_ids.tolist(), lambda c: 1)
    assert drawn == best_pairs(values)
    assert len(drawn) > 1


def test_the_summary_gives_means_intervals_and_the_share_of_repeats():
    known, repeated = [5, 6, 6, 5, 6, 8, 5, 6, 10], [False, False, True] + [False] * 6
    rows = zip(["p"] * 9, [0] * 3 + [1] * 3 + [2] * 3, [0, 1, 2] * 3, known, repeated, strict=True)
    curves = pd.DataFrame(rows, columns=["player", "run", "attempt", "known", "repeated"])
    table = summarise_curves(curves, marks=(1, 50))
    assert table["attempt"].tolist() == [1, 2]
    assert table["mean"].tolist() == [6, 8]
    half = 1.96 * 2 / math.sqrt(3)  # the standard deviation of 6, 8, 10 is 2
    np.testing.assert_allclose(table[["low", "high"]], [[6, 6], [8 - half, 8 + half]])
    np.testing.assert_allclose(table["repeated"], [0, 1 / 6])
    single = summarise_curves(curves[curves["run"] == 0])
    assert single["low"].isna().all()
    assert single["mean"].tolist() == [6, 6]


def test_plays_record_the_attempt_of_each_entity(kitchen):
    players = make_discoverers(["random", "greedy"], kitchen)
    plays = play_runs(kitchen, players, ATTEMPTS, runs=4, seed=2)
    is_base = np.isin(np.arange(kitchen.num_entities), kitchen.base_ids)
    assert ((plays.learnt == 0) == is_base).all()
    assert (plays.learnt == NEVER).any()
    for attempt in range(ATTEMPTS + 1):
        by_now = ((plays.learnt != NEVER) & (plays.learnt <= attempt)).sum(axis=2)
        np.testing.assert_array_equal(by_now, plays.known[:, :, attempt])


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
