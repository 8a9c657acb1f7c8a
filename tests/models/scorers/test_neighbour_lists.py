"""Neighbour lists and their features: against full tables, with ties, hubs and pairs with many results."""

import math
import runpy
from itertools import product

import numba
import numpy as np
import pytest
import torch
from kernel_oracles import explicit_ridge, link_tables
from link_helpers import random_graph

from wordcraft_kg.base.settings import CORES_VARIABLE
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, recipe_triples
from wordcraft_kg.models.scorers.kernel import TEXT, completion, profiles
from wordcraft_kg.models.scorers.neighbours import blocks, lists as lists_module
from wordcraft_kg.models.scorers.neighbours.feature_loops import FLOOR as LEAST_EVIDENCE, LEAST
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.links import OF_COMBINES, link_features, links_by_key
from wordcraft_kg.models.scorers.neighbours.lists import SIGNATURE, make_lists, nearest_words
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES, pair_features
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker

SIZE = 12

FLOOR = float(LEAST_EVIDENCE)


def unit_vectors(size=SIZE, dim=6, seed=99):
    rows = np.random.default_rng(seed).normal(size=(size, dim)).astype(np.float32)
    rows[1] = 0  # an entity without words
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return (rows / np.maximum(norms, 1e-9)).astype(np.float16).astype(np.float32)


def full_lists(recipes, vectors):
    """Lists as long as the book: nothing is left out."""
    size = len(vectors)
    near = nearest_words(vectors, size)
    return make_lists(recipes, vectors, near, nearest=size, used=size, made=size, support=10**4)


