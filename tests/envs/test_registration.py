"""The environments are known by name, and importing the package stays light."""

import subprocess
import sys

import gymnasium as gym
import pytest

import wordcraft_kg  # noqa: F401 - registers the environments


@pytest.mark.parametrize("first", ["import gymnasium, wordcraft_kg", "import wordcraft_kg, gymnasium"])
def test_gymnasium_knows_the_environments_in_either_order(first):
    code = f"{first}\nfor name in ('WordCraft-v0', 'WordCraft-OpenEnded-v0'): print(gymnasium.spec(name).id)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.split() == ["WordCraft-v0", "WordCraft-OpenEnded-v0"]


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_everyday_is_played_if_no_graph_is_named(make):
    options = {"num_envs": 2, "vectorization_mode": "vector_entry_point"} if make is gym.make_vec else {}
    env = make("WordCraft-v0", **options).unwrapped
    assert env.world.graph.name == gym.make("WordCraft-OpenEnded-v0").unwrapped.graph.name == "everyday"
    assert make("WordCraft-v0", graph="kitchen", **options).unwrapped.world.graph.name == "kitchen"
