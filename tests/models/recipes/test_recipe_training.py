"""Fitting recipe scorers: the same bytes again, nothing of a fold left out, and what a spoilt folder says."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers import recorded, resume
from link_helpers import contents, interrupt_after, rewritten, same_files
from short_fits import assert_sources_are_restored, short_fits
from threadpoolctl import threadpool_info

from wordcraft_kg import (
    RecipesConfig,
    RecipeScorerConfig,
    WordCraftConfig,
    World,
    load_scorer,
    make_sources,
    open_graph,
    train_recipes,
)
from wordcraft_kg.base.errors import ArtefactError, ConfigError, LeakError
from wordcraft_kg.graphs import make_folds
from wordcraft_kg.models.knowledge import books
from wordcraft_kg.models.recipes import fitting, recipe_training
from wordcraft_kg.models.recipes.committee import (
    TABLES,
    Examples,
    _drawn_network,
    _moments,
    _prepared,
    _set_gradients,
    fit_committee,
)
from wordcraft_kg.models.scorers import score_limits
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.neighbours import lists, storage
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.lists import nearest_words
from wordcraft_kg.models.scorers.protocol import FactoredScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer

SMALL = RecipeScorerConfig(folds=3, features="one-hot")


@pytest.fixture
def only_compared():
    with short_fits():
        yield


compares_fits = pytest.mark.usefixtures("only_compared")


@pytest.fixture(scope="module")
def small(book, tmp_path_factory):
    """A recipe scorer of that book; read only."""
    folder = tmp_path_factory.mktemp("models") / "small"
    with short_fits():
        return train_recipes(RecipesConfig(str(book), SMALL), folder).folder


@pytest.fixture
def spoilt(recipes_folder, tmp_path):
    """Load a copy of the kitchen's model with changed tensors of its folds."""
    return lambda change: load_scorer(rewritten(recipes_folder, tmp_path / "spoilt", change))


@compares_fits
def test_the_same_settings_give_the_same_bytes_with_one_thread_or_two(book, small, monkeypatch):
    state = torch.get_rng_state()
    # Folds of the small scorer were fitted one by one.
    monkeypatch.setattr(recipe_training, "cores", lambda: 2)
    folder = train_recipes(RecipesConfig(str(book), SMALL), small.parent / "with-2").folder
    assert same_files(small, folder, "calibration.json")
    assert torch.equal(torch.get_rng_state(), state)
    other = replace(SMALL, seed=1)
    folder = train_recipes(RecipesConfig(str(book), other), small.parent / "other").folder
    assert contents(small)["model.safetensors"] != contents(folder)["model.safetensors"]


@compares_fits
def test_an_interrupted_run_continues_to_the_same_bytes(book, small, monkeypatch):
    # 3 sets of lists serve the first fit, 2 more the second, 1 more both others.
    folder = small.parent / "interrupted"
    with pytest.raises(KeyboardInterrupt, match=r"part 1 is saved.*Repeat the command"):
        train_recipes(RecipesConfig(str(book), SMALL), folder, progress=interrupt_after(4))
    made = recorded(monkeypatch, recipe_training, "fit_recipe_scorers")
    resume(folder)
    assert made == [(0,), (1,), (2,)]
    assert same_files(folder, small, "calibration.json")


def test_a_training_makes_the_lists_of_each_set_of_recipes_once(
    book, only_compared, tmp_path, monkeypatch
):
    made = []

    def make_lists(recipes, vectors, near_words):
        made.append(tuple(map(tuple, sorted(recipes.tolist()))))
        return lists.make_lists(recipes, vectors, near_words)

    monkeypatch.setattr(fitting, "STRICT", 0)
    for module in (books, storage):
        monkeypatch.setattr(module, "make_lists", make_lists)
    train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "model")
    # Those of all train recipes, and of those without each of three folds.
    assert len(made) == len({*made}) == 4
    monkeypatch.setattr(fitting, "STRICT", 2_000)
    made.clear()
    train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "strict")
    # And of those without each two folds.
    assert len(made) == len({*made}) == 7


