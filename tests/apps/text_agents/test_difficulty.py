"""Measured difficulty: the shipped figures are of the book's tasks, and choose the same games."""

import numpy as np
import pytest

from wordcraft_kg import SplitConfig, WordCraftConfig, World, evaluate, open_graph
from wordcraft_kg.agents.players import words_player
from wordcraft_kg.apps.text_agents.benchmark import open_track, read_manifest
from wordcraft_kg.apps.text_agents.plays import (
    MEASURED_TABLES,
    GameList,
    measured_success,
    open_play,
    read_range,
    tasks_within,
)
from wordcraft_kg.apps.text_agents.text_env import TextEnv
from wordcraft_kg.apps.text_agents.trl import crafting_rows
from wordcraft_kg.base.errors import ConfigError


def everyday(part="train", depth=1, split="by-recipe"):
    return World(open_graph("everyday", SplitConfig(split)), WordCraftConfig(part, depth))


@pytest.mark.parametrize(
    "settings",
    [
        ("test", 1),
        pytest.param(("train", 1), marks=pytest.mark.slow),
        pytest.param(("train", 2), marks=pytest.mark.slow),
        pytest.param(("test", 2), marks=pytest.mark.slow),
        pytest.param(("train", 1, "by-goal"), marks=pytest.mark.slow),
        pytest.param(("test", 1, "by-goal"), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_words_of_the_file_are_what_nearest_words_make(settings):
    world = everyday(*settings)
    ((_, words),) = words_player(world.graph).items()
    played = evaluate(words, world, distractor_seeds=MEASURED_TABLES)
    success = measured_success(world)
    assert success.shape == (len(world.tasks), 3)
    np.testing.assert_array_equal(success[:, 0], played.success.mean(axis=1))
    # No player is always right or wrong, and the planner, which reads recipes, is the best.
    assert 0 < success.mean(axis=0).min() < success.mean(axis=0).max() < 1
    assert success.mean(axis=0).argmax() == 2


@pytest.mark.parametrize(
    "track",
    [
        name if name == "craft-8" else pytest.param(name, marks=pytest.mark.slow)
        for name, track in read_manifest()[0].tracks.items()
        if track.depth == 1
    ],
)
def test_each_task_of_the_frozen_tracks_of_depth_1_is_measured(track):
    success = measured_success(open_track(track).world)
    assert ((success >= 0) & (success <= 1)).all()


def test_a_range_chooses_the_same_tasks_for_every_interface():
    limits = (0.2, 0.8)
    play = open_play("everyday", "test", 1, 8, None)
    world = play.world
    difficulty = 1 - measured_success(world).mean(axis=1)
    chosen = tasks_within(world, limits)
    assert {*chosen} == {
        task for task, each in enumerate(difficulty) if limits[0] <= each <= limits[1]
    }
    assert 0 < len(chosen) < len(world.tasks)
    games = GameList({"test": [play]}, limits)
    assert [games.at("test", index)[1] for index in range(games.count("test"))] == [*chosen]
    outside = next(task for task in range(len(world.tasks)) if task not in chosen)
    with pytest.raises(ConfigError, match="is no game of this server"):
        games.named(f"everyday-test-1-8-{outside}-0")
    rows = crafting_rows("everyday", part="test", difficulty=limits, tasks=20)
    assert {row["task"] for row in rows} <= {*chosen}
    assert len(rows) == 20
    env = TextEnv("everyday", part="test", difficulty=limits)
    assert {env.reset(seed=seed)[1]["task"] for seed in range(30)} <= {*chosen}


def test_chats_are_of_tasks_in_the_range(run, tmp_path):
    out = tmp_path / "chats.jsonl"
    done = run("chats", "everyday", "--difficulty", ".9:1", "--tasks", 5, "--out", out)
    assert (done.code, len(out.read_text().splitlines())) == (0, 5)
    hard = tasks_within(everyday(), (0.9, 1))
    assert all(f"-{task}-" in out.read_text() for task in hard[np.arange(5) * len(hard) // 5])


@pytest.mark.parametrize("limits", [0.5, (0.5,), ".2:.8"])
def test_a_range_in_python_is_two_shares(limits):
    with pytest.raises(ConfigError, match=r"expected two shares such as \(.2, .8\)"):
        crafting_rows("everyday", part="test", difficulty=limits, tasks=2)


@pytest.mark.parametrize(
    ("graph", "text", "says"),
    [
        ("kitchen", ".2:.8", "were not measured"),
        ("everyday", "hard", "expected a range such as .2:.8"),
        ("everyday", ".2", "expected a range such as .2:.8"),
        ("everyday", ".8:.2", "a share from 0.8 to 1"),
        ("everyday", "nan:1", "a share from 0 to 1"),
        ("everyday", ".01:.02", "leaves no task"),
    ],
)
def test_a_range_that_chooses_nothing_is_refused(graph, text, says):
    with pytest.raises(ConfigError, match=says):
        GameList({"test": [open_play(graph, "test", 1, 8, None)]}, read_range(text))
