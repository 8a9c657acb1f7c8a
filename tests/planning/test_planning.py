"""The search for plans against slow references, and the source p."""

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest
import torch

from wordcraft_kg import (
    RecipeGraph,
    SplitConfig,
    WordCraftConfig,
    World,
    make_sources,
    make_split,
    open_graph,
)
from wordcraft_kg.agents.players import knowledge_player, scorer_alone
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.envs.wrappers import KGScoreObservation
from wordcraft_kg.graphs import OpenedGraph, Split, draw_train_sample, make_folds
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.lists import nearest_words
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES
from wordcraft_kg.models.scorers.probabilities import RecipeCurve, fit_recipe_curve
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker
from wordcraft_kg.planning.search import (
    AT_ONCE,
    FURTHER,
    INTERMEDIATE,
    NO_PLAN,
    REUSED,
    PlanSearch,
)
from wordcraft_kg.planning.source import BestPlan

SIZE = 7
CURVE = RecipeCurve(intercepts=(-2.0, -1.0), slope=0.8, shift=0.25)


def random_search(seed, width=SIZE, recipes=6):
    """A search with random features, weights and known recipes; as many candidates as entities by
    default."""
    generator = torch.Generator().manual_seed(seed)
    rng = np.random.default_rng(seed)
    known = np.unique(np.sort(rng.integers(SIZE, size=(recipes, 3)), axis=1), axis=0)
    vectors = rng.normal(size=(SIZE, 5)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    knowledge = RecipeKnowledge.of_recipes(
        known, vectors.astype(np.float16), nearest_words(vectors)
    )
    knowledge.lists()
    shapes = ((len(FEATURES), 4), (4,), (4,), ())
    weights = {
        name: torch.randn(shape, generator=generator) / 3
        for name, shape in zip(RANKER, shapes, strict=True)
    }
    return PlanSearch(knowledge.with_ranker(Ranker(**weights)), CURVE, width=width)


def state_of(goal, table, **options):
    return tuple(torch.tensor(part, **options) for part in ([goal], [table], [0]))


def untried(table):
    """A mask of tried pairs, of none."""
    return torch.zeros(*table.shape, table.shape[1], dtype=torch.bool)


def values_of(search, goal, table, model, left):
    return search.values(goal, table, model, torch.as_tensor(left), untried(table))


def slow_log_probability(search, a, b, result, prior=0.0):
    """log P(result | a, b), by its definition."""
    knowledge = search.knowledge
    recipes = knowledge.recipes.tolist()
    results = [made for *pair, made in recipes if pair == sorted((a, b))]
    if result in results:
        return 0.0
    score = float(
        knowledge(torch.tensor([result]), torch.tensor([[a, b]]), torch.tensor([0]))[0, 0, 1]
    )
    kind = int(any(made == result for *_, made in recipes))
    return -math.log1p(
        math.exp(-(CURVE.intercepts[kind] + CURVE.shift + prior + CURVE.slope * score))
    )


def slow_value(search, goal, table, attempts, cache):
    """V: the best plan over all sequences of attempts and results."""
    return max(
        slow_pair(search, goal, table, attempts, pair, cache)
        for pair in itertools.combinations_with_replacement(sorted(table), 2)
    )


def slow_pair(search, goal, table, attempts, pair, cache):
    key = goal, table, attempts, pair
    if key not in cache:
        value = slow_log_probability(search, *pair, goal)
        for result in set(range(SIZE)) - table - {goal} if attempts > 1 else ():
            chance = slow_log_probability(search, *pair, result, INTERMEDIATE)
            further = slow_value(search, goal, table | {result}, attempts - 1, cache) - FURTHER
            value = max(value, chance + further)
        cache[key] = value
    return cache[key]


def slow_with_form(search, goal, table, attempts, pair, cache):
    """The best plan that begins with a pair; the form of two attempts has log-odds."""
    if attempts != 2:
        return slow_pair(search, goal, table, attempts, pair, cache)
    plans = [slow_log_probability(search, *pair, goal) + AT_ONCE]
    for result in set(range(SIZE)) - table - {goal}:
        chance = slow_log_probability(search, *pair, result, INTERMEDIATE) - FURTHER
        for second in itertools.combinations_with_replacement(sorted(table | {result}), 2):
            uses_again = result in second and set(pair) & set(second)
            form = REUSED * bool(uses_again) if result in second else AT_ONCE
            plans.append(chance + slow_log_probability(search, *second, goal) + form)
    return max(plans)


@pytest.mark.parametrize(
    ("seed", "attempts"),
    [
        pytest.param(seed, attempts, marks=pytest.mark.slow if seed or attempts > 3 else [])
        for seed in range(3)
        for attempts in (1, 2, 3, 4)
    ],
)
def test_values_are_those_of_all_plans(seed, attempts):
    search = random_search(seed)
    goal, table = seed, [(seed + 1) % SIZE, (seed + 3) % SIZE, (seed + 4) % SIZE]
    cache = {}
    state = torch.tensor([goal]), torch.tensor([[*table, SIZE]]), torch.tensor([0])
    values = values_of(search, *state, [attempts])[0]
    for i, j in itertools.product(range(3), repeat=2):
        pair = tuple(sorted((table[i], table[j])))
        best = slow_with_form(search, goal, frozenset(table), attempts, pair, cache)
        expected = max(best, NO_PLAN)
        assert values[i, j] == pytest.approx(expected, abs=2e-3)  # features are half precision
    assert (values[3] == -torch.inf).all()
    pair = divmod(int(values.argmax()), 4)
    tried = untried(torch.tensor([table]))
    steps = search.plan(goal, table, pair, model=0, attempts_left=attempts, tried=tried)
    assert steps[-1][2] == goal
    form = log_odds_of_form(steps) if attempts == 2 else 0
    assert form + sum(math.log(max(chance, 1e-13)) for *_, chance in steps) == pytest.approx(
        float(values.max()), abs=2e-3
    )


def log_odds_of_form(steps):
    """What the form of a plan costs, if two attempts are left."""
    first, *later = ({*step[:2]} for step in steps)
    if not any(steps[0][2] in second for second in later):
        return AT_ONCE
    return REUSED * any(first & second for second in later)


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_plan_is_carried_on_after_the_result_that_it_expects(seed):
    search = random_search(seed)
    goal = seed % SIZE
    table = [(goal + step) % SIZE for step in (1, 2, 4)]
    state = state_of(goal, table)
    first = divmod(int(values_of(search, *state, [2])[0].argmax()), 3)
    tried = untried(torch.tensor([table]))
    steps = search.plan(goal, table, first, model=0, attempts_left=2, tried=tried)
    assert len(steps) == 2
    tried = torch.zeros(1, 4, 4, dtype=torch.bool)
    tried[0, first[0], first[1]] = tried[0, first[1], first[0]] = True
    later = search.values(*state_of(goal, [*table, steps[0][2]]), torch.tensor([1]), tried)[0]
    one, other = divmod(int(later.argmax()), 4)
    at_hand = [*table, steps[0][2]]
    assert {at_hand[one], at_hand[other]} == {*steps[1][:2]}
    # After a pair that nobody planned, an ingredient of it costs as much as in a plan.
    afresh = values_of(search, *state_of(goal, at_hand), [1])[0]
    uses_again = torch.tensor([slot in first for slot in range(4)])
    uses_again = (uses_again[:, None] | uses_again).float()
    expected = (afresh + REUSED * uses_again).masked_fill(tried[0], NO_PLAN)
    torch.testing.assert_close(later, expected.clamp(min=NO_PLAN))


def test_a_batch_has_the_values_of_single_states():
    search = random_search(3, width=4)
    rng = np.random.default_rng(0)
    tables = torch.from_numpy(np.stack([rng.permutation(SIZE)[:5] for _ in range(12)]))
    tables[::3, 3:] = SIZE
    goals, left = torch.from_numpy(rng.integers(SIZE, size=12)), torch.arange(12) % 5
    models = torch.zeros_like(goals)
    values = values_of(search, goals, tables, models, left)
    for row in range(12):
        one = slice(row, row + 1)
        single = values_of(search, goals[one], tables[one], models[one], left[one])[0]
        torch.testing.assert_close(values[row], single, rtol=0, atol=1e-4)


def test_a_plan_avoids_tried_pairs_as_its_value_does():
    search = random_search(1)
    goal, table = 0, [1, 2, 3]
    pair = divmod(int(values_of(search, *state_of(goal, table), [1])[0].argmax()), 3)
    tried = torch.zeros(1, 3, 3, dtype=torch.bool)
    tried[0, pair[0], pair[1]] = tried[0, pair[1], pair[0]] = True
    values = search.values(*state_of(goal, table), torch.tensor([3]), tried)[0]
    best = divmod(int(values.argmax()), 3)
    steps = search.plan(goal, table, best, model=0, attempts_left=3, tried=tried)
    assert {table[slot] for slot in pair} not in [{a, b} for a, b, *_ in steps]
    assert sum(math.log(chance) for *_, chance in steps) == pytest.approx(
        float(values.max()), abs=2e-3
    )
    assert search.plan(goal, table, pair, model=0, attempts_left=3, tried=tried) == []


def test_an_entity_alone_has_the_values_of_a_table_with_empty_slots():
    search = random_search(10, width=2)
    for left in (2, 3, 4):
        alone, padded = (
            values_of(search, *state_of(0, [1, *empty]), [left])[0, 0, 0]
            for empty in ([], [SIZE, SIZE])
        )
        assert alone == pytest.approx(float(padded), abs=1e-5)


def test_a_search_that_does_not_fit_into_memory_says_what_it_would_take():
    search = random_search(0, width=10**6)
    search.knowledge.num_entities = 10**6
    with pytest.raises(
        ConfigError, match=r"`plan_width` 1,000,000: candidate plans would take [\d,.]+ GiB"
    ):
        next(search._searches(torch.full((3,), 4), 5))


def test_the_curve_fits_known_probabilities():
    rng = np.random.default_rng(0)
    counts = np.zeros((2, 2, 1001))
    bins = np.clip(np.rint((rng.normal(2, 3, 400_000) + 20) / 0.05), 0, 1000).astype(int)
    scores, kinds = -20 + 0.05 * bins, rng.integers(2, size=len(bins))
    truth = 1 / (1 + np.exp(-(np.array(CURVE.intercepts)[kinds] + CURVE.slope * scores)))
    np.add.at(counts, (kinds, (rng.random(len(bins)) < truth).astype(int), bins), 1)
    folds = make_folds(open_graph("kitchen").split, 5)
    curve = fit_recipe_curve([counts], folds)
    assert curve.intercepts == pytest.approx(CURVE.intercepts, abs=0.05)
    assert curve.slope == pytest.approx(CURVE.slope, abs=0.02)
    half = folds.with_train_sample(
        draw_train_sample(folds.split, 0.5, 0.0, 1, of_recipe=folds.of_recipe)
    )
    for one in (folds, half):
        seen, everything = int(one.seen().sum()), folds.split.graph.num_recipes
        assert fit_recipe_curve([counts], one).shift == pytest.approx(
            math.log((everything - seen) * 5 / seen)
        )
    assert half.seen().sum() < folds.seen().sum()


@pytest.fixture(scope="module")
def scorer(cross_fitted):
    return cross_fitted


def success(world, source):
    tasks = np.arange(0, len(world.tasks), 4)
    state = BatchEngine(world, len(tasks)).pose(tasks)
    player, rng, won = knowledge_player([source]), np.random.default_rng(0), 0
    while (state.attempts_left > 0).any():
        state, step = state.engine.step_once(state, player(state, rng))
        won += int((step.outcome == GOAL).sum())
    return won / len(tasks)


@pytest.mark.slow
def test_planning_with_all_recipes_solves_every_task(opened):
    source = BestPlan.of_recipes(opened.graph.num_entities, opened.graph.recipes)
    for depth in (1, 2, 3):
        world = World(
            opened, WordCraftConfig(part="test", depth=depth, num_distractors=3, num_tasks=60)
        )
        assert success(world, source) == 1


def test_planning_beats_recipe_scores_at_depth_2(opened, scorer):
    world = World(opened, WordCraftConfig(part="test", depth=2, num_distractors=4, num_tasks=60))
    p, w = make_sources(["p", "w"], scorer)
    assert success(world, p) > success(world, w) + 0.2
    assert list(scorer_alone({"u": w, "w": w, "p": p})) == [
        "combines (u), recipe (w), plan (p)",
        "recipe (w)",
        "plan (p)",
    ]


def test_first_pairs_do_not_depend_on_unseen_recipes_or_plans(opened, scorer):
    graph, split = opened.graph, opened.split
    rng = np.random.default_rng(0)
    is_train = split.is_in("train")
    entities = np.array(graph.entities)
    recipes = [tuple(entities[row]) for row in graph.recipes[is_train]]
    known = {(a, b) for a, b, _ in recipes}
    while len(recipes) < graph.num_recipes:
        a, b, c = rng.permutation(len(entities))[:3].tolist()
        pair = tuple(entities[sorted((a, b))])
        if pair not in known:
            known.add(pair)
            recipes.append((*pair, entities[c]))
    other = RecipeGraph.from_recipes(recipes)
    assert other.entities == graph.entities
    trained = {tuple(row) for row in graph.recipes[is_train].tolist()}
    parts = np.array(
        [0 if tuple(row) in trained else 2 for row in other.recipes.tolist()], dtype=np.int8
    )
    worlds = [
        World(OpenedGraph(one, part, ""), WordCraftConfig(part="test", depth=2, num_distractors=4))
        for one, part in ((graph, split), (other, Split(other, SplitConfig(), parts)))
    ]
    (source,) = make_sources(["p"], scorer)
    tasks = np.arange(0, len(worlds[0].tasks), 4)
    state = BatchEngine(worlds[0], len(tasks)).pose(tasks)
    goal, table, left = state.goal, state.table, state.attempts_left
    assert len(worlds[1].tasks)
    posed = BatchEngine(worlds[1], state.num_envs).reset()._replace(goal=goal, attempts_left=left)
    wide = np.full((state.num_envs, posed.wide.shape[1]), posed.nothing)
    wide[:, : table.shape[1]] = table[:, : wide.shape[1]]
    posed = posed._replace(wide=wide, selection=np.full_like(goal, posed.nothing))
    slots = min(table.shape[1], wide.shape[1] - 1)
    first, again = (source(states_of(one)._replace(task=None)) for one in (state, posed))
    assert torch.equal(first[:, :slots], again[:, :slots])


def test_p_of_a_batch_follows_selection_and_attempts(scorer, opened):
    (p,) = make_sources(["p"], scorer)
    world = World(opened, WordCraftConfig(part="test", depth=2, num_distractors=2))
    states = states_of(BatchEngine(world, 50).pose(np.arange(50)))
    models = torch.zeros(50, dtype=torch.int64)
    values = values_of(p.search, states.goal, states.table, models, states.attempts.left)
    empty = states.table == opened.graph.num_entities
    free = p(states)
    torch.testing.assert_close(free, values.amax(2).masked_fill(empty, 0), rtol=0, atol=1e-5)
    held = p(states._replace(selection=states.table[:, 1], task=None))
    torch.testing.assert_close(held, values[:, 1].masked_fill(empty, 0), rtol=0, atol=1e-5)
    with pytest.raises(ValueError, match="needs `attempts`"):
        p(States(*states[:3]))
    one = Attempts(torch.ones_like(states.goal))
    assert not torch.equal(p(States(*states[:3], attempts=one)), free)


def test_evidence_is_a_plan_whose_probability_is_p(scorer, opened):
    (p,) = make_sources(["p"], scorer)
    graph, empty = opened.graph, opened.graph.num_entities
    goal, table = torch.tensor([graph.id_of("bread")]), torch.tensor([[empty, 3, 40, empty, 7, 70]])
    for selection in (empty, 3, 55):  # nothing, on the table, not on the table
        for pairs in ([[3, 40]], [[7, 7], [3, 70]]):
            attempts = Attempts(torch.tensor([2]), torch.tensor([pairs]))
            state = States(goal, torch.tensor([selection]), table, None, attempts)
            scores = p(state)[0]
            for slot, evidence in enumerate(p.evidence(state)):
                assert (evidence is None) == (int(table[0, slot]) == empty)
                if evidence and evidence.plan:
                    chance = math.log(math.prod(step[3] for step in evidence.plan))
                    # After tried pairs, forms do not count.
                    assert chance == pytest.approx(float(scores[slot]), abs=2 * FURTHER)
                    first, result = {*evidence.plan[0][:2]}, evidence.plan[0][2]
                    assert first == {int(table[0, slot]), evidence.partner}
                    expected = p.knowledge.supporting_recipes(
                        int(table[0, slot]), evidence.partner, result, limit=3
                    )
                    assert evidence.supporting == tuple(expected)
                elif evidence:
                    assert scores[slot] == NO_PLAN


def test_a_scorer_without_probabilities_of_recipes_is_refused():
    scorer = TableScorer(torch.zeros(2, 5, 5), [f"e{i}" for i in range(5)], "0" * 64)
    with pytest.raises(ConfigError, match=r"`use` plan \(p\) needs probabilities of recipes"):
        make_sources(["p"], scorer)


def test_wrapped_environments_observe_p(opened: OpenedGraph):
    source = BestPlan.of_recipes(opened.graph.num_entities, opened.graph.recipes)
    source.graph_hash = opened.graph.hash
    env = gym.make("WordCraft-v0", graph="kitchen", part="test", depth=2, num_distractors=2)
    observation, _ = KGScoreObservation(env, [source]).reset(seed=0)
    state = (torch.tensor(observation[key])[None] for key in ("goal", "selection", "table"))
    states = States(*state, attempts=Attempts(torch.tensor([2])))
    np.testing.assert_array_equal(observation["p"], source(states)[0].numpy())
    assert observation["p"].max() > -2 * FURTHER  # a plan of known recipes
    env.close()


@pytest.mark.parametrize("attempts", [2, 3, 4])
def test_of_equally_probable_plans_the_shortest_is_best(attempts):
    source = BestPlan.of_recipes(6, np.array([[0, 1, 4], [2, 3, 5]]))
    goal, table, model = state_of(5, [0, 1, 2, 3])
    values = values_of(source.search, goal, table, model, [attempts])[0]
    assert divmod(int(values.argmax()), 4) == (2, 3)
    assert (values[2, 3], values[0, 1]) == pytest.approx((0, -FURTHER))
    options = {"model": 0, "attempts_left": attempts, "tried": untried(table)}
    assert len(source.search.plan(5, [0, 1, 2, 3], (0, 1), **options)) == 2


def test_one_ingredient_recipes_are_planned():
    graph = RecipeGraph.from_recipes(
        [("seed", "seed", "plant"), ("plant", "plant", "tree"), ("tree", "seed", "wood")]
    )
    assert make_split(graph, SplitConfig("none")).is_in("train").all()
    source = BestPlan.of_recipes(graph.num_entities, graph.recipes)
    start, goal = graph.id_of("seed"), graph.id_of("wood")
    tried = untried(torch.tensor([[start]]))
    steps = source.search.plan(goal, [start], (0, 0), model=0, attempts_left=3, tried=tried)
    assert [graph.entities[made] for *_, made, _ in steps] == ["plant", "tree", "wood"]
    assert [chance for *_, chance in steps] == [1, 1, 1]