def test_an_interrupted_run_of_a_larger_book_continues_to_the_same_bytes(
    book, only_compared, tmp_path, monkeypatch
):
    monkeypatch.setattr(fitting, "STRICT", 0)
    config = RecipesConfig(str(book), SMALL)
    whole = train_recipes(config, tmp_path / "whole").folder
    for parts in (4, 6):
        folder = tmp_path / f"interrupted {parts}"
        with pytest.raises(KeyboardInterrupt):
            train_recipes(config, folder, progress=interrupt_after(parts))
        resume(folder)
        assert same_files(folder, whole, "calibration.json")


def test_lists_are_made_by_one_thread_whatever_the_fits_have(
    book, only_compared, tmp_path, monkeypatch
):
    """Sums of several threads have other last bits, so that a loaded scorer would differ."""
    threads = []

    def make_lists(*args):
        threads.extend(
            pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"
        )
        return lists.make_lists(*args)

    for module in (books, storage):
        monkeypatch.setattr(module, "make_lists", make_lists)
    train_recipes(RecipesConfig(str(book), replace(SMALL, threads=2)), tmp_path / "model")
    assert {*threads} == {1}


def test_the_folder_has_words_once_and_a_scorer_for_each_fold(small, book):
    scorer, opened = load_scorer(small), open_graph(str(book))
    assert isinstance(scorer, CrossFitted)
    assert isinstance(scorer.whole, RecipeScorer)
    assert isinstance(scorer, FactoredScorer)
    np.testing.assert_array_equal(scorer.recipes, opened.split.recipes("train"))
    folds = make_folds(opened.split, 3)
    for fold in range(3):
        np.testing.assert_array_equal(scorer.left_out(fold).recipes, folds.recipes([fold]))
        scorer.trained_on(fold, opened.graph)
    assert scorer.probability(0, "componentOf", 1) <= 1
    assert scorer.result_probabilities(0, 1).sum() == pytest.approx(1, abs=1e-5)
    everything = torch.arange(len(scorer.entities))
    for relation in (0, 1):
        table = scorer.table(relation)
        grid = scorer.score(everything[:, None], relation, everything[None])
        torch.testing.assert_close(grid, table, rtol=1e-5, atol=1e-5)
        heads, tails = everything.flip(0), everything
        scores = scorer.score(heads, relation, tails)
        torch.testing.assert_close(scores, table[heads, tails], rtol=1e-5, atol=1e-5)


def test_each_fold_has_the_scorer_of_all_other_train_recipes(recipes_folder, opened_kitchen):
    scorer, folds = (
        load_scorer(recipes_folder, graph=opened_kitchen.graph),
        make_folds(opened_kitchen.split, 3),
    )
    assert isinstance(scorer, CrossFitted)
    np.testing.assert_array_equal(scorer.whole.recipes, opened_kitchen.split.recipes("train"))
    for fold in range(3):
        left_out = scorer.left_out(fold)
        assert isinstance(left_out, RecipeScorer)
        seen = opened_kitchen.graph.recipes[folds.seen([fold])]
        np.testing.assert_array_equal(left_out.recipes, seen)
        supporting = left_out.knowledge.supporting_recipes(0, 1, 2, limit=100)
        assert {one.recipe for one in supporting} <= {tuple(recipe) for recipe in seen.tolist()}
        np.testing.assert_array_equal(
            scorer.trained_on(fold, opened_kitchen.graph), folds.triples([fold])
        )


def swap(tensors):
    for name in [name.removeprefix("fold0.") for name in tensors if name.startswith("fold0.")]:
        one, other = f"fold0.{name}", f"fold1.{name}"
        tensors[one], tensors[other] = tensors[other], tensors[one]


