"""Asking a policy what to pick, by labels, and saving it from a program."""

import json
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
import torch
from helpers import refuses
from link_helpers import flip_bit, random_graph
from small_scorers import states as states_of

from wordcraft_kg import PolicyConfig, make_sources
from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    OutputExistsError,
    UnknownEntityError,
)
from wordcraft_kg.models.policies.networks import AttentionPolicy
from wordcraft_kg.models.policies.policy import EntityVectors
from wordcraft_kg.models.policies.policy_folder import load_policy, make_policy, save_policy
from wordcraft_kg.models.policies.sources import source as room
from wordcraft_kg.models.policies.sources.source import KeptScores, ScoreView
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

GRAPH = random_graph(num_entities=8, num_recipes=20)

GOAL, HELD, *TABLE = GRAPH.entities[:6]


def policy_of(kind="attention", *, guided=False):
    config = PolicyConfig(policy=kind, features="random", key_size=5, value_size=4, hidden_size=6)
    scorer = FrequencyScorer(GRAPH, GRAPH.triples) if guided else None
    return make_policy(config, GRAPH, 4, scorer=scorer, observed=GRAPH.triples)[0]


@pytest.fixture(params=["attention", "guided", "mlp"])
def policy(request):
    return policy_of(
        "mlp" if request.param == "mlp" else "attention", guided=request.param == "guided"
    )


def probabilities(policy, goal, selection, table):
    output = policy(States(torch.tensor([goal]), torch.tensor([selection]), torch.tensor([table])))
    return torch.softmax(output.logits[0], dim=0).tolist()


def test_a_greedy_pick_is_the_most_probable_slot_of_the_same_state_in_ids(policy):
    for held in (None, *range(len(GRAPH.entities))):
        expected = probabilities(
            policy, 0, GRAPH.num_entities if held is None else held, [2, 3, 4, 5]
        )
        pick = policy.act(GOAL, TABLE, None if held is None else GRAPH.entities[held])
        assert pick.slot == max(range(4), key=expected.__getitem__)
        assert pick.entity == TABLE[pick.slot]
        assert pick.probability == pytest.approx(expected[pick.slot])
    assert policy.act(0, [2, 3, 4, 5], 1) == policy.act(GOAL, TABLE, HELD)


def test_with_a_generator_slots_are_drawn_by_their_probabilities():
    policy, draw = policy_of(), torch.Generator().manual_seed(0)
    with torch.no_grad():
        policy.attention.query.weight.mul_(30)  # far from uniform
    expected = torch.tensor(probabilities(policy, 0, 1, [2, 3, 4, 5]))
    assert expected.max() > 2 * expected.min()
    slots = [policy.act(GOAL, TABLE, HELD, generator=draw).slot for _ in range(600)]
    drawn = torch.bincount(torch.tensor(slots), minlength=4)
    assert (drawn / 600 - expected).abs().max() < 0.07


UNKNOWN = [
    ((GOAL, ["e1x", *TABLE[:3]]), "'e1'"),
    ((8, TABLE), "0 .. 7"),
    ((GOAL, TABLE, -1), "entity -1"),
]


@pytest.mark.parametrize(("state", "fragment"), UNKNOWN)
def test_unknown_entities_are_errors_with_the_nearest_labels(policy, state, fragment):
    with pytest.raises(UnknownEntityError, match=fragment):
        policy.act(*state)


@pytest.mark.parametrize("table", [[], [None], [None, None, None, None]])
def test_a_table_without_anything_is_refused(table):
    with refuses("table"):
        policy_of().act(GOAL, table)


def test_a_saved_policy_loads_with_the_same_bits_and_labels(policy, tmp_path):
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(0.1)
    loaded = load_policy(save_policy(tmp_path / "mine", policy))
    assert (loaded.entities, loaded.graph_hash) == (GRAPH.entities, GRAPH.hash)
    assert loaded.act(GOAL, TABLE, HELD) == policy.act(GOAL, TABLE, HELD)
    for name, tensor in policy.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor), name


def test_a_saved_policy_is_hashed_and_says_where_it_is_from(tmp_path):
    folder = save_policy(tmp_path / "mine", policy_of())
    assert json.loads((folder / "run.json").read_text())["kind"] == "save-policy"
    assert "A program saved this policy" in (folder / "README.md").read_text()
    flip_bit(folder / "policy.safetensors", -1)
    with pytest.raises(ArtefactError, match=r"policy\.safetensors"):
        load_policy(folder)


def test_what_cannot_be_used_again_is_not_saved(tmp_path):
    unnamed = AttentionPolicy(PolicyConfig(), EntityVectors(8))
    with refuses("entities"):
        save_policy(tmp_path / "x", unnamed)
    broken = policy_of()
    with torch.no_grad():
        next(broken.parameters()).fill_(torch.nan)
    with pytest.raises(ConfigError, match="not finite"):
        save_policy(tmp_path / "x", broken)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_is_replaced_only_by_force(tmp_path):
    folder = save_policy(tmp_path / "mine", policy_of())
    with pytest.raises(OutputExistsError):
        save_policy(folder, policy_of("mlp"))
    save_policy(folder, policy_of("mlp"), force=True)
    assert load_policy(folder).config.policy == "mlp"


def values(states):
    """Types and numbers of all fields."""
    parts = [*states[:4], *(states.attempts or ())]
    return [None if part is None else (part.dtype, part.tolist()) for part in parts]


