"""Entities that the graph does not have, scored by the words of their labels."""

import numpy as np
import pytest
import torch
from short_fits import short_fits

from wordcraft_kg import RecipesConfig, RecipeScorerConfig, load_scorer, train_recipes
from wordcraft_kg.base.errors import UnknownEntityError
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.recipes.inductive import extended, with_words
from wordcraft_kg.models.scorers.features import make_features
from wordcraft_kg.models.scorers.neighbours.links import OF_COMPONENTS, link_features
from wordcraft_kg.models.scorers.neighbours.lists import make_lists, nearest_words

DIMENSIONS = 8
NEW = ("naan", "muffin", "cheese cake")


@pytest.fixture(scope="module")
def vectors(opened_kitchen, tmp_path_factory):
    """A file of vectors of all words of the kitchen and of `naan`, which has that of `bread`, and `muffin`."""
    rng = np.random.default_rng(0)
    words = sorted(
        {word for label in opened_kitchen.graph.entities for word in label.split()} | {"muffin"}
    )
    rows = {word: " ".join(f"{x:.6f}" for x in rng.normal(size=DIMENSIONS)) for word in words}
    rows["naan"] = rows["bread"]
    path = tmp_path_factory.mktemp("vectors") / "words.txt"
    path.write_text("".join(f"{word} {row}\n" for word, row in rows.items()))
    return path


@pytest.fixture(scope="module", autouse=True)
def only_compared():
    """Scores are compared with each other, however good they are."""
    with short_fits():
        yield


@pytest.fixture(scope="module")
def folder(opened_kitchen, vectors, tmp_path_factory):
    settings = RecipeScorerConfig(kg="full", folds=2, features=str(vectors))
    out = tmp_path_factory.mktemp("models") / "kitchen-recipes"
    return train_recipes(RecipesConfig(opened_kitchen.source, settings), out).folder


@pytest.fixture(scope="module")
def scorer(folder):
    return load_scorer(folder)


def wider(folder, scorer, labels=NEW):
    return with_words(folder, scorer, labels)


def assert_tables_agree(one, other, size):
    """Both scorers give the first entities nearly the same scores."""
    for relation in ("combinesWith", "componentOf"):
        expected, table = (scorer.table(relation)[:size, :size] for scorer in (one, other))
        torch.testing.assert_close(table, expected, rtol=1e-3, atol=1e-3 * float(expected.std()))


# --- what stays ------------------------------------------------------------------------------------------------------


def test_new_entities_leave_the_scores_of_the_others_as_they_are(folder, scorer):
    size = len(scorer.entities)
    more = wider(folder, scorer)
    assert_tables_agree(scorer, more, size)
    ids = torch.randint(size, (3, 500), generator=torch.Generator().manual_seed(0))
    before, after = scorer.score_recipes(*ids), more.score_recipes(*ids)
    torch.testing.assert_close(after, before, rtol=1e-3, atol=1e-2 * float(before.std()))


def test_a_model_with_outside_knowledge_knows_the_graphs_entities_alone(
    opened_kitchen, vectors, put, tmp_path
):
    book = put("a,b,result\nbread,tomato,bruschetta\nflour,butter,shortbread\n", "other.csv")
    settings = RecipeScorerConfig(kg="full", folds=2, features=str(vectors), with_=(str(book),))
    folder = train_recipes(RecipesConfig(opened_kitchen.source, settings), tmp_path / "m").folder
    with pytest.raises(UnknownEntityError, match=r"'naan'.*outside knowledge"):
        with_words(folder, load_scorer(folder), NEW)


def test_an_entity_of_no_recipe_is_scored_in_the_graph_as_out_of_it(opened_kitchen):
    """An entity in no recipe has the same features inside the vocabulary as at its end."""
    size = opened_kitchen.graph.num_entities
    draws = np.random.default_rng(2).normal(size=(size + 1, DIMENSIONS)).astype(np.float32)
    vectors = draws / np.linalg.norm(draws, axis=1, keepdims=True)
    recipes = opened_kitchen.graph.recipes
    middle = 40  # the new entity is in the middle of the vocabulary instead of at its end
    order = np.insert(np.arange(size), middle, size)
    moved = vectors[order]
    inside = make_lists(recipes + (recipes >= middle), moved, nearest_words(moved, size))
    outside = make_lists(recipes, vectors, nearest_words(vectors, size))
    every = np.arange(size + 1)
    for relation in (COMBINES_WITH, COMPONENT_OF):
        found = link_features(inside, relation, every, every)
        expected = link_features(outside, relation, every, every)[order][:, order]
        torch.testing.assert_close(found, expected, rtol=1e-2, atol=1e-2)


