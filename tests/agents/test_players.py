"""Scripted players: what each knows decides how often it makes the goal."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from wordcraft_kg import (
    SplitConfig,
    WordCraftConfig,
    World,
    load_scorer,
    make_sources,
    make_split,
    open_graph,
)
from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.agent_training import AgentTraining
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer, play_all
from wordcraft_kg.agents.explanation import Explainer
from wordcraft_kg.agents.players import (
    fact_sources,
    fewest_uses,
    knowledge_players,
    nearest_words,
    pair_player,
    random_distinct,
    random_entity,
    recipe_oracle,
    scorer_players,
    words_player,
)
from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, LeakError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import load_policy, make_policy, save_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import FrequencyScorer, SymbolicScorer
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.features import glove_features, make_features
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge


def play(opened, players, distractors=(1,), distractor_seeds=5, **settings):
    world = World(opened, WordCraftConfig(**{"part": "test", **settings}))
    return play_all(world, players, distractors, distractor_seeds=distractor_seeds)


def success(table, player, distractors=1):
    (row,) = (row for row in table if (row.player, row.distractors) == (player, distractors))
    return row.success


def test_chance_is_what_it_should_be(opened):
    players = {"random": random_entity, "random, distinct": random_distinct}
    table = play_all(
        World(opened, WordCraftConfig(part="all")), players, (1,), distractor_seeds=40, seed=1
    )
    # Three entities on the table of a task of two ingredients, two of one: pairs in any order.
    starts = BatchEngine(World(opened, WordCraftConfig(part="all")), 1).world.tasks.starts
    selfs = float(np.mean(starts[:, 1] == opened.graph.num_entities))
    expected = (1 - selfs) * 2 / 9 + selfs / 4
    assert success(table, "random") == pytest.approx(expected, abs=0.02)
    assert success(table, "random, distinct") == pytest.approx((1 - selfs) / 3, abs=0.02)


def test_the_two_nearest_words_are_chosen_without_a_graph_or_training(opened):
    vectors, size = glove_features(opened.graph.entities).unit_vectors, opened.graph.num_entities
    checked = []

    def both(state, rng):
        slots = nearest(state, rng)
        for goal, selection, table, slot in zip(
            state.goal, state.selection, state.table, slots, strict=True
        ):
            others = list(set(table.tolist()) - {size, selection}) or [selection]
            best = max(float(vectors[goal] @ vectors[entity]) for entity in others)
            checked.append(
                float(vectors[goal] @ vectors[table[slot]]) == pytest.approx(best, abs=1e-6)
            )
        return slots

    nearest = nearest_words(vectors)
    table = play(opened, {"nearest": both, "random, distinct": random_distinct}, (1, 8))
    assert all(checked)
    assert success(table, "nearest", 8) > success(table, "random, distinct", 8)


def test_words_beside_a_scorer_are_its_own_and_otherwise_the_best_built_in(opened):
    """The row names the vectors."""
    graph = opened.graph
    glove = glove_features(graph.entities).unit_vectors
    best = make_features("minilm", graph.entities).unit_vectors
    others = np.roll(glove, 1, axis=0)
    state = BatchEngine(World(opened, WordCraftConfig(part="test")), 40).reset(0)
    for vectors, name, expected in (
        (None, "minilm", best),
        (np.zeros((graph.num_entities, 0)), "minilm", best),
        (best, "minilm", best),
        (glove, "glove", glove),
        (others, "the scorer's vectors", others),
    ):
        knowledge = None
        if vectors is not None:
            rounded = vectors.astype(np.float16)
            near = np.zeros((graph.num_entities, 0), dtype=np.int32)
            knowledge = RecipeKnowledge.of_recipes(opened.split.recipes("train"), rounded, near)
        ((row, player),) = words_player(graph, knowledge).items()
        assert row == f"nearest words ({name})"
        rounded = expected.astype(np.float16).astype(np.float32)
        same = nearest_words(expected if knowledge is None else rounded)
        chosen = [each(state, np.random.default_rng(0)) for each in (player, same)]
        np.testing.assert_array_equal(*chosen)


def test_train_uses_count_recipes_with_an_ingredient_and_weigh_distractors(opened):
    pairs = opened.split.recipes("train")[:, :2]
    uses = [int((pairs == entity).any(axis=1).sum()) for entity in range(opened.graph.num_entities)]
    assert opened.split.train_uses.tolist() == uses
    assert (pairs[:, 0] == pairs[:, 1]).any()  # a pair of one entity counts once
    weights = World(opened, WordCraftConfig(distractor_weighting="use")).distractor_weights
    assert weights.tolist() == [1 + number for number in uses]


def test_rare_items_are_a_shortcut_where_distractors_are_drawn_by_use():
    """Recipes are random, so nothing but the draw of distractors can help a player that ignores the
    goal."""
    rng = np.random.default_rng(0)
    pairs = sorted({(int(min(pair)), int(max(pair))) for pair in rng.integers(800, size=(1600, 2))})
    recipes = [(f"e{a}", f"e{b}", f"made {rng.integers(60)}") for a, b in pairs]
    graph = RecipeGraph.from_recipes(recipes)
    opened = OpenedGraph(graph, make_split(graph, SplitConfig("by-recipe-plain")), "random book")
    players = {"fewest uses": fewest_uses(opened.split), "random": random_distinct}
    rates = {
        weighting: {
            row.player: row.success
            for row in play(opened, players, (8,), 10, distractor_weighting=weighting)
        }
        for weighting in ("use", "uniform")
    }
    assert rates["use"]["fewest uses"] > 2 * rates["use"]["random"]
    assert rates["uniform"]["fewest uses"] < 1.2 * rates["uniform"]["random"]


@pytest.mark.parametrize("cells", [1, 40, 1_000_000])
def test_the_pair_player_picks_a_best_pair_in_any_chunks(opened, monkeypatch, cells):
    """The pair player picks a best pair of the table whatever is scored at a time."""
    monkeypatch.setattr("wordcraft_kg.agents.players.CELLS", cells)
    graph, world = opened.graph, World(opened, WordCraftConfig(part="test", num_distractors=3))
    scores = torch.rand((graph.num_entities,) * 3, generator=torch.Generator().manual_seed(0))
    scores = (scores + scores.transpose(0, 1)) / 2
    engine = BatchEngine(world, 50)
    state = engine.pose(np.arange(50))
    table, goals = state.table, state.goal.tolist()
    player, rng = pair_player(lambda a, b, c: scores[a, b, c]), np.random.default_rng(0)
    actions = []
    for _ in range(2):
        slots = player(state, rng)
        actions.append(table[np.arange(50), slots].tolist())
        state, _ = engine.step_once(state, slots)
    for row, goal, one, other in zip(table.tolist(), goals, *actions, strict=True):
        there = [entity for entity in row if entity != graph.num_entities]
        assert float(scores[one, other, goal]) == max(
            float(scores[a, b, goal]) for a in there for b in there
        )


def test_two_entities_come_before_an_equal_pair_with_itself(opened):
    """A pair of two entities comes before one of the same score with itself."""
    indifferent = pair_player(
        lambda a, b, c: torch.zeros(torch.broadcast_shapes(a.shape, b.shape, c.shape))
    )
    players = {"indifferent": indifferent, "random, distinct": random_distinct}
    table = play(opened, players, distractor_seeds=40, part="all")
    assert success(table, "indifferent") == pytest.approx(
        success(table, "random, distinct"), abs=0.02
    )


def test_votes_beat_chance_only_where_the_goal_has_train_recipes(opened):
    """Votes make more goals than chance and no more where no slot of the goal is known."""
    by_slot = make_split(opened.graph, SplitConfig("by-slot"))
    rates = []
    for split in (opened.split, by_slot):
        players = {
            name: knowledge_players(split)[name]
            for name in ("partial KG, votes", "random, distinct")
        }
        table = play(OpenedGraph(opened.graph, split, "kitchen"), players, distractor_seeds=20)
        rates.append([success(table, name) for name in players])
    (by_recipe, chance), (without, same) = rates
    assert by_recipe > chance + 0.2
    assert without == pytest.approx(same, abs=0.05)


def test_a_scorers_players_take_its_scores_on_a_common_scale(opened):
    graph = opened.graph
    scorer = FrequencyScorer(graph, opened.split.partial)
    louder = TableScorer(
        torch.stack([100 * scorer.table(0), scorer.table(1)]), graph.entities, graph.hash
    )
    plain, scaled = (
        scorer_players(graph, kind, graph.triples)["u+v, self edges kept"]
        for kind in (scorer, louder)
    )
    table = play(opened, {"plain": plain, "louder": scaled}, (4,), distractor_seeds=3)
    assert success(table, "plain", 4) == success(table, "louder", 4)


@pytest.mark.slow
def test_a_scorer_of_recipes_plays_the_pair_whose_recipe_scores_highest(opened, recipes_folder):
    scorer = load_scorer(recipes_folder)
    players = scorer_players(opened.graph, scorer, opened.split.partial)
    pairs = pair_player(whole_of(scorer).score_recipes)
    table = play(
        opened, {"by pairs": pairs, "w": players["w, best pair"]}, (1, 8), distractor_seeds=3
    )
    for distractors in (1, 8):
        assert success(table, "w", distractors) == pytest.approx(
            success(table, "by pairs", distractors), abs=0.02
        )
    assert success(table, "w", 8) > 0.5
    with pytest.raises(LeakError):
        play(opened, {"w": players["w, best pair"]}, part="train")
    links = SymbolicScorer(opened.graph, opened.split.partial)
    assert "w, best pair" not in scorer_players(opened.graph, links, opened.split.partial)


@pytest.mark.parametrize("known", [0, 1, 400, 10_000])
def test_facts_score_slots_like_tables_of_all_pairs_do(opened, known):
    graph, rng = opened.graph, np.random.default_rng(known)
    triples = rng.permutation(graph.triples)[:known]
    # Ids up to that of nothing, which no fact is about.
    goal, selection, *table = torch.tensor(rng.integers(0, graph.num_entities + 1, (7, 5_000)))
    slots = torch.stack(table, dim=1)
    dense = make_sources(("u", "v"), SymbolicScorer(graph, triples))
    for expected, found in zip(dense, fact_sources(graph, triples).values(), strict=True):
        torch.testing.assert_close(
            found(States(goal, selection, slots)), expected(States(goal, selection, slots))
        )


def test_a_foreign_scorer_is_refused(opened):
    other = open_graph("paper-examples").graph
    with pytest.raises(GraphMismatchError):
        scorer_players(opened.graph, FrequencyScorer(other, other.triples), opened.graph.triples)


FIGURES = (
    ("recipe oracle", 1, 1.0),
    ("full KG, v", 1, 0.529),
    ("full KG, u", 8, 0.117),
    ("full KG, u+v", 1, 0.803),
    ("full KG, u+v", 8, 0.779),
    ("full KG, u+v, no self edges", 1, 0.995),
    ("full KG, u+v, no self edges", 8, 0.963),
    ("full KG, best pair", 8, 0.979),
)


@pytest.mark.parametrize(("player", "distractors", "expected"), FIGURES)
def test_little_alchemy_2_gives_the_reference_figures(alchemy_table, player, distractors, expected):
    # One split of 653 tasks, five tables each: a standard error of up to .009 around the mean of
    # five splits.
    assert success(alchemy_table, player, distractors) == pytest.approx(expected, abs=0.025)


@pytest.fixture(scope="module")
def alchemy_table(alchemy_path):
    opened = open_graph(alchemy_path)
    players = knowledge_players(opened.split)
    return play(opened, {name: players[name] for name, _, _ in FIGURES}, (1, 8))


ENTITIES, RECIPES = 12_000, 36_000

ALL_PAIRS = ENTITIES**2 * 4 / 2**20
"""MiB of a table of all pairs, 4 bytes a cell."""

COMMANDS = (
    ("describe",),
    ("discover", "--attempts", "5", "--runs", "1"),
    ("evaluate-agent", "--distractors", "1", "--distractor-seeds", "1"),
    ("describe", "--tasks", "--depth", "2", "--distractors", "4"),
)

MEASURE = """
import resource, sys
import pandas, torch
import wordcraft_kg.agents.discovery, wordcraft_kg.envs.wordcraft, wordcraft_kg.evaluation.agents
from wordcraft_kg.cli import main

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10

