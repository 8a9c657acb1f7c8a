"""The paper's protocol for people: picks, tasks, and the interval of a rate."""

import msgspec
import numpy as np
import pytest
from refusals import refuses

from wordcraft_kg.apps.people.config import TASKS_PER_PART
from wordcraft_kg.apps.people.protocol import HumanProtocol, episode_seed, schedule
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.statistics import wilson_interval
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.words import table_labels
from wordcraft_kg.graphs import SplitConfig, make_split


@pytest.fixture(scope="module")
def protocol(kitchen):
    return HumanProtocol(kitchen)


def test_a_session_is_40_train_tasks_and_then_40_test_tasks():
    assert schedule() == tuple(
        (part, number) for part in ("train", "test") for number in range(1, 41)
    )


def test_the_tasks_are_those_of_an_environment_as_agents_get_it(protocol, kitchen):
    for part in ("train", "test"):
        agents = WordCraftEnv(kitchen, part=part, num_distractors=8)
        for number in range(1, TASKS_PER_PART + 1):
            expected, _ = agents.reset(seed=episode_seed(0, part, number))
            env, observation = protocol.pose(part, number)
            assert env.task == agents.task
            assert np.array_equal(observation["table"], expected["table"])
            assert observation["attempts_left"] == 1


def test_fewer_tasks_are_the_first_of_more_and_a_world_may_be_shared(protocol):
    few = HumanProtocol(protocol.world, tasks=3)
    assert few.turns == tuple((part, number) for part in ("train", "test") for number in (1, 2, 3))
    assert [few.task(*turn) for turn in few.turns] == [protocol.task(*turn) for turn in few.turns]
    settings = protocol.header.settings | {"tasks_per_part": 3}
    assert few.header == msgspec.structs.replace(protocol.header, settings=settings)


@pytest.mark.parametrize(
    ("setting", "value"), [*(("tasks", value) for value in (0, -1, 1_001, True, 1.5)), ("seed", -1)]
)
def test_a_setting_that_cannot_be_is_refused(protocol, setting, value):
    with refuses(setting):
        HumanProtocol(protocol.world, **{setting: value})


def test_an_answer_is_what_an_environment_says_of_the_same_picks(protocol):
    outcomes = set()
    for part, number in protocol.turns:
        task = protocol.task(part, number)
        parts = [task.table.index(label) for label in task.plans[0][:2]]
        for slots in ((0, 1), (number % 10, 0), (4, 4), (parts[0], parts[1])):
            env, observation = protocol.pose(part, number)
            assert table_labels(env, observation) == task.table
            assert env.state.task == task.index
            env.step(slots[0])
            *_, info = env.step(slots[1])
            answer = protocol.answer(task, slots, 1.23456)
            assert (answer.part, answer.number, answer.goal, answer.table) == (
                part,
                number,
                task.goal,
                task.table,
            )
            assert answer.actions == tuple(task.table[slot] for slot in slots)
            assert answer.success == (info["outcome"] == "goal")
            assert set(answer.made) >= set(env.world.graph.labels(env.state.table[10:]))
            assert answer.seconds == 1.23
            outcomes.add((answer.success, bool(answer.made)))
    assert outcomes == {(True, True), (False, True), (False, False)}


def test_the_goals_are_the_same_with_any_number_of_distractors(protocol):
    few = HumanProtocol(protocol.world, 1)
    for turn in protocol.turns:
        assert few.task(*turn).goal == protocol.task(*turn).goal
        assert len(few.task(*turn).table) == len(protocol.task(*turn).table) - 7


def test_a_task_does_not_depend_on_what_was_posed_before(protocol, kitchen):
    env, observation = HumanProtocol(kitchen).pose("test", 7)
    first = env.task, table_labels(env, observation)
    for number in (3, 7):
        env, observation = protocol.pose("test", number)
    assert (env.task, table_labels(env, observation)) == first


def test_episode_seeds_differ_by_seed_part_and_number_and_never_change():
    keys = [
        (seed, part, number)
        for seed in (0, 1, 2**40)
        for part in ("train", "test")
        for number in range(1, 41)
    ]
    assert len({episode_seed(*key) for key in keys}) == len(keys)
    golden = {(0, "train", 1): 3613627650, (0, "test", 1): 1321936645, (1, "train", 40): 264182322}
    assert {key: episode_seed(*key) for key in golden} == golden


def test_the_header_and_an_answer_have_nothing_about_people(protocol, kitchen):
    settings = {"tasks_per_part": 40, "depth": 1, "num_distractors": 8, "attempts": 1}
    weights = {
        "distractor_weighting": "use",
        "distractor_policy": "any",
        "task_weighting": "task",
        "ambiguity": "all",
    }
    hashes = {"graph_hash": kitchen.hash, "split_hash": make_split(kitchen, SplitConfig()).hash}
    others = {"graph": "kitchen", "seed": 0, "settings": settings | weights}
    assert as_values(protocol.header) == {**others, **hashes}
    answer = protocol.answer(protocol.task("train", 1), (0, 1), 1.5)
    assert list(as_values(answer)) == [
        "part",
        "number",
        "goal",
        "table",
        "actions",
        "made",
        "success",
        "seconds",
    ]


@pytest.mark.parametrize(("successes", "n"), [(0, 0), (-1, 3), (4, 3)])
def test_a_rate_that_cannot_be_is_refused(successes, n):
    with pytest.raises(ConfigError, match="expected"):
        wilson_interval(successes, n)
