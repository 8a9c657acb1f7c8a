"""The pair encoder against loops that follow its equations, and the results that it proposes."""

import math

import numpy as np
import pytest
import torch

from wordcraft_kg import RecipeGraph, SplitConfig, make_split
from wordcraft_kg.graphs.train_samples import make_folds
from wordcraft_kg.models.recipes import encoder_fitting
from wordcraft_kg.models.recipes.encoder_fitting import EncoderSchedule, fit_encoder
from wordcraft_kg.models.scorers.neighbours import results
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.lists import make_lists, nearest_words
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES, OF_ENCODER
from wordcraft_kg.models.scorers.ranker import Ranker

TINY = EncoderSchedule(used=5, hidden=7, made=4, batch=8, sampled=6, epochs=2)
SIZE = 11


@pytest.fixture(scope="module")
def vectors():
    drawn = torch.randn(SIZE, 3, generator=torch.Generator().manual_seed(1))
    return torch.nn.functional.normalize(drawn).half()


@pytest.fixture(scope="module")
def recipes():
    rows = np.random.default_rng(0).integers(SIZE, size=(40, 3))
    rows[:, :2].sort(axis=1)
    return np.unique(rows, axis=0)


@pytest.fixture(scope="module")
def encoder(recipes, vectors):
    return fit_encoder(recipes, vectors.float(), torch.Generator().manual_seed(2), TINY)


@pytest.fixture(scope="module")
def knowledge(recipes, vectors, encoder):
    """Knowledge with rankers of drawn weights."""
    near = nearest_words(vectors.float().numpy())
    made = RecipeKnowledge.of_recipes(recipes, vectors.numpy(), near, {}, encoder)
    number = len(FEATURES) + len(OF_ENCODER)
    generator = torch.Generator().manual_seed(3)

    def ranker():
        return Ranker(
            torch.randn(number, 6, generator=generator) / 10,
            torch.randn(6, generator=generator),
            torch.randn(6, generator=generator),
            torch.zeros(()),
        )

    return made.with_ranker(ranker()).with_ranker(ranker(), "results_")


def slow_scores(encoder, a, b, goal):
    """S, s - u and u of a recipe, number by number."""
    one, other = encoder.used[a].double().tolist(), encoder.used[b].double().tolist()
    inputs = [x + y for x, y in zip(one, other, strict=True)]
    inputs += [x * y for x, y in zip(one, other, strict=True)]
    inputs += [abs(x - y) for x, y in zip(one, other, strict=True)]
    units = []
    for column, bias in zip(encoder.first.T.tolist(), encoder.first_bias.tolist(), strict=True):
        total = bias + sum(weight * value for weight, value in zip(column, inputs, strict=True))
        units.append(max(total, 0.0))
    own = float(encoder.pair_bias)
    own += sum(weight * unit for weight, unit in zip(encoder.pair.tolist(), units, strict=True))
    score = float(encoder.bias[goal])
    of_result = zip(
        encoder.second.T.tolist(),
        encoder.second_bias.tolist(),
        encoder.made[goal].tolist(),
        strict=True,
    )
    for column, bias, made in of_result:
        z = bias + sum(weight * unit for weight, unit in zip(column, units, strict=True))
        score += z * made
    return score + own, score, own


def test_features_are_those_of_the_equations(encoder):
    a = torch.tensor([[0, 3, 3], [7, 7, 1]])
    b = torch.tensor([[1, 3, 9], [2, 7, 0]])
    goal = torch.tensor([4, 10])
    features = encoder.features(a, b, goal)
    for row in range(2):
        for column in range(3):
            ids = int(a[row, column]), int(b[row, column]), int(goal[row])
            expected = torch.tensor(slow_scores(encoder, *ids))
            torch.testing.assert_close(features[row, column], expected, rtol=1e-4, atol=1e-4)
    assert torch.equal(features, encoder.features(b, a, goal))


def test_scores_of_all_results_are_those_of_single_ones(encoder):
    a, b = torch.tensor([0, 5, 5]), torch.tensor([1, 5, 2])
    every = encoder.result_scores(a, b)
    for goal in range(SIZE):
        single = encoder.features(a[:, None], b[:, None], torch.full((3,), goal))[:, 0, 1]
        torch.testing.assert_close(every[:, goal], single, rtol=1e-4, atol=1e-4)


