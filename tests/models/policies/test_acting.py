"""Asking a policy what to pick, by labels, and saving it from a program."""

import json

import pytest
import torch
from link_helpers import flip_bit, random_graph
from refusals import refuses

from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    OutputExistsError,
    UnknownEntityError,
)
from wordcraft_kg.models.policies.attention import AttentionPolicy
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.folder import load_policy, make_policy, save_policy
from wordcraft_kg.models.policies.policy import EntityVectors
from wordcraft_kg.models.policies.states import States
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


def test_an_empty_slot_is_never_picked(policy):
    table = [None, TABLE[0], None, TABLE[1]]
    draw = torch.Generator().manual_seed(0)
    assert {policy.act(GOAL, table, generator=draw).slot for _ in range(60)} == {1, 3}
    assert policy.act(GOAL, [None, None, None, HELD]) == (3, HELD, 1.0)


def test_with_a_generator_slots_are_drawn_by_their_probabilities():
    policy, draw = policy_of(), torch.Generator().manual_seed(0)
    with torch.no_grad():
        policy.attention.query.weight.mul_(30)  # far from uniform
    expected = torch.tensor(probabilities(policy, 0, 1, [2, 3, 4, 5]))
    assert expected.max() > 2 * expected.min()
    slots = [policy.act(GOAL, TABLE, HELD, generator=draw).slot for _ in range(600)]
    drawn = torch.bincount(torch.tensor(slots), minlength=4)
    assert (drawn / 600 - expected).abs().max() < 0.07


def test_the_same_generator_gives_the_same_picks(policy):
    """The same generator gives the same picks and no global one is touched."""
    before = torch.get_rng_state()
    draws = (torch.Generator().manual_seed(5) for _ in range(2))
    one, other = ([policy.act(GOAL, TABLE, generator=draw) for _ in range(20)] for draw in draws)
    assert one == other
    assert torch.equal(torch.get_rng_state(), before)


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
