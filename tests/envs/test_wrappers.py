"""The vector environment and the wrappers."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg import RecipeGraph, make_sources, open_book, open_graph
from wordcraft_kg.base.errors import ConfigError, EpisodeError, GraphMismatchError
from wordcraft_kg.envs.wrappers import (
    KGScoreObservation,
    TaskObservation,
)
from wordcraft_kg.models.scorers.baselines import FrequencyScorer, NeighbourScorer

SETTINGS = {"graph": "kitchen", "part": "all", "depth": 2, "num_distractors": 3}


@pytest.fixture(scope="module")
def scorer():
    opened = open_graph("kitchen")
    return NeighbourScorer(opened.graph, opened.split.partial)


def single():
    return gym.make("WordCraft-v0", **SETTINGS)


def vector(num_envs=5, **more):
    settings = {**SETTINGS, **more}
    return gym.make_vec(
        "WordCraft-v0", num_envs=num_envs, vectorization_mode="vector_entry_point", **settings
    )


def test_the_vector_environment_stays_within_its_spaces():
    """The vector environment stays within its spaces and says how it resets."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs = vector()
        assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        seen, infos = envs.reset(seed=0)
        begun, kept = seen, {key: value.copy() for key, value in seen.items()}
        rng, ended = np.random.default_rng(0), 0
        for _ in range(100):
            assert envs.observation_space.contains(seen)
            seen, rewards, terminated, truncated, infos = envs.step(
                rng.integers(envs.single_action_space.n, size=5)
            )
            assert rewards.shape == terminated.shape == truncated.shape == (5,)
            assert not truncated.any()
            assert (infos["outcome"] == "in_progress").all()
            assert ("final_info" in infos) == terminated.any()
            assert (seen["attempts_left"][terminated] == 2).all()
            ended += int(terminated.sum())
    assert ended > 50
    for key, value in begun.items():
        np.testing.assert_array_equal(value, kept[key])


def test_what_a_step_ends_is_in_its_final_infos():
    """Ends are those of environments alone, which begin the same episodes."""
    envs = vector(3)
    alone = [gym.make("WordCraft-v0", **SETTINGS) for _ in range(3)]
    envs.reset(seed=[4, 5, 6])
    for seed, env in enumerate(alone, start=4):
        env.reset(seed=seed)
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(60):
        actions = rng.integers(envs.single_action_space.n, size=3)
        seen, rewards, over, _, infos = envs.step(actions)
        for i, env in enumerate(alone):
            shown, reward, ended, _, info = env.step(actions[i])
            assert (ended, reward) == (over[i], rewards[i])
            if ended:
                for name, values in shown.items():
                    np.testing.assert_array_equal(infos["final_obs"][i][name], values)
                assert envs.single_observation_space.contains(infos["final_obs"][i])
                assert infos["final_info"]["outcome"][i] == info["outcome"]
                shown, info = env.reset()
                ends += 1
            elif over.any():
                assert infos["final_obs"][i] is None
                assert not infos["_final_info"][i]
            assert infos["task"][i] == info["task"]
            for name, values in shown.items():
                np.testing.assert_array_equal(seen[name][i], values)
    assert ends > 50


def first_end(envs):
    """Return the infos of the first step that ends an episode."""
    while True:
        infos = envs.step(np.zeros(3, dtype=np.int64))[4]
        if "final_obs" in infos:
            return infos


def test_ends_of_episodes_have_gymnasiums_form():
    """Ends of episodes have the form of gymnasiums own vector environments."""
    mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
    naive = gym.make_vec(
        "WordCraft-v0", 3, vectorization_mode="sync", vector_kwargs=mode, **SETTINGS
    )
    ours = vector(3)
    for envs in (naive, ours):
        envs.reset(seed=[4, 5, 6])
    infos, expected = map(first_end, (ours, naive))
    assert {key for key in expected if "final" in key} == {key for key in infos if "final" in key}
    assert (infos["final_obs"].dtype, infos["final_obs"].shape) == (object, (3,))
    # The single environment also names the goal.
    own = {key for key in expected["final_info"] if not key.endswith("goal")}
    assert set(infos["final_info"]) == own
    for key in own:
        assert infos["final_info"][key].dtype == expected["final_info"][key].dtype, key
    wrapped = gym.wrappers.vector.DictInfoToList(ours)
    # Every episode takes four actions at most.
    listed = [wrapped.step(np.zeros(3, dtype=np.int64))[4] for _ in range(4)]
    assert any("final_info" in info for infos in listed for info in infos)


def test_a_seed_of_none_in_a_list_continues():
    one, other = vector(3), vector(3)
    for envs in (one, other):
        envs.reset(seed=2)
    continued = one.reset()[0]
    seeded = other.reset(seed=[None, 5, None])[0]
    first = vector(1).reset(seed=5)[0]
    for name, values in seeded.items():
        np.testing.assert_array_equal(values[[0, 2]], continued[name][[0, 2]])
        np.testing.assert_array_equal(values[1], first[name][0])


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda envs: envs.step(np.zeros(5, dtype=np.int64)), EpisodeError, "call reset"),
        (
            lambda envs: envs.reset(seed=[1, 2, 3, 4]),
            ConfigError,
            "`seed`: 4 seeds for 5 environments; expected one for each",
        ),
        (
            lambda envs: envs.reset(seed=[1, 2, 3, 4, "five"]),
            ConfigError,
            "`seed` 'five': expected a whole number, 0 or more",
        ),
        (lambda envs: envs.reset(options={"task": 1}), ConfigError, "unknown reset option 'task'"),
        (
            lambda envs: envs.reset(seed=-1),
            ConfigError,
            "`seed` -1: expected a whole number, 0 or more",
        ),
    ],
)
def test_the_vector_environment_refuses_what_it_cannot_do(call, error, says):
    with pytest.raises(error, match=says):
        call(vector().unwrapped)


def sources_of(scorer):
    return make_sources(["u", "v"], scorer)


def test_a_scorer_of_another_graph_and_other_environments_are_refused():
    with pytest.raises(ConfigError, match="is not a WordCraft environment"):
        TaskObservation(gym.make("CartPole-v1"))
    graph = RecipeGraph.from_book(open_book("paper-examples"))
    foreign = FrequencyScorer(graph, graph.triples)
    with pytest.raises(GraphMismatchError):
        KGScoreObservation(single(), sources_of(foreign))


@pytest.mark.slow
@pytest.mark.interop
def test_torchrl_wraps_it():
    torchrl_envs = pytest.importorskip("torchrl.envs")
    env = torchrl_envs.GymEnv("WordCraft-v0", graph="kitchen", num_distractors=2, device="cpu")
    rollout = env.rollout(6, break_when_any_done=False)
    assert rollout["table"].shape[0] == 6
    assert "action_mask" in rollout
