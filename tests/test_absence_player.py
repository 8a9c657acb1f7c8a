"""A player that reads train tables alone finds no held-out pair by its absence."""

import runpy
from pathlib import Path

import pytest

from wordcraft_kg import SplitConfig, WordCraftConfig, World, make_split, open_graph
from wordcraft_kg.graphs import OpenedGraph

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "absence_player.py"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["by-recipe", "by-goal"])
@pytest.mark.parametrize("seed", [0, 1])
def test_held_out_pairs_are_not_told_by_their_absence(kind, seed):
    """With a guard that kept them off the tables of their goal it made .8 with 8 distractors."""
    absence_player = runpy.run_path(str(SCRIPT))["absence_player"]
    graph = open_graph("everyday").graph
    opened = OpenedGraph(graph, make_split(graph, SplitConfig(kind, seed=seed)), "everyday")
    for distractors in (8, 1):
        train = World(opened, WordCraftConfig(num_distractors=distractors))
        measured = absence_player(train, train.variant(part="test"), 700_000)
        assert measured["absence"] < measured["random pair"] + 0.03
