"""Graphs and environments work without what only scorers, training and reports need."""

import json
import os
import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest

from wordcraft_kg.base.extras import CPU_TORCH, pip_install
from wordcraft_kg.graphs.library import DATA_VARIABLE

PROGRAM = """
import json, shlex, sys

HIDDEN = set(json.loads(sys.argv.pop(1)))

class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hide())
"""

COMMANDS = """
from wordcraft_kg.cli import main
print(json.dumps([main(shlex.split(line)) for line in sys.argv[1:]]))
"""

PUBLIC_NAMES = """
import wordcraft_kg
def needed(name):
    try:
        getattr(wordcraft_kg, name)
    except ImportError as error:
        return f"{type(error).__name__}: {error}"
print(json.dumps({name: needed(name) for name in wordcraft_kg.__all__}))
"""

WORKING = (
    *(
        "books",
        "check-book kitchen",
        "build-graph kitchen --out graph",
        "describe graph",
        "describe graph --entity bread",
    ),
    *("describe graph --tasks --limit 2", "export graph --format hif --out graph.hif.json"),
    *(
        "export graph --format graphml --out graph.graphml",
        "play graph",
        "discover graph --runs 1 --attempts 5",
    ),
)

ROOT = Path(__file__).parents[2]


def direct_dependencies():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return {re.split(r"[<>=\[]", line)[0] for line in project["dependencies"]}


@cache
def hidden_modules():
    """Return the modules of all dependencies that the guide to the light installation does not
    name."""
    guide = (ROOT / "docs/installation.md").read_text()
    named = set(re.search(r"^pip install (cyclopts .*)$", guide, re.MULTILINE)[1].split())
    brought = {"rich"}  # by cyclopts
    hidden = direct_dependencies() - named - brought
    assert {"torch", "pykeen", "jinja2"} <= hidden
    by_dependency = {
        module
        for module, packages in packages_distributions().items()
        if hidden.intersection(package.lower() for package in packages)
    }
    by_torch_or_pykeen = {"torch", "optuna", "sklearn"}
    return sorted(by_dependency | by_torch_or_pykeen)