class SlowFeatures:
    """All features by their definitions, from full tables of similarities."""

    def __init__(self, recipes, vectors):
        self.recipes = recipes.tolist()
        self.size = len(vectors)
        rows = profiles(recipes, self.size).toarray()
        cosines = vectors.astype(float) @ vectors.astype(float).T
        np.fill_diagonal(cosines, 1)
        kernel = rows @ rows.T + TEXT * np.maximum(cosines, 0) ** 2
        norms = np.sqrt(((rows**2).sum(1) > 0.5) + TEXT)
        self.kernel = np.minimum(kernel / np.outer(norms, norms), 1)
        np.fill_diagonal(self.kernel, 1)
        self.cosines = cosines
        self.alike = self.kernel**2
        self.words = np.maximum(cosines, 0) ** 4
        self.used = {entity for a, b, _ in self.recipes for entity in (a, b)}
        self.made = {result for *_, result in self.recipes}
        self.regression = kernel_tables(recipes, rows, cosines)
        self.word_regression = word_tables(recipes, vectors)
        self.expected = expected_results(recipes, vectors.astype(float))

    def links(self, x, c):
        return sum(result == c and x in (a, b) for a, b, result in self.recipes)

    def of_component(self, x, c):
        alike, words = self.alike, self.words
        link = link_words = 0.0
        for other, result in product(self.used, self.made):
            weight = alike[x, other] * alike[c, result]
            if weight >= LEAST:
                link += weight * self.links(other, result)
                link_words += words[x, other] * words[c, result] * self.links(other, result)
        reverse = sum(alike[x, result] * self.links(c, result) for result in self.made)
        of_goal = {b for a, b, _ in self.recipes if a == c}
        of_goal |= {a for a, b, _ in self.recipes if b == c}
        parts = {i for a, b, result in self.recipes if result == c for i in (a, b)}
        partners = [p for p in parts if any({a, b} == {x, p} for a, b, _ in self.recipes)]
        return [
            self.cosines[x, c],
            self.kernel[x, c],
            math.log1p(sum(x in (a, b) for a, b, _ in self.recipes)),
            math.log1p(sum(result == x for *_, result in self.recipes)),
            math.log(FLOOR + link),
            math.log(FLOOR + link_words),
            math.log(FLOOR + reverse),
            math.log(FLOOR + sum(alike[x, partner] for partner in of_goal)),
            float(x in of_goal),
            math.log1p(len(partners)),
            math.log1p(sum(self.links(x, part) > 0 for part in parts)),
            self.regression[1][x, c],
            self.word_regression[1][x, c],
            math.log1p(sum(c in (a, b) for a, b, _ in self.recipes)),
            math.log1p(sum(result == c for *_, result in self.recipes)),
        ]

    def of_pair(self, a, b, c):
        alike, words = self.alike, self.words
        anything = makes = anything_words = makes_words = 0.0
        for one, other, result in self.recipes:
            # A self pair is one pair of neighbours, any other pair is two.
            for i, j in {(one, other), (other, one)}:
                weight = alike[a, i] * alike[b, j]
                if weight < LEAST:
                    continue
                anything += weight
                makes += weight * alike[c, result]
                anything_words += words[a, i] * words[b, j]
                makes_words += words[a, i] * words[b, j] * words[c, result]
        results = {result for one, other, result in self.recipes if {one, other} == {a, b}}
        sums = (anything, makes, anything_words, makes_words)
        return [
            *(math.log(FLOOR + each) for each in sums),
            float(bool(results)),
            float(c in results),
            self.cosines[a, b],
            self.kernel[a, b],
            float(a == b),
            math.log1p(sum(result == c for *_, result in self.recipes)),
            math.log1p(sum(c in (one, other) for one, other, _ in self.recipes)),
            self.regression[0][a, b],
            self.word_regression[0][a, b],
            self.expected(a, b, c),
        ]

    def of_table(self, a, b, c):
        """The features of a pair and a goal, with link scores of 0."""
        slots = []
        for x in (a, b):
            slots.append([*self.of_component(x, c)[:-2], math.log1p(self.links(x, c)), 0])
        return [*np.sum(slots, axis=0), *np.min(slots, axis=0), *self.of_pair(a, b, c), 0]

    def of_combines(self, a, b):
        """The features of a combinesWith link, without completion."""
        alike = self.alike
        uses = [math.log1p(sum(x in (i, j) for i, j, _ in self.recipes)) for x in (a, b)]
        made = [math.log1p(sum(result == x for *_, result in self.recipes)) for x in (a, b)]
        pairs = {pair for i, j, _ in self.recipes for pair in ((i, j), (j, i))}
        exact = sum(alike[a, i] for i, j in pairs if j == b)
        exact += sum(alike[b, j] for i, j in pairs if i == a)
        return [
            self.cosines[a, b],
            self.kernel[a, b],
            sum(uses),
            abs(uses[0] - uses[1]),
            sum(made),
            float(a == b),
            math.log(FLOOR + exact),
            self.word_regression[0][a, b],
        ]


def kernel_tables(recipes, rows, cosines):
    kernel = rows @ rows.T + TEXT * np.maximum(cosines, 0) ** 2
    # A vector of zeros is no word: it is not like itself.
    kernel -= np.diag(TEXT * ((cosines**2).sum(0) == 1))
    return regressions(recipes, kernel)


def word_tables(recipes, vectors):
    return regressions(recipes, vectors.astype(float) @ vectors.astype(float).T)


def expected_results(recipes, vectors):
    """How well a result's words fit the regression of results: least squares with further rows."""
    known = vectors[np.unique(recipes)]
    _, directions = np.linalg.eigh(known.T @ known)
    words = vectors @ directions[:, ::-1]

    def inputs(a, b):
        return [*(words[a] + words[b]), *(4 * words[a] * words[b])]

    dim = vectors.shape[1]
    rows = [*(inputs(a, b) for a, b, _ in recipes), *(math.sqrt(3) * np.eye(2 * dim))]
    targets = np.concatenate([words[recipes[:, 2]], np.zeros((2 * dim, dim))])
    weights, *_ = np.linalg.lstsq(np.array(rows), targets)

    def cosine(a, b, c):
        expected = inputs(a, b) @ weights
        return expected @ words[c] / max(np.linalg.norm(expected), 1e-6)

    return cosine


