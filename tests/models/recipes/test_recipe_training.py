"""Fitting recipe scorers: the same bytes again, nothing of a fold left out, and what a spoilt folder says."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from link_helpers import contents, interrupt_after, random_graph, rewritten, same_files
from resumption import resume

from wordcraft_kg.base.errors import ArtefactError, ConfigError, LeakError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, open_graph
from wordcraft_kg.graphs.folds import OUTSIDE, Folds, make_folds
from wordcraft_kg.graphs.splits import Draw, Split, make_split
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.recipes import training
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.fitting import fit_recipe_scorer
from wordcraft_kg.models.recipes.training import train_recipes
from wordcraft_kg.models.scorers import config
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.kernel import cosines
from wordcraft_kg.models.scorers.pair_features import FEATURES
from wordcraft_kg.models.scorers.recipes import RecipeScorer, RecipeScores
from wordcraft_kg.runs import parallel

SMALL = RecipeScorerConfig(folds=3, features="one-hot")


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """A book so small that a fit takes a moment."""
    path = tmp_path_factory.mktemp("books") / "small.csv"
    graph = random_graph(1, 12, 60)
    rows = [",".join(graph.entities[entity] for entity in row) for row in graph.recipes.tolist()]
    path.write_text("\n".join(["ingredient_a,ingredient_b,result", *rows]))
    return path


@pytest.fixture(scope="module")
def small(book, tmp_path_factory):
    """A recipe scorer of that book; read only."""
    return train_recipes(
        RecipesConfig(str(book), SMALL), tmp_path_factory.mktemp("models") / "small"
    ).folder


@pytest.fixture
def spoilt(recipes_folder, tmp_path):
    """Load a copy of the kitchen's model with changed tensors of its folds."""
    return lambda change: load_scorer(rewritten(recipes_folder, tmp_path / "spoilt", change))


# --- the same again --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_same_settings_give_the_same_bytes(book, small):
    config, state = RecipesConfig(str(book), SMALL), torch.get_rng_state()
    assert same_files(small, train_recipes(config, small.parent / "again").folder)
    assert torch.equal(torch.get_rng_state(), state)
    other = train_recipes(
        replace(config, settings=replace(SMALL, seed=1)), small.parent / "other"
    ).folder
    assert contents(small)["model.safetensors"] != contents(other)["model.safetensors"]


@pytest.mark.slow
def test_parallel_fits_equal_sequential_fits(book, small, monkeypatch):
    started, together = [], parallel.train_in_processes
    monkeypatch.setattr(training, "ALONE", 0)
    monkeypatch.setattr(parallel, "cores", lambda: 2)
    monkeypatch.setattr(
        parallel,
        "train_in_processes",
        lambda jobs, *options: started.append(len(jobs)) or together(jobs, *options),
    )
    assert same_files(
        small, train_recipes(RecipesConfig(str(book), SMALL), small.parent / "side-by-side").folder
    )
    assert started == [4]


@pytest.mark.slow
def test_an_interrupted_run_continues_with_the_fits_that_are_missing(book, small, monkeypatch):
    steps = SMALL.folds + 3
    folder = small.parent / "interrupted"  # so that the path to the book is the same
    with pytest.raises(KeyboardInterrupt, match=r"2 of 4 fits are saved.*Repeat the command"):
        train_recipes(RecipesConfig(str(book), SMALL), folder, progress=interrupt_after(2 * steps))
    assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
    with pytest.raises(ArtefactError, match="interrupted, not done"):
        load_scorer(folder)
    fitted = []
    fit = fit_recipe_scorer
    monkeypatch.setattr(
        training,
        "fit_recipe_scorer",
        lambda *args, **options: fitted.append(options["left_out"]) or fit(*args, **options),
    )
    resume(folder)
    assert 0 < len(fitted) < 4
    assert () not in fitted
    assert same_files(folder, small)


# --- what is held out ------------------------------------------------------------------------------------------------


def folds_of(graph, fold_of):
    """Folds by the labels of recipes; those that are not named are the test part."""
    of_recipe = np.array(
        [fold_of.get(graph.labels(row), OUTSIDE) for row in graph.recipes.tolist()], dtype=np.int64
    )
    parts = np.where(of_recipe == OUTSIDE, 2, 0).astype(np.int8)
    return Folds(Split(graph, SplitConfig(), Draw(parts)), 3, 0, of_recipe)


