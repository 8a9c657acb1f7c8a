"""Explained actions: against evaluated episodes, against the formula in loops, and in several
threads."""

from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
import torch
from helpers import refuses
from slow_attention import SlowAttention, softmax

from wordcraft_kg import (
    PolicyConfig,
    WordCraftConfig,
    World,
    load_scorer,
    make_sources,
)
from wordcraft_kg.agents.evaluation import _HASH_FACTOR, Evaluator, PolicyPlayer
from wordcraft_kg.agents.explanation import MOST_ON_TABLE, Explainer
from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.draws import EVALUATION_SEED, EvaluationTables
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, SplitConfig, make_split
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

SMALL = {
    "features": "random",
    "key_size": 4,
    "value_size": 5,
    "self_edges": "keep",
}
KINDS = ("no scorer", "mlp", "links", "cross-fitted links", "recipes", "scorer alone", "in sample")
QUICK = (
    ("train", 1, None, "no scorer"),
    ("train", 1, None, "cross-fitted links"),
    ("train", 1, None, "recipes"),
    ("test", 1, 3, "mlp"),
    ("test", 1, 3, "in sample"),
)
"""Each kind of model, in and out of sample; `make slow` has all plays of all kinds."""


@pytest.fixture(scope="module")
def scorer(recipes_folder):
    return load_scorer(recipes_folder)


def random_policy(graph, num_slots, scorer=None, tasks=None, **settings):
    config = PolicyConfig(**SMALL, **settings)
    policy, _ = make_policy(config, graph, num_slots, scorer=scorer, tasks=tasks, seed=4)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.mul_(2)
    return policy.eval()


@pytest.fixture(scope="module")
def made(opened, scorer):
    """Make a world and a policy of random weights, large enough that its picks differ from state to
    state."""
    links = FrequencyScorer(opened.graph, opened.split.partial)
    kinds = {
        "no scorer": (None, {}),
        "mlp": (None, {"policy": "mlp", "hidden_size": 7}),
        "links": (links, {"use": "u,v"}),
        "cross-fitted links": (scorer, {"use": "u,v"}),
        "recipes": (scorer, {"use": "u,v,w"}),
        "scorer alone": (scorer, {"use": "v,w", "kg_only": True, "mixing": "softmax"}),
        "in sample": (scorer, {"use": "w", "in_sample": True}),
    }

    @cache
    def world_of(part, **settings):
        return World(opened, WordCraftConfig.of({"part": part, "num_distractors": 4, **settings}))

    @cache
    def policy_of(kind, num_slots):
        guide, settings = kinds[kind]
        tasks = world_of("train").tasks
        return random_policy(opened.graph, num_slots, scorer=guide, tasks=tasks, **settings)

    def made(kind, part="test", **settings):
        world = world_of(part, **settings)
        return world, policy_of(kind, world.num_slots)

    return made


@pytest.fixture(scope="module")
def explaining(made):
    """Make an explainer."""
    return lambda kind, part="test": Explainer(*reversed(made(kind, part)))


def made_up(rows, base, **settings):
    """A world of a few recipes, and an explainer."""
    graph = RecipeGraph.from_recipes(rows, base)
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("none")), "made up")
    world = World(opened, WordCraftConfig(num_distractors=0, **settings))
    return Explainer(random_policy(graph, world.num_slots), world)


def decision_of(graph, episode):
    """The number of an episode's pairs, as of an evaluation."""
    actions = graph.ids_of(step.action for step in episode.steps)
    pairs = np.sort(actions.reshape(-1, 2), axis=1)
    decision = np.zeros(1, dtype=np.int64)
    for first, second in pairs.tolist():
        decision *= _HASH_FACTOR
        decision += 1 + first * graph.num_entities + second
    return decision[0]


