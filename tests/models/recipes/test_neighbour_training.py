"""Training by neighbour lists: the same bytes again, nothing of a fold left out, and all uses of the scorer."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from link_helpers import interrupt_after, random_graph, rewritten, same_files
from resumption import resume

from wordcraft_kg.base.errors import ArtefactError, ConfigError, LeakError
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, open_graph
from wordcraft_kg.graphs.folds import OUTSIDE, Folds, make_folds
from wordcraft_kg.graphs.splits import Draw, Split, make_split
from wordcraft_kg.models.policies.sources.registry import make_sources
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.recipes import method, training
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.inductive import with_words
from wordcraft_kg.models.recipes.neighbour_fitting import Words, fit_by_neighbours
from wordcraft_kg.models.recipes.training import train_recipes
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.neighbours.scorer import NeighbourRecipeScorer
from wordcraft_kg.models.scorers.protocol import FactoredScorer

# Each fit takes seconds, and the first compiles all loops; test_neighbour_lists has what is fast.
pytestmark = pytest.mark.slow
SMALL = RecipeScorerConfig(folds=3, features="one-hot")


@pytest.fixture(scope="module", autouse=True)
def lists():
    """Train every book by neighbour lists."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method, "MOST_WITH_TABLES", 0)
        yield


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    path = tmp_path_factory.mktemp("books") / "small.csv"
    graph = random_graph(1, 12, 60)
    rows = [",".join(graph.entities[entity] for entity in row) for row in graph.recipes.tolist()]
    path.write_text("\n".join(["ingredient_a,ingredient_b,result", *rows]))
    return path


@pytest.fixture(scope="module")
def small(book, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "small"
    return train_recipes(RecipesConfig(str(book), SMALL), folder).folder


def test_the_same_settings_give_the_same_bytes_with_one_thread_or_two(book, small, monkeypatch):
    state = torch.get_rng_state()
    for workers in (1, 2):
        monkeypatch.setattr(training, "cores", lambda number=workers: number)
        folder = small.parent / f"with-{workers}"
        assert same_files(
            small, train_recipes(RecipesConfig(str(book), SMALL), folder).folder, "calibration.json"
        )
    assert torch.equal(torch.get_rng_state(), state)


def test_an_interrupted_run_continues_to_the_same_bytes(book, small):
    # 3 sets of lists serve the first fit, 2 more the second, 1 more both others.
    folder = small.parent / "interrupted"
    with pytest.raises(KeyboardInterrupt, match=r"1 of 4 fits are saved.*Repeat the command"):
        train_recipes(RecipesConfig(str(book), SMALL), folder, progress=interrupt_after(4))
    resume(folder)
    assert same_files(folder, small, "calibration.json")


def fitted(folds, vectors, wanted):
    fits = fit_by_neighbours(folds, Words.of(vectors), wanted)
    return {left_out: knowledge.constants() for left_out, knowledge in fits}


def same_tensors(one, other):
    return all(torch.equal(one[name], other[name]) for name in one)


def test_a_fit_does_not_depend_on_the_other_fits_of_its_run():
    folds = make_folds(make_split(random_graph(2, 12, 60), SplitConfig()), 3)
    vectors = np.random.default_rng(0).normal(size=(12, 5))
    together = fitted(folds, vectors, [(), (0,), (1,), (2,)])
    for left_out in ((), (1,), (2,)):
        assert same_tensors(fitted(folds, vectors, [left_out])[left_out], together[left_out])


@pytest.mark.parametrize("what", ["changed", "a test recipe changed"])
def test_a_fold_has_no_influence_on_the_scorer_without_it(what):
    graph = random_graph(2, 12, 60)
    folds = make_folds(make_split(graph, SplitConfig()), 3)
    fold = OUTSIDE if what == "a test recipe changed" else 1
    rows = graph.recipes.copy()
    row = int(np.flatnonzero(folds.of_recipe == fold)[0])
    known = {tuple(recipe) for recipe in rows.tolist()}
    a, b, _ = rows[row].tolist()
    rows[row, 2] = next(result for result in range(12) if (a, b, result) not in known)
    changed = RecipeGraph(graph.entities, rows, [], name="changed")
    place = {tuple(recipe): number for number, recipe in enumerate(rows.tolist())}
    order = [place[tuple(recipe)] for recipe in changed.recipes.tolist()]
    of_recipe = folds.of_recipe[order]
    parts = np.where(of_recipe == OUTSIDE, 2, 0).astype(np.int8)
    other = Folds(Split(changed, SplitConfig(), Draw(parts)), 3, 0, of_recipe)
    vectors = np.random.default_rng(0).normal(size=(12, 5))
    wanted = [(), (0,), (1,)]
    before, after = (fitted(each, vectors, wanted) for each in (folds, other))
    for left_out in wanted:
        is_same = same_tensors(before[left_out], after[left_out])
        assert is_same == (fold == OUTSIDE or left_out == (1,))


def test_the_folder_has_words_once_and_a_scorer_for_each_fold(small, book):
    scorer, opened = load_scorer(small), open_graph(str(book))
    assert isinstance(scorer, CrossFitted)
    assert isinstance(scorer.whole, NeighbourRecipeScorer)
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


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: tensors.pop("fold1.recipes"),
        lambda tensors: tensors.__setitem__("fold1.first", torch.zeros(())),
        lambda tensors: tensors["fold1.recipes"].fill_(99),
        lambda tensors: tensors.__setitem__("fold1.seen", torch.ones(1, 2, dtype=torch.bool)),
    ],
)
def test_a_missing_or_damaged_fold_is_named(small, tmp_path, change):
    with pytest.raises(ArtefactError, match=r"fold 1 of 3 is missing or damaged"):
        load_scorer(rewritten(small, tmp_path / "spoilt", change))