def fitted(fit):
    """All tensors of a fit."""
    knowledge, rankers = fit
    of_links = {
        f"{number}.{name}": tensor
        for number, ranker in enumerate(rankers)
        for name, tensor in ranker.weights().items()
    }
    return knowledge.constants() | of_links


def same_tensors(one, other):
    assert one.keys() == other.keys()
    return all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("missing", [1, pytest.param(0, marks=pytest.mark.slow)])
def test_a_book_whose_tables_do_not_fit_into_memory_is_refused(
    book, tmp_path, monkeypatch, missing
):
    graph = open_graph(str(book)).graph
    needed = config.fit_bytes(graph.num_entities, graph.num_recipes, SMALL.folds)
    monkeypatch.setattr(config, "memory", lambda: needed - missing)
    if not missing:
        train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "model")
        return
    with pytest.raises(
        ConfigError, match=r"all pairs of 12 entities, which takes .* GiB.*train-complex"
    ):
        train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_a_fit_of_4000_entities_is_expected_to_take_more_than_4_gib():
    """Tables of 4,000 entities have 64 MB, and the fit held more than the 60 that were expected once."""
    assert config.fit_bytes(4_000, 20_000, 5) > 4 * 2**30


@pytest.mark.parametrize("at_once", [1, 2])
def test_fits_run_in_parallel_only_if_their_memory_is_there(book, tmp_path, monkeypatch, at_once):
    is_parallel = []

    def jobs(waiting, threads, note, *, is_long):
        is_parallel.append(is_long)
        raise KeyboardInterrupt  # the decision is all that matters here

    graph = open_graph(str(book)).graph
    needed = config.fit_bytes(graph.num_entities, graph.num_recipes, SMALL.folds)
    monkeypatch.setattr(training, "cores", lambda: 2)
    monkeypatch.setattr(training, "memory", lambda: at_once * needed)
    monkeypatch.setattr(training, "ALONE", 1)
    monkeypatch.setattr(training, "train_jobs", jobs)
    with pytest.raises(KeyboardInterrupt):
        train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "model")
    assert is_parallel == [at_once == 2]


@pytest.mark.parametrize("what", ["removed", "changed", "a test recipe changed"])
def test_a_fold_has_no_influence_on_the_scorer_without_it(what):
    graph = random_graph(2, 12, 60)
    folds = make_folds(make_split(graph, SplitConfig()), 3)
    fold_of = {
        graph.labels(row): int(fold)
        for row, fold in zip(graph.recipes.tolist(), folds.of_recipe, strict=True)
    }
    book = [graph.labels(row) for row in graph.recipes.tolist()]
    text = cosines(torch.randn(graph.num_entities, 5, generator=torch.Generator().manual_seed(0)))
    fold = OUTSIDE if what == "a test recipe changed" else 1
    a, b, result = book.pop(next(row for row, recipe in enumerate(book) if fold_of[recipe] == fold))
    del fold_of[a, b, result]
    if what != "removed":
        made = next(
            label for label in graph.entities if (a, b, label) not in book and label != result
        )
        book.append((a, b, made))
        fold_of[a, b, made] = fold
    other = RecipeGraph.from_recipes(book, base=[])
    assert other.entities == graph.entities
    changed = folds_of(other, fold_of)
    for left_out in ((), (0,), (1,)):
        before, after = (
            fitted(fit_recipe_scorer(each, text, left_out=left_out)) for each in (folds, changed)
        )
        assert same_tensors(before, after) == (fold == OUTSIDE or left_out == (1,))


def test_each_fold_has_the_scorer_of_all_other_train_recipes(recipes_folder, opened_kitchen):
    scorer, folds = (
        load_scorer(recipes_folder, graph=opened_kitchen.graph),
        make_folds(opened_kitchen.split, 3),
    )
    assert isinstance(scorer, CrossFitted)
    assert isinstance(scorer.whole, RecipeScores)
    np.testing.assert_array_equal(scorer.whole.recipes, opened_kitchen.split.recipes("train"))
    for fold in range(3):
        left_out = scorer.left_out(fold)
        assert isinstance(left_out, RecipeScorer)
        seen = opened_kitchen.graph.recipes[folds.seen([fold])]
        np.testing.assert_array_equal(left_out.recipes, seen)
        supporting = {
            tuple(recipe) for recipe in left_out.knowledge.supporting[0, :-1].flatten(0, 1).tolist()
        }
        assert supporting <= {tuple(recipe) for recipe in seen.tolist()}
        np.testing.assert_array_equal(
            scorer.trained_on(fold, opened_kitchen.graph), folds.triples([fold])
        )


