"""Recipe scorers with a pair encoder: nothing of a fold leaks, the same bytes again, small books without."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import recorded, resume
from link_helpers import (
    contents,
    interrupt_after,
    random_graph,
    rewritten,
    same_files,
    write_random_book,
)
from short_fits import assert_sources_are_restored, short_fits, words_of

from wordcraft_kg import RecipeGraph, WordCraftConfig, World, load_scorer, open_graph, open_model
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.graphs.splits import Split, SplitConfig, make_split
from wordcraft_kg.graphs.train_samples import Folds, make_folds
from wordcraft_kg.models.knowledge.books import open_other_book
from wordcraft_kg.models.recipes import encoder_fitting, fitting, recipe_config, recipe_training
from wordcraft_kg.models.recipes.encoder_fitting import EncoderSchedule, fit_encoders
from wordcraft_kg.models.recipes.fitting import encoders_of, fit_recipe_scorers
from wordcraft_kg.models.recipes.recipe_config import (
    ENCODER_UP_TO,
    RecipesConfig,
    RecipeScorerConfig,
)
from wordcraft_kg.models.recipes.recipe_training import encoder_of_books, train_recipes
from wordcraft_kg.models.scorers.neighbours.pair_features import OF_ENCODER
from wordcraft_kg.models.scorers.neighbours.results import results_of
from wordcraft_kg.models.scorers.ranker import Ranker

TINY = EncoderSchedule(used=6, hidden=8, made=5, batch=16, sampled=8, epochs=1)
WITH = RecipeScorerConfig(folds=3, features="one-hot")


@pytest.fixture(scope="module", autouse=True)
def only_compared():
    with short_fits(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(encoder_fitting, "SCHEDULE", TINY)
        patch.setattr(fitting, "RESULTS", fitting.RESULTS._replace(epochs=1, steps=4))
        patch.setattr(recipe_config, "ENCODER_FROM", 20)
        patch.setattr(fitting, "ONE_LESSON_FROM", 20)
        patch.setattr(fitting, "STRICT", 0)
        yield


@pytest.fixture(scope="module")
def trained(book, tmp_path_factory):
    """A recipe scorer with an encoder; read only."""
    folder = tmp_path_factory.mktemp("models") / "with"
    return train_recipes(RecipesConfig(str(book), WITH), folder).folder


@pytest.mark.parametrize(
    ("done", "left"),
    [
        pytest.param(1, 5, marks=pytest.mark.slow),
        pytest.param(4, 2, marks=pytest.mark.slow),
        (7, 0),
    ],
)
def test_an_interrupted_run_continues_to_the_same_bytes(book, trained, done, left, monkeypatch):
    # Six encoders come first: (), (0,), (0, 1), (1,), (2,), (0, 2).
    folder = trained.parent / f"interrupted-{done}"
    with pytest.raises(KeyboardInterrupt, match=r"part \d is saved in .*Repeat the command"):
        train_recipes(RecipesConfig(str(book), WITH), folder, progress=interrupt_after(done))
    before = contents(folder / "checkpoints")
    needed = recorded(monkeypatch, recipe_training, "fit_encoders")
    resume(folder)
    assert before
    # Beside the encoder that was reported, another may have ended.
    assert len(needed) <= left
    assert not (folder / "checkpoints").exists()
    assert same_files(folder, trained, "calibration.json")


def test_ctrl_c_in_the_middle_of_a_fit_ends_it():
    """The fit of an encoder takes minutes on a large book: it looks at each step."""
    asked = []

    def stop():
        asked.append(len(asked))
        return len(asked) > 1

    folds = make_folds(make_split(random_graph(2, 12, 60), SplitConfig()), 3)
    with pytest.raises(KeyboardInterrupt):
        list(fit_encoders(folds, torch.zeros(12, 0), [()], stop=stop))
    assert len(asked) == 2


def fitted(folds, words, wanted):
    vectors = torch.from_numpy(words.vectors).float()
    encoders = {}
    if not fitting.STRICT:
        encoders = dict(fit_encoders(folds, vectors, encoders_of(folds, wanted)))
    fits = fit_recipe_scorers(folds, words, wanted, encoders=encoders)
    return {left_out: knowledge.constants() for left_out, knowledge in fits}


def same_tensors(one, other):
    return all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("strict", [0, 60])
def test_a_changed_result_of_a_fold_leaves_the_scorer_without_it_alone(monkeypatch, strict):
    """But for rankers of a large book: features of other folds' queries count its recipes."""
    monkeypatch.setattr(fitting, "STRICT", strict)
    monkeypatch.setattr(fitting, "ONE_LESSON_FROM", strict + 1)
    graph = random_graph(2, 12, 60)
    folds = make_folds(make_split(graph, SplitConfig()), 3)
    rows = graph.recipes.copy()
    row = int(np.flatnonzero(folds.of_recipe == 1)[0])
    known = {tuple(recipe) for recipe in rows.tolist()}
    a, b, _ = rows[row].tolist()
    rows[row, 2] = next(result for result in range(12) if (a, b, result) not in known)
    changed = RecipeGraph(graph.entities, rows, [], name="changed")
    place = {tuple(recipe): number for number, recipe in enumerate(rows.tolist())}
    order = [place[tuple(recipe)] for recipe in changed.recipes.tolist()]
    of_recipe = folds.of_recipe[order]
    other = Folds(
        Split(changed, SplitConfig(), np.where(of_recipe < 0, 2, 0).astype(np.int8)),
        3,
        0,
        of_recipe,
    )
    words = words_of(np.random.default_rng(0).normal(size=(12, 5)))
    wanted = [(), (0,), (1,)]
    before, after = (fitted(each, words, wanted) for each in (folds, other))
    prefixes = ("", "results_", "combinesWith_", "componentOf_")
    rankers = {f"{prefix}{name}" for prefix in prefixes for name in Ranker._fields}
    for left_out in wanted:
        learned, changed_to = before[left_out], after[left_out]
        differing = {name for name in learned if not torch.equal(learned[name], changed_to[name])}
        assert (differing <= rankers) == (left_out == (1,))
        assert bool(differing) != (left_out == (1,) and strict > 0)


