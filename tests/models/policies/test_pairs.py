"""The policy that scores pairs: its formulas written out, and what both selections make together."""

import itertools
import math

import pytest
import torch
from small_scorers import BareScorer, normal

from wordcraft_kg import PolicyConfig, make_sources
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.policies.pairs import LENGTH, PairPolicy
from wordcraft_kg.models.policies.policy import EntityVectors
from wordcraft_kg.models.policies.states import Attempts, States

SIZE = 7
NOTHING = SIZE
SLOTS = 5
HIDDEN = 4
SCORER = BareScorer(SIZE, seed=1)


def policy_of(*, knows=False, **settings):
    config = PolicyConfig("pairs", pair_size=HIDDEN, mixing="residual", **settings)
    sources = make_sources(config.sources, SCORER) if knows else ()
    policy = PairPolicy(config, EntityVectors(SIZE, normal(SIZE, 3)), sources)
    for i, parameter in enumerate(policy.parameters()):
        parameter.data = normal(*parameter.shape, seed=i) / 2
    return policy.double()


def states(selection=None, attempts=None):
    """Return nine states, with no selection, or with the entity of a slot."""
    generator = torch.Generator().manual_seed(0)
    # Different entities, and an empty slot on most tables.
    rows = [torch.randperm(SIZE + 1, generator=generator)[:SLOTS] for _ in range(9)]
    table = torch.stack(rows)
    goal = torch.arange(9) % SIZE
    selected = torch.full_like(goal, NOTHING) if selection is None else table[:, selection]
    return States(goal, selected, table, attempts=attempts)


def numbers(policy, states):
    """Return the probability of each pair of slots, in both orders, from :meth:`choose`."""
    shares = torch.softmax(policy.choose(states, policy.weights(), None).logits, dim=1)
    return {
        (i, j): shares[:, number]
        for number, (i, j) in enumerate((i, j) for i in range(SLOTS) for j in range(i + 1))
    }


def test_a_pairs_logit_is_that_of_the_formula_written_out():
    policy, state = policy_of(knows=True), states()
    scores = policy.external_scores(state)
    output = policy.choose(state, policy.weights(), scores.double())
    units = torch.nn.functional.normalize(policy.vectors.vectors, dim=1)
    x = units * LENGTH
    of_words, of_itself = 30 * policy.words.step
    u, v = (source.scores.double() for source in policy.sources.values())
    lambda_u, lambda_v = (1 + 30 * policy.lambdas.step).tolist()
    for row, (goal, table) in enumerate(zip(state.goal, state.table, strict=True)):
        a, b = policy.goals(x[goal]).chunk(2)
        places = ((i, j) for i in range(SLOTS) for j in range(i + 1))
        for number, (i, j) in enumerate(places):
            one, other = table[i], table[j]
            if NOTHING in (one, other):
                assert output.logits[row, number] == -math.inf
                continue
            p, q, r = policy.items(x[one]).chunk(3)
            p2, q2, r2 = policy.items(x[other]).chunk(3)
            hidden = torch.relu(p + p2 + q * q2 + a + b * (r + r2))
            centred = hidden - hidden.mean()
            hidden = centred / (centred.square().mean() + 1e-5).sqrt()
            alpha = policy.score.weight[0] @ hidden
            alpha += of_words * units[goal] @ (units[one] + units[other]) + of_itself * (i == j)
            known = lambda_u * (u[one, other] + u[other, one]) / 2
            known += lambda_v * (v[goal, one] + v[goal, other]) / 2
            torch.testing.assert_close(output.logits[row, number], alpha + known)


def test_both_selections_together_choose_a_pair_with_its_probability():
    """The marginal times the conditional probability, in both orders, is that of the pair."""
    policy = policy_of()
    joint = numbers(policy, states())
    first = torch.softmax(policy(states()).logits, dim=1)
    for i, j in itertools.combinations_with_replacement(range(SLOTS), 2):
        orders = {(i, j), (j, i)}
        total = torch.zeros(9).double()
        for one, other in orders:
            second = torch.softmax(policy(states(selection=one)).logits, dim=1)
            is_there = states().table[:, one] != NOTHING
            total += torch.where(is_there, first[:, one] * second[:, other], 0)
        torch.testing.assert_close(total, joint[max(i, j), min(i, j)])


@pytest.mark.parametrize("selection", [None, 0])
def test_contributions_of_sources_add_up_to_the_logits(selection):
    policy = policy_of(knows=True)
    state = states(selection)
    output = policy(state, external_scores=policy.external_scores(state).double())
    total = torch.einsum("bs,bsa->ba", output.lambdas, output.sources)
    is_filled = state.table != NOTHING
    torch.testing.assert_close(total[is_filled], output.logits[is_filled])
    assert output.sources[:, 1:].any()