def test_an_entity_of_words_alone_is_an_entity_whose_own_vectors_are_zero(
    recipes, vectors, encoder
):
    unseen = int(np.setdiff1d(np.arange(SIZE), recipes)[0]) if len({*recipes.flat}) < SIZE else None
    longer = encoder.with_entities(vectors[:2].float())
    assert longer.used.shape == (SIZE + 2, TINY.used)
    words = vectors[:2].float()
    expected = (words @ encoder.used_words + encoder.used_bias).relu().half()
    assert torch.equal(longer.used[SIZE:], expected)
    assert torch.equal(longer.made[:SIZE], encoder.made)
    if unseen is not None:
        again = encoder.with_entities(vectors[unseen : unseen + 1].float())
        assert torch.equal(again.used[SIZE], encoder.used[unseen])


def test_centring_changes_scores_by_a_constant_alone(recipes, encoder, vectors):
    generator = torch.Generator().manual_seed(1)
    moved = encoder._replace(
        used=encoder.used.float(),
        made=encoder.made.float() + torch.randn(TINY.made, generator=generator),
        bias=encoder.bias + 3,
        second_bias=encoder.second_bias + torch.randn(TINY.made, generator=generator),
        pair=encoder.pair + 0.5,
    )
    centred = encoder_fitting._centred(moved, torch.from_numpy(recipes))
    a, b, goal = torch.randint(SIZE, (3, 50), generator=generator)
    one, other = (each.features(a[:, None], b[:, None], goal)[:, 0, 0] for each in (moved, centred))
    assert (one - other).std() < 1e-4
    # An entity that has words alone is treated as all others.
    longer = [each.with_entities(vectors[:3].float()) for each in (moved, centred)]
    new = torch.arange(SIZE, SIZE + 3)
    one, other = (each.result_scores(a[:3], b[:3])[:, new] for each in longer)
    # In (pairs, results), the difference is a number of each pair, as that of its u.
    assert (one - other).std(1).max() < 2e-2


def test_the_same_seed_gives_the_same_bits_and_touches_no_global_generator(recipes, vectors):
    state = torch.get_rng_state()

    def fitted(seed, rows=recipes):
        generator = torch.Generator().manual_seed(seed)
        return fit_encoder(rows, vectors.float(), generator, TINY)

    one, again, other = fitted(5), fitted(5), fitted(6)
    assert all(torch.equal(x, y) for x, y in zip(one, again, strict=True))
    assert not torch.equal(one.used, other.used)
    assert torch.equal(torch.get_rng_state(), state)
    assert all(part.isfinite().all() for part in one)


@pytest.mark.parametrize("empty", [False, True])
def test_knowledge_appends_the_encoders_features(knowledge, encoder, empty):
    table = torch.tensor([[0, 3, SIZE if empty else 5]])
    goal = torch.tensor([4])
    features = knowledge.features(goal, table, torch.zeros_like(goal))
    assert features.shape[2] == len(FEATURES) + len(OF_ENCODER)
    (pair,) = encoder.features(torch.tensor([[0]]), torch.tensor([[3]]), goal)[0]
    torch.testing.assert_close(features[0, 1, len(FEATURES) :], pair)
    # The pair of the slots 0 and 2.
    assert features[0, 2, len(FEATURES) :].any() != empty


def slow_proposals(lists, encoder, a, b, number):
    """Results of the pairs of neighbours by weight, and the encoder's best ones."""
    weights = {}
    for x, of_a in zip(lists.used.ids[a], lists.used.alike[a], strict=True):
        for y, of_b in zip(lists.used.ids[b], lists.used.alike[b], strict=True):
            if x < 0 or y < 0 or of_a * of_b < 2e-3:
                continue
            low, high = min(x, y), max(x, y)
            made = lists.result[(lists.first == low) & (lists.second == high)]
            for result in made.tolist():
                weights[result] = weights.get(result, 0.0) + float(of_a * of_b)
    of_lists = sorted(weights, key=lambda entity: (-weights[entity], entity))[:number]
    scores = [slow_scores(encoder, a, b, goal)[1] for goal in range(len(encoder.bias))]
    of_encoder = sorted(range(len(scores)), key=lambda entity: -scores[entity])[:number]
    return {*of_lists, *of_encoder}