def test_no_held_out_result_changes_a_feature_from_which_rankers_learn():
    """Queries of fold 0 with other results have the same features, to the bit."""
    graph = random_graph(3, 12, 60)
    folds = make_folds(make_split(graph, SplitConfig()), 3)
    words = words_of(np.random.default_rng(0).normal(size=(12, 5)))
    vectors = torch.from_numpy(words.vectors).float()
    ((_, encoder),) = fit_encoders(folds, vectors, [(0,)])
    lists = words.lists(folds.recipes([0]))
    held_out = folds.recipes_of(0)
    replaced = held_out.copy()
    replaced[:, 2] = (replaced[:, 2] + 1) % 12
    features = []
    for rows in (held_out, replaced):
        # All results are right for all pairs, so that no query is dropped.
        every = np.array([(a, b, c) for a, b, _ in held_out.tolist() for c in range(12)])
        rng = np.random.default_rng(0)
        features.append(fitting._result_queries(lists, encoder, rows, every, rng))
    (links, queries), (replaced_links, replaced_queries) = features
    assert torch.equal(links, replaced_links)
    assert torch.equal(queries.features, replaced_queries.features)
    assert torch.equal(queries.competes, replaced_queries.competes)


def test_a_fold_without_right_candidates_gives_an_empty_ranker_of_results():
    folds = make_folds(make_split(random_graph(3, 12, 60), SplitConfig()), 3)
    words = words_of(np.random.default_rng(0).normal(size=(12, 5)))
    vectors = torch.from_numpy(words.vectors).float()
    ((_, encoder),) = fit_encoders(folds, vectors, [(0,)])
    lists = words.lists(folds.recipes([0]))
    nothing = np.zeros((0, 3), dtype=np.int64)
    rng = np.random.default_rng(0)
    _, queries = fitting._result_queries(lists, encoder, folds.recipes_of(0), nothing, rng)
    assert len(queries.competes) == 0
    ranker = fitting._result_ranker(queries, torch.Generator(), None, folds.recipes())
    assert not ranker.second.any()


def test_a_known_recipe_is_the_first_result_of_its_pair():
    """Where each pair makes one thing, no held-out pair teaches what a known result looks like."""
    rows = random_graph(4, 12, 60).recipes
    _, first = np.unique(rows[:, :2], axis=0, return_index=True)
    graph = RecipeGraph(tuple("abcdefghijkl"), rows[first], [], name="single")
    folds = make_folds(make_split(graph, SplitConfig()), 3)
    words = words_of(np.random.default_rng(0).normal(size=(12, 5)))
    vectors = torch.from_numpy(words.vectors).float()
    encoders = dict(fit_encoders(folds, vectors, encoders_of(folds, [()])))
    ((_, knowledge),) = fit_recipe_scorers(folds, words, [()], encoders=encoders)
    known = torch.from_numpy(folds.recipes([]))
    ids, _ = results_of(knowledge, known[:, 0], known[:, 1])
    assert torch.equal(ids[:, 0], known[:, 2])


