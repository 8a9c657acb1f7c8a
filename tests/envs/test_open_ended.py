import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, strategies as st

from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError
from wordcraft_kg.envs import register
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.graphs import RecipeGraph

RECIPES = [
    *(("fire", "water", "steam"), ("fire", "water", "fog")),  # an ambiguous pair
    *(
        ("fire", "fire", "blaze"),
        ("blaze", "steam", "train"),
        ("moon", "water", "tide"),
    ),  # the last is never reached
]
GRAPH = RecipeGraph.from_recipes(RECIPES, base=["fire", "water"], name="small")
NAMES = ("fire", "water", "steam", "fog", "blaze", "train", "moon")
FIRE, WATER, STEAM, FOG, BLAZE, TRAIN, MOON = map(GRAPH.id_of, NAMES)


def make(**settings):
    env = OpenEndedEnv(GRAPH, **settings)
    env.reset()
    return env


def slow_results(graph, known, one, other):
    """Return what two entities newly give, by reading the whole book."""
    made = {r for a, b, r in graph.recipes.tolist() if (a, b) in ((one, other), (other, one))}
    return made - known if {one, other} <= known else set()


@pytest.mark.parametrize("render_mode", [None, "ansi"])
def test_gymnasium_finds_nothing_to_complain_about(render_mode):
    register()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(
            "WordCraft-OpenEnded-v0", graph="kitchen", max_attempts=7, render_mode=render_mode
        )
        check_env(env.unwrapped)
        env.reset(seed=0)
        while not env.step(env.action_space.sample())[2]:
            pass


@given(
    pairs=st.lists(
        st.tuples(st.integers(0, 2**16), st.integers(0, 2**16), st.booleans()),
        min_size=1,
        max_size=60,
    )
)
def test_every_step_equals_a_slow_reading_of_the_book(kitchen, pairs):
    env = OpenEndedEnv(kitchen, max_attempts=len(pairs))
    observation, info = env.reset()
    known, tried = set(kitchen.base_ids.tolist()), set()
    for spent, (x, y, legal) in enumerate(pairs, start=1):
        # Mostly legal pairs, so that play gets somewhere; else any pair.
        choices = sorted(known) if legal else range(kitchen.num_entities)
        one, other = choices[x % len(choices)], choices[y % len(choices)]
        new = slow_results(kitchen, known, one, other)
        is_legal = {one, other} <= known
        before = observation["known"]
        observation, reward, terminated, truncated, info = env.step(np.array([one, other]))
        assert env.observation_space.contains(observation)
        assert reward == len(new)
        assert (
            set(info["new_entities"])
            == new
            == set(np.flatnonzero(observation["last_results"]).tolist())
        )
        assert info["illegal_action"] is not is_legal
        assert info["repeated"] is (is_legal and frozenset((one, other)) in tried)
        known |= new
        if is_legal:
            tried.add(frozenset((one, other)))
        assert set(np.flatnonzero(observation["known"]).tolist()) == known
        assert info["known"] == len(known)
        assert (observation["known"] >= before).all()
        assert observation["attempts_left"] == len(pairs) - spent
        for mask in env.action_masks():
            np.testing.assert_array_equal(mask, observation["known"])
        assert not truncated
        assert terminated == (spent == len(pairs) or info["outcome"] == "all_known")
        if terminated:
            break


@pytest.mark.parametrize(
    "action",
    [
        [0],
        [0, 1, 2],
        [0, -1],
        [0, GRAPH.num_entities],
        [0.0, 1.0],
        [[0], [0, 1]],
        ["fire", "water"],
        3,
        None,
    ],
)
def test_an_action_outside_the_space_is_an_error(action):
    with pytest.raises(ActionError, match=f"two entity ids, 0 to {GRAPH.num_entities - 1}"):
        make().step(action)


def test_the_episode_ends_with_the_last_attempt_and_takes_no_further_step():
    env = OpenEndedEnv(GRAPH, max_attempts=2)
    with pytest.raises(EpisodeError):
        env.step([FIRE, WATER])
    with pytest.raises(ConfigError, match="unknown reset option 'base'"):
        env.reset(options={"base": [1]})
    env.reset()
    assert not env.step([FIRE, WATER])[2]
    observation, _, terminated, truncated, info = env.step([FIRE, WATER])
    assert (terminated, truncated, info["outcome"]) == (True, False, "out_of_attempts")
    assert observation["attempts_left"] == 0
    with pytest.raises(EpisodeError):
        env.step([FIRE, WATER])
    env.reset()
    env.step([FIRE, WATER])


def test_the_episode_ends_when_everything_reachable_is_known():
    env = make()
    env.step([FIRE, WATER])
    env.step([FIRE, FIRE])
    _, _, terminated, _, info = env.step([BLAZE, STEAM])
    assert (terminated, info["outcome"], info["known"]) == (True, "all_known", 6)
    assert info["known"] == GRAPH.num_entities - 2  # the moon and its tide are out of reach


@pytest.mark.parametrize("base", [["moon", "water"], [MOON, WATER], {"water", "moon"}])
def test_another_base_may_be_given_by_label_or_id(base):
    env = make(base=base)
    assert set(env.discovery.known) == {MOON, WATER}
    _, reward, terminated, _, _ = env.step([MOON, WATER])
    assert reward == 1
    assert terminated


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"max_attempts": 0}, "`max_attempts` 0: expected a whole number, 1 or more"),
        ({"max_attempts": True}, "`max_attempts` True"),
        ({"max_attempts": 2.5}, "`max_attempts` 2.5"),
        ({"base": ["fire", "watre"]}, "`base`: no entity 'watre' in small. Did you mean 'water'"),
        ({"base": [99]}, "`base`: no entity id 99"),
        ({"base": ["moon"]}, "`base` moon: nothing new can be made"),
        ({"base": []}, r"`base` \(empty\): nothing new can be made"),
        ({"render_mode": "text"}, "`render_mode` 'text'"),
    ],
)
def test_a_bad_setting_says_what_was_expected(settings, says):
    with pytest.raises(ConfigError, match=says):
        OpenEndedEnv(GRAPH, **settings)


def test_the_state_is_told_in_words():
    env = make(render_mode="ansi", max_attempts=3)
    assert "known: 2 of 6   attempts left: 3   nothing tried yet\nfire, water" in env.render()
    env.step([FIRE, FIRE])
    assert "known: 3 of 6   attempts left: 2   fire + fire -> blaze" in env.render()
    env.step([BLAZE, FIRE])
    assert "blaze + fire -> nothing new" in env.render()
    assert make().render() is None