def regressions(recipes, kernel):
    links = link_tables(recipe_triples(recipes), len(kernel))
    return [explicit_ridge(kernel, table, np.unique(recipes)) for table in links]


def distinct(recipes):
    rows = recipes.copy()
    rows[:, :2].sort(axis=1)
    return np.unique(rows, axis=0)


@pytest.mark.parametrize(("num_recipes", "bits"), [(70, SIGNATURE), (70, 8), (9, SIGNATURE)])
def test_with_full_lists_every_feature_is_what_its_definition_says(num_recipes, bits, monkeypatch):
    """In a signature of 8 bits, several of the 12 entities share one: the hash table decides."""
    monkeypatch.setattr(lists_module, "SIGNATURE", bits)
    recipes = distinct(random_graph(0, SIZE, num_recipes).recipes)
    vectors = unit_vectors()
    lists = full_lists(recipes, vectors)
    slow = SlowFeatures(recipes, vectors)
    rng = np.random.default_rng(1)
    tables = rng.integers(SIZE, size=(25, 3))
    tables[:4, 1] = tables[:4, 0]
    goals = rng.integers(SIZE, size=25)
    one, other = np.triu_indices(3)
    features = features_of_tables(lists, goals, tables)
    for row, pair in product(range(25), range(6)):
        expected = slow.of_table(tables[row, one[pair]], tables[row, other[pair]], goals[row])
        np.testing.assert_allclose(features[row, pair], expected, rtol=2e-3, atol=2e-3)


def features_of_tables(lists, goals, tables):
    links = links_by_key(lists, COMPONENT_OF, goals, tables).numpy()
    slot_pairs = np.triu_indices(tables.shape[1])
    return pair_features(lists, slot_pairs, goals, tables, links)


def test_rows_with_the_same_table_have_the_bits_of_rows_alone():
    """Empty slots, rows without a goal and a goal on the table among them."""
    recipes = distinct(random_graph(0, SIZE, 70).recipes)
    vectors = unit_vectors()
    lists = make_lists(recipes, vectors, nearest_words(vectors, 5), nearest=5, used=4, rank=5)
    rng = np.random.default_rng(2)
    tables = rng.integers(-1, SIZE, size=(5, 4)).repeat(6, axis=0)
    goals = rng.integers(-1, SIZE, size=len(tables))
    together = features_of_tables(lists, goals, tables)
    assert together.any()
    for row in range(len(tables)):
        some = slice(row, row + 1)
        alone = features_of_tables(lists, goals[some], tables[some])
        np.testing.assert_array_equal(together[some], alone)