before = peak()
for command, *options in eval(sys.argv[2]):
    code = main([command, sys.argv[1], *options, "--quiet"])
    print(command, code, peak() - before, file=sys.stderr)
"""


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """A book in which each thing is made by three pairs of earlier things."""
    rng = np.random.default_rng(0)
    results = np.repeat(np.arange(10, ENTITIES), 3)[:RECIPES]
    parts = (rng.random((len(results), 2)) * results[:, None]).astype(int)
    path = tmp_path_factory.mktemp("books") / "large.csv"
    lines = [
        f"t{a},t{b},t{result}\n"
        for (a, b), result in zip(parts.tolist(), results.tolist(), strict=True)
    ]
    head = (
        "# base: "
        f"{', '.join(f't{entity}' for entity in range(10))}\ningredient_a,ingredient_b,result\n"
    )
    path.write_text("".join([head, *lines]), encoding="utf-8")
    return path


@pytest.mark.slow
def test_memory_does_not_grow_with_the_square_of_the_entities(book):
    outcome = subprocess.run(
        [sys.executable, "-c", MEASURE, str(book), repr(COMMANDS)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    lines = [line.split() for line in outcome.stderr.splitlines()]
    assert [(name, code) for name, code, _ in lines] == [(command[0], "0") for command in COMMANDS]
    for name, _, growth in lines:
        assert float(growth) < ALL_PAIRS, name


BOOK = "examples/kitchen-sets.csv"


@pytest.fixture(scope="module")
def world():
    return World.open(BOOK, WordCraftConfig(part="all", num_distractors=2))


@pytest.fixture(scope="module")
def policy(world):
    graph = world.graph
    scorer = SymbolicScorer(graph, graph.triples)
    config = PolicyConfig(use="u,v", self_edges="keep", sees_attempts=True, features="random")
    policy, _ = make_policy(config, graph, world.num_slots, scorer=scorer)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():  # zeros say nothing
        for parameter in policy.combine.parameters():
            parameter.normal_(generator=generator)
    return policy.eval()


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_the_oracle_makes_every_goal(world, depth):
    variant = world.variant(depth=depth, num_distractors=1)
    evaluation = Evaluator(variant, distractor_seeds=1)(recipe_oracle)
    assert evaluation.success.all()
    assert evaluation.by_plan.all()


def test_the_order_of_selections_and_slots_changes_no_decision(world, policy):
    engine = BatchEngine(world, 64)
    state = engine.reset(0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        state, _ = engine.step(state, state.random_actions(rng.random(64)))
    states = states_of(state)
    assert (states.num_selected(policy.num_entities) > 2).any()
    output = policy(states)
    picks = np.sort(states.selection.numpy(), axis=1)  # the padding stays behind
    assert (picks != states.selection.numpy()).any()
    turned = policy(states._replace(selection=torch.from_numpy(picks)))
    torch.testing.assert_close(turned.logits, output.logits)
    slots = np.append(rng.permutation(engine.num_slots - 1), engine.num_slots - 1)
    moved = policy(states._replace(table=states.table[:, slots]))
    torch.testing.assert_close(moved.logits, output.logits[:, slots])
    mask = torch.from_numpy(state.action_masks())
    assert ((output.logits > -torch.inf) == mask).all()


def test_u_is_the_mean_over_the_selected_entities(world, policy):
    source = policy.sources["u"]
    graph = world.graph
    table = torch.arange(8)[None]
    nothing = graph.num_entities
    goal = torch.tensor([0])
    pairs = [
        source(States(goal, torch.tensor([entity]), table)) for entity in (5, graph.id_of("flour"))
    ]
    selection = torch.tensor([[5, graph.id_of("flour"), nothing, nothing, nothing, nothing]])
    means = source(States(goal, selection, table))
    torch.testing.assert_close(means[:, :7], (pairs[0] + pairs[1])[:, :7] / 2)
    empty = source(States(goal, torch.full_like(selection, nothing), table))
    assert not empty.any()


def test_a_policy_for_sets_is_saved_and_acts_by_label(world, policy, tmp_path):
    loaded = load_policy(save_policy(tmp_path / "policy", policy))
    results = [
        Evaluator(world, distractor_seeds=1)(PolicyPlayer(player)).decisions
        for player in (policy, loaded)
    ]
    np.testing.assert_array_equal(*results)
    action = loaded.act("stew", ["carrot", "pork"], ["carrot", "pork"])
    assert action.entity in ("carrot", "pork", "")
    assert (action.entity == "") == (action.slot == 2)
    with pytest.raises(ConfigError, match="fewer than 6 entities"):
        loaded.act("stew", ["carrot"], 6 * ["carrot"])


def test_an_explanation_adds_up_and_names_the_action_to_combine(world, policy):
    explainer = Explainer(policy, world)
    for task in range(0, len(world.tasks), 10):
        shown = explainer.task(task)
        for step in shown.episode.steps:
            assert sum(slot.probability for slot in step.slots) == pytest.approx(1)
            assert ("" in [slot.entity for slot in step.slots]) == (step.selection is not None)
            for slot in step.slots:
                assert sum(slot.contributions.values()) == pytest.approx(slot.logit, abs=1e-9)
        played = Evaluator(world, distractor_seeds=1)(PolicyPlayer(policy))
        assert len(shown.episode.steps) == played.actions[task, 0]
    begun = explainer.table("stew", ["carrot", "pork", "potato"], ["carrot", "pork"])
    assert begun.episode.steps[0].selection == "carrot + pork"


@pytest.mark.parametrize("kind", ["pairs", "mlp"])
def test_policies_of_pairs_refuse_sets(world, kind):
    with pytest.raises(ConfigError, match="Choose `policy` attention"):
        make_policy(PolicyConfig(policy=kind, features="random"), world.graph, world.num_slots)


def test_a_training_on_sets_takes_attention_and_long_unrolls_by_itself(caplog):
    opened = open_graph(BOOK)
    config = AgentTraining.settled(AgentConfig(BOOK, tasks=TaskConfig(max_attempts=2)), opened)
    assert "attention in place of pairs" in caplog.text
    assert (config.policy.policy, config.trainer.unroll) == ("attention", 12)
    given = AgentConfig(BOOK, trainer=ImpalaConfig(unroll=3, batch_size=8))
    settled = AgentTraining.settled(given, opened)
    assert (settled.trainer.unroll, settled.trainer.batch_size) == (3, 8)
    pairs = AgentConfig("kitchen")
    assert AgentTraining.settled(pairs, open_graph("kitchen")) is pairs