@pytest.mark.parametrize("task", [None, torch.arange(5)])
@pytest.mark.parametrize(
    "attempts",
    [None, Attempts(torch.arange(5)), Attempts(torch.arange(5), torch.arange(20).view(5, 2, 2))],
)
def test_rows_keep_all_fields_together(task, attempts):
    states = States(
        torch.arange(5), torch.arange(5) + 1, torch.arange(15).view(5, 3), task, attempts
    )
    for start, stop in ((0, 2), (2, 5), (4, 9)):
        part = states.rows(start, stop)
        assert part.goal.tolist() == list(range(start, min(stop, 5)))
        assert part.table.shape == (min(stop, 5) - start, 3)
        assert (part.task is None) == (task is None)
        assert (part.attempts is None) == (attempts is None)
        if attempts is not None:
            assert part.attempts.left.tolist() == part.goal.tolist()
            assert (part.attempts.tried is None) == (attempts.tried is None)
        if attempts is not None and attempts.tried is not None:
            assert torch.equal(part.attempts.tried, attempts.tried[start:stop])


def test_a_single_observation_is_a_batch_of_one():
    env = gym.make("WordCraft-v0", graph="kitchen", num_distractors=2)
    observation, info = env.reset(seed=0)
    states = States.of_observation(observation, info["task"])
    assert states.table.tolist() == [observation["table"].tolist()]
    assert (states.goal.tolist(), states.task.tolist()) == ([observation["goal"]], [info["task"]])
    assert states.attempts.left.tolist() == [1]
    assert states.attempts.tried is None


def test_rollout_buffers_may_hold_floats_with_a_further_axis():
    ids = {
        "goal": np.array([3, 4]),
        "selection": np.array([9, 0]),
        "table": np.array([[1, 2, 9], [5, 6, 7]]),
    }
    plain = States.of_observation(ids, np.array([7, 8]))
    assert plain.attempts is None
    stored = {name: torch.tensor(values, dtype=torch.float32) for name, values in ids.items()}
    stored["goal"] = stored["goal"][:, None]
    stored["selection"] = stored["selection"][:, None]
    stored["action_mask"] = torch.ones(2, 3)
    assert values(States.of_observation(stored, torch.tensor([[7.0], [8.0]]))) == values(plain)
    assert {dtype for dtype, _ in values(plain)} == {torch.int64}


def slow_scores(goal, table):
    """Scores of slots that differ for each input."""
    return goal[:, None] * 1000.0 + table + 1


def ask(kept, goal, table, computed=None):
    """Return the kept scores of a batch, and count the rows that were computed."""

    def compute(rows):
        found = slow_scores(goal[rows], table[rows])
        if computed is not None:
            computed.append(len(found))
        return found

    return kept.scores((goal, table), compute, table.shape[1:])


ROW = room.ROW_BYTES + 12  # a row of three scores


def batches(seed, number, rows, goals, width=3):
    generator = torch.Generator().manual_seed(seed)
    for _ in range(number):
        goal = torch.randint(goals, (rows,), generator=generator)
        yield goal, torch.randint(4, (rows, width), generator=generator)


def test_a_row_is_computed_once_while_there_is_room():
    kept = KeptScores()
    seen, computed = set(), []
    for goal, table in batches(0, number=20, rows=50, goals=9):
        rows = [tuple(row) for row in torch.cat([goal[:, None], table], dim=1).tolist()]
        before = sum(computed)
        assert torch.equal(ask(kept, goal, table, computed), slow_scores(goal, table))
        # Equal rows of a batch are computed together, each.
        assert sum(computed) - before == sum(row not in seen for row in rows)
        seen |= set(rows)


@pytest.mark.parametrize("most", [0, 10, 100])
def test_without_room_rows_make_way_for_others_and_stay_right(monkeypatch, most):
    monkeypatch.setattr(room, "KEPT", most * ROW)
    kept = KeptScores()
    computed = []
    for goal, table in batches(1, number=60, rows=20, goals=50):
        assert torch.equal(ask(kept, goal, table, computed), slow_scores(goal, table))
    assert len(kept._rows) <= most
    assert sum(computed) > 60 * 20 / 2


def test_threads_and_tables_of_other_widths_get_their_own_scores(monkeypatch):
    monkeypatch.setattr(room, "KEPT", 20 * ROW)
    kept = KeptScores()
    asked = [
        batch
        for width in range(1, 10)
        for batch in batches(width, number=10, rows=30, goals=20, width=width)
    ]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda batch: ask(kept, *batch), asked))
    assert all(
        torch.equal(scores, slow_scores(*batch)) for scores, batch in zip(found, asked, strict=True)
    )
    sizes = [room.ROW_BYTES + row.nbytes for row in kept._rows.values()]
    assert sum(sizes) == kept._size <= 20 * ROW


def test_a_row_has_the_same_bits_in_any_batch(cross_fitted):
    def sources():
        return make_sources(["u", "v", "w", "p"], cross_fitted, ScoreView(without_tables=True))

    size = len(cross_fitted.whole.entities)
    goal, selection, table = states_of(size, 60, 6)
    states = States(goal, selection, table, attempts=Attempts(torch.full_like(goal, 2)))
    whole = [source(states) for source in sources()]
    generator = torch.Generator().manual_seed(0)
    for count in (1, 7, 50):
        rows = torch.randperm(60, generator=generator)[:count]
        for source, expected in zip(sources(), whole, strict=True):
            assert torch.equal(source(states.of(rows)), expected[rows]), (source.name, count)