def test_proposals_come_from_neighbours_and_from_the_encoder(recipes, vectors, encoder):
    near = nearest_words(vectors.float().numpy())
    lists = make_lists(recipes, vectors.float().numpy(), near)
    a, b = torch.tensor([0, 1, 4, 6]), torch.tensor([2, 1, 3, 10])
    for number in (2, 4):
        found = results.propose_results(lists, encoder, a, b, number)
        assert found.shape == (4, 2 * number)
        for row in range(4):
            entities = [entity for entity in found[row].tolist() if entity >= 0]
            assert entities == sorted({*entities})
            expected = slow_proposals(lists, encoder, int(a[row]), int(b[row]), number)
            assert {*entities} == expected


def test_results_are_scored_by_their_own_ranker_best_first(knowledge):
    a, b = torch.tensor([0, 6]), torch.tensor([2, 3])
    ids, scores = results.results_of(knowledge, a, b, number=3)
    assert torch.equal(ids, results.results_of(knowledge, b, a, number=3)[0])
    ranker = knowledge.ranker("results_").model(0)
    one = (torch.tensor([0]), torch.tensor([1]))
    for row in range(2):
        found = ids[row][ids[row] < SIZE]
        low, high = sorted((int(a[row]), int(b[row])))
        table = torch.tensor([[low, high]]).expand(len(found), 2)
        features = knowledge.features(found, table, torch.zeros_like(found), one)
        expected = ranker(features[:, 0])
        torch.testing.assert_close(scores[row, : len(found)], expected, rtol=1e-4, atol=1e-4)
        assert scores[row].tolist() == sorted(scores[row].tolist(), reverse=True)
        assert (scores[row, len(found) :] == -math.inf).all()


def test_no_pairs_have_no_results(knowledge):
    nothing = torch.zeros(0, dtype=torch.int64)
    ids, scores = results.results_of(knowledge, nothing, nothing)
    assert len(ids) == len(scores) == 0


def test_a_book_without_words_has_an_encoder_of_single_entities(recipes):
    no_words = torch.zeros(SIZE, 0)
    fitted = fit_encoder(recipes, no_words, torch.Generator().manual_seed(2), TINY)
    assert fitted.used_words.shape == (0, TINY.used)
    assert (
        fitted.features(torch.tensor([[0]]), torch.tensor([[1]]), torch.tensor([2]))
        .isfinite()
        .all()
    )


def test_lessons_need_few_encoders(monkeypatch):
    from wordcraft_kg.models.recipes import fitting
    from wordcraft_kg.models.recipes.fitting import encoders_of, lesson_folds, lessons_of

    entities = [f"e{number}" for number in range(30)]
    rows = [(entities[i], entities[(7 * i + 1) % 30], entities[(3 * i) % 30]) for i in range(30)]
    graph = RecipeGraph.from_recipes(rows, name="thirty")
    folds = make_folds(make_split(graph, SplitConfig()), 5)
    every = [(), (0,), (1,), (2,), (3,), (4,)]
    for left_out in every:
        remaining = [fold for fold in range(5) if fold not in left_out]
        assert lesson_folds(folds, left_out) == remaining
    # In a small book a scorer without a fold has lessons of its own.
    assert len(lessons_of(folds, every)) == 5 + 5 * 4
    monkeypatch.setattr(fitting, "STRICT", len(folds.recipes()))
    assert len(lessons_of(folds, every)) == 5 + 5 * 4
    monkeypatch.setattr(fitting, "STRICT", len(folds.recipes()) - 1)
    assert lessons_of(folds, every) == [((), fold) for fold in range(5)]
    # In a large book one fold has examples enough.
    monkeypatch.setattr(fitting, "ONE_LESSON_FROM", len(folds.recipes()))
    needed = encoders_of(folds, every)
    assert needed == every
    assert lessons_of(folds, every) == [((), 0), ((), 1)]
    for left_out in every:
        (turn,) = lesson_folds(folds, left_out)
        assert turn not in left_out
