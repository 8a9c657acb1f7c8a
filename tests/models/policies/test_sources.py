"""Sources: u and v of slots against one question to the scorer each, and sources of other kinds."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from helpers import refuses
from small_scorers import BareScorer, scaled_scorer, states as states_of

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg import plugins
from wordcraft_kg.agents import states as engine_states
from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.agents.agent_training import train_agent
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.envs.wrappers import KGScoreObservation
from wordcraft_kg.graphs import OUTSIDE, RELATIONS
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.policies.policy_folder import load_policy
from wordcraft_kg.models.policies.sources import (
    ALPHA,
    label_of,
    registry,
    shown_setting,
    source_names,
)
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.policies.sources.registry import (
    make_sources,
    source_class,
)
from wordcraft_kg.models.policies.sources.source import ScoreView
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import NeighbourScorer
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer

SIZE = 6

NOTHING = SIZE

any_sources = pytest.mark.parametrize("names", [("u",), ("v",), ("u", "v")], ids=",".join)

SCORER = BareScorer(SIZE)


def knowledge_of(names, scorer=SCORER):
    """Return a function of states that gives the scores of all sources, shape (B, S, A)."""
    sources = make_sources(names, scorer)
    return lambda *state: torch.stack([source(States(*state)) for source in sources], dim=1)


def states(size=7, num_slots=4):
    """Goals, selections that differ from row to row and are sometimes nothing, and tables with
    empty slots."""
    goal = torch.arange(size) % SIZE
    selection = (torch.arange(size) * 2 + 1) % (SIZE + 1)
    table = torch.randint(SIZE + 1, (size, num_slots), generator=torch.Generator().manual_seed(0))
    assert {NOTHING} < set(selection.tolist())
    assert (table == NOTHING).any()
    return goal, selection, table


def slow_scores(names, goal, selection, table):
    """``u_i = L(e_i, combinesWith, e_s)`` and ``v_i = L(e_i, componentOf, e_g)``, one question for
    each slot."""

    def ask(entity, relation, other):
        return 0.0 if NOTHING in (entity, other) else SCORER.score(entity, relation, other).item()

    keys = {"u": ("combinesWith", selection.tolist()), "v": ("componentOf", goal.tolist())}
    return [
        [
            [ask(entity, relation, key[i]) for entity in row]
            for relation, key in (keys[name] for name in names)
        ]
        for i, row in enumerate(table.tolist())
    ]


@any_sources
def test_u_and_v_score_slots_with_selection_and_goal(names):
    """U and v are the scores of each slot with the selection and with the goal."""
    assert isinstance(SCORER, TripleScorer)
    assert not any(
        torch.allclose(SCORER.table(relation), SCORER.table(relation).T) for relation in RELATIONS
    )
    found = knowledge_of(names)(*states())
    assert (found.shape, found.dtype) == ((7, len(names), 4), torch.float32)
    assert torch.equal(found, torch.tensor(slow_scores(names, *states())))


@pytest.mark.parametrize("scale", ["standardise", "ranks", "none"])
@pytest.mark.parametrize("self_edges", ["keep", "drop"])
def test_a_policy_sees_exactly_the_scores_that_observations_show(kitchen, scale, self_edges):
    scorer = NeighbourScorer(kitchen, kitchen.triples[::2])
    sources = make_sources(["u", "v"], scorer, ScoreView(scale, self_edges))
    settings = {"graph": "kitchen", "part": "all", "depth": 2, "num_distractors": 3}
    env = KGScoreObservation(gym.make("WordCraft-v0", **settings), sources)
    knowledge = knowledge_of(["u", "v"], scaled_scorer(scorer, scale=scale, self_edges=self_edges))
    rng = np.random.default_rng(0)
    seen, _ = env.reset(seed=0)
    held, empty = 0, 0
    for _ in range(40):
        state = [
            torch.as_tensor(np.asarray(seen[key]))[None] for key in ("goal", "selection", "table")
        ]
        u, v = knowledge(*state)[0].numpy()
        np.testing.assert_array_equal(u, seen["u"])
        np.testing.assert_array_equal(v, seen["v"])
        held += bool(u.any())
        empty += bool((state[-1] == kitchen.num_entities).any())
        seen, _, over, *_ = env.step(int(rng.choice(np.flatnonzero(seen["action_mask"]))))
        if over:
            seen, _ = env.reset()
    assert min(held, empty) > 0


def test_scores_are_constants_even_if_the_scorer_is_being_trained():
    assert SCORER.table("combinesWith").requires_grad
    for source in make_sources(["u", "v"], SCORER):
        assert list(source.parameters()) == []
        assert list(source.state_dict()) == ["scores"]
        assert not source(States(*states())).requires_grad


@any_sources
def test_tables_that_would_not_fit_are_refused_before_the_scorer_is_asked(names, monkeypatch):
    needed = len(names) * (SIZE + 1) ** 2 * 4
    monkeypatch.setattr(registry, "TABLE_LIMIT", needed)
    make_sources(names, SCORER)
    monkeypatch.setattr(registry, "TABLE_LIMIT", needed - 1)
    monkeypatch.setattr(BareScorer, "table", None)
    with pytest.raises(ConfigError, match="score tables for 6 entities take"):
        make_sources(names, SCORER)


class Factored(BareScorer):
    """Scores that are a matrix product."""

    def factors(self, relation):
        left, singular, right = torch.linalg.svd(self.table(relation).detach().double())
        return (left * singular).float(), right.T.float()


@pytest.fixture
def no_tables(monkeypatch):
    monkeypatch.setattr(registry, "TABLE_LIMIT", 1)


@any_sources
@pytest.mark.parametrize("scale", ["standardise", "none"])
@pytest.mark.parametrize("self_edges", ["keep", "observed", "drop"])
def test_sources_of_factors_score_like_tables_and_nothing_scores_zero(
    names, scale, self_edges, monkeypatch
):
    view = ScoreView(scale, self_edges, np.array([[1, 0, 1]]))
    everything = torch.arange(SIZE + 1)
    goal, held, slot = torch.cartesian_prod(everything[:-1], everything, everything).T
    state = goal, held, torch.stack([slot, held], dim=1)
    tables = make_sources(names, Factored(SIZE), view)
    monkeypatch.setattr(registry, "TABLE_LIMIT", 1)
    for table, factors in zip(tables, make_sources(names, Factored(SIZE), view), strict=True):
        assert "scores" not in factors.state_dict()
        torch.testing.assert_close(
            factors(States(*state)), table(States(*state)), atol=1e-5, rtol=1e-4
        )
        assert not factors(States(*state))[state[2] == NOTHING].any()


@pytest.mark.parametrize("by_factors", [False, True])
@pytest.mark.parametrize("scale", ["standardise", "ranks"])
@pytest.mark.parametrize("name", ["u", "v"])  # w's is among the tests of recipe scorers
def test_a_source_is_restored_from_its_constants(name, scale, by_factors, monkeypatch):
    if by_factors:
        monkeypatch.setattr(registry, "TABLE_LIMIT", 1)
    (full,) = make_sources([name], Factored(SIZE), ScoreView(scale, "drop"))
    constants = full.state_dict()
    restored = source_class(name).restored(SIZE, constants)
    assert ("scores" in constants) is not by_factors
    assert torch.equal(restored(States(*states())), full(States(*states())))


def test_a_scale_without_a_fitting_table_names_those_that_do(
    no_tables,
):
    """A scale that needs a table is refused where none fits and names the scales that do."""
    with refuses("scale"):
        make_sources(["u", "v"], Factored(SIZE), ScoreView("log-softmax"))


def test_sources_that_do_not_fit_are_refused_before_a_folder_is_made(folded, tmp_path, no_tables):
    with pytest.raises(ConfigError, match="score table"):
        train_agent(AgentConfig("kitchen", str(folded)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_agent_learns_with_factors_and_its_policy_comes_back(
    folded, tmp_path, no_tables, monkeypatch
):
    monkeypatch.setattr("wordcraft_kg.models.scorers.score_limits.TABLE_LIMIT", 1)
    policy = PolicyConfig(scale="standardise")
    config = AgentConfig("kitchen", str(folded), TaskConfig(), policy, ImpalaConfig(steps=512))
    trained = train_agent(config, tmp_path / "run")
    loaded = load_policy(trained.folder)
    buffers = {"left", "right", "shift", "dropped", "itself", "fold_of_recipe"}
    assert set(loaded.sources["u"].state_dict()) == buffers


def test_spelled_settings_are_stored_by_letter():
    """Settings with names for people are stored by letter and shown with both."""
    policy = PolicyConfig(use="recipe, u")
    assert policy.use == "w,u"
    assert policy.sources == ("u", "w")
    config = AgentConfig("kitchen", "models/kitchen", policy=policy)
    assert config.values()["use"] == "w,u"
    assert shown_setting("use", "w,u") == "recipe (w), combines (u)"
    assert shown_setting("scale", "w") == "w"
    # The default is spelled, and no difference.
    assert PolicyConfig().use == PolicyConfig(use="u,v").use == "u,v"
    assert "use" not in AgentConfig("kitchen").differing()


def test_an_unknown_name_of_a_source_gets_both_names_and_a_hint():
    with pytest.raises(ConfigError, match=r"combines \(u\).*plan \(p\).*mean 'recipe'"):
        PolicyConfig(use="u,recipes")


def test_every_source_has_a_label_of_its_own_name_and_symbol():
    labels = [label_of(name) for name in (ALPHA.name, *source_names())]
    assert [label.name for label in labels] == [ALPHA.name, *source_names()]
    assert len({label.symbol for label in labels}) == len(labels)
    assert [label.coefficient for label in labels][:3] == ["λα", "λu", "λv"]


@pytest.mark.parametrize("name", ["alpha", "u", "w", "combines", "plan"])
def test_a_source_may_not_take_the_name_of_one_that_is_built_in(name):
    with pytest.raises(ConfigError, match="built in"):
        plugins.source(name)(type("Other", (BestRecipe,), {}))
    with pytest.raises(ConfigError, match=r"combines \(u\), component \(v\), recipe \(w\)"):
        source_class("nowhere")


def test_sources_of_other_graphs_are_known_by_their_hash():
    assert {source.graph_hash for source in make_sources(["u", "v"], SCORER)} == {SCORER.graph_hash}


@pytest.fixture(scope="module")
def scorer_of_recipe_source(cross_fitted):
    return cross_fitted.whole


@pytest.fixture(scope="module")
def w(scorer_of_recipe_source):
    (source,) = make_sources(["w"], scorer_of_recipe_source)
    return source


def states_of_recipe_source(size, rows=40):
    """States in which the entity held is often on the table."""
    goal, selection, table = states_of(size, rows, 6)
    table[:, 4:] = torch.where(torch.arange(rows)[:, None] % 3 == 0, size, table[:, 4:])
    selection[::4] = table[::4, 2]
    return goal, selection, table


def slow_w(scorer_of_recipe_source, goal, held, table):
    """W by its definition, slot by slot; empty slots have 0."""
    size = len(scorer_of_recipe_source.entities)
    partners = [held] if held != size else [entity for entity in table if entity != size]
    return [
        0.0
        if entity == size
        else float(scorer_of_recipe_source.score_recipes(entity, partners, goal).max())
        for entity in table
    ]


def test_w_is_the_score_with_the_entity_held_or_with_the_best_partner(w, scorer_of_recipe_source):
    goal, selection, table = states_of_recipe_source(w.num_entities)
    found = w(States(goal, selection, table))
    for row in range(len(goal)):
        expected = slow_w(
            scorer_of_recipe_source, int(goal[row]), int(selection[row]), table[row].tolist()
        )
        torch.testing.assert_close(found[row], torch.tensor(expected), rtol=1e-4, atol=1e-4)
        single = w(States(goal[row : row + 1], selection[row : row + 1], table[row : row + 1]))
        torch.testing.assert_close(single[0], found[row], rtol=1e-4, atol=1e-4)


def test_the_scores_that_are_kept_do_not_answer_for_another_state(scorer_of_recipe_source):
    (kept,) = make_sources(["w"], scorer_of_recipe_source)
    goal, selection, table = states_of_recipe_source(kept.num_entities)
    first = kept(States(goal, selection, table))
    changed = table.clone()
    changed[:, 0] = (changed[:, 0] + 1) % kept.num_entities
    (fresh,) = make_sources(["w"], scorer_of_recipe_source)
    torch.testing.assert_close(
        kept(States(goal, selection, changed)),
        fresh(States(goal, selection, changed)),
        rtol=0,
        atol=0,
    )
    torch.testing.assert_close(kept(States(goal, selection, table)), first, rtol=0, atol=0)
    table[:, 0] = changed[:, 0]  # in place, as an engine does
    torch.testing.assert_close(
        kept(States(goal, selection, table)), fresh(States(goal, selection, table)), rtol=0, atol=0
    )


def test_train_tasks_have_w_and_evidence_out_of_sample(cross_fitted, opened):
    """Train tasks have w and evidence of the scorer without their recipes."""
    world = World(opened, WordCraftConfig(part="all", num_distractors=3))
    (source,) = make_sources(["w"], cross_fitted, tasks=world.tasks)
    state = engine_states.states_of(
        BatchEngine(world, len(world.tasks)).pose(np.arange(len(world.tasks)))
    )
    found = source(state)
    seen = set()
    for row in range(0, len(world.tasks), 8):
        folds = {
            int(cross_fitted.of_recipe[step]) for plan in world.tasks.plans[row] for step in plan
        } - {OUTSIDE}
        one = state.rows(row, row + 1)
        evidence = source.evidence(one)
        seen.add(len(folds))
        if len(folds) > 1:  # every model has seen one of its recipes
            assert not found[row].any()
            assert evidence == (None,) * len(evidence)
            continue
        model = cross_fitted.left_out(*folds) if folds else cross_fitted.whole
        assert isinstance(model, RecipeScorer)
        table = one.table[0].tolist()
        expected = slow_w(model, int(one.goal), source.num_entities, table)
        torch.testing.assert_close(found[row], torch.tensor(expected), rtol=1e-4, atol=1e-4)
        plans = {tuple(opened.graph.recipes[plan[-1]].tolist()) for plan in world.tasks.plans[row]}
        for slot, entity in enumerate(table):
            told = evidence[slot]
            assert (told is None) == (entity == source.num_entities)
            if told is None:
                continue
            score = float(model.score_recipes(entity, told.partner, int(one.goal)))
            assert score == pytest.approx(expected[slot], abs=1e-3)
            labels = [model.entities[part] for part in (entity, told.partner, int(one.goal))]
            spoken = [
                tuple(model.entities[part] for part in supporting.recipe)
                for supporting in told.supporting
            ]
            assert spoken == [
                tuple(witness.recipe) for witness in model.supporting_recipes(*labels, limit=3)
            ]
            assert not plans & {supporting.recipe for supporting in told.supporting}
    assert seen == {0, 1, 2}


def test_the_partner_of_a_slot_is_the_entity_held(w):
    nothing = w.num_entities
    goal, selection, table = (
        torch.tensor([7]),
        torch.tensor([3]),
        torch.tensor([[3, 4, nothing, 5]]),
    )
    evidence = w.evidence(States(goal, selection, table))
    assert [told and told.partner for told in evidence] == [3, 3, None, 3]
    assert all(len(told.supporting) <= 3 for told in evidence if told)


def test_sources_of_links_have_no_evidence_and_a_scorer_of_links_has_no_w(scorer_of_recipe_source):
    links = TableScorer(
        torch.stack([scorer_of_recipe_source.table(0), scorer_of_recipe_source.table(1)]),
        scorer_of_recipe_source.entities,
        scorer_of_recipe_source.graph_hash,
        name="links",
    )
    (v,) = make_sources(["v"], links)
    goal, selection, table = states_of_recipe_source(v.num_entities, rows=1)
    assert v.evidence(States(goal, selection, table)) == (None,) * 6
    with pytest.raises(ConfigError, match="needs recipe scores"):
        BestRecipe.of_scorer(links, None)
