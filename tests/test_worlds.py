"""Worlds that benchmarks cut out of books, and intervals over splits."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.graphs import RecipeGraph, layers, open_book

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

worlds_of_books = import_module("cut_worlds")

SIZES = worlds_of_books.SIZES

WAYS = worlds_of_books.WAYS

cut_world = worlds_of_books.cut_world


split_interval = import_module("split_intervals").split_interval


GOLDEN = ["9515e6c95ace", "cfb5e820a644"]
"""Begin of the hashes of the worlds 0 and 7 of ``everyday``."""


@pytest.fixture(scope="module")
def everyday():
    return open_book("everyday")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_a_world_has_all_recipes_among_its_entities_and_all_can_be_made(everyday, way, seed):
    world = cut_world(everyday, seed, way)
    entities = set(world.entities)
    assert SIZES[0] <= len(entities) <= SIZES[1]
    assert 4 <= len(world.base) <= 6
    inside = {recipe for recipe in everyday.recipes if entities.issuperset(recipe)}
    assert set(world.recipes) == inside
    assert (layers(RecipeGraph.from_book(world)) >= 0).all()
    assert {world.kinds[recipe] for recipe in world.recipes} <= set(everyday.kinds.values())
    if way != "base":
        assert world.base == everyday.base


def test_worlds_differ_by_seed_and_way_and_depend_on_nothing_else(everyday):
    worlds = {(seed, way): cut_world(everyday, seed, way) for seed in range(2) for way in WAYS}
    assert len({world.recipes for world in worlds.values()}) == len(worlds)
    assert len({world.sha256 for world in worlds.values()}) == len(worlds)
    for (seed, way), world in worlds.items():
        assert cut_world(everyday, seed, way) == world
    # The ways take turns with the seed.
    assert cut_world(everyday, 1).recipes == worlds[1, "topic"].recipes
    graphs_of_two = [RecipeGraph.from_book(cut_world(everyday, seed)).hash[:12] for seed in (0, 7)]
    # Known figures refer to these worlds: the draws may never change.
    assert graphs_of_two == GOLDEN


def test_the_mean_over_splits_is_never_surer_than_the_tasks_of_one_split():
    noise = 0.02
    low, high = split_interval([0.2200, 0.2205, 0.2195], [noise] * 3)
    assert (low, high) == pytest.approx((0.22 - 1.959964 * noise, 0.22 + 1.959964 * noise))
    student = student_interval([0.2200, 0.2205, 0.2195])
    assert student[1] - student[0] < 0.1 * (high - low)
    wide = [0.18, 0.22, 0.20]
    between = 4.302653**2 * (0.02**2 - 0.019**2) / 3 + 1.959964**2 * 0.019**2
    low, high = split_interval(wide, [0.019] * 3)
    student = 4.302653 * 0.02 / 3**0.5
    assert (0.2 - low, high - 0.2) == pytest.approx([max(between**0.5, student)] * 2)
    near = [0.195, 0.205, 0.20]
    between = 4.302653**2 * (0.005**2 - 0.004**2) / 3 + 1.959964**2 * 0.004**2
    assert between**0.5 < 4.302653 * 0.005 / 3**0.5, "Student's t is the wider one"
    assert split_interval(near, [0.004] * 3) == pytest.approx(student_interval(near))
    assert split_interval([0.4], [0.1]) == pytest.approx((0.4 - 0.1959964, 0.4 + 0.1959964))
    assert split_interval([-0.9, -0.9], [0.1, 0.1], within=(-1, 1))[0] == -1
    with pytest.raises(ConfigError, match="2 errors of 3 scores"):
        split_interval([0.1, 0.2, 0.3], [0.1, 0.1])
