"""The single environment: its rules, its spaces, and what it refuses."""

import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from helpers import refuses

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg.base.errors import (
    ActionError,
    ArtefactError,
    ConfigError,
    EpisodeError,
    NotRegisteredError,
    RecipeFileError,
    TaskError,
    UnknownEntityError,
)
from wordcraft_kg.envs.wordcraft import WordCraftEnv, WordCraftVectorEnv
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import REWARDS, RewardConfig, WordCraftConfig
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split, make_tasks

# water + earth makes two things, sun + sand glass, and so does fire + sand.
ROWS = [
    *(
        ("earth", "water", "mud"),
        ("earth", "water", "clay"),
        ("mud", "mud", "brick"),
        ("brick", "fire", "house"),
    ),
    *(("sand", "sun", "glass"), ("fire", "sand", "glass"), ("clay", "fire", "pot")),
]


@pytest.fixture
def world():
    graph = RecipeGraph.from_recipes(ROWS)
    return OpenedGraph(graph, make_split(graph, SplitConfig("none")), "tiny")


def labels_on(env, seen):
    return [
        env.world.graph.entities[entity] for entity in seen["table"] if entity < env.world.nothing
    ]


def posed(world, goal, table, **options):
    """Begin an episode with this goal and table; returns the environment."""
    config = WordCraftConfig(part="all", **options)
    every_task = make_tasks(world.graph, config.depth, twice_share=None)
    env = WordCraftEnv(World(world, config, every_task))
    task = next(i for i in range(len(env.tasks)) if env.tasks[i].goal == goal)
    env.reset(seed=0, options={"task": task, "table": table})
    return env


def pick(env, *labels):
    """Pick entities by label; returns the last step."""
    names = env.world.graph.entities
    for label in labels:
        last = env.step([names[entity] for entity in env.state.table].index(label))
    return last


def test_two_picks_make_an_attempt_and_all_results_come_to_the_table(world):
    env = posed(world, "mud", ["earth", "water"])
    seen, reward, terminated, _, info = pick(env, "earth")
    assert (seen["selection"], reward, terminated) == (env.world.graph.id_of("earth"), 0, False)
    seen, reward, terminated, truncated, info = pick(env, "water")
    assert (reward, terminated, truncated) == (1, True, False)
    assert (info["outcome"], info["by_plan"], info["goal"]) == ("goal", True, "mud")
    assert labels_on(env, seen) == ["earth", "water", "clay", "mud"]
    assert seen["selection"] == env.world.nothing


def test_an_empty_slot_loses_the_attempt_and_conjures_nothing(world):
    env = posed(world, "glass", ["sand", "sun"], max_attempts=2)
    pick(env, "sand")
    seen, reward, terminated, _, info = env.step(env.num_slots - 1)
    assert info["illegal_action"]
    assert (seen["selection"], seen["attempts_left"], reward, terminated) == (
        env.world.nothing,
        1,
        0,
        False,
    )
    assert seen["action_mask"].sum() == 2


@pytest.mark.parametrize(
    ("picks", "expected"),
    [
        (["earth", "earth"], [0, -0.25]),  # a wrong pair
        (["clay", "fire"], [0, -0.5]),  # something, but nothing of the plan
        (["earth", "water"], [0, 2.0]),  # an intermediate
        (["earth", "water", "earth", "water"], [0, 2.0, 0, 0]),  # the second time it is not new
        (["earth", "water", "mud", "mud"], [0, 2.0, 0, 1.0]),
    ],
)
def test_shaped_rewards_follow_the_rules(world, monkeypatch, picks, expected):
    monkeypatch.setitem(REWARDS, "mine", RewardConfig(0.25, 0.5, 2.0))
    table = ["earth", "water", "clay", "fire"]
    rules = {"depth": 2, "max_attempts": 3, "num_distractors": 2}
    env = posed(world, "brick", table, reward="mine", **rules)
    assert [pick(env, label)[1] for label in picks] == expected
    assert (REWARDS["sparse"], REWARDS["official"]) == (RewardConfig(), RewardConfig(0.1, 0.1, 1.0))


@pytest.mark.parametrize("depth", [1, 3])
def test_gymnasiums_checker_finds_nothing(depth):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(
            "WordCraft-v0", graph="kitchen", depth=depth, num_distractors=4, num_tasks=30
        )
        check_env(env.unwrapped)
    assert env.spec.kwargs["graph"] == "kitchen"
    assert gym.make(env.spec).spec == env.spec


def test_it_renders_in_words(opened_kitchen):
    env = WordCraftEnv(opened_kitchen, render_mode="ansi")
    with pytest.raises(EpisodeError):
        env.render()
    env.reset(seed=0)
    assert env.render().startswith("goal: ")
    assert "attempts left: 1" in env.render()
    assert WordCraftEnv(opened_kitchen).render() is None


def test_a_graph_too_small_to_split_is_played_as_a_whole(
    world,
):
    """A graph too small to split is played as a whole with as many distractors as it has room for."""
    env = WordCraftEnv(RecipeGraph.from_recipes(ROWS[:2]), part="all", num_distractors=0)
    assert len(env.tasks) == 2
    most = WordCraftEnv(world, part="all", num_distractors=0).world.max_distractors
    WordCraftEnv(world, part="all", num_distractors=most).reset(seed=0)
    with pytest.raises(ConfigError, match=f"expected at most {most}."):
        WordCraftEnv(world, part="all", num_distractors=most + 1)