@pytest.mark.parametrize(
    ("part", "depth", "attempts", "kind"),
    [
        pytest.param(*play, kind, marks=[] if (*play, kind) in QUICK else pytest.mark.slow)
        for play in (("train", 1, None), ("test", 1, 3), ("test", 2, 3))
        for kind in KINDS
    ],
)
def test_an_explained_episode_is_that_of_the_evaluation(opened, made, kind, part, depth, attempts):
    world, policy = made(kind, part, depth=depth, max_attempts=attempts)
    engine = BatchEngine(world, len(world.tasks))
    result = Evaluator(world, distractor_seeds=2)(PolicyPlayer(policy))
    explainer = Explainer(policy, world)
    outcomes = set()
    # Some 16 tasks of a part: an explained episode takes far longer than a played one.
    step = max(8, len(world.tasks) // 16)
    for distractor_seed in range(2):
        posed = engine.pose(np.arange(len(world.tasks)), distractor_seed, seed=EVALUATION_SEED)
        for task in range(distractor_seed, len(world.tasks), step):
            found = explainer.task(task, distractor_seed)
            table = [entity for entity in posed.table[task].tolist() if entity != engine.nothing]
            assert found.table == opened.graph.labels(table)
            assert len(found.episode.steps) == result.actions[task, distractor_seed]
            assert (found.episode.outcome == "goal") == result.success[task, distractor_seed]
            decision = decision_of(opened.graph, found.episode)
            assert decision == result.decisions[task, distractor_seed]
            assert found.episode.start == world.tasks[task].start
            outcomes.add(found.episode.outcome)
    # With scores of learned recipes an agent makes all goals of train tasks.
    is_sure = (kind, part) == ("in sample", "train")
    assert (
        is_sure or outcomes == {"goal", "out_of_attempts"} or kind not in ("recipes", "in sample")
    )


def test_of_a_sample_of_the_tasks_the_tables_are_those_that_were_played(opened, explaining):
    explainer = explaining("no scorer")
    world = explainer.world
    explainer.tables = EvaluationTables(world, limit=20)
    evaluator = Evaluator(world, distractor_seeds=1, limit=20)
    posed = evaluator.engine.pose(evaluator.tasks, seed=EVALUATION_SEED)
    assert evaluator.tasks[1] > 1
    for row, task in enumerate(evaluator.tasks.tolist()):
        table = [entity for entity in posed.table[row].tolist() if entity != world.nothing]
        assert explainer.task(task).table == opened.graph.labels(table)
    assert len(explainer.task(1).table) == len(world.tasks[1].start) + 4


def by_loops(policy, goal, selection, table, values):
    """Logits, value and λ of a state from the paper's formulas, given the values of the sources."""
    slow = SlowAttention(policy)
    alpha = slow.alpha(goal, policy.num_entities if selection is None else selection, table)
    (value,) = slow.head("value", alpha, table)
    if not values:
        return alpha, value, []
    lambdas = slow.lambdas(alpha, table)
    terms = list(values.values()) if policy.config.kg_only else [alpha, *values.values()]
    logits = [
        sum(weight * term[i] for weight, term in zip(lambdas, terms, strict=True))
        for i in range(len(table))
    ]
    return logits, value, lambdas


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "mlp"])
@pytest.mark.parametrize("is_held", [False, True])
def test_a_table_of_ones_own_is_explained_as_the_formula_says(opened, made, kind, is_held):
    world, policy = made(kind)
    explainer, graph = Explainer(policy, world), opened.graph
    rng = np.random.default_rng(3)
    for _ in range(6):
        goal, *table = rng.permutation(graph.num_entities)[:8].tolist()
        selection = table[2] if is_held else None
        found = explainer.table(goal, table, selection)
        step = found.episode.steps[0]
        assert step.selection == (graph.entities[selection] if selection is not None else None)
        assert [slot.entity for slot in step.slots] == [graph.entities[entity] for entity in table]
        names = [name for name in step.slots[0].sources if name in policy.sources]
        values = {name: [slot.sources[name] for slot in step.slots] for name in names}
        logits, value, lambdas = by_loops(policy, goal, selection, table, values)
        assert [slot.logit for slot in step.slots] == pytest.approx(logits, abs=1e-9)
        assert [slot.probability for slot in step.slots] == pytest.approx(softmax(logits), abs=1e-9)
        assert step.value == pytest.approx(value, abs=1e-9)
        assert list(step.lambdas.values()) == pytest.approx(lambdas, abs=1e-9)
        assert step.action == max(step.slots, key=lambda slot: slot.logit).entity
        for slot in step.slots:
            assert sum(slot.contributions.values()) == pytest.approx(slot.logit, abs=1e-9)
            for name, share in step.lambdas.items():
                assert slot.contributions[name] == pytest.approx(
                    share * slot.sources[name], abs=1e-12
                )
        if not is_held:  # the second pick follows from the first
            assert found.episode.steps[1].selection == step.action
        assert len(found.episode.steps) == 2 - is_held


def test_what_is_made_is_on_the_table_for_the_next_attempt():
    """A pair with two results, one of them there already, and then one that makes the goal with its
    own result."""
    rows = [["a", "b", "c"], ["a", "b", "d"], ["d", "d", "goal"], ["c", "e", "f"]]
    explainer = made_up(rows, ["a", "b", "e"], depth=2, max_attempts=3)
    # The policy picks something; the picks are followed by hand.
    for table in (["a", "b", "c", "e"], ["a", "b"], ["d", "a"], ["b", "e", "d", "goal"]):
        there, selection, is_made = list(table), None, False
        for step in explainer.table("goal", table).episode.steps:
            assert not is_made
            assert step.selection == selection
            assert [slot.entity for slot in step.slots] == there
            made = (
                []
                if selection is None
                else [c for a, b, c in rows if sorted((selection, step.action)) == [a, b]]
            )
            assert step.made == tuple(entity for entity in made if entity not in there)
            is_made = "goal" in made
            there += step.made
            selection = step.action if selection is None else None
        assert (explainer.table("goal", table).episode.outcome == "goal") == is_made


