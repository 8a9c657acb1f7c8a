"""The package of the OpenEnv environment: its canary games and what it declares."""

import json
import re
import shlex
import tomllib
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


def test_the_image_has_the_packages_of_the_small_installation_and_of_the_extra():
    root = PACKAGE.parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    guide = (root / "docs" / "installation.md").read_text(encoding="utf-8")
    small = re.findall(r"^pip install (cyclopts .*)$", guide, re.M)[0].split()
    (command,) = re.findall(
        r"pip install --no-cache-dir (cyclopts.*?) &&",
        (PACKAGE / "Dockerfile").read_text(encoding="utf-8"),
        re.S,
    )
    extra = project["optional-dependencies"]["openenv"]
    # Sessions stand on pages' guard, whose messages are templates.
    assert sorted(shlex.split(command.replace("\\\n", ""))) == sorted([*small, *extra, "jinja2"])