def test_a_greedy_player_takes_the_best_pair_and_not_the_most_probable_first_slot():
    policy = policy_of()
    # Nearly equal pairs: a slot in many good pairs is more probable than one in the best pair.
    policy.words.step.data = -policy.words.first / 30
    policy.score.weight.data /= 20
    joint = numbers(policy, states())
    best = [max(joint, key=lambda pair: joint[pair][row].item()) for row in range(9)]
    first = policy.best_slots(states())
    table = states().table
    second = policy.best_slots(states()._replace(selection=table.gather(1, first[:, None])[:, 0]))
    assert [{*pair} for pair in best] == [
        {*pair} for pair in zip(first.tolist(), second.tolist(), strict=True)
    ]
    assert not torch.equal(first, policy(states()).logits.argmax(1))


def test_a_selection_beside_the_table_has_the_scores_that_it_would_have_on_it():
    policy = policy_of(knows=True)
    goal, _, table = states()[:3]
    # An entity that is on no table.
    table = torch.where(table == 3, NOTHING, table)
    beside = States(goal, torch.full_like(goal, 3), table)
    wider = beside._replace(table=torch.cat([table, beside.selection[:, None]], dim=1))
    found, expected = policy.float()(beside), policy(wider)
    torch.testing.assert_close(found.logits, expected.logits[:, :SLOTS])
    torch.testing.assert_close(found.sources, expected.sources[:, :, :SLOTS])


def test_dropped_units_are_the_same_for_all_pairs_and_the_others_make_up_for_them():
    policy = policy_of(dropout=0.25)
    state, weights = states(), policy.weights()
    noise = torch.full((9, HIDDEN), 0.25)
    noise[:, 1] = 0.24
    expected = policy_of(dropout=0.25)
    expected.score.weight.data[0, 1] = 0
    expected.score.weight.data /= 0.75
    expected.words.step.data[:] = policy.words.step
    found = policy.choose(state, weights, None, noise).logits
    torch.testing.assert_close(found, expected.choose(state, expected.weights(), None).logits)


def test_noise_moves_the_vectors_that_the_maps_see_and_no_cosine():
    policy = policy_of(vector_noise=0.5)
    plain, again, other = (
        policy.weights(None if seed is None else torch.Generator().manual_seed(seed))
        for seed in (None, 1, 1)
    )
    assert torch.equal(again["items"], other["items"])
    assert not torch.allclose(plain["items"], again["items"])
    assert torch.equal(plain["units"], again["units"])
    # Of length .5 where vectors have length 1: a map's inputs differ by about LENGTH / 2.
    policy.items = torch.nn.Linear(3, 3, bias=False).double()
    policy.items.weight.data = torch.eye(3).double()
    moved = policy.weights(torch.Generator().manual_seed(1))["items"] - policy.weights()["items"]
    assert 0.3 * LENGTH < moved[:-1].norm(dim=1).square().mean().sqrt() < 0.8 * LENGTH
    silent = policy_of(vector_noise=0)
    assert torch.equal(silent.weights(torch.Generator())["goals"], silent.weights()["goals"])


def test_without_sources_a_policy_begins_near_a_player_of_nearest_words():
    config = PolicyConfig("pairs", pair_size=HIDDEN)
    policy = PairPolicy(config, EntityVectors(SIZE, normal(SIZE, 3)))
    assert policy.words().tolist() == [8, 0]
    knowing = PairPolicy(
        PolicyConfig("pairs", pair_size=HIDDEN, mixing="residual"),
        EntityVectors(SIZE, normal(SIZE, 3)),
        make_sources(["u", "v"], SCORER),
    )
    assert knowing.words().tolist() == [0, 0]


def test_the_attempts_left_have_their_own_terms_whatever_the_selection():
    policy = policy_of(sees_attempts=True)
    left = [Attempts(torch.full((9,), number)) for number in (1, 2)]
    one, two = (policy(states(attempts=each)).logits for each in left)
    assert not torch.allclose(one, two)
    # Both selections of an attempt are of the same pairs.
    state = states(selection=0, attempts=left[1])
    pairs = policy.choose(state, policy.weights(), None).logits
    unselected = policy.choose(states(attempts=left[1]), policy.weights(), None).logits
    assert torch.equal(pairs, unselected)
    with pytest.raises(ConfigError, match="needs the attempts left"):
        policy(states())


@pytest.mark.parametrize("settings", [{"kg_only": True}, {"mixing": "free"}])
def test_a_mixture_that_pairs_do_not_have_is_refused(settings):
    config = PolicyConfig(**{"policy": "pairs", "mixing": "residual", **settings})
    with pytest.raises(ConfigError, match="needs `policy` attention"):
        PairPolicy(config, EntityVectors(SIZE), make_sources(["u", "v"], SCORER))
