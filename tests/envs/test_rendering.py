"""Pictures of the environments."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg.base.errors import EpisodeError, MissingExtraError
from wordcraft_kg.envs import rendering
from wordcraft_kg.envs.open_ended import OpenEndedEnv
from wordcraft_kg.envs.rendering import COLOURS, Scene, Tile, picture
from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs import RecipeGraph

NAMES = ("WordCraft-v0", "WordCraft-OpenEnded-v0")
ROWS = [("fire", "water", "steam"), ("steam", "steam", "cloud"), ("cloud", "fire", "rain"), ("rain", "water", "sea")]
GRAPH = RecipeGraph.from_recipes(ROWS, base=["fire", "water"])


@pytest.fixture
def drawn() -> None:
    """Skip tests that draw where pygame is not installed."""
    pytest.importorskip("pygame", reason="needs pygame, from the extra render")


def posed(mode: str, **settings: Any) -> WordCraftEnv:
    """An environment whose table is known."""
    env = WordCraftEnv(GRAPH, part="all", num_distractors=1, render_mode=mode, **settings)
    env.reset(seed=0, options={"task": 0, "table": ["fire", "steam", "water"]})
    return env


def has(shown: np.ndarray, colour: tuple[int, int, int]) -> bool:
    return bool((shown == np.array(colour)).all(axis=2).any())


@pytest.mark.parametrize("kind", [WordCraftEnv, OpenEndedEnv])
def test_without_pygame_the_error_names_the_extra(kind: Any, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    with pytest.raises(MissingExtraError, match=r"pip install 'pygame>="):
        kind(GRAPH, render_mode="rgb_array")


@pytest.mark.parametrize("name", NAMES)
def test_without_pygame_gymnasiums_checker_accepts_the_other_modes(name: str):
    code = "import sys; sys.modules['pygame'] = None\nimport gymnasium, wordcraft_kg\n"
    code += "from gymnasium.utils.env_checker import check_env\n"
    code += f"check_env(gymnasium.make({name!r}, graph='kitchen').unwrapped)"
    subprocess.run([sys.executable, "-W", "error::UserWarning", "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("make", [lambda: WordCraftEnv(GRAPH, part="all", num_distractors=0, render_mode="ansi"), None])
def test_an_environment_that_has_not_begun_has_nothing_to_show(make: Any):
    env = make() if make else OpenEndedEnv(GRAPH, render_mode="ansi")
    with pytest.raises(EpisodeError):
        env.render()


def test_the_scene_shows_goal_selection_table_and_outcome():
    env = posed("ansi")
    names = GRAPH.entities
    goal = names[env.state.goal]
    env.step(1)
    facts, tiles = env._scene()
    assert dict(facts[:3]) == {"goal": Tile(goal, "goal"), "selection": Tile("steam", "held"), "attempts left": "1"}
    assert [tile.label for tile in tiles[:3]] == ["fire", "steam", "water"]
    assert tiles[1].mark == "held"
    assert [tile.mark for tile in tiles[3:]] == ["empty"] * (env.num_slots - 3)
    env.step(1)
    facts, tiles = env._scene()
    assert facts[1] == ("selection", Tile("nothing", "empty"))
    assert tiles[3] == Tile("cloud", "goal" if goal == "cloud" else "plain", 3)
    assert facts[3] == ("", "made" if goal == "cloud" else "not made")


def test_the_scene_of_open_ended_play_shows_the_latest_entities(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("wordcraft_kg.envs.open_ended.SHOWN", 3)
    env = OpenEndedEnv(GRAPH, render_mode="ansi")
    env.reset()
    assert env._scene().tiles == [Tile("fire"), Tile("water"), Tile("", "empty")]
    env.step([GRAPH.id_of("fire"), GRAPH.id_of("water")])
    env.step([GRAPH.id_of("steam"), GRAPH.id_of("steam")])
    scene = env._scene()
    assert scene.tiles == [Tile("water"), Tile("steam"), Tile("cloud", "new")]
    assert scene.facts[0] == ("known", "4 of 6")
    assert scene.facts[2] == ("last attempt", "steam + steam -> cloud")


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("name", NAMES)
def test_gymnasiums_checker_accepts_all_modes_and_all_pictures_have_one_even_size(name: str):
    check_env(gym.make(name, graph="kitchen").unwrapped)
    env = gym.make(name, graph="kitchen", render_mode="rgb_array")
    env.reset(seed=0)
    shown = [env.render()]
    for _ in range(2):
        env.step(np.array([0, 0]) if name == NAMES[1] else 0)
        shown.append(env.render())
    assert {(one.dtype, one.shape) for one in shown} == {(np.dtype(np.uint8), shown[0].shape)}
    assert shown[0].shape[0] % 2 == shown[0].shape[1] % 2 == 0  # video encoders need even sizes


@pytest.mark.usefixtures("drawn")
def test_a_picture_shows_what_is_held_and_changes_with_it():
    env = posed("rgb_array")
    before = env.render()
    assert not has(before, COLOURS["held"][0])
    assert has(before, COLOURS["goal"][0])
    env.step(0)
    after = env.render()
    assert has(after, COLOURS["held"][0])
    assert not np.array_equal(before, after)
    assert np.array_equal(after, env.render())


@pytest.mark.usefixtures("drawn")
def test_a_long_label_stays_in_its_tile():
    long = picture(Scene((), [Tile("m" * 60), Tile("")]))
    short = picture(Scene((), [Tile(""), Tile("")]))
    changed = np.flatnonzero((long != short).any(axis=(0, 2)))
    left = rendering.MARGIN
    assert left < changed.min() <= changed.max() < left + rendering.TILE[0]


@pytest.mark.usefixtures("drawn")
def test_a_video_is_recorded(tmp_path: Path):
    pytest.importorskip("moviepy", reason="needs moviepy, from the extra render")
    env = gym.make("WordCraft-v0", graph="kitchen", depth=2, render_mode="rgb_array")
    env = gym.wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda _: True)
    env.reset(seed=0)
    over = False
    while not over:
        *_, over, _, _ = env.step(0)
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    assert video.stat().st_size > 1_000
