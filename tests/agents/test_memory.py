"""The memory of own successes, and updates of a policy that chooses pairs, against loops."""

import copy
import itertools

import pytest
import torch

from wordcraft_kg import ImpalaConfig, PolicyConfig, WordCraftConfig, World
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.agents.losses import Successes, led_to_goals, memory_loss
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.models.policies.folder import make_policy
from wordcraft_kg.models.policies.states import Attempts, States

BATCH = 16
CPU = torch.device("cpu")


def ids(*numbers):
    return torch.tensor(numbers)


def trainer(opened, *, depth=1, policy="pairs", updates=50, **config):
    world = World(opened, WordCraftConfig(part="train", depth=depth, num_distractors=2))
    unroll = 2 * depth
    config = {"learning_rate": 0.02, "memory_cost": 2.0, **config}
    config = ImpalaConfig(batch_size=BATCH, unroll=unroll, steps=updates * BATCH * unroll, **config)
    engine = BatchEngine(world, BATCH)
    settings = PolicyConfig(policy, pair_size=6, key_size=5, features="one-hot")
    made, _ = make_policy(settings, opened.graph, engine.num_slots)
    return Impala(made, engine.reset(0), config)


def test_a_pair_is_remembered_for_its_goal_and_attempts_in_any_order_and_once():
    memory = Successes(10, CPU)
    table = ids([3, 5, 10, 7])
    assert not memory.hold(ids(1), ids(1), table).any()
    memory.add(ids(1, 1, 2), ids(1, 1, 2), ids(5, 3, 7), ids(3, 5, 7))
    assert len(memory.keys) == 2
    held = memory.hold(ids(1), ids(1), table)[0]
    assert held.nonzero().tolist() == [[0, 1], [1, 0]]
    assert memory.hold(ids(2), ids(2), table)[0].nonzero().tolist() == [[3, 3]]
    for goal, left in ((1, 2), (2, 1), (3, 1)):
        assert not memory.hold(ids(goal), ids(left), table).any()


def test_only_choices_that_made_something_in_won_episodes_are_remembered():
    #      won later | made nothing | lost | cut off | won at once, then lost
    won = ids([0, 0, 0, 0, 1], [1, 1, 0, 0, 0]).bool()
    over = ids([0, 0, 0, 0, 1], [1, 1, 1, 0, 1]).bool()
    is_new = ids([1, 0, 1, 1, 1], [1, 1, 0, 1, 1]).bool()
    led = led_to_goals(won, over, is_new)
    assert led.tolist() == [
        [True, False, False, False, True],
        [True, True, False, False, False],
    ]


def test_the_memorys_loss_is_minus_the_log_of_the_remembered_probability():
    log_policies = torch.log_softmax(torch.randn(4, 3, dtype=torch.double), 0).requires_grad_()
    remembered = ids([0, 1, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0]).bool()
    shares = log_policies.exp()
    expected = -shares[3, 0].log() - (shares[0, 1] + shares[1, 1]).log()
    loss = memory_loss(log_policies, remembered)
    torch.testing.assert_close(loss, expected)
    loss.backward()
    # A state without a remembered choice learns nothing.
    assert log_policies.grad.isfinite().all()
    assert not log_policies.grad[:, 2].any()