def test_links_have_the_features_of_their_definitions():
    recipes = distinct(random_graph(0, SIZE, 70).recipes)
    vectors = unit_vectors()
    lists = full_lists(recipes, vectors)
    slow = SlowFeatures(recipes, vectors)
    every = np.arange(SIZE)
    found = link_features(lists, COMBINES_WITH, every, every).numpy()
    completed = np.log(FLOOR + completion(recipes, SIZE))
    place = OF_COMBINES.index("completion")
    np.testing.assert_allclose(found[..., place], completed, rtol=1e-4, atol=1e-4)
    found = np.delete(found, place, axis=2)
    for a, b in product(range(SIZE), repeat=2):
        np.testing.assert_allclose(found[a, b], slow.of_combines(a, b), rtol=2e-3, atol=2e-3)
    found = link_features(lists, COMPONENT_OF, every, every).numpy()
    for x, c in product(range(SIZE), repeat=2):
        expected = slow.of_component(x, c)
        np.testing.assert_allclose(found[x, c], expected, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("width", [2, SIZE])
def test_links_have_the_same_features_in_a_table_and_one_by_one(width):
    recipes = distinct(random_graph(5, SIZE, 60).recipes)
    vectors = unit_vectors()
    near = nearest_words(vectors, width)
    lists = make_lists(recipes, vectors, near, nearest=width, used=width, made=width, rank=5)
    every = np.arange(SIZE)
    components = link_features(lists, COMPONENT_OF, every, every)
    pairs = link_features(lists, COMBINES_WITH, every, every)
    torch.testing.assert_close(pairs, pairs.transpose(0, 1), rtol=1e-5, atol=1e-5)
    for key in every:
        heads = every[:4][None]
        alone = links_by_key(lists, COMPONENT_OF, every[key : key + 1], heads)
        assert torch.equal(alone[0], components[:4, key])
        alone = links_by_key(lists, COMBINES_WITH, every[key : key + 1], heads)
        assert torch.equal(alone[0], pairs[key, :4])


def test_a_book_too_large_for_matrices_of_similarities_has_the_same_features(monkeypatch):
    recipes = distinct(random_graph(5, SIZE, 60).recipes)
    vectors = unit_vectors()
    every = np.arange(SIZE)
    tables = np.tile(every, (SIZE, 1))
    features = []
    for most in (SIZE, SIZE - 1):
        monkeypatch.setattr(lists_module, "MATRIX", most)
        lists = full_lists(recipes, vectors)
        assert len(lists.kernels) == len(lists.cosines) == (SIZE if most == SIZE else 0)
        features.append(features_of_tables(lists, every, tables))
    np.testing.assert_array_equal(*features)


def test_nearest_words_are_the_largest_positive_cosines_with_ties_by_id():
    vectors = unit_vectors(40, 3)
    vectors[7] = vectors[5]
    vectors[3] = vectors[5]
    near = nearest_words(vectors, 6, block=7)
    for row in range(40):
        cosines = vectors @ vectors[row]
        cosines[row] = -1
        order = np.lexsort((np.arange(40), -cosines))[:6]
        expected = [int(other) if cosines[other] > 0 else -1 for other in order]
        assert near[row].tolist() == expected
    assert near[5, :2].tolist() == [3, 7]
    np.testing.assert_array_equal(nearest_words(vectors, 6, first=30), near[30:])
    assert nearest_words(vectors[:, :0], 6).shape == (40, 0)
    assert nearest_words(vectors[:1], 6).shape == (1, 0)


def test_lists_have_the_same_bits_with_any_number_of_threads(monkeypatch):
    monkeypatch.setattr(blocks, "ROWS", 7)
    recipes = distinct(random_graph(3, 30, 80).recipes)
    vectors = unit_vectors(30)
    made = []
    for number in ("1", "3"):
        monkeypatch.setenv(CORES_VARIABLE, number)
        made.append(make_lists(recipes, vectors, nearest_words(vectors, 8), nearest=5))
    alone, together = (arrays_of(lists) for lists in made)
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)


def arrays_of(lists):
    """All arrays, also those of lists within lists."""
    parts = [part if isinstance(part, tuple) else (part,) for part in lists]
    return [array for arrays in parts for array in arrays]


def test_structural_neighbours_have_the_largest_cosines_of_profiles():
    recipes = distinct(random_graph(3, 30, 80).recipes)
    vectors = np.zeros((30, 0), dtype=np.float32)
    lists = make_lists(recipes, vectors, nearest_words(vectors), nearest=5)
    rows = profiles(recipes, 30).toarray()
    cosines = rows @ rows.T
    np.fill_diagonal(cosines, 0)
    for entity in range(30):
        places = slice(lists.near.starts[entity], lists.near.starts[entity + 1])
        found = lists.near.columns[places]
        assert sorted(found) == found.tolist()
        np.testing.assert_allclose(lists.near.values[places], cosines[entity, found], rtol=1e-5)
        # Its own five, and all that have it among their five.
        left_out = np.setdiff1d(np.arange(30), found)
        own = np.sort(cosines[entity])[::-1][:5]
        assert cosines[entity, left_out].max() <= own[-1] + 1e-6
        for other in np.flatnonzero(cosines[entity] > 0):
            theirs = np.sort(cosines[other])[::-1][4]
            if cosines[entity, other] > max(theirs, own[-1]) + 1e-6:
                assert other in found


