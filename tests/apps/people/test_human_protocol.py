"""The paper's protocol for people: picks, tasks, the file of answers, and the interval of a rate."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuses
from scipy.stats import binomtest

from tests.apps.people.stored import other_world, unchanged
from wordcraft_kg.apps.people.config import TASKS_PER_PART
from wordcraft_kg.apps.people.protocol import Answer, HumanProtocol, episode_seed, schedule
from wordcraft_kg.apps.people.session_file import Session, append_answer, open_session, read_session
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.statistics import wilson_interval
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.envs.words import table_labels
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split


@pytest.fixture(scope="module")
def protocol(kitchen: RecipeGraph) -> HumanProtocol:
    return HumanProtocol(kitchen)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "human.jsonl"


def answer_to(protocol: HumanProtocol, part: str, number: int) -> Answer:
    """The answer of somebody who combines the first two things, or in every third task is right."""
    task = protocol.task(part, number)
    slots = tuple(task.table.index(label) for label in task.plans[0][:2]) if number % 3 == 0 else (0, 1)
    return protocol.answer(task, slots, 1.5)


def play(path: Path, protocol: HumanProtocol, count: int = 80) -> Session:
    """Go on with a session until so many tasks are answered."""
    session = open_session(path, protocol)
    for turn in protocol.turns[len(session.answers) : count]:
        session = append_answer(path, session, answer_to(protocol, *turn))
    return session


def test_a_session_is_40_train_tasks_and_then_40_test_tasks():
    assert schedule() == tuple((part, number) for part in ("train", "test") for number in range(1, 41))


def test_the_tasks_are_those_of_an_environment_as_agents_get_it(protocol: HumanProtocol, kitchen: RecipeGraph):
    for part in ("train", "test"):
        agents = WordCraftEnv(kitchen, part=part, num_distractors=8)
        for number in range(1, TASKS_PER_PART + 1):
            expected, _ = agents.reset(seed=episode_seed(0, part, number))
            env, observation = protocol.pose(part, number)
            assert env.task == agents.task
            assert np.array_equal(observation["table"], expected["table"])
            assert observation["attempts_left"] == 1


def test_fewer_tasks_are_the_first_of_more_and_a_world_may_be_shared(protocol: HumanProtocol):
    few = HumanProtocol(protocol.world, tasks=3)
    assert few.turns == tuple((part, number) for part in ("train", "test") for number in (1, 2, 3))
    assert [few.task(*turn) for turn in few.turns] == [protocol.task(*turn) for turn in few.turns]
    settings = protocol.header.settings | {"tasks_per_part": 3}
    assert few.header == msgspec.structs.replace(protocol.header, settings=settings)


@pytest.mark.parametrize(
    ("setting", "value"), [*(("tasks", value) for value in (0, -1, 1_001, True, 1.5)), ("seed", -1)]
)
def test_a_setting_that_cannot_be_is_refused(protocol: HumanProtocol, setting: str, value: Any):
    with refuses(setting):
        HumanProtocol(protocol.world, **{setting: value})


def test_an_answer_is_what_an_environment_says_of_the_same_picks(protocol: HumanProtocol):
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
            assert (answer.part, answer.number, answer.goal, answer.table) == (part, number, task.goal, task.table)
            assert answer.actions == tuple(task.table[slot] for slot in slots)
            assert answer.success == (info["outcome"] == "goal")
            assert set(answer.made) >= set(env.world.graph.labels(env.state.table[10:]))
            assert answer.seconds == 1.23
            outcomes.add((answer.success, bool(answer.made)))
    assert outcomes == {(True, True), (False, True), (False, False)}


def test_the_goals_are_the_same_with_any_number_of_distractors(protocol: HumanProtocol):
    few = HumanProtocol(protocol.world, 1)
    for turn in protocol.turns:
        assert few.task(*turn).goal == protocol.task(*turn).goal
        assert len(few.task(*turn).table) == len(protocol.task(*turn).table) - 7


def test_a_task_does_not_depend_on_what_was_posed_before(protocol: HumanProtocol, kitchen: RecipeGraph):
    env, observation = HumanProtocol(kitchen).pose("test", 7)
    first = env.task, table_labels(env, observation)
    for number in (3, 7):
        env, observation = protocol.pose("test", number)
    assert (env.task, table_labels(env, observation)) == first


def test_episode_seeds_differ_by_seed_part_and_number_and_never_change():
    keys = [(seed, part, number) for seed in (0, 1, 2**40) for part in ("train", "test") for number in range(1, 41)]
    assert len({episode_seed(*key) for key in keys}) == len(keys)
    golden = {(0, "train", 1): 3613627650, (0, "test", 1): 1321936645, (1, "train", 40): 264182322}
    assert {key: episode_seed(*key) for key in golden} == golden


def test_the_header_has_nothing_about_people(protocol: HumanProtocol, kitchen: RecipeGraph, path: Path):
    play(path, protocol, 3)
    header, first, *_ = map(json.loads, path.read_text().splitlines())
    settings = {"tasks_per_part": 40, "depth": 1, "num_distractors": 8, "attempts": 1}
    weights = {"distractor_weighting": "use", "distractor_policy": "any", "task_weighting": "task", "ambiguity": "all"}
    hashes = {"graph_hash": kitchen.hash, "split_hash": make_split(kitchen, SplitConfig()).hash}
    others = {"format": "wordcraft-kg human protocol 1", "graph": "kitchen", "seed": 0}
    assert header == {**others, **hashes, "settings": settings | weights}
    assert list(first) == ["part", "number", "goal", "table", "actions", "made", "success", "seconds"]


def test_a_session_in_pieces_is_the_session_in_one(protocol: HumanProtocol, tmp_path: Path):
    for count in (0, 1, 39, 40, 41, 80, 80):
        session = play(tmp_path / "pieces.jsonl", protocol, count)
        assert session.is_finished == (count == 80)
    assert session == play(tmp_path / "one.jsonl", protocol) == read_session(tmp_path / "one.jsonl")
    assert (tmp_path / "pieces.jsonl").read_bytes() == (tmp_path / "one.jsonl").read_bytes()


def test_a_torn_last_line_is_dropped_and_its_task_posed_again(protocol: HumanProtocol, path: Path, caplog):
    play(path, protocol, 3)
    data = path.read_bytes()
    start = data.rindex(b"\n", 0, -1) + 1
    for end in range(start + 1, len(data)):
        path.write_bytes(data[:end])
        session = open_session(path, protocol)
        assert (len(session.answers), session.torn) == (2, 0)
        assert path.read_bytes() == data[:start]
    assert "torn" in caplog.text
    play(path, protocol, 3)
    assert path.read_bytes() == data


@pytest.mark.parametrize(
    ("other", "kind", "name"),
    [
        ({"seed": 1}, ConfigError, "seed 0, but this command has 1"),
        ({"num_distractors": 1}, ConfigError, "num_distractors 8, but this command has 1"),
        ("split", GraphMismatchError, "split_hash"),
        ("graph", GraphMismatchError, "graph_hash"),
    ],
)
def test_a_file_of_another_session_is_refused(protocol, kitchen, path: Path, other: Any, kind: type, name: str):
    play(path, protocol, 3)
    with path.open("ab") as file:
        file.write(b'{"torn')
    is_world = isinstance(other, str)
    another = HumanProtocol(other_world(kitchen, other)) if is_world else HumanProtocol(kitchen, **other)
    with unchanged(path.parent), pytest.raises(kind, match=name):
        open_session(path, another)


def test_another_name_of_the_same_graph_goes_on(protocol: HumanProtocol, kitchen: RecipeGraph, path: Path):
    play(path, protocol, 3)
    renamed = RecipeGraph(kitchen.entities, kitchen.recipes, kitchen.base_ids, "cuisine")
    assert len(open_session(path, HumanProtocol(renamed)).answers) == 3


@pytest.mark.parametrize(
    "content", ["", "my notes", "my notes\n", "{}\n", "[]\n", "\n", '{"format": "other"}\n', "\xff"]
)
def test_a_file_that_is_something_else_is_refused_and_stays(protocol: HumanProtocol, path: Path, content: str):
    path.write_text(content, encoding="latin-1")
    with unchanged(path.parent), pytest.raises(ArtefactError, match="not a session file"):
        open_session(path, protocol)


DAMAGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "another part": lambda row: row | {"part": "test"},
    "another number": lambda row: row | {"number": 3},
    "a number that is none": lambda row: row | {"number": True},
    "a pick that was not there": lambda row: row | {"actions": ["gold", "gold"]},
    "one pick": lambda row: row | {"actions": row["actions"][:1]},
    "a table of numbers": lambda row: row | {"table": [*row["table"], 1]},
    "a success that was none": lambda row: row | {"success": not row["success"]},
    "negative seconds": lambda row: row | {"seconds": -1.0},
    "endless seconds": lambda row: row | {"seconds": math.inf},
    "a key more": lambda row: row | {"name": "somebody"},
    "a key less": lambda row: {key: value for key, value in row.items() if key != "made"},
    "a list": lambda row: [row],
    "nothing": lambda row: None,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_answer_is_refused_with_its_line(protocol: HumanProtocol, path: Path, damage: str):
    play(path, protocol, 4)
    lines = path.read_text().splitlines()
    lines[2] = json.dumps(DAMAGES[damage](json.loads(lines[2])))
    path.write_text("\n".join(lines) + "\n")
    for read in (read_session, lambda path: open_session(path, protocol)):
        with unchanged(path.parent), pytest.raises(ArtefactError, match="line 3 is damaged"):
            read(path)


def test_a_task_that_is_not_posed_there_is_refused(protocol: HumanProtocol, path: Path):
    session = play(path, protocol, 2)
    third = answer_to(protocol, "train", 3)
    append_answer(path, session, msgspec.structs.replace(third, table=third.table[::-1]))
    with pytest.raises(ArtefactError, match="line 4: this version poses another task"):
        open_session(path, protocol)


@pytest.mark.parametrize("name", ["tasks_per_part", "num_distractors"])
@pytest.mark.parametrize("value", [None, "8", True, -1, 10**9, 1.0])
def test_a_header_whose_settings_are_none_is_refused(protocol: HumanProtocol, path: Path, name: str, value: Any):
    play(path, protocol, 2)
    header, *lines = path.read_text().splitlines()
    changed = json.loads(header)
    changed["settings"][name] = value
    path.write_text("\n".join([json.dumps(changed), *lines]) + "\n")
    with pytest.raises(ArtefactError, match="line 1 is damaged"):
        read_session(path)


def test_lines_lost_doubled_or_in_excess_are_refused(protocol: HumanProtocol, path: Path):
    play(path, protocol)
    lines = path.read_bytes().splitlines(keepends=True)
    for changed in (lines[:3] + lines[4:], [*lines[:3], *lines[2:]], [*lines, lines[-1]], [*lines[:4], b"\n"]):
        path.write_bytes(b"".join(changed))
        with pytest.raises(ArtefactError, match="damaged"):
            read_session(path)


@given(st.integers(1, 10_000), st.data(), st.sampled_from([0.5, 0.9, 0.95, 0.999]))
def test_the_wilson_interval_is_scipys(n: int, data: st.DataObject, level: float):
    successes = data.draw(st.integers(0, n))
    expected = tuple(binomtest(successes, n).proportion_ci(level, method="wilson"))
    low, high = wilson_interval(successes, n, level)
    assert (low, high) == pytest.approx(expected, abs=1e-12)
    assert 0 <= low <= successes / n <= high <= 1


@pytest.mark.parametrize(("successes", "n", "level"), [(0, 0, 0.95), (-1, 3, 0.95), (4, 3, 0.95), (1, 3, 0), (1, 3, 1)])
def test_a_rate_that_cannot_be_is_refused(successes: int, n: int, level: float):
    with pytest.raises(ConfigError, match="expected"):
        wilson_interval(successes, n, level)
