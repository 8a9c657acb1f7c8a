"""Sources of a cross-fitted scorer: each train task is scored by a model that has not seen its
recipes."""

import json
from functools import cache

import gymnasium as gym
import msgspec
import numpy as np
import pytest
import torch
from helpers import refuses

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    PolicyConfig,
    WordCraftConfig,
    World,
    load_scorer,
    make_sources,
    save_scorer,
    train_agent,
    train_links,
)
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.players import knowledge_player
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.wrappers import KGScoreObservation, TaskObservation
from wordcraft_kg.graphs import OpenedGraph, SplitConfig, make_folds, make_split, open_graph
from wordcraft_kg.models.policies.policy_folder import load_policy, make_policy
from wordcraft_kg.models.policies.sources import registry
from wordcraft_kg.models.policies.sources.source import ScoreView
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers import cross_fitting
from wordcraft_kg.models.scorers.baselines import FrequencyScorer
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, models_of_tasks
from wordcraft_kg.models.scorers.scales import scaled_table

FOLDS = 3
SMALL = {"features": "random", "key_size": 8, "value_size": 8}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A cross-fitted ComplEx of the kitchen; read only."""
    out = tmp_path_factory.mktemp("models") / "model"
    return train_links(
        LinksConfig("kitchen", ComplExConfig(dim=8, epochs=4, n3=0.1, folds=FOLDS)), out
    ).folder


@pytest.fixture(scope="module")
def scorer(folder):
    return load_scorer(folder)


def world_of(opened, part="train", depth=1, **settings):
    return World(opened, WordCraftConfig(part=part, depth=depth, num_distractors=3, **settings))


def folds_of(world):
    """The fold to leave out for each task: none, one, or several if no fold has a recipe of each
    plan."""
    of_recipe = make_folds(world.split, FOLDS).of_recipe
    # A choice among shared folds counts train recipes alone.
    number = np.cumsum(of_recipe >= 0)

    def left_out(plans):
        of_plans = [{int(of_recipe[row]) for row in plan} for plan in plans]
        of_plans = [folds for folds in of_plans if -1 not in folds]
        shared = sorted(set.intersection(*of_plans)) if of_plans else []
        return (
            {shared[number[list(plans[0])].sum() % len(shared)]}
            if shared
            else set().union(*of_plans)
        )

    return list(map(left_out, world.tasks.plans))


def expected_scores(opened, scorer, view, state, folds):
    """u and v by the scorer of each state's fold, one by one: shape (2, B, A)."""
    goal, selection, table, *_ = state
    nothing, partial = opened.graph.num_entities, opened.split.partial
    found = torch.zeros(2, *table.shape)

    @cache
    def scores_of(fold, relation):
        model = scorer.whole if fold is None else scorer.left_out(fold)
        observed = partial if fold is None else make_folds(opened.split, FOLDS).triples([fold])
        self_edges = view.self_edges if relation == 0 else "keep"
        return scaled_table(model, relation, view.scale, self_edges=self_edges, observed=observed)

    for row, of_task in enumerate(folds):
        if len(of_task) > 1:
            continue
        (fold,) = of_task or {None}
        for source, (relation, key) in enumerate([(0, selection[row]), (1, goal[row])]):
            scores = scores_of(fold, relation)
            for slot, entity in enumerate(table[row].tolist()):
                if nothing not in (entity, int(key)):
                    found[source, row, slot] = scores[entity, key]
    return found


@pytest.mark.parametrize("kind", ["tables", "factors", "lists"])
@pytest.mark.parametrize(
    ("part", "depth", "scale"),
    [
        ("train", 1, "ranks"),
        pytest.param("train", 2, "standardise", marks=pytest.mark.slow),
        pytest.param("all", 1, "ranks", marks=pytest.mark.slow),
        pytest.param("all", 1, "standardise", marks=pytest.mark.slow),
        ("test", 1, "ranks"),
    ],
)
def test_every_task_is_scored_by_a_model_that_has_not_seen_its_recipes(
    opened, folder, recipes_folder, part, depth, kind, scale, monkeypatch
):
    view = ScoreView(scale, "observed", opened.split.partial)
    if kind != "tables":
        monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1)
        monkeypatch.setattr(registry, "TABLE_LIMIT", 1)
    # The lists of a recipe scorer score links when they are asked for.
    scorer = load_scorer(recipes_folder if kind == "lists" else folder)
    world = world_of(opened, part, depth, num_tasks=60)
    sources = make_sources(["u", "v"], scorer, view, tasks=None if part == "test" else world.tasks)
    folds = folds_of(world)
    if part == "all":
        assert {len(one) for one in folds} == {0, 1, 2}
    engine = BatchEngine(world, len(world.tasks))
    for _ in range(2):
        posed = engine.pose(np.arange(len(world.tasks)), seed=1)
        held, _ = engine.step_once(
            posed, np.zeros(len(world.tasks), dtype=np.int64)
        )  # something is in hand
        state = states_of(held)
        found = torch.stack([source(state) for source in sources])
        expected = expected_scores(opened, scorer, view, state, folds)
        # Ranks without a table are interpolated.
        atol = 0.01 if kind != "tables" and scale == "ranks" else 1e-4
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=atol)
    assert (part == "test") == (state.task is None)