def test_at_most_max_actions_of_an_episode_are_explained(made):
    world, policy = made("no scorer", max_attempts=4)

    def explaining_to(most):
        explainer = Explainer(policy, world, max_actions=most)
        return cache(lambda task: explainer.task(task).episode)

    whole, cut = explaining_to(None), explaining_to(5)
    tasks = range(len(world.tasks))
    long = next(task for task in tasks if len(whole(task).steps) == 8)
    assert cut(long).steps == whole(long).steps[:5]
    assert (cut(long).outcome, whole(long).outcome) == ("in_progress", "out_of_attempts")
    short = next(task for task in tasks if len(whole(task).steps) <= 4)
    assert cut(short) == whole(short)


def ways_by_loops(graph, goal, table):
    pairs = {tuple(sorted(pair)) for pair in combinations_with_replacement(table, 2)}
    return {
        tuple(recipe)
        for recipe in graph.recipe_labels()
        if recipe[2] == goal and tuple(recipe[:2]) in pairs
    }


@pytest.mark.parametrize("part", ["train", "test", pytest.param("all", marks=pytest.mark.slow)])
def test_no_model_that_has_seen_its_recipes_answers_a_task(opened, scorer, explaining, part):
    explainer = explaining("recipes", part)
    world = explainer.world
    rows, models = opened.graph.recipe_labels(), set()
    fold_of = dict(zip(rows, scorer.of_recipe.tolist(), strict=True))
    for number in range(0, len(world.tasks), 12):
        found, plans = explainer.task(number), world.tasks[number].plans
        mine = {fold_of[recipe] for plan in plans for recipe in plan} - {-1}
        if not mine:
            assert (found.model, found.fold) == ("train_recipes", None)
        elif len(mine) == 1:
            assert (found.model, found.fold) == ("without_a_fold", mine.pop())
        else:
            assert (found.model, found.fold) == ("no_knowledge", None)
        models.add(found.model)
        assert_ways(opened.graph, scorer, found)
        table = explainer.table(found.episode.goal, found.table, like=number)
        assert table.episode == found.episode
    assert "without_a_fold" in models or part == "test"


def assert_ways(graph, scorer, found):
    """The ways are the recipes on the table, and what is remembered is what the model that answers
    was trained on."""
    ways = {(*one.ingredients, one.result): one for way in found.ways for one in way}
    assert ways.keys() == ways_by_loops(graph, found.episode.goal, found.table)
    for row, recipe in enumerate(graph.recipe_labels()):
        if recipe in ways:
            fold, told = int(scorer.of_recipe[row]), ways[recipe]
            assert (told.part == "train") == (fold >= 0)
            seen = {
                "train_recipes": fold >= 0,
                "without_a_fold": fold not in (-1, found.fold),
                "no_knowledge": False,
            }
            assert told.is_in_sample == seen[found.model]
    assert {*found.in_sample} == {one for one in ways.values() if one.is_in_sample}


def test_an_own_table_is_scored_out_of_sample(opened, scorer, explaining):
    """A table of ones own is answered by a model that has not seen how the goal is made on it."""
    explainer, graph, rng = explaining("recipes"), opened.graph, np.random.default_rng(5)
    recipes, found_models = graph.recipes.tolist(), []
    for a, b, goal in recipes[::12]:
        others = [
            entity
            for entity in rng.permutation(graph.num_entities).tolist()
            if entity not in (a, b, goal)
        ][:4]
        table = [*dict.fromkeys((a, b)), *others]
        found = explainer.table(goal, table)
        assert_ways(opened.graph, scorer, found)
        on_table = ways_by_loops(graph, graph.entities[goal], graph.labels(table))
        rows = [row for row, recipe in enumerate(graph.recipe_labels()) if recipe in on_table]
        folds = {int(scorer.of_recipe[row]) for row in rows} - {-1}
        expected = (
            ("without_a_fold", next(iter(folds))) if len(folds) == 1 else ("train_recipes", None)
        )
        assert (found.model, found.fold) == expected
        found_models.append((found.model, bool(found.in_sample)))
        model = scorer.whole if found.fold is None else scorer.left_out(found.fold)
        (w,) = make_sources(["w"], model)
        nothing = torch.tensor([graph.num_entities])
        slots = w(States(torch.tensor([goal]), nothing, torch.tensor([table])))[0].tolist()
        assert [slot.sources["w"] for slot in found.episode.steps[0].slots] == pytest.approx(
            slots, abs=1e-4
        )
    assert {("without_a_fold", False), ("train_recipes", False)} <= set(found_models)