# --- what words say --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["bread", "water", "milk"])
def test_a_new_entity_goes_where_one_with_the_same_words_goes(scorer, model):
    twin = scorer.entities.index(model)
    of_twin = scorer.tensors()["vectors"][[twin]].float().numpy()
    more = extended(scorer, ["twin"], of_twin)
    recipes = scorer.recipes
    made = torch.unique(recipes[(recipes[:, :2] == twin).any(1), 2]).long()
    size = len(scorer.entities)
    # By kernel regression: the ranker learned from words without a meaning.
    features = link_features(
        more.knowledge.lists(), COMPONENT_OF, np.array([size]), np.arange(size)
    )
    row = features[0, :, OF_COMPONENTS.index("regression")]
    ranks = (row[None] > row[made][:, None]).sum(1)
    assert float(ranks.float().mean()) < size / 4  # half of all by chance


def test_a_recipe_with_a_new_entity_is_scored_and_explained(folder, scorer):
    more = wider(folder, scorer)
    scores = more.score_recipes("naan", "cheese", list(more.entities))
    assert scores.shape == (len(scorer.entities) + len(NEW),)
    assert torch.isfinite(scores).all()
    assert all(
        "naan" not in witness.recipe
        for witness in more.supporting_recipes("naan", "cheese", "sandwich")
    )


# --- refusals --------------------------------------------------------------------------------------------------------


def test_a_word_without_a_vector_is_named_with_the_nearest_entities(folder, scorer):
    with pytest.raises(UnknownEntityError, match=r"'flouur'.*'flour'.*vector in .*words.txt"):
        wider(folder, scorer, ["naan", "flouur"])


def test_a_link_predictor_knows_the_entities_of_its_graph_only(complex_folder):
    with pytest.raises(UnknownEntityError, match=r"'naan'.*train-recipes"):
        with_words(complex_folder, load_scorer(complex_folder), ["naan"])


@pytest.mark.parametrize(
    "features", ["one-hot", pytest.param("shuffled:glove", marks=pytest.mark.slow)]
)
def test_features_that_are_no_words_say_nothing_of_new_ones(opened_kitchen, tmp_path, features):
    settings = RecipeScorerConfig(kg="full", folds=2, features=features)
    trained = train_recipes(RecipesConfig(opened_kitchen.source, settings), tmp_path / "model")
    with pytest.raises(UnknownEntityError, match=rf"'naan'.*{features}.*glove"):
        with_words(trained.folder, load_scorer(trained.folder), ["naan"])


def test_what_is_no_label_is_refused(scorer):
    with pytest.raises(ValueError, match="blank"):
        extended(scorer, ["naan", " "], np.zeros((2, DIMENSIONS)))


def test_a_model_of_built_in_vectors_places_other_words_by_glove(recipes_folder):
    scorer = load_scorer(recipes_folder)
    more = with_words(recipes_folder, scorer, ["lemonade"])
    vectors = more.knowledge.vectors.float()
    size = len(scorer.entities)
    assert torch.equal(more.knowledge.vectors[:size], scorer.whole.knowledge.vectors)
    assert float(vectors[size].norm()) == pytest.approx(1, abs=1e-3)
    glove = make_features("glove", more.entities).unit_vectors
    nearest = int((glove[:size] @ glove[size]).argmax())
    cosines = vectors[:size] @ vectors[size]
    # The most similar label by GloVe is among the first of 80 by the vector made of such labels.
    assert int((cosines > cosines[nearest]).sum()) < 8
    with pytest.raises(LookupError, match="No word in this label has a vector"):
        with_words(recipes_folder, scorer, ["qqxzzk"])
