import math

import numpy as np
import pytest

from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book, recipe_triples
from wordcraft_kg.models.features import EntityFeatures, glove_features
from wordcraft_kg.models.near_synonyms import NEAR_SYNONYM, near_synonym_recipes, near_synonym_triples


def cosine(one, other):
    lengths = math.sqrt(sum(x * x for x in one)) * math.sqrt(sum(y * y for y in other))
    return sum(x * y for x, y in zip(one, other, strict=True)) / lengths if lengths else 0.0


def test_the_vector_of_the_is_gloves():
    # The first numbers of the first line of the published glove.6B.50d.txt.
    features = glove_features(["the"])
    np.testing.assert_allclose(features.vectors[0, :4], [0.418, 0.24968, -0.41242, 0.1217], rtol=1e-5)
    assert features.vectors.shape == (1, 50)
    assert features.vectors.dtype == np.float32


def test_a_phrase_is_the_mean_of_its_words_whatever_their_case():
    features = glove_features(["Black  Hole", "black", "hole"])
    np.testing.assert_allclose(features.vectors[0], features.vectors[1:].mean(0), rtol=1e-6)
    assert features.words == ("black", "hole")


def test_words_without_a_vector_are_named_and_left_out_of_the_mean():
    features = glove_features(["zqxjkv", "water zqxjkv", "water"])
    assert features.missing_words == ("zqxjkv",)
    assert features.known.tolist() == [False, True, True]
    assert not features.vectors[0].any()
    np.testing.assert_array_equal(features.vectors[1], features.vectors[2])
    assert np.isfinite(features.unit_vectors).all()
    assert not features.unit_vectors[0].any()


def test_features_follow_the_order_of_the_labels_and_cannot_be_changed():
    labels = ["sea", "iron", "bread", "sea"]
    features = glove_features(labels)
    again = glove_features(labels[::-1])
    np.testing.assert_array_equal(features.vectors, again.vectors[::-1])
    np.testing.assert_allclose(np.linalg.norm(features.unit_vectors, axis=1), 1, rtol=1e-5)
    for array in (features.vectors, features.known, features.unit_vectors):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_no_labels_have_no_features():
    assert glove_features([]).vectors.shape == (0, 50)


def test_nearly_all_words_of_everyday_have_a_vector():
    features = glove_features(open_book("everyday").entities)
    assert (len(features.missing_words), len(features.words)) == (0, 737)


def test_meaning_is_in_the_vectors():
    lake, river, bread = glove_features(["lake", "river", "bread"]).vectors.tolist()
    assert cosine(lake, river) > NEAR_SYNONYM > cosine(lake, bread)


# --- near-synonyms ---------------------------------------------------------------------------------------------------


def slow_near_synonyms(split, vectors, threshold):
    """Compare each test recipe with each train recipe, word by word as the definition says."""
    found = []
    for recipe, part in zip(split.graph.recipes.tolist(), split.parts.tolist(), strict=True):
        twins = False
        for other, other_part in zip(split.graph.recipes.tolist(), split.parts.tolist(), strict=True):
            if part != 2 or other_part != 0 or recipe[2] != other[2]:
                continue
            for kept, changed in ((0, 1), (1, 0)):
                for other_kept, other_changed in ((0, 1), (1, 0)):
                    same = recipe[kept] == other[other_kept]
                    near = cosine(vectors[recipe[changed]], vectors[other[other_changed]]) >= threshold
                    twins = twins or (same and near)
        found.append(twins)
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("threshold", [0.3, 0.7])
def test_near_synonyms_are_those_of_the_definition(seed, threshold):
    rng = np.random.default_rng(seed)
    rows = [(f"e{a}", f"e{b}", f"e{c}") for a, b, c in rng.integers(0, 9, size=(60, 3)).tolist()]
    graph = RecipeGraph.from_recipes(rows)
    split = make_split(graph, SplitConfig("by-recipe-plain", train_ratio=0.6, valid_ratio=0.1, seed=seed))
    vectors = rng.normal(size=(graph.num_entities, 3)).astype(np.float32)
    vectors[0] = 0
    known = np.ones(graph.num_entities, dtype=bool)
    features = EntityFeatures("test", vectors, known, graph.entities, ())
    expected = slow_near_synonyms(split, vectors.tolist(), threshold)
    assert near_synonym_recipes(split, features, threshold).tolist() == expected
    assert any(expected)
    assert not all(flag for flag, part in zip(expected, split.parts.tolist(), strict=True) if part == 2)


def test_a_triple_counts_if_any_near_synonym_recipe_gives_it():
    graph = RecipeGraph.from_recipes([("a", "b", "x"), ("a", "c", "x"), ("b", "c", "y")])
    repeated = np.array([True, False, False])
    triples = graph.triples
    given = {tuple(row) for row in recipe_triples(graph.recipes[:1]).tolist()}
    expected = [tuple(row) in given for row in triples.tolist()]
    assert near_synonym_triples(graph, repeated, triples).tolist() == expected
    assert not near_synonym_triples(graph, np.zeros(3, dtype=bool), triples).any()
