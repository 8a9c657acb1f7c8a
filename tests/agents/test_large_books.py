"""Commands that need no training on a book of thousands of entities: none may hold a table of all
pairs."""

import os
import subprocess
import sys

import numpy as np
import pytest

ENTITIES, RECIPES = 12_000, 36_000
ALL_PAIRS = ENTITIES**2 * 4 / 2**20
"""MiB of a table of all pairs, 4 bytes a cell."""
COMMANDS = (
    ("describe",),
    ("discover", "--attempts", "5", "--runs", "1"),
    ("evaluate-agent", "--distractors", "1", "--distractor-seeds", "1"),
    ("describe", "--tasks", "--depth", "2", "--distractors", "4"),
)
MEASURE = """
import resource, sys
import pandas, torch
import wordcraft_kg.agents.discovery, wordcraft_kg.envs.wordcraft, wordcraft_kg.evaluation.players
from wordcraft_kg.cli import main

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10

before = peak()
for command, *options in eval(sys.argv[2]):
    code = main([command, sys.argv[1], *options, "--quiet"])
    print(command, code, peak() - before, file=sys.stderr)
"""


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """A book in which each thing is made by three pairs of earlier things."""
    rng = np.random.default_rng(0)
    results = np.repeat(np.arange(10, ENTITIES), 3)[:RECIPES]
    parts = (rng.random((len(results), 2)) * results[:, None]).astype(int)
    path = tmp_path_factory.mktemp("books") / "large.csv"
    lines = [
        f"t{a},t{b},t{result}\n"
        for (a, b), result in zip(parts.tolist(), results.tolist(), strict=True)
    ]
    head = (
        "# base: "
        f"{', '.join(f't{entity}' for entity in range(10))}\ningredient_a,ingredient_b,result\n"
    )
    path.write_text("".join([head, *lines]), encoding="utf-8")
    return path


@pytest.mark.slow
def test_memory_does_not_grow_with_the_square_of_the_entities(book):
    outcome = subprocess.run(
        [sys.executable, "-c", MEASURE, str(book), repr(COMMANDS)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    lines = [line.split() for line in outcome.stderr.splitlines()]
    assert [(name, code) for name, code, _ in lines] == [(command[0], "0") for command in COMMANDS]
    for name, _, growth in lines:
        assert float(growth) < ALL_PAIRS, name