def test_without_a_task_the_whole_model_answers(opened, scorer):
    """Without a task and for another one the model of all train recipes answers."""
    world = world_of(opened)
    (of_all,) = make_sources(["v"], scorer.whole)
    (source,) = make_sources(["v"], scorer, tasks=world.tasks)
    goal = torch.arange(20)
    state = States(goal, goal + 1, goal[:, None] + torch.arange(6))
    other = state._replace(task=torch.full((20,), len(world.tasks)))
    torch.testing.assert_close(source(state), of_all(state), rtol=0, atol=0)
    torch.testing.assert_close(source(other), of_all(state), rtol=0, atol=0)
    assert not torch.equal(source(state._replace(task=torch.arange(20))), of_all(state))
    assert of_all.reads_task is False
    of_all.bind(world.tasks)  # asks for nothing


def test_a_number_that_no_task_has_is_an_error_and_not_another_row(opened, scorer):
    world = world_of(opened)
    (source,) = make_sources(["v"], scorer, tasks=world.tasks)
    goal = torch.zeros(1, dtype=torch.int64)
    for number in (-1, len(world.tasks) + 1):
        with pytest.raises((IndexError, RuntimeError), match="index out of range"):
            source(States(goal, goal, goal[:, None], torch.tensor([number])))


def test_sources_without_tasks_serve_no_train_task(opened, scorer):
    world = world_of(opened)
    (source,) = make_sources(["v"], scorer)
    assert source.scores.ndim == 2
    goal = torch.zeros(1, dtype=torch.int64)
    source(States(goal, goal, goal[:, None]))
    with pytest.raises(LeakError):
        source(States(goal, goal, goal[:, None], goal))
    with refuses("tasks", LeakError):
        source.bind(world.tasks)
    with pytest.raises(LeakError):
        Evaluator(world)(knowledge_player([source]))
    Evaluator(world.variant(part="test"))(knowledge_player([source]))


def test_tasks_of_another_split_or_graph_are_refused(opened, scorer):
    other = OpenedGraph(opened.graph, make_split(opened.graph, SplitConfig(seed=1)), "kitchen")
    with pytest.raises(GraphMismatchError):
        make_sources(["u"], scorer, tasks=world_of(other).tasks)
    foreign = world_of(open_graph("everyday"))
    with pytest.raises(GraphMismatchError):
        make_sources(["u"], scorer, tasks=foreign.tasks)
    (source,) = make_sources(["u"], scorer, tasks=world_of(opened).tasks)
    with pytest.raises(GraphMismatchError):
        source.bind(foreign.tasks)


def test_a_model_that_has_seen_a_recipe_of_the_plan_is_never_asked(opened, scorer, monkeypatch):
    # Plant the fault: the rule says that another fold's model answers.
    monkeypatch.setattr(
        cross_fitting,
        "fold_of_tasks",
        lambda of_recipe, tasks: np.zeros(len(tasks), dtype=np.int64),
    )
    with pytest.raises(LeakError):
        models_of_tasks(scorer.of_recipe, world_of(opened).tasks)


def test_a_model_trained_on_other_triples_than_the_folds_say_is_not_used(opened, scorer):
    first, *others = scorer.record.folds
    changed = (msgspec.structs.replace(first, trained_on="0" * 64), *others)
    record = msgspec.structs.replace(scorer.record, folds=changed)
    swapped = CrossFitted(scorer.whole, [lambda: scorer.whole] * FOLDS, scorer.of_recipe, record)
    with pytest.raises(LeakError):
        make_sources(["u"], swapped, tasks=world_of(opened).tasks)


def guided(opened, scorer, world, **settings):
    config = PolicyConfig(**SMALL, **settings)
    partial = opened.split.partial
    return make_policy(
        config, opened.graph, world.num_slots, scorer=scorer, observed=partial, tasks=world.tasks
    )[0]


def impala_of(policy, world):
    """A trainer after one update."""
    impala = Impala(policy, BatchEngine(world, 8).reset(), ImpalaConfig(steps=64, batch_size=8))
    impala.update()
    return impala


def test_evaluations_and_training_bind_their_own_tasks(opened, scorer):
    """Evaluations bind the tasks that they play and training binds its own again."""
    world = world_of(opened)
    policy = guided(opened, scorer, world)
    deep, u = world.variant(depth=2, num_tasks=40), policy.sources["u"]
    impala = impala_of(policy, world)
    assert u.bound_to == world.tasks.hash
    Evaluator(deep, distractor_seeds=1)(PolicyPlayer(policy))
    assert u.bound_to == deep.tasks.hash
    assert u.model_of_task.tolist() == [*models_of_tasks(scorer.of_recipe, deep.tasks), 0]
    impala.update()
    assert u.bound_to == world.tasks.hash
    Evaluator(world.variant(part="test"), distractor_seeds=1)(PolicyPlayer(policy))
    assert u.bound_to == world.tasks.hash