def test_where_every_model_was_trained_on_a_plan_it_is_marked_as_in_sample(
    opened, scorer, explaining
):
    explainer, graph = explaining("recipes", "train"), opened.graph
    world = explainer.world
    by_goal = {}
    for row, (_, _, goal) in enumerate(graph.recipes.tolist()):
        if scorer.of_recipe[row] >= 0:
            by_goal.setdefault(goal, {}).setdefault(int(scorer.of_recipe[row]), []).append(row)
    goal, rows = next(
        (goal, [of[0] for of in folds.values()][:2])
        for goal, folds in by_goal.items()
        if len(folds) > 1
    )
    table = sorted({part for row in rows for part in graph.recipes[row, :2].tolist()})
    found = explainer.table(goal, table)
    assert (found.model, bool(found.in_sample)) == ("train_recipes", True)
    # Made from a task, it stays that task: its own model answers, which has seen the other way
    # only.
    plans = {task: plan for task, plan in enumerate(world.tasks.plans) if (rows[0],) in plan}
    (task,) = plans
    like = explainer.table(goal, table, like=task)
    assert (like.model, like.fold) == ("without_a_fold", int(scorer.of_recipe[rows[0]]))
    assert [one.is_in_sample for way in like.ways for one in way if one.part == "train"].count(
        False
    ) >= 1
    # Without its ingredients, or with another goal, it is that task no more.
    gone = [entity for entity in table if entity != graph.recipes[rows[0], 0]] or table
    assert explainer.table(goal, gone, like=task).model == explainer.table(goal, gone).model


@pytest.mark.parametrize(("kg", "model"), [("full", "all_recipes"), ("partial", "train_recipes")])
def test_a_scorer_without_folds_has_in_sample_recipes(made, kg, model):
    """Recipes are in sample for a scorer without folds that was trained on them."""
    world, policy = made("links", "all")
    explainer = Explainer(
        policy,
        world,
        trained_on=OpenedGraph(world.graph, world.split, "").train_sample(kg).is_trained_on,
    )
    for task in range(0, len(world.tasks), 5):
        found = explainer.task(task)
        assert (found.model, found.fold) == (model, None)
        for way in found.ways:
            assert all(one.is_in_sample == (kg == "full" or one.part == "train") for one in way)


def test_explaining_leaves_the_policy_as_it_is(made):
    world, policy = made("recipes", "train")
    before = {name: tensor.clone() for name, tensor in policy.state_dict().items()}
    bound = [source.bound_to for source in policy.sources.values()]
    shared = {tensor.data_ptr() for tensor in policy.sources["w"].buffers() if tensor.numel()}
    explainer = Explainer(policy, world.variant(part="all"))
    explainer.table("bread", ["flour", "water"])
    assert all(torch.equal(tensor, before[name]) for name, tensor in policy.state_dict().items())
    assert all(tensor.dtype == before[name].dtype for name, tensor in policy.state_dict().items())
    assert [source.bound_to for source in policy.sources.values()] == bound
    # A scorer's tables are tens of megabytes: they are there once.
    mine = {
        tensor.data_ptr() for tensor in explainer._exact.sources["w"].buffers() if tensor.numel()
    }
    assert len(shared & mine) >= len(shared) - 1


@pytest.mark.parametrize(
    ("setting", "table", "options"),
    [
        ("table", [], {}),
        ("table", 65, {}),
        ("table", ["flour", "water", "flour"], {}),
        ("selection", ["flour", "water"], {"selection": "fire"}),
        ("like", ["flour"], {"like": 63}),
    ],
)
def test_a_table_that_cannot_be_played_is_refused(opened, explaining, setting, table, options):
    assert MOST_ON_TABLE == 64
    with refuses(setting):
        explaining("no scorer").table(
            "bread", opened.graph.entities[:table] if table == 65 else table, **options
        )


def test_unknown_labels_and_tasks_are_refused(opened, explaining):
    explainer = explaining("no scorer")
    for goal, table, problem in (
        ("bread", ["flouur", "water"], r"no entity 'flouur' in kitchen\. Did you mean 'flour'"),
        ("breaad", ["flour"], "no entity 'breaad'"),
    ):
        with pytest.raises(UnknownEntityError, match=problem):
            explainer.table(goal, table)
    for setting, task, distractor_seed in (("task", 63, 0), ("distractor_seed", 0, -1)):
        with refuses(setting):
            explainer.task(task, distractor_seed)
    mlp = explaining("mlp")
    assert len(mlp.table("bread", ["flour", "water"]).episode.steps) == 2
    with pytest.raises(ConfigError, match="this mlp was made for"):
        mlp.table("bread", opened.graph.entities[:20])