def test_the_scorer_of_another_fold_is_a_leak(small, tmp_path, book):
    def swap(tensors):
        for name in ("recipes", "seen", "first"):
            one, other = f"fold0.{name}", f"fold1.{name}"
            tensors[one], tensors[other] = tensors[other], tensors[one]

    scorer = load_scorer(rewritten(small, tmp_path / "spoilt", swap))
    with pytest.raises(LeakError):
        scorer.trained_on(0, open_graph(book).graph)


def test_w_and_p_score_tables_and_are_restored_from_their_constants(small, book):
    from wordcraft_kg.models.policies.sources.registry import source_class

    scorer = load_scorer(small)
    world = World(str(book), WordCraftConfig(part="train", num_distractors=2))
    nothing = len(scorer.entities)
    goal = torch.tensor([3, 4])
    table = torch.tensor([[0, 1, 2, nothing], [1, 2, 5, nothing]])
    attempts = Attempts(torch.tensor([2, 3]))
    states = States(goal, torch.tensor([nothing, 1]), table, torch.tensor([0, 1]), attempts)
    for full in make_sources(["w", "p"], scorer, tasks=world.tasks):
        expected = full(states)
        assert expected.isfinite().all()
        restored = source_class(full.name).restored(full.num_entities, full.state_dict())
        restored.load_state_dict(full.state_dict())
        restored.bind(world.tasks)
        assert torch.equal(restored(states), expected)
        one = States(goal[:1], torch.tensor([nothing]), table[:1], torch.tensor([0]))
        one = one._replace(attempts=Attempts(torch.tensor([2])))
        assert len(full.evidence(one)) == 4


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


def test_new_entities_are_scored_by_words_and_old_scores_stay(kitchen, tmp_path):
    settings = RecipeScorerConfig(kg="full", folds=2, features="glove")
    folder = train_recipes(RecipesConfig("kitchen", settings), tmp_path / "model").folder
    scorer = load_scorer(folder)
    wider = with_words(folder, scorer, ["goulash", "lemonade"])
    assert wider.entities == (*kitchen.entities, "goulash", "lemonade")
    recipe = "flour", "water", "dough"
    torch.testing.assert_close(
        wider.score_recipes(*recipe), scorer.score_recipes(*recipe), rtol=1e-4, atol=1e-4
    )
    assert wider.score_recipes("flour", "milk", "goulash").isfinite()
    assert wider.score("flour", "componentOf", "goulash").isfinite()
    with pytest.raises(ConfigError, match="exists already"):
        with_words(folder, scorer, ["flour"])


def test_known_recipes_score_highest_if_held_out_goals_have_none(kitchen):
    split = make_split(kitchen, SplitConfig("by-goal"))
    size = kitchen.num_entities
    folds = make_folds(split, 3)
    ((_, knowledge),) = fit_by_neighbours(folds, Words.of(np.zeros((size, 0))), [()])
    a, b, goal = torch.from_numpy(split.recipes("train").copy()).T
    every = torch.arange(size)
    hits = []
    for row in range(0, len(a), 7):
        table = torch.stack([a[row], b[row]]).expand(size, 2)
        scores = knowledge(every, table, torch.zeros_like(every))[:, 0, 1]
        hits.append(int(scores.argmax()) == int(goal[row]))
    assert np.mean(hits) > 0.9


def test_outside_knowledge_and_too_little_memory_are_refused_before_the_start(
    book, tmp_path, monkeypatch
):
    config = RecipesConfig(str(book), replace(SMALL, with_=("everyday",)))
    with pytest.raises(ConfigError, match=r"`with` everyday.*12 entities.*Leave out"):
        train_recipes(config, tmp_path / "model")
    monkeypatch.setattr(method, "memory", lambda: 2**20)
    with pytest.raises(ConfigError, match=r"12 entities and \d+ recipes takes about .* GiB"):
        train_recipes(RecipesConfig(str(book), SMALL), tmp_path / "model")
    assert not (tmp_path / "model").exists()