def run(folder, *lines, program=COMMANDS, installed=frozenset()):
    """Run commands in one process, and return their exit codes and its stderr."""
    hidden = sorted(set(hidden_modules()) - installed)
    command = [sys.executable, "-c", PROGRAM + program, json.dumps(hidden), *lines]
    # Built-in books alone: to list those of a data folder, all its recipes are read.
    variables = {name: value for name, value in os.environ.items() if name != DATA_VARIABLE}
    done = subprocess.run(
        command,
        cwd=folder,
        env=variables,
        input="q\n",
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


@pytest.mark.slow
def test_graphs_tasks_exports_play_and_discovery_need_no_torch(tmp_path):
    codes, errors = run(tmp_path, *WORKING)
    assert codes == [0] * len(WORKING), errors


def test_games_are_served_to_trainers_without_torch_and_joblib(tmp_path):
    program = "import wordcraft_kg.apps.text_agents.openenv_server\nprint('{}')"
    # Pages' guard, with messages as templates, comes with the server's extra.
    errors, _ = run(tmp_path, program=program, installed={"jinja2", "markupsafe"})
    assert not errors


def test_a_command_that_needs_more_names_the_package(tmp_path):
    codes, errors = run(tmp_path, "train-complex kitchen")
    assert codes == [1]
    assert "this command needs torch" in errors
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_public_name_that_needs_more_names_the_package(tmp_path):
    errors, _ = run(tmp_path, program=PUBLIC_NAMES)
    assert errors["open_graph"] is errors["LinksConfig"] is None
    needs = "train_agent needs torch, which is not installed. Install it: " + CPU_TORCH
    assert errors["train_agent"] == f"MissingExtraError: {needs}"
    assert errors["train_links"].startswith(
        "MissingExtraError: train_links needs torch, which is not installed."
    )
    assert all(
        error is None or error.startswith("MissingExtraError: ") for error in errors.values()
    )


def test_packages_that_need_torch_come_after_its_cpu_build(uninstalled):
    assert pip_install("pykeen") == "pip install 'pykeen<1.12,>=1.11.1'"
    uninstalled("torch")
    assert pip_install("pykeen") == f"{CPU_TORCH} && pip install 'pykeen<1.12,>=1.11.1'"
    assert pip_install("torch") == CPU_TORCH


def test_constraints_and_lock_file_pin_all_dependencies():
    """Constraints and lock file pin the tested versions of all direct dependencies."""
    root = Path(__file__).parents[2]
    pins = [
        (root / name).read_text()
        for name in ("constraints.txt", "benchmarks/requirements-results.txt")
    ]
    pinned, locked = (
        dict(re.findall(r"^([\w.-]+)==([^+\s]+)", text, re.MULTILINE)) for text in pins
    )
    locked = {name.lower().replace("_", "-"): pin for name, pin in locked.items()}
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    # Extras that the fast tests do not need are not pinned.
    unpinned = {name: [] for name in ("docs", "ray", "tensorboard", "trl")}
    extras = {**project["optional-dependencies"], **unpinned}
    lines = [*project["dependencies"], *(line for extra in extras.values() for line in extra)]
    direct = {re.split(r"[<>=\[]", line)[0] for line in lines} - {"wordcraft-kg"}
    assert {name: version(name).partition("+")[0] for name in sorted(direct)} == pinned
    assert {name: pinned.get(name, pin) for name, pin in locked.items()} == locked
    assert {re.split(r"[<>=\[]", line)[0] for line in project["dependencies"]} <= locked.keys()


@pytest.mark.parametrize(
    ("package", "command", "says"),
    [
        ("mcp", "mcp kitchen", "pip install 'mcp<3"),
        ("websockets", "serve openenv kitchen", "websockets"),
        ("starlette", "explore kitchen", "pip install 'starlette<2"),
    ],
)
def test_without_the_packages_of_an_app_its_command_names_the_extra(
    refused, uninstalled, package, command, says
):
    uninstalled(package)
    refused(*command.split(), says=says, kind="MissingExtraError")


@pytest.fixture
def doctor(run, home):
    def doctor():
        outcome = run("doctor", "--json")
        view = json.loads(outcome.out)
        assert view["passed"] == (outcome.code == 0)
        return outcome.code, {one.pop("check"): tuple(one.values()) for one in view["findings"]}

    return doctor


def test_a_sound_installation_passes_and_a_missing_extra_is_a_note(doctor, uninstalled):
    uninstalled("mcp")
    code, checks = doctor()
    assert (code, checks["packages"][0], checks["torch"][0]) == (0, "ok", "ok")
    assert checks["extra explore"] == ("ok", "installed in supported versions", "")
    assert checks["extra mcp"] == ("note", "mcp is not installed", "pip install 'mcp<3,>=2.3'")


@pytest.mark.parametrize(
    ("missing", "code", "state"),
    [
        (["torch", "pykeen"], 0, "note"),
        pytest.param(["pykeen"], 1, "error", marks=pytest.mark.slow),
    ],
)
def test_only_a_deliberate_light_installation_passes_without_packages(
    doctor, uninstalled, missing, code, state
):
    uninstalled(*missing)
    actual, checks = doctor()
    assert (actual, checks["packages"][0], "torch" in checks) == (
        code,
        state,
        "torch" not in missing,
    )
    assert checks["packages"][2].endswith("pip install 'pykeen<1.12,>=1.11.1'")


def test_an_old_package_fails(doctor, monkeypatch):
    monkeypatch.setattr(
        "wordcraft_kg.base.extras.version", lambda name: "1.0" if name == "scipy" else "99"
    )
    code, checks = doctor()
    assert code == 1
    assert "scipy has version 1.0, expected >=1.12" in checks["packages"][1]