def test_a_trainer_uses_for_a_task_what_the_source_says_of_it(opened, scorer):
    """What the policy scores while acting and learning is by task: without it another policy
    results."""
    world = world_of(opened)
    trained = []
    for settings in ({}, {"in_sample": True}):
        policy = impala_of(guided(opened, scorer, world, **settings), world).policy
        trained.append(torch.cat([parameter.flatten() for parameter in policy.parameters()]))
    assert not torch.equal(*trained)


def test_scripted_players_do_not_remember_the_recipes_of_train_tasks(opened, scorer):
    world = world_of(opened)
    kinds = (
        make_sources(["u", "v"], scorer, tasks=world.tasks),
        make_sources(["u", "v"], scorer.whole),
    )
    honest, memory = (
        Evaluator(world)(knowledge_player(sources)).success.mean() for sources in kinds
    )
    assert memory > honest + 0.1


@pytest.mark.parametrize("in_sample", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_run_on_memory_says_so(folder, tmp_path, caplog, in_sample):
    if not in_sample:
        config = ComplExConfig(dim=4, epochs=1, n3=0.1, folds=0)
        folder = train_links(LinksConfig("kitchen", config), tmp_path / "model").folder
    policy = PolicyConfig(**SMALL, in_sample=in_sample)
    trainer = ImpalaConfig(steps=64, batch_size=32, eval_every=0)
    done = train_agent(
        AgentConfig("kitchen", str(folder), policy=policy, trainer=trainer), tmp_path / "run"
    ).folder
    assert "scores for train tasks are in-sample" in caplog.text
    assert ("`in_sample` is set" if in_sample else "no folds") in caplog.text
    assert "cross_fitted" not in json.loads((done / "run.json").read_text())
    assert "the scores were in-sample" in (done / "README.md").read_text()
    assert not load_policy(done).reads_task


def test_a_scorer_without_seen_recipes_gives_no_warning(opened, tmp_path, caplog):
    """An agent with a scorer that has seen no recipe is not warned of memory."""
    scorer = FrequencyScorer(opened.graph, opened.split.partial)
    folder = save_scorer(tmp_path / "model", scorer, opened, kg="none")
    trainer = ImpalaConfig(steps=64, batch_size=32, eval_every=0)
    train_agent(
        AgentConfig("kitchen", str(folder), policy=PolicyConfig(**SMALL), trainer=trainer),
        tmp_path / "run",
    )
    card = (tmp_path / "run/README.md").read_text()
    assert "in-sample" not in caplog.text + card
    assert "a scorer trained on no recipes" in card


def test_in_sample_needs_a_scorer():
    with refuses("in_sample"):
        AgentConfig("kitchen", policy=PolicyConfig(in_sample=True))


def test_wrappers_give_the_scores_of_models_that_have_not_seen_the_task(opened, scorer):
    world = world_of(opened)
    sources = make_sources(["u", "v"], scorer, tasks=world.tasks)
    of_all = make_sources(["u", "v"], scorer.whole)
    env = KGScoreObservation(gym.make("WordCraft-v0", graph=world), sources)
    differ = False
    for seed in range(4):
        seen, _ = env.reset(seed=seed)
        state = [torch.as_tensor(np.atleast_1d(seen[key])) for key in ("goal", "selection")]
        state.append(torch.as_tensor(np.atleast_2d(seen["table"])))
        expected = sources[1](States(*state, torch.as_tensor([env.unwrapped.state.task])))
        np.testing.assert_array_equal(seen["v"], expected.numpy()[0])
        differ |= not np.array_equal(seen["v"], of_all[1](States(*state)).numpy()[0])
    assert differ


def test_a_wrapper_refuses_sources_that_cannot_be_honest_about_its_tasks(opened, scorer):
    world = world_of(opened)
    env = gym.make("WordCraft-v0", graph=world)
    with refuses("tasks", LeakError):
        KGScoreObservation(env, make_sources(["u", "v"], scorer))
    KGScoreObservation(
        gym.make("WordCraft-v0", graph=world.variant(part="test")), make_sources(["u", "v"], scorer)
    )
    other = OpenedGraph(opened.graph, make_split(opened.graph, SplitConfig(seed=1)), "kitchen")
    with pytest.raises(GraphMismatchError):
        KGScoreObservation(
            gym.make("WordCraft-v0", graph=world_of(other)),
            make_sources(["u"], scorer, tasks=world.tasks),
        )


@pytest.mark.parametrize("part", ["train", "test"])
def test_observations_can_have_the_number_of_the_task(opened, part):
    world = world_of(opened, part)
    number = len(world_of(opened).tasks)
    env = TaskObservation(gym.make("WordCraft-v0", graph=world))
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.observation_space["task"].n == number + 1
    assert seen["task"] == (env.unwrapped.state.task if part == "train" else number)
    assert env.action_masks().sum() == seen["action_mask"].sum()