@pytest.fixture(scope="module")
def other_book(book, tmp_path_factory):
    """Another book of the same labels, with two recipes that both books have."""
    shared = book.read_text().splitlines()[1:3]
    return write_random_book(tmp_path_factory.mktemp("books") / "other.csv", 5, shared)


@pytest.mark.slow
def test_a_large_other_book_gives_all_folds_its_encoder(book, other_book, tmp_path):
    settings = RecipeScorerConfig(folds=3, features="one-hot", with_=(str(other_book),))
    scorer = load_scorer(
        train_recipes(RecipesConfig(str(book), settings), tmp_path / "model").folder
    )
    other = open_other_book(str(other_book), open_graph(str(book)))
    expected = encoder_of_books([other], 12, "one-hot")
    for each in (scorer.whole, *(scorer.left_out(fold) for fold in range(3))):
        assert same_tensors(each.knowledge.encoder()._asdict(), expected._asdict())
        # The ranker uses it.
        assert each.knowledge.first[0, -len(OF_ENCODER) :].any()
        # It proposes no results: they are those of other books.
        assert not each.proposes_results


def test_an_encoder_of_words_that_the_graph_does_not_use_knows_no_new_entities():
    rows = random_graph(6, 12, 60).recipes.copy()
    vectors = torch.randn(12, 4, generator=torch.Generator().manual_seed(0))
    encoder = encoder_fitting.fit_encoder(rows, vectors, torch.Generator().manual_seed(1))
    longer = encoder.without_words(6).with_entities(torch.eye(6)[:2])
    assert torch.equal(longer.used[:-2], encoder.used)
    assert torch.equal(longer.made[-1], longer.made[-2])


def test_agents_score_by_the_encoders_of_their_folds_and_are_restored(trained, book):
    world = World.open(str(book), WordCraftConfig(part="train", num_distractors=2))
    assert_sources_are_restored(load_scorer(trained), world.tasks)


def test_results_of_a_pair_have_probabilities(trained, book):
    from wordcraft_kg.evaluation.scores import RecipeQuery, RecipeScoring

    scorer = load_scorer(trained)
    calibration = json.loads((trained / "calibration.json").read_text())
    assert 0 < calibration["covered"] <= 1
    shares = scorer.result_probabilities(0, [1, 2])
    assert shares.shape == (2, 12)
    torch.testing.assert_close(shares.sum(1), torch.full((2,), calibration["covered"]))
    scoring = RecipeScoring(open_model(trained, str(book)))
    query = RecipeQuery((scorer.entities[0], scorer.entities[1], None))
    answers = list(scoring.answers([query], 4, is_explained=True))
    assert len(answers) == 4
    probabilities = [answer.probability for answer in answers]
    assert probabilities == sorted(probabilities, reverse=True)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, True),
        ({"with_": ("everyday",)}, False),
        ({"kg": "none", "with_": ("everyday",)}, False),
    ],
)
def test_an_encoder_depends_on_the_number_of_recipes_and_on_outside_knowledge(settings, expected):
    config = RecipeScorerConfig(**settings)
    assert not config.has_encoder(recipe_config.ENCODER_FROM - 1)
    assert config.has_encoder(recipe_config.ENCODER_FROM) == expected
    # Beyond a million recipes, nine encoders would take hours.
    assert config.has_encoder(ENCODER_UP_TO) == expected
    assert not config.has_encoder(ENCODER_UP_TO + 1)


def test_an_unknown_device_is_refused_before_anything_is_written(book, tmp_path):
    with pytest.raises(ConfigError, match="device"):
        train_recipes(RecipesConfig(str(book), replace(WITH, device="abacus")), tmp_path / "model")
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: tensors.pop("encoder_made"),
        lambda tensors: tensors.pop("results_first"),
        lambda tensors: tensors.__setitem__("encoder_used", torch.zeros(1, 11, 6).half()),
        lambda tensors: tensors.__setitem__("encoder_used", torch.zeros(1, 12, 6)),
        lambda tensors: tensors.__setitem__("encoder_first", torch.zeros(1, 17, 8)),
        lambda tensors: tensors.__setitem__("encoder_bias", torch.zeros(())),
        lambda tensors: tensors.__setitem__("results_first", torch.zeros(1, 3, 2)),
    ],
)
def test_vectors_of_other_labels_or_shapes_are_refused(trained, tmp_path, change):
    with pytest.raises(ArtefactError, match=r"does not contain a scorer.*Train again"):
        load_scorer(rewritten(trained, tmp_path / "spoilt", weights=change))