def random_knowledge(seed, num_recipes=70):
    vectors = unit_vectors()
    recipes = distinct(random_graph(seed, SIZE, num_recipes).recipes)
    found = RecipeKnowledge.of_recipes(recipes, vectors.astype(np.float16), nearest_words(vectors))
    draws = torch.Generator().manual_seed(seed)
    shapes = ((len(FEATURES), 8), (8,), (8,), ())
    weights = [torch.randn(shape, generator=draws) for shape in shapes]
    return found.with_ranker(Ranker(**dict(zip(RANKER, weights, strict=True))))


def random_tables(rows=30, slots=6):
    rng = np.random.default_rng(0)
    table = torch.from_numpy(rng.integers(SIZE + 1, size=(rows, slots)))
    table[:3, 1] = table[:3, 0]
    table[3:6, 2] = SIZE
    return torch.from_numpy(rng.integers(SIZE, size=rows)), table


def test_a_batch_scores_like_single_tables_in_any_order_of_slots():
    known = random_knowledge(0)
    goal, table = random_tables()
    model = torch.zeros_like(goal)
    features = known.features(goal, table, model)
    for row in range(len(goal)):
        one = slice(row, row + 1)
        assert torch.equal(known.features(goal[one], table[one], model[one]), features[one])
    scores = known(goal, table, model)
    assert torch.equal(scores, scores.transpose(1, 2))
    is_empty = table == SIZE
    assert torch.equal(torch.isneginf(scores), is_empty[:, :, None] | is_empty[:, None])
    order = torch.from_numpy(np.random.default_rng(3).permutation(table.shape[1]))
    moved = known(goal, table[:, order], model)
    torch.testing.assert_close(moved, scores[:, order][:, :, order], rtol=1e-4, atol=1e-4)


def test_unknown_ids_are_refused_and_a_missing_goal_has_no_features():
    known = random_knowledge(0)
    goal, table, model = torch.tensor([SIZE]), torch.tensor([[0, 1]]), torch.tensor([0])
    assert not known.features(goal, table, model).any()
    for wrong in (-1, SIZE + 1):
        with pytest.raises(IndexError, match=r"0 \.\. 12"):
            known.features(torch.tensor([wrong]), table, model)
        with pytest.raises(IndexError, match=r"0 \.\. 12"):
            known.features(torch.tensor([0]), torch.tensor([[0, wrong]]), model)


@pytest.mark.parametrize("name", ["recipes", "near_words"])
def test_stored_ids_outside_the_book_are_damage(name):
    known = random_knowledge(0)
    for wrong in (SIZE, -2):
        spoilt = known.constants()[name].clone()
        spoilt[0, 0] = wrong
        with pytest.raises(ValueError, match=rf"{name} contains numbers outside -?\d \.\. 11"):
            RecipeKnowledge(known.constants() | {name: spoilt})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_own": torch.tensor([SIZE + 1], dtype=torch.int32)}, "vectors has 12 rows"),
        ({"vectors": torch.zeros(SIZE - 1, 4).half()}, "near_words has type .* T = 11"),
        ({"vectors": torch.full((SIZE, 4), 2.0).half()}, "vectors holds numbers above 1"),
        ({"seen": torch.ones(2, 3, dtype=torch.bool)}, "seen has type"),
        ({"recipes": torch.zeros(3, 3)}, "recipes has type torch.float32"),
        ({"componentOf_table": torch.zeros(1, 3, 3).half()}, "_table has type"),
    ],
)
def test_tensors_that_compiled_loops_could_leave_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        RecipeKnowledge(random_knowledge(0).constants() | change)