def test_by_goal_known_recipes_score_highest(kitchen):
    """By goal known recipes score highest and constant features have no weight."""
    split, size = make_split(kitchen, SplitConfig("by-goal")), kitchen.num_entities
    knowledge, _ = fit_recipe_scorer(make_folds(split, 3), torch.zeros(size, size))
    is_zero = (knowledge.first[0] == 0).all(1).tolist()
    constant = {"made", "words_sum", "words_min", "words_pair", "words_evidence"}
    assert {name for name, zero in zip(FEATURES, is_zero, strict=True) if zero} == constant
    a, b, goal = torch.from_numpy(split.recipes("train").copy()).T
    everything, model = (
        torch.arange(size).repeat(len(a)),
        torch.zeros(len(a) * size, dtype=torch.int64),
    )
    table = torch.stack([a, b], dim=1).repeat_interleave(size, dim=0)
    scores = knowledge(everything, table, model)[:, 0, 1].view(-1, size)
    assert scores.abs().max() < 100
    assert (scores.argmax(1) == goal).float().mean() > 0.9


# --- spoilt folders --------------------------------------------------------------------------------------------------


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
        lambda tensors: tensors.pop("fold1.parts"),
        lambda tensors: tensors.__setitem__("fold1.pairs", torch.zeros(1, 2, 2, 3).half()),
        lambda tensors: tensors.__setitem__("fold1.first", torch.zeros(())),
        lambda tensors: tensors.__setitem__("fold1.recipes", tensors["fold1.recipes"].long()),
        lambda tensors: tensors["fold1.supporting"].fill_(9_999),
    ],
)
def test_a_missing_or_damaged_fold_is_named(spoilt, change):
    with pytest.raises(
        ArtefactError, match=r"fold 1 of 3 is missing or damaged in .*folds\.safetensors"
    ):
        spoilt(change)


def test_two_folds_are_too_few_to_leave_one_out(book, tmp_path):
    with pytest.raises(ConfigError, match="expected 3 or more"):
        train_recipes(
            RecipesConfig(str(book), RecipeScorerConfig(folds=2, features="one-hot")),
            tmp_path / "model",
        )
    assert not (tmp_path / "model").exists()


def test_w_is_restored_from_its_constants(recipes_folder):
    """W is restored from its constants and a kept table is not mistaken for another."""
    from wordcraft_kg.models.policies.sources.registry import source_class

    scorer = load_scorer(recipes_folder)
    world = World("kitchen", WordCraftConfig(num_distractors=2))
    (full,) = make_sources(["w"], scorer, tasks=world.tasks)
    restored = source_class("w").restored(full.num_entities, full.state_dict())
    nothing = full.num_entities
    goal, held = torch.tensor([3, 4]), torch.tensor([nothing, 1])
    table = torch.tensor([[0, 1, 2, nothing], [1, 2, 5, nothing]])
    states = States(goal, held, table)
    assert not restored(states).any()
    restored.load_state_dict(full.state_dict())
    expected = full(states)
    assert torch.equal(restored(states), expected)
    wider = torch.cat([table, torch.full((2, 3), nothing)], dim=1)
    assert torch.equal(full(States(goal, held, wider)), torch.nn.functional.pad(expected, (0, 3)))
    assert not full(States(goal, held, torch.full_like(table, nothing))).any()


def test_the_link_report_of_a_recipe_scorer_is_written(recipes_folder):
    from wordcraft_kg.agents.players import scorer_players
    from wordcraft_kg.models.folder import open_model
    from wordcraft_kg.reports.link_report import PLAYERS

    model = open_model(recipes_folder, "kitchen")
    players = scorer_players(model.opened.graph, model.scorer, model.opened.split.partial)
    assert "w, best pair" in players
    assert {*players} <= {*PLAYERS}