@pytest.mark.parametrize(
    "changes",
    [
        *[{"depth": depth} for depth in (0, 50, 1.5)],
        *[{"num_distractors": amount} for amount in (-1, 80)],
        {"part": "tests"},
        {"reward": "dense"},
        {"max_attempts": 1, "depth": 2},
        {"render_mode": "text"},
        *[{"graph": graph} for graph in (None, 5)],
    ],
)
def test_bad_settings_are_refused_by_name(changes):
    setting = next(iter(changes))
    with refuses(setting, NotRegisteredError if setting == "reward" else ConfigError):
        WordCraftEnv(**{"graph": "kitchen", **changes})


@pytest.mark.parametrize(
    ("changes", "error", "says"),
    [
        ({"part": "valid"}, TaskError, "kitchen has no task of depth 1 in the valid part"),
        (
            {"distractors": 3},
            ConfigError,
            "argument 'distractors'; .* Did you mean 'num_distractors'",
        ),
        ({"graph": "kitchn"}, RecipeFileError, "Did you mean 'kitchen'"),
        ({"graph": "tests"}, ArtefactError, "expected a graph folder"),
    ],
)
def test_graphs_tasks_and_settings_that_are_not_there_are_refused(changes, error, says):
    with pytest.raises(error, match=says):
        WordCraftEnv(**{"graph": "kitchen", **changes})


@pytest.mark.parametrize("action", [-1, 99, 0.0, "0", None, np.array([0, 1])])
def test_actions_outside_the_space_raise(opened_kitchen, action):
    env = WordCraftEnv(opened_kitchen)
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"action .*: expected"):
        env.step(action)


def test_steps_before_a_reset_and_after_the_end_raise(opened_kitchen):
    env = WordCraftEnv(opened_kitchen)
    with pytest.raises(EpisodeError):
        env.step(0)
    env.reset(seed=0)
    env.step(0)
    env.step(0)
    with pytest.raises(EpisodeError):
        env.step(0)


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"tsk": 1}, ConfigError, "unknown reset option 'tsk'"),
        ({"task": 10**6}, ConfigError, "`task` 1000000: expected a whole number, 0 to"),
        ({"task": "a"}, ConfigError, "`task` 'a': expected a whole number, 0 to"),
        ({"table": []}, ConfigError, "`table` of 0 entities: expected 1 to"),
        ({"table": ["flour", "flour"]}, ConfigError, "holds 'flour' twice"),
        ({"table": ["flour", "wat"]}, UnknownEntityError, "no entity 'wat'"),
        ({"table": ["flour"] * 50}, ConfigError, "`table` of 50 entities: expected 1 to"),
    ],
)
def test_bad_reset_options_are_refused(opened_kitchen, options, error, says):
    with pytest.raises(error, match=says):
        WordCraftEnv(opened_kitchen).reset(options=options)


@pytest.mark.parametrize(
    "first",
    [
        "import gymnasium, wordcraft_kg",
        pytest.param("import wordcraft_kg, gymnasium", marks=pytest.mark.slow),
    ],
)
def test_gymnasium_knows_the_environments_in_either_order(first):
    code = (
        f"{first}\nfor name in ('WordCraft-v0', 'WordCraft-OpenEnded-v0'): "
        "print(gymnasium.spec(name).id)"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert out.split() == ["WordCraft-v0", "WordCraft-OpenEnded-v0"]


@pytest.mark.parametrize("make", [gym.make, pytest.param(gym.make_vec, marks=pytest.mark.slow)])
def test_everyday_is_played_if_no_graph_is_named(make):
    options = (
        {"num_envs": 2, "vectorization_mode": "vector_entry_point"} if make is gym.make_vec else {}
    )
    env = make("WordCraft-v0", **options).unwrapped
    assert (
        env.world.graph.name
        == gym.make("WordCraft-OpenEnded-v0").unwrapped.graph.name
        == "everyday"
    )
    assert make("WordCraft-v0", graph="kitchen", **options).unwrapped.world.graph.name == "kitchen"


@pytest.mark.parametrize(
    "rules",
    [
        {"depth": 2, "part": "test", "reward": "official", "distractor_weighting": "uniform"},
        {"depth": 3, "num_tasks": 50, "max_attempts": 4},
    ],
)
def test_it_is_a_vector_environment_of_one(opened_kitchen, rules):
    env = WordCraftEnv(opened_kitchen, num_distractors=4, **rules)
    envs = WordCraftVectorEnv(1, env.world)
    rng = np.random.default_rng(0)
    seen, _ = env.reset(seed=11)
    shown, _ = envs.reset(seed=11)
    for _ in range(100):
        slot = int(rng.integers(seen["action_mask"].sum() + 1))
        seen, reward, over, _, info = env.step(min(slot, env.num_slots - 1))
        shown, rewards, ended, _, infos = envs.step(np.array([min(slot, env.num_slots - 1)]))
        assert (over, reward) == (ended[0], pytest.approx(rewards[0]))
        if over:
            assert info["outcome"] == infos["final_info"]["outcome"][0]
            seen, info = env.reset()
        for name in ("outcome", "by_plan", "illegal_action", "task"):
            assert info[name] == infos[name][0]
        for name, values in seen.items():
            np.testing.assert_array_equal(values, shown[name][0])


def test_a_given_task_takes_the_place_of_one_episode(opened_kitchen):
    env = WordCraftEnv(opened_kitchen, num_distractors=4)
    following = []
    for options in (None, {"task": 1}, {"task": 1, "table": ["flour", "water"]}):
        env.reset(seed=3)
        _, info = env.reset(options=options)
        assert options is None or info["task"] == 1
        following.append(env.reset()[0]["table"].tolist())
    assert following[0] == following[1] == following[2]
    assert env.reset(seed=3)[0]["table"].tolist() != following[0]
