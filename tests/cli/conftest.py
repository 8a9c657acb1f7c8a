"""Commands that are expected to print values, and trained folders that all files here share."""

import json

import pytest
from helpers import write_graph
from quick import QUICK, SMALL, TINY, succeed


@pytest.fixture(scope="session")
def trained(made_once):
    """A folder with a graph, two models of its partial graph, one of its full graph, and two seeds;
    read only."""

    def make(root):
        write_graph(root / "graph")
        train = ("train-complex", root / "graph", *QUICK)
        succeed(
            (*train, "--out", root / "one"),
            (*train, "--seed", 1, "--out", root / "two"),
            (*train, "--kg", "full", "--out", root / "full"),
            ("train-complex", root / "graph", *TINY, "--seeds", "0,3", "--out", root / "links"),
        )

    return made_once("cli-links", make)


@pytest.fixture(scope="session")
def world(made_once):
    """A folder with a graph, a scorer with folds, and runs: two unguided seeds, a guided one, more
    attempts."""

    def make(root):
        write_graph(root / "graph")
        train = ("train-agent", root / "graph", *SMALL, "--distractors", 2)
        succeed(
            (
                "train-complex",
                root / "graph",
                "--dim",
                8,
                "--epochs",
                5,
                "--n3",
                0.1,
                "--out",
                root / "scorer",
                "--quiet",
            ),
            (*train, "--seeds", "0,1", "--out", root / "plain"),
            (*train, "--scorer", root / "scorer", "--out", root / "guided"),
            (*train, "--max-attempts", 3, "--seed", 5, "--out", root / "many"),
        )

    return made_once("cli-agents", make)


@pytest.fixture
def printed(run):
    """Run a command that goes well, and return the JSON object that it prints."""

    def printed(*command):
        outcome = run(*command, "--json")
        assert outcome.code == 0, outcome.err
        assert outcome.out.count("\n") == 1
        return json.loads(outcome.out)

    return printed