@pytest.mark.parametrize("policy", ["pairs", "attention"])
def test_remembered_are_the_choices_of_pairs_that_won_before(opened, policy):
    impala = trainer(opened, policy=policy)
    graph = opened.graph
    won = set()
    for _ in range(30):
        impala.update()
        unroll = impala._unroll
        states = unroll.states
        for t, b in itertools.product(range(len(unroll.won)), range(BATCH)):
            goal, table, selection = (
                part[t, b].tolist() for part in (states.goal, states.table, states.selection)
            )
            choice = int(unroll.actions[t, b])
            if policy == "pairs":
                places = [(i, j) for i in range(len(table)) for j in range(i + 1)]
                pairs = [(table[i], table[j]) for i, j in places]
            else:
                pairs = [(selection, entity) for entity in table]
            if unroll.won[t, b]:
                won.add((goal, *sorted(pairs[choice])))
    assert len(won) == len(impala.successes.keys)
    assert {goal for goal, _, _ in won} <= {*range(graph.num_entities)}
    recipes = {(c, a, b) for a, b, c in graph.recipes.tolist()}
    assert won <= recipes
    # The last unroll's mask, by the memory after it.
    for t, b in itertools.product(range(len(unroll.won)), range(BATCH)):
        goal, table, selection = (
            part[t, b].tolist() for part in (states.goal, states.table, states.selection)
        )
        known = [{one, other} for made, one, other in won if made == goal]
        if policy == "pairs":
            pairs = [{table[i], table[j]} for i in range(len(table)) for j in range(i + 1)]
            expected = [pair in known for pair in pairs]
        elif selection == graph.num_entities:
            on_table = [pair for pair in known if pair <= {*table}]
            expected = [any(entity in pair for pair in on_table) for entity in table]
        else:
            expected = [{selection, entity} in known for entity in table]
        assert unroll.remembered[t, b].tolist() == expected
    assert unroll.remembered.any()


@pytest.mark.parametrize("depth", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_update_of_pairs_has_the_gradient_of_the_losses_written_out(opened, depth):
    impala = trainer(opened, depth=depth, updates=400)
    for update in range(400):
        policy = copy.deepcopy(impala.policy).double()
        impala.update()
        # At depth 2 successes are rare at first, and their tables have to come again.
        if update >= 30 and impala._unroll.remembered.any():
            break
    unroll, config = impala._unroll, impala.config
    weights = policy.weights()
    loss = 0.0
    goal, selection, table, _, attempts = unroll.states

    def choose(t, b):
        left = Attempts(attempts.left[t, b : b + 1])
        places = (part[t, b : b + 1] for part in (goal, selection, table))
        return policy.choose(
            States(*places, attempts=left), weights, None, unroll.noise[t, b : b + 1]
        )

    for b in range(BATCH):
        # An episode that succeeds at its first attempt shifts the next ones, which unrolls then cut.
        target = choose(depth, b).value[0].detach()
        for t in reversed(range(depth)):
            output = choose(t, b)
            shares = torch.softmax(output.logits[0], 0)
            # On-policy, V-trace's targets are the discounted returns of the unroll.
            target = unroll.rewards[t, b] + unroll.discounts[t, b] * target
            value = output.value[0]
            advantage = (target - value).detach()
            entropy = -(shares * shares.clamp(min=1e-300).log()).sum()
            loss = loss - shares[unroll.actions[t, b]].log() * advantage
            loss = loss + config.baseline_cost * (target - value) ** 2 / 2
            loss = loss - config.entropy_cost * entropy
            remembered = shares[unroll.remembered[t, b]]
            if len(remembered):
                loss = loss - config.memory_cost * remembered.sum().log()
    assert unroll.remembered.any()
    assert unroll.discounts.isclose(torch.tensor(0.99**2)).any() == (depth == 2)
    gradients = torch.autograd.grad(loss, list(policy.parameters()))
    expected = torch.cat([gradient.reshape(-1) for gradient in gradients])
    assert expected.norm() < config.clip
    torch.testing.assert_close(impala._flat.grad.double(), expected, atol=1e-4, rtol=1e-3)


def test_without_a_cost_there_is_no_memory(opened):
    impala = trainer(opened, memory_cost=0)
    for _ in range(10):
        impala.update()
    assert impala._unroll.remembered is None
    assert not len(impala.successes.keys)


def test_an_unroll_that_ends_within_an_attempt_is_refused(opened):
    with pytest.raises(ConfigError, match="`unroll` 3: expected an even number"):
        Impala(trainer(opened).policy, trainer(opened).envs, ImpalaConfig(unroll=3))
