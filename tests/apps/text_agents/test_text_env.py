"""The game for Gymnasium in which observations and actions are strings."""

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg.apps.text_agents.hosted_games import open_play
from wordcraft_kg.apps.text_agents.text_env import LONGEST_ACTION, TextEnv
from wordcraft_kg.base.errors import ActionError, ConfigError, EpisodeError


def made(**settings):
    settings = {"graph": "kitchen", "num_distractors": 2, **settings}
    return gym.make("WordCraft-Text-v0", **settings)


def solution(env):
    game = env.unwrapped.talk.game
    rows = game.tasks.plans[game.task][0]
    pairs = (game.graph.labels(pair) for pair in game.graph.recipes[rows, :2].tolist())
    return [*dict.fromkeys(pairs)]


@pytest.mark.parametrize("settings", [{}, {"depth": 2, "render_mode": "ansi"}])
def test_gymnasium_accepts_it(settings):
    check_env(made(**settings).unwrapped)


def test_a_plan_in_words_earns_the_reward():
    env = made(depth=2)
    for seed in range(10):
        env.reset(seed=seed)
        *_, last = [env.step(f"We need it.\n{one} + {other}") for one, other in solution(env)]
        reply, reward, terminated, truncated, info = last
        assert reply.endswith(f"You made the goal: {info['goal']}.")
        assert (reward, terminated, truncated, info["is_success"]) == (1, True, False, True)
        with pytest.raises(EpisodeError):
            env.unwrapped.step("1 + 2")


def test_a_chosen_game_is_that_of_other_interfaces():
    env = made(part="test")
    shown, info = env.reset(options={"task": 3, "distractor_seed": 7})
    assert shown == open_play("kitchen", "test", 1, 2, None).begin(3, 7).opening
    assert (info["task"], info["distractor_seed"]) == (3, 7)


def test_options_do_not_change_the_games_that_follow():
    one, other = made(), made()
    one.reset(seed=4)
    other.reset(seed=4, options={"task": 0})
    assert one.reset() == other.reset()


def test_actions_of_any_length_and_in_any_script_are_part_of_the_game():
    env = made()
    env.reset(seed=0)
    for action in ("", "Ω" * 10_000_000, "\ud800 + \x00", "word " * LONGEST_ACTION):
        reply, reward, _, _, info = env.step(action)
        assert reply in env.observation_space
        assert (reward, reply.startswith("Invalid answer")) == (0, True)
    assert info["invalid_actions"] == 4


def test_mistakes_are_refused():
    env = TextEnv("kitchen", num_distractors=2, render_mode="ansi")
    with pytest.raises(EpisodeError, match="call reset"):
        env.step("1 + 2")
    with pytest.raises(EpisodeError, match="call reset"):
        env.render()
    with pytest.raises(ConfigError, match="unknown reset option 'table'"):
        env.reset(options={"table": []})
    with pytest.raises(ConfigError, match="task"):
        env.reset(options={"task": 10**9})
    shown, _ = env.reset(seed=0)
    assert env.render() in shown
    with pytest.raises(ActionError, match="expected a text"):
        env.step(3)
    with pytest.raises(ConfigError, match="knowledge"):
        TextEnv("kitchen", knowledge="scorer")
    with pytest.raises(ConfigError, match="`render_mode`"):
        TextEnv("kitchen", render_mode="human")