def test_the_scorer_of_another_fold_is_a_leak(spoilt):
    scorer, opened = spoilt(swap), open_graph("kitchen")
    with pytest.raises(LeakError):
        scorer.trained_on(0, opened.graph)
    scorer.trained_on(2, opened.graph)
    tasks = World(opened, WordCraftConfig(part="train", num_distractors=1)).tasks
    for names in (["w"], ["u", "v"]):
        with pytest.raises(LeakError):
            make_sources(names, scorer, tasks=tasks)


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: tensors.pop("fold1.recipes"),
        lambda tensors: tensors.__setitem__("fold1.first", torch.zeros(())),
        lambda tensors: tensors["fold1.recipes"].fill_(9_999),
        lambda tensors: tensors.__setitem__("fold1.recipes", tensors["fold1.recipes"].long()),
        lambda tensors: tensors.__setitem__("fold1.seen", torch.ones(1, 2, dtype=torch.bool)),
        lambda tensors: tensors.__setitem__("fold1.componentOf_first", torch.zeros(())),
        lambda tensors: tensors.pop("fold1.componentOf_second"),
        lambda tensors: tensors.__setitem__("fold1.combinesWith_second", torch.zeros(3)),
        lambda tensors: tensors.__setitem__("fold1.componentOf_table", torch.zeros(1, 2, 2).half()),
    ],
)
def test_a_missing_or_damaged_fold_is_named(spoilt, change):
    with pytest.raises(
        ArtefactError, match=r"3 folds are incomplete or damaged in .*folds\.safetensors"
    ):
        spoilt(change)


def test_a_folder_of_the_earlier_format_says_to_train_again(recipes_folder, tmp_path):
    def earlier(tensors):
        tensors["parts"] = tensors.pop("vectors")

    with pytest.raises(ArtefactError, match=r"does not contain a scorer.*Train again"):
        load_scorer(rewritten(recipes_folder, tmp_path / "old", weights=earlier))


def test_a_folder_with_an_earlier_curve_says_to_train_again(recipes_folder, tmp_path):
    """Its hashes are right, so it is not damaged: another version wrote it."""

    def earlier(calibration):
        calibration["recipes"]["intercepts"] *= 2

    expected = r"calibration\.json has the format of another version.*intercepts.*Train again"
    with pytest.raises(ArtefactError, match=expected):
        load_scorer(rewritten(recipes_folder, tmp_path / "old", calibration=earlier))


def test_two_folds_are_too_few_to_leave_one_out(book, tmp_path):
    with pytest.raises(ConfigError, match="expected 3 or more"):
        train_recipes(
            RecipesConfig(str(book), RecipeScorerConfig(folds=2, features="one-hot")),
            tmp_path / "model",
        )
    assert not (tmp_path / "model").exists()


def test_w_and_p_score_tables_and_are_restored_from_their_constants(small, book):
    world = World.open(str(book), WordCraftConfig(part="train", num_distractors=2))
    assert_sources_are_restored(load_scorer(small), world.tasks)


def test_candidates_of_a_plan_begin_with_the_results_of_known_recipes(small):
    knowledge = load_scorer(small).whole.knowledge
    recipes = {(*sorted(row[:2]), row[2]) for row in knowledge.recipes.tolist()}
    size = knowledge.num_entities
    table = torch.tensor([[0, 1, 2, size]])
    goal, model = torch.tensor([11]), torch.tensor([0])
    for attempts in (2, 3):
        (found,) = knowledge.intermediates(
            goal, table, model, attempts=attempts, width=size, near=4
        ).tolist()
        entities = [entity for entity in found if entity < size]
        assert not {0, 1, 2, 11} & {*entities}
        assert len({*entities}) == len(entities)
        at_hand = {(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)}
        known = {c for a, b, c in recipes if (a, b) in at_hand} - {0, 1, 2, 11}
        assert known
        assert {*entities[: len(known)]} == known


def test_a_plan_may_make_an_entity_that_no_known_recipe_makes():
    """In a by-goal split, what the goal needs may have lost all of its recipes."""
    # 0 + 1 -> 2 is known; nothing known makes 7, which is like 2 by words, and makes 5 with 4.
    recipes = np.array([[0, 1, 2], [4, 7, 5], [0, 4, 6]])
    vectors = np.eye(8, 4, dtype=np.float32)
    vectors[7] = vectors[2]
    near = nearest_words(vectors)
    knowledge = RecipeKnowledge.of_recipes(recipes, vectors.astype(np.float16), near)
    table = torch.tensor([[0, 1, 4]])
    (found,) = knowledge.intermediates(
        torch.tensor([5]), table, torch.tensor([0]), attempts=2, width=3, near=2
    ).tolist()
    # A known recipe leads from 7 to the goal, so it comes with 2, which a known recipe makes, before
    # 6, from which nothing leads there.
    assert {*found[:2]} == {2, 7}
    assert found[2] == 6


