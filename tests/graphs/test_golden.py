"""Figures that are known from elsewhere, or were once looked through by eye and must not change
unnoticed."""

from collections import Counter

import numpy as np
import pytest

from wordcraft_kg.graphs import RecipeGraph, SplitConfig, layers, make_split, read_book, rounds

MUD = [
    *(("water", "earth", "mud"), ("earth", "water", "plant"), ("mud", "fire", "brick")),
    *(("brick", "brick", "wall"), ("fire", "water", "steam")),
]


@pytest.fixture(scope="module")
def mud():
    return RecipeGraph.from_recipes(MUD)


def test_the_small_graph_has_its_ids_recipes_and_base(mud):
    assert mud.entities == ("brick", "earth", "fire", "mud", "plant", "steam", "wall", "water")
    assert mud.base == ("earth", "fire", "water")
    assert mud.hash == "1c95ed91bd75498735e3822d5b67038c625f86fa5ed8e84e856eb99ab9a74e58"
    assert mud.recipes.tolist() == [[0, 0, 6], [1, 7, 3], [1, 7, 4], [2, 3, 0], [2, 7, 5]]


def test_the_kitchen_is_the_book_that_was_published(kitchen):
    assert kitchen.hash == "43fe37e2e912f6b42e9b5f510cde548bc69cc02f72d403c5365572355e54e772"
    assert (kitchen.num_entities, kitchen.num_recipes, kitchen.num_pairs, len(kitchen.triples)) == (
        80,
        326,
        310,
        961,
    )


SPLIT_HASHES = {
    "by-recipe": "62faec6fe06217e84565be30e46c521126ff7701dc233ed1690aa14cad22d0b7",
    "by-recipe-plain": "66473333a27f415d10e124396a3bed46d9c5f17cba65e27ce5d982d634eb6716",
    "by-slot": "fc341139e3aa95fc859fa66cd33341aa833cd507e322e4e509aebf1cac6d506d",
    "by-goal": "566741cd3cbdc0033b8f348f8235d47b31a83120148c1427d230ea1ee9bffe77",
    "none": "d598958fe9302c32f980219c352839a17e8b2165f9b4677d49d19c98be8f992d",
}


@pytest.mark.parametrize("kind", SPLIT_HASHES)
def test_the_kitchen_is_split_as_ever(kitchen, kind):
    assert make_split(kitchen, SplitConfig(kind, seed=0)).hash == SPLIT_HASHES[kind]


def test_little_alchemy_2_has_its_known_hash_and_size(alchemy):
    assert alchemy.hash == "43e57b020d434e8c00300f92770656bf0f555c3dbaed47e41defc0f005626b1e"
    assert (alchemy.num_entities, alchemy.num_recipes, alchemy.num_pairs) == (700, 3417, 3277)
    assert alchemy.triples[:, 1].tolist().count(0) == 6420
    assert alchemy.triples[:, 1].tolist().count(1) == 3578
    assert len(alchemy.triples) == 9998
    assert not len(make_split(alchemy, SplitConfig()).uncovered)


def test_little_alchemy_2_as_read_has_nine_self_results(alchemy_path):
    """Little alchemy 2 as read has nine self results and hardly reaches anything."""
    book = read_book(alchemy_path)
    inferred = RecipeGraph.from_book(book)
    assert (book.dropped_self_results, inferred.base) == (9, ("earth", "fire", "time"))
    assert rounds(layers(inferred))[-1] == 30
    kept = RecipeGraph.from_book(read_book(alchemy_path, keep_self_results=True))
    assert (kept.num_recipes, kept.num_pairs) == (3426, 3285)
    assert Counter(np.diff(kept.pair_starts).tolist()) == {1: 3151, 2: 127, 3: 7}


def test_little_alchemy_2_takes_sixteen_rounds_with_time(alchemy):
    """Little alchemy 2 is reached in sixteen rounds with time and not without."""
    known = [5, 15, 27, 37, 53, 84, 109, 128, 178, 293, 396, 468, 560, 640, 687, 698, 700]
    assert rounds(layers(alchemy)) == known
    layer = layers(alchemy, ["air", "earth", "fire", "water"])
    assert (max(layer), rounds(layer)[-1]) == (16, 697)
    assert alchemy.labels(np.flatnonzero(layer < 0)) == ("archeologist", "ruins", "time")
