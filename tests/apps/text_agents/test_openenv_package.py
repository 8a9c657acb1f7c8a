"""The package of the OpenEnv environment: its canary games and what it declares."""

import json
import re
from pathlib import Path

import pytest

pytest.importorskip("starlette")

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.benchmark import read_manifest
from wordcraft_kg.apps.text_agents.hosted_games import GameList, open_play
from wordcraft_kg.apps.text_agents.openenv_server import CraftingSession

PACKAGE = Path(__file__).parents[3] / "publish" / "openenv"


@pytest.mark.slow
def test_canary_games_and_the_declared_number_of_tasks_are_those_of_the_server():
    games = GameList({"train": [open_play("everyday", "train", 1, 8, None)]})
    session = CraftingSession(games)
    lines = (PACKAGE / "validation" / "canaries.jsonl").read_text(encoding="utf-8").splitlines()
    rewards = []
    for line in map(json.loads, lines):
        session.reset(line["reset"])
        total = sum(session.step(action)["reward"] for action in line["actions"])
        assert total == line["reward"]
        rewards.append(total)
    assert {*rewards} == {0.0, 1.0}
    declared = (PACKAGE / "openenv.yaml").read_text(encoding="utf-8")
    assert re.search(r"^      train: (\d+)$", declared, re.M)[1] == str(games.count("train"))


def test_the_card_of_the_benchmark_names_its_tracks():
    card = (PACKAGE.parent / "everyday-v3" / "README.md").read_text(encoding="utf-8")
    rows = "\n".join(line for line in card.splitlines() if line.startswith("| `"))
    assert set(re.findall(r"`([a-z0-9-]+)`", rows)) == set(read_manifest()[0].tracks)


def test_the_package_is_of_this_version_and_ships_no_oracle_in_its_image():
    declared = (PACKAGE / "openenv.yaml").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in declared
    copied = re.findall(r"^COPY (.*)", (PACKAGE / "Dockerfile").read_text(encoding="utf-8"), re.M)
    assert copied == ["*.whl ./", "server ./server"]