def test_fewer_sets_of_lists_are_made_at_once_where_memory_is_short(monkeypatch):
    size = (30_000, 150_000, 384)
    for available in (1, 3):
        has_room_for = score_limits.fitting_bytes(*size, available)
        monkeypatch.setattr(score_limits, "memory", lambda room=has_room_for: room)
        assert score_limits.fitting_workers(*size, most=4) == available


def test_too_little_memory_or_too_much_outside_is_refused_at_first(book, tmp_path, monkeypatch):
    monkeypatch.setattr(score_limits, "memory", lambda: 2**20)
    with pytest.raises(ConfigError, match=r"12 entities and \d+ recipes takes about .* GiB"):
        train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "model")
    monkeypatch.setattr(score_limits, "TABLE_LIMIT", 2**8)
    outside = RecipesConfig(str(book), replace(SMALL, with_=("everyday",)))
    with pytest.raises(ConfigError, match=r"outside knowledge.*12 entities"):
        train_recipes(outside, tmp_path / "model")
    assert not (tmp_path / "model").exists()


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(3)


def drawn_queries(generator, queries=40, candidates=7, features=5):
    """Return queries some of whose candidates do not compete, and with one or more right ones."""
    values = torch.randn(queries, candidates, features, generator=generator)
    competes = torch.rand(queries, candidates, generator=generator) < 0.6
    is_right = competes & (torch.rand(queries, candidates, generator=generator) < 0.3)
    competes[:, 0] = True
    is_right[:, 0] = True
    return Examples(values, competes, is_right)


def loss_of(network, queries, mean, scale):
    """Return the mean of ``-log Σ_right softmax(scores)``, query by query."""
    first, first_bias, second = network
    losses = []
    for values, competes, is_right in zip(*queries, strict=True):
        scores = ((values - mean) / scale @ first + first_bias).relu() @ second
        shares = scores[competes].softmax(0)
        losses.append(-shares[is_right[competes]].sum().log())
    return torch.stack(losses).mean()


def test_gradients_are_those_of_automatic_differentiation(generator):
    queries = drawn_queries(generator)
    mean, scale = _moments(queries)
    networks = [_drawn_network(5, generator) for _ in range(2)]
    _set_gradients(networks, *_prepared(queries, torch.arange(40), mean, scale))
    for network in networks:
        copy = [weights.clone().requires_grad_() for weights in network[:3]]
        loss_of(copy, queries, mean, scale).backward()
        for weights, expected in zip(network, copy, strict=False):
            torch.testing.assert_close(weights.grad, expected.grad, rtol=1e-4, atol=1e-6)


def test_moments_are_those_of_competing_candidates(generator):
    queries = drawn_queries(generator)
    queries.features[..., 2] = 4.0
    known = queries.features[queries.competes]
    mean, scale = _moments(queries)
    torch.testing.assert_close(mean, known.mean(0))
    varies = torch.tensor([0, 1, 3, 4])
    torch.testing.assert_close(scale[varies], known.std(0)[varies])
    # A constant says nothing: its weight becomes 0.
    assert scale[2] == torch.inf


def test_committee_learns_which_candidate_is_right(generator):
    queries = drawn_queries(generator, queries=200)
    queries.is_right.zero_()
    # The competing candidate with the largest feature 1 is right.
    among = queries.features[..., 1].masked_fill(~queries.competes, -torch.inf)
    queries.is_right[torch.arange(200), among.argmax(1)] = True
    ranker = fit_committee(queries, generator, TABLES._replace(steps=300))
    scores = ranker(queries.features).masked_fill(~queries.competes, -torch.inf)
    assert (scores.argmax(1) == among.argmax(1)).float().mean() > 0.9