def test_tensors_that_are_loaded_later_are_checked_as_well():
    known = random_knowledge(0)
    wrong = {"recipes": known.recipes + SIZE}
    with pytest.raises(ValueError, match="recipes contains numbers outside"):
        known.load_state_dict(known.state_dict() | wrong)


def test_a_stack_answers_as_each_model_also_from_its_constants():
    models = [random_knowledge(seed) for seed in range(3)]
    stack = RecipeKnowledge.stacked(models)
    again = RecipeKnowledge(stack.constants(), SIZE)
    goal, table = random_tables()
    for number, one in enumerate(models):
        alone = one(goal, table, torch.zeros_like(goal))
        for stacked in (stack, again):
            found = stacked(goal, table, torch.full_like(goal, number))
            torch.testing.assert_close(found, alone, rtol=1e-5, atol=1e-5)


def test_recipes_with_the_most_similar_results_support_a_goal():
    known = random_knowledge(1)
    lists = known.lists()
    slow = SlowFeatures(known.recipes.numpy(), unit_vectors())
    a, b, goal = 0, 1, 2
    found = known.supporting_recipes(a, b, goal, limit=100)
    assert found
    for one in found:
        i, j, result = one.recipe
        orders = (slow.alike[a, i] * slow.alike[b, j], slow.alike[a, j] * slow.alike[b, i])
        assert one.weight == pytest.approx(slow.alike[goal, result] * max(orders), rel=1e-3)
    assert known.supporting_recipes(b, a, goal, limit=100) == found
    i, j, result = known.recipes[0].tolist()
    first, *_ = known.supporting_recipes(i, j, result)
    assert (first.recipe, first.weight) == ((i, j, result), 1)
    assert (lists.support[goal] >= 0).sum() == min(len(known.recipes), lists.support.shape[1])


@pytest.mark.parametrize("recipes", [[], [[0, 0, 0]], [[0, 1, 2]]])
def test_books_with_hardly_a_recipe_have_features(recipes):
    rows = np.array(recipes, dtype=np.int64).reshape(-1, 3)
    vectors = unit_vectors(3)
    lists = make_lists(rows, vectors, nearest_words(vectors))
    assert np.isfinite(features_of_tables(lists, np.array([2]), np.array([[0, 1]]))).all()
    for relation in (COMBINES_WITH, COMPONENT_OF):
        assert link_features(lists, relation, np.arange(3), np.arange(3)).isfinite().all()


LOOP = """
from wordcraft_kg.models.scorers.neighbours.compiled import compiled

@compiled
def scaled(values):
    for place in range(len(values)):
        values[place] *= {}
"""


@pytest.mark.parametrize("damage", ["other types", "earlier source", "cut", "empty index"])
def test_only_the_machine_code_of_a_call_runs(damage, tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "loop.py"

    def hits(factor, kind=np.int64):
        """Call a loop, defined anew as in a new process; return whether the disk had its code."""
        path.write_text(LOOP.format(factor))
        loop = runpy.run_path(str(path))["scaled"]
        values = np.arange(3, dtype=kind)
        loop(values)
        assert values.tolist() == [0, factor, 2 * factor]
        return sum(loop.stats.cache_hits.values())

    assert [hits(2), hits(2), hits(2, np.float64)] == [0, 1, 0]
    codes = sorted((tmp_path / "cache").rglob("*.nbc"))
    if damage == "other types":
        codes[0].write_bytes(codes[1].read_bytes())
    elif damage == "earlier source":
        earlier = codes[0].read_bytes()
        hits(3)
        codes[0].write_bytes(earlier)
    elif damage == "cut":
        codes[0].write_bytes(codes[0].read_bytes()[:100])
    else:
        next((tmp_path / "cache").rglob("*.nbi")).write_bytes(b"")
    factor = 3 if damage == "earlier source" else 2
    assert [hits(factor), hits(factor)] == [0, 1]
