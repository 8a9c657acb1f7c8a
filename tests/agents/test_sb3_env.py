"""The batched environments for Stable-Baselines3."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")

from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported

from wordcraft_kg import WordCraftConfig, World
from wordcraft_kg.agents.sb3 import SB3VecEnv
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.envs.wordcraft import WordCraftVectorEnv
from wordcraft_kg.envs.wrappers import TaskObservation

pytestmark = pytest.mark.interop
SIZE = 6


@pytest.fixture(scope="module")
def world(opened_kitchen):
    return World(opened_kitchen, WordCraftConfig(num_distractors=3, depth=2))


def random_slots(env, rng):
    counts = np.stack(env.env_method("action_masks")).sum(1)
    return (rng.random(env.num_envs) * counts).astype(np.int64)


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


def test_episodes_are_those_of_the_vector_environment(world):
    env, vector, rng = (
        SB3VecEnv(SIZE, world),
        WordCraftVectorEnv(SIZE, world),
        np.random.default_rng(0),
    )
    env.seed(5)
    assert_same(env.reset(), vector.reset(seed=5)[0])
    ended = 0
    for _ in range(60):
        slots = random_slots(env, rng)
        observations, rewards, over, infos = env.step(slots)
        expected, rewards_there, over_there, _, infos_there = vector.step(slots)
        assert_same(observations, expected)
        np.testing.assert_array_equal(rewards, rewards_there)
        np.testing.assert_array_equal(over, over_there)
        for row in range(SIZE):
            if not over[row]:
                assert infos[row] == {}
                continue
            ended += 1
            assert_same(infos[row]["terminal_observation"], infos_there["final_obs"][row])
            assert infos[row]["is_success"] == (rewards[row] == 1)
            assert infos[row]["TimeLimit.truncated"] is False
            assert infos[row]["task"] == infos_there["final_info"]["task"][row]
    assert ended > 20


def test_a_seed_gives_the_same_episodes_and_is_used_once(world):
    env = SB3VecEnv(SIZE, world)
    env.seed(3)
    first, later = env.reset(), env.reset()
    env.seed(3)
    assert_same(env.reset(), first)
    assert any((first[name] != later[name]).any() for name in first)


def test_masks_are_those_of_the_tables(world):
    env = SB3VecEnv(SIZE, world)
    observations = env.reset()
    assert is_masking_supported(env)
    np.testing.assert_array_equal(get_action_masks(env), observations["action_mask"] == 1)
    np.testing.assert_array_equal(
        env.env_method("action_masks", indices=[-1, 2]), get_action_masks(env)[[-1, 2]]
    )
    assert len(env.get_attr("render_mode", indices=1)) == 1


def test_the_task_is_as_in_the_wrapper(opened_kitchen):
    for part in ("train", "test"):
        world = World(opened_kitchen, WordCraftConfig(part=part, num_distractors=3))
        env, single = (
            SB3VecEnv(SIZE, world, with_task=True),
            TaskObservation(gym.make("WordCraft-v0", graph=world)),
        )
        assert env.observation_space == single.observation_space
        shown = env.reset()["task"]
        expected = (
            env.env.state.task if part == "train" else [env.observation_space["task"].n - 1] * SIZE
        )
        np.testing.assert_array_equal(shown, expected)
        before = shown
        env.step(np.zeros(SIZE, dtype=int))
        *_, over, infos = env.step(np.zeros(SIZE, dtype=int))
        for row in np.flatnonzero(over):
            assert infos[row]["terminal_observation"]["task"] == before[row]


def test_mistakes_are_refused(world):
    env = SB3VecEnv(SIZE, world)
    env.reset()
    with pytest.raises(ActionError, match="expected 0 to"):
        env.step(np.full(SIZE, 10_000))
    with pytest.raises(AttributeError, match="no method 'render'"):
        env.env_method("render")
    with pytest.raises(AttributeError, match="cannot be set"):
        env.set_attr("num_envs", 7)
    with pytest.raises(IndexError):
        env.env_method("action_masks", indices=[SIZE])
    assert not env.has_attr("unicorn")
    assert env.env_is_wrapped(TaskObservation) == [False] * SIZE
    env.close()
