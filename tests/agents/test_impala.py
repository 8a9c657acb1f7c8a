"""The trainer against updates and V-trace written out state by state, and what a training must keep
to."""

import copy
import csv
import itertools
import json
import math
import runpy
from pathlib import Path

import hypothesis.extra.numpy as npst
import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from helpers import refuses
from hypothesis import given

from wordcraft_kg import (
    AgentConfig,
    ImpalaConfig,
    PolicyConfig,
    RecipeGraph,
    TaskConfig,
    WordCraftConfig,
    World,
    open_graph,
    train_agent,
)
from wordcraft_kg.agents.impala import LOSSES, Impala
from wordcraft_kg.agents.losses import Successes, led_to_goals, v_trace
from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.models.policies.policy import PolicyOutput
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

SLOW = pytest.mark.slow

BATCH = 8

SIZES = {"key_size": 5, "value_size": 7, "hidden_size": 9}

SMALL = {"features": "glove", "self_edges": "keep", **SIZES}


@pytest.fixture(scope="module")
def scorer(opened):
    return FrequencyScorer(opened.graph, opened.split.partial)


@pytest.fixture(scope="module")
def trainer(opened):
    """Return a maker of small trainers; rewards are shaped, so that there are some."""

    def make(
        *,
        depth=1,
        policy=(),
        scorer=None,
        env_seed=3,
        env_device="cpu",
        policy_seed=0,
        world=(),
        **config,
    ):
        settings = {"steps": 10**4, "batch_size": BATCH, "learning_rate": 0.02, **config}
        settings = {"preset": "paper", **settings}
        config = ImpalaConfig(**settings)
        tasks = WordCraftConfig(
            **{"depth": depth, "num_distractors": 2, "reward": "official", **dict(world)}
        )
        engine = BatchEngine(World(opened, tasks), config.batch_size, device=env_device)
        kind = PolicyConfig(**{**SMALL, **dict(policy)})
        tasks = engine.world.tasks
        made, _ = make_policy(
            kind, opened.graph, engine.num_slots, scorer=scorer, tasks=tasks, seed=policy_seed
        )
        return Impala(made, engine.reset(env_seed), config)

    return make


def flat(impala):
    return torch.cat([parameter.detach().reshape(-1) for parameter in impala.policy.parameters()])


def train(impala, updates):
    for _ in range(updates):
        impala.update()
    return flat(impala).clone()


def assert_same_state(one, other):
    one, other = one.state(), other.state()
    assert one.keys() == other.keys()
    assert [name for name in one if not torch.equal(one[name], other[name])] == []


class SlowImpala:
    """The same training with loops: an environment, a step, a state and a parameter at a time, in
    double precision.

    Only the actions are taken from the trainer under test; environments, values, behaviour and
    optimiser are its own.
    """

    def __init__(self, impala):
        self.policy = copy.deepcopy(impala.policy).double()
        self.policy.sources = impala.policy.sources
        self.config, self.nothing = impala.config, impala.envs.nothing
        world = World(open_graph("kitchen"), impala.envs.world.config)
        self.envs = BatchEngine(world, impala.envs.num_envs).reset(3)
        self.actors = []
        self.updates = 0
        self.squares = [torch.zeros_like(parameter) for parameter in self.policy.parameters()]

    def look(self, policy, state):
        """Return log-probabilities by slot of the entities that are there, the value, and λ."""
        goal, selection, table, task, left = state
        ids = (torch.tensor([part]) for part in (goal, selection, table))
        attempts = Attempts(torch.tensor([left]))
        output = policy(States(*ids, task=torch.tensor([task]), attempts=attempts))
        there = [slot for slot, entity in enumerate(table) if entity != self.nothing]
        log_probs = torch.log_softmax(output.logits[0, there], dim=0)
        divergence = torch.zeros(())
        if "w" in policy.sources and self.envs.world.config.depth == 1:
            alone = torch.log_softmax(output.sources[0, -1, there], dim=0)
            divergence = sum(
                one.exp() * (one - other) for one, other in zip(log_probs, alone, strict=True)
            )
        return dict(zip(there, log_probs, strict=True)), output.value[0], output.lambdas, divergence

    def states(self):
        envs = self.envs
        return list(
            zip(
                *(
                    part.tolist()
                    for part in (
                        envs.goal,
                        envs.selection,
                        envs.table,
                        envs.task,
                        envs.attempts_left,
                    )
                ),
                strict=True,
            )
        )

    def play(self, actions):
        """Return the states of each step and after the last, rewards, which episodes ended, and
        which made the goal."""
        states, rewards, over, won = [self.states()], [], [], []
        for row in actions.numpy():
            self.envs, step = self.envs.engine.step(self.envs, row)
            states.append(self.states())
            rewards.append(step.reward.tolist())
            over.append(step.over.tolist())
            won.append((step.outcome == GOAL).tolist())
        return states, np.array(rewards), np.array(over), np.array(won)

    def update(self, actions):
        """Learn from the steps that these actions make; return what should be logged, and the
        clipped gradient."""
        config = self.config
        self.actors = [*self.actors, copy.deepcopy(self.policy)][-1 - config.policy_lag :]
        states, rewards, over, won = self.play(actions)
        time, batch = rewards.shape
        seen = [[self.look(self.policy, state) for state in row] for row in states]
        chosen = [[seen[t][b][0][int(actions[t, b])] for b in range(batch)] for t in range(time)]
        log_rhos = np.zeros((time, batch))
        for t, b in itertools.product(range(time), range(batch)):
            behaviour = self.look(self.actors[0], states[t][b])[0][int(actions[t, b])]
            log_rhos[t, b] = (chosen[t][b] - behaviour).item()
        values = np.array([[seen[t][b][1].item() for b in range(batch)] for t in range(time + 1)])
        discounts = config.discount * (1 - over.astype(float))
        vs, advantages = slow_v_trace(log_rhos, discounts, rewards, values[:-1], values[-1])
        pg_loss = baseline = entropy = divergence = 0.0
        for t, b in itertools.product(range(time), range(batch)):
            log_probs, value, _, from_scorer = seen[t][b]
            divergence = divergence + from_scorer
            pg_loss = pg_loss - chosen[t][b] * advantages[t, b]
            baseline = baseline + 0.5 * (vs[t, b] - value) ** 2
            entropy = entropy - sum(log_prob.exp() * log_prob for log_prob in log_probs.values())
        loss = pg_loss + config.baseline_cost * baseline - config.entropy_cost * entropy
        loss = (
            loss + (3.0 if config.scorer_cost is None else config.scorer_cost) * divergence
        )  # kitchen is small
        gradients = torch.autograd.grad(loss, list(self.policy.parameters()))
        norm = math.sqrt(sum((gradient**2).sum().item() for gradient in gradients))
        gradients = [gradient * min(1, config.clip / norm) for gradient in gradients]
        self.rms_prop(gradients)
        lambdas = {"first": [], "second": []}
        for t, b in itertools.product(range(time), range(batch)):
            lambdas["first" if states[t][b][1] == self.nothing else "second"].append(seen[t][b][2])
        losses = (
            loss.item(),
            pg_loss.item(),
            baseline.item(),
            entropy.item() / (time * batch),
            norm,
        )
        gradient = torch.cat([gradient.reshape(-1) for gradient in gradients])
        logged = {
            "rewards": rewards.sum(),
            "over": over,
            "won": won.sum(),
            "ratios": np.exp(log_rhos),
        }
        return (
            dict(zip(LOSSES, losses, strict=True))
            | logged
            | {"lambdas": lambdas, "gradient": gradient}
        )

    def rms_prop(self, gradients):
        config = self.config
        rate = config.learning_rate * (1 - self.updates / config.updates)
        for i, (parameter, gradient) in enumerate(
            zip(self.policy.parameters(), gradients, strict=True)
        ):
            self.squares[i] = (
                config.rms_decay * self.squares[i] + (1 - config.rms_decay) * gradient**2
            )
            step = gradient / (self.squares[i].sqrt() + config.rms_epsilon)
            parameter.data -= rate * step
        self.updates += 1


@pytest.mark.parametrize(
    ("depth", "unroll", "settings"),
    [
        (1, 1, {}),
        pytest.param(1, 2, {"discount": 0.7}, marks=pytest.mark.slow),
        pytest.param(1, 3, {"entropy_cost": 0.3, "baseline_cost": 1.5}, marks=pytest.mark.slow),
        pytest.param(2, 1, {"policy_lag": 1}, marks=pytest.mark.slow),
        (2, 2, {"rms_decay": 0.8, "clip": 2.0, "policy_lag": 2}),
        pytest.param(2, 3, {"policy": {"policy": "mlp"}}, marks=pytest.mark.slow),
        pytest.param(
            2,
            3,
            {"policy": {"value_readout": "logits"}, "policy_lag": 2},
            marks=pytest.mark.slow,
        ),
        (2, 3, {"scorer": "frequency", "policy_lag": 1}),
        pytest.param(
            2,
            3,
            {"scorer": "frequency", "policy": {"mixing": "residual"}, "policy_lag": 1},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            1,
            3,
            {"scorer": "cross-fitted", "policy": {"use": "u,v,w"}, "policy_lag": 1},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            2, 3, {"scorer": "cross-fitted", "policy": {"use": "w"}}, marks=pytest.mark.slow
        ),
        pytest.param(
            2, 3, {"policy": {"sees_attempts": True}, "policy_lag": 1}, marks=pytest.mark.slow
        ),
        pytest.param(
            2,
            3,
            {"scorer": "cross-fitted", "policy": {"use": "u,v,w", "sees_attempts": True}},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_updates_are_those_of_the_formulas_written_out(
    trainer, scorer, cross_fitted, depth, unroll, settings
):
    updates = 4  # two more than the largest lag
    scorers = {"frequency": scorer, "cross-fitted": cross_fitted}
    settings = settings | {"scorer": scorers.get(settings.get("scorer"))}
    impala = trainer(depth=depth, unroll=unroll, steps=(updates + 1) * BATCH * unroll, **settings)
    slow = SlowImpala(impala)
    logged = []
    for number in range(updates):
        impala.update()
        seen = impala._unroll
        before = slow.states()
        expected = slow.update(seen.actions)
        logged.append(expected)
        # The trainer saw the environments as they were, to the state after the last step.
        for row, states in ((0, before), (-1, slow.states())):
            goal, selection, table = (ids[row].tolist() for ids in seen.states[:3])
            for state, *seen_here in zip(states, goal, selection, table, strict=True):
                assert seen_here[:2] == list(state[:2])
                # Without the slots that only the results of the last attempt need.
                table_here = seen_here[2]
                assert table_here == state[2][: len(table_here)]
        torch.testing.assert_close(
            impala._flat.grad.double(), expected["gradient"], atol=3e-4, rtol=1e-3
        )
        reference = torch.cat(
            [parameter.detach().reshape(-1) for parameter in slow.policy.parameters()]
        )
        torch.testing.assert_close(flat(impala).double(), reference, atol=5e-5, rtol=1e-3)
        assert impala.update_number == number + 1

    figures = impala.take_metrics()
    for name in LOSSES:
        assert figures[name] == pytest.approx(
            np.mean([row[name] for row in logged]), rel=2e-3, abs=1e-4
        ), name
    over = np.array([row["over"] for row in logged])
    assert figures["return"] == pytest.approx(
        sum(row["rewards"] for row in logged) / over.sum(), abs=1e-5
    )
    assert figures["success"] == pytest.approx(sum(row["won"] for row in logged) / over.sum())
    ratios = logged[-1]["ratios"]
    assert figures["ratio_mean"] == pytest.approx(ratios.mean(), rel=1e-3)
    assert figures["ratio_max"] == pytest.approx(ratios.max(), rel=1e-3)
    assert figures["ratio_clipped"] == pytest.approx((ratios > 1 + 1e-5).mean())
    assert (np.abs(ratios - 1).mean() > 1e-4) == (impala.config.policy_lag > 0)
    for pick, rows in logged[-1]["lambdas"].items():
        for i, source in enumerate(label.name for label in impala.policy.labels):
            expected = torch.cat(rows)[:, i].mean().item()
            assert figures[f"lambda_{source}_{pick}"] == pytest.approx(expected, rel=1e-3)

    # What these cases are for: episodes that are cut and need the value after them, and such that
    # are not.
    ended = over[:, -1].all(axis=1)
    assert ended.all() if (depth, unroll) == (1, 2) else not ended.all()
    assert any(abs(row["rewards"]) > 0.05 for row in logged)
    assert impala.config.clip == 40 or figures["grad_norm"] > impala.config.clip


def test_figures_begin_anew_each_time_and_are_none_where_no_episode_ended(trainer):
    impala = trainer(depth=1, unroll=1)
    impala.update()  # the first pick of all: nothing can have ended
    first = impala.take_metrics()
    assert first["return"] is first["success"] is None
    impala.update()
    second = impala.take_metrics()
    assert 0 <= second["success"] <= 1
    assert second["loss"] != first["loss"]
    assert not any(name.startswith("lambda") for name in second)
    assert impala.take_metrics()["loss"] == 0


def test_each_uniform_number_picks_the_slot_whose_share_it_falls_into(trainer):
    impala = trainer(policy={"key_size": 40})
    count = 10_000
    weights = impala.policy.weights()
    state = [getattr(impala.envs, name)[:1] for name in ("goal", "selection", "table")]
    states = States(*(torch.from_numpy(np.repeat(array, count, axis=0)) for array in state))
    noise = (torch.arange(count) + 0.5) / count
    with torch.no_grad():
        actions, log_probs = impala._choose(weights, states, None, noise)
        shares = torch.softmax(impala.policy(states.rows(0, 1)).logits[0], dim=0)
    frequencies = torch.bincount(actions, minlength=len(shares)) / count
    torch.testing.assert_close(frequencies, shares, atol=2 / count, rtol=0)
    assert shares.max() - shares[shares > 0].min() > 0.05
    torch.testing.assert_close(log_probs.exp(), shares[actions])
    assert (actions.diff() >= 0).all()


def test_an_entity_whose_probability_is_rounded_to_zero_is_never_picked(trainer, monkeypatch):
    impala = trainer()
    logits = torch.tensor([-200.0, 0.0, -200.0, 0.0, -200.0, -torch.inf])
    noise = torch.tensor([0.0, 0.25, 0.5, 0.75, 1 - 2.0**-24])
    monkeypatch.setattr(
        impala.policy, "choose", lambda *_, **__: PolicyOutput(logits.repeat(len(noise), 1), noise)
    )
    actions, log_probs = impala._choose({}, States(noise, noise, noise), None, noise)
    assert actions.tolist() == [1, 1, 3, 3, 3]
    torch.testing.assert_close(log_probs, torch.full((5,), math.log(0.5)))


def test_the_environments_of_a_batch_see_different_tasks(trainer):
    """In the released code all actors see the same tasks; here n environments draw n streams."""
    impala = trainer(batch_size=16)
    goals = []
    for _ in range(10):
        impala.update()
        goals.append(impala._unroll.states.goal[0].clone())
        # At any time most of them have a goal of their own.
        assert len(goals[-1].unique()) > 8
    assert len({tuple(row) for row in torch.stack(goals, dim=1).tolist()}) == 16


def test_the_same_seeds_give_the_same_parameters_and_others_others(trainer):
    one, same = train(trainer(), 8), train(trainer(), 8)
    assert torch.equal(one, same)
    for changed in ({"seed": 1}, {"env_seed": 1}, {"policy_seed": 1}):
        assert not torch.equal(one, train(trainer(**changed), 8))


@pytest.mark.parametrize(
    ("depth", "unroll", "use"),
    [
        (1, 2, "u,v,w"),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((2, 4, "u,v,w,p"), (2, 3, "w"))),
    ],
)
def test_a_second_thread_changes_no_bit(trainer, cross_fitted, depth, unroll, use, monkeypatch):
    settings = {"depth": depth, "unroll": unroll, "policy": {"use": use}, "scorer": cross_fitted}
    # Threads get blocks of the batch, however small it is.
    monkeypatch.setattr("wordcraft_kg.models.scorers.neighbours.knowledge._ROWS", 2)
    monkeypatch.setattr("wordcraft_kg.models.scorers.neighbours.knowledge._BLOCK", 2)
    one = trainer(**settings)
    two = trainer(**settings, threads=2)
    before = one.state()
    for number in range(6):
        one.update()
        two.update()
        # An evaluation binds the policy to other tasks between two updates.
        two.policy.bind(two.envs.world.variant(part="all").tasks)
        if number == 2:  # back to the start
            one.restore(before)
            two.restore(before)
        assert torch.equal(flat(one), flat(two))
        assert torch.equal(one._unroll.external_scores, two._unroll.external_scores)
    assert_same_state(one, two)


@pytest.mark.parametrize(
    ("depth", "unroll", "settings"),
    [(1, 2, {}), pytest.param(2, 3, {"policy_lag": 2}, marks=pytest.mark.slow)],
)
def test_torch_environments_train_the_same_as_numpy_ones(trainer, depth, unroll, settings):
    one, other = (
        trainer(depth=depth, unroll=unroll, env_device=device, **settings)
        for device in ("cpu", "torch:cpu")
    )
    begun = flat(one).clone()
    for _ in range(20):
        one.update()
        other.update()
        assert torch.equal(one._unroll.actions, other._unroll.actions)
        torch.testing.assert_close(one._unroll.rewards, other._unroll.rewards)
        # Rows are summed in batches of another size, so that last bits differ, by processor, and a
        # unit near 0 may be on in the one and off in the other: a single parameter says little, all
        # of them together much.
        assert (flat(one) - flat(other)).norm() < 1e-3 * (flat(one) - begun).norm()
    assert one.take_metrics() == pytest.approx(other.take_metrics(), rel=1e-3, abs=1e-3)


def test_the_last_update_has_almost_no_rate_and_there_is_none_after_it(trainer):
    impala = trainer(steps=10 * 2 * BATCH)
    positions = [flat(impala).clone()] + [train(impala, 1) for _ in range(12)]
    moves = [(after - before).norm().item() for before, after in itertools.pairwise(positions)]
    assert 0 < moves[9] < 0.3 * moves[0]
    assert moves[10] == moves[11] == 0


RESTORED = ((2, True, 7),)


@pytest.mark.parametrize(
    ("lag", "guided", "updates"),
    [
        pytest.param(lag, *learned, marks=[] if (lag, *learned) in RESTORED else SLOW)
        for lag in (0, 2)
        for learned in ((False, 7), (True, 7), (False, 0))
    ],
)
def test_a_restored_trainer_goes_on_bit_for_bit(trainer, scorer, lag, guided, updates):
    settings = {
        "depth": 2,
        "unroll": 3,
        "policy_lag": lag,
        "scorer": scorer if guided else None,
    }
    one = trainer(**settings)
    train(one, updates)
    state = one.state()
    # Nothing but the seed of the environments and the constants has to be the same.
    other = trainer(**settings, policy_seed=8, seed=9)
    other.restore(state)
    assert_same_state(one, other)
    for _ in range(25):  # far enough to draw new episodes
        one.update()
        other.update()
        assert torch.equal(flat(one), flat(other))
    assert_same_state(one, other)
    # A second time, from the same tensors, in a trainer that has gone elsewhere.
    other.restore(state)
    for tensor in state.values():
        tensor.zero_()  # the trainer has copies
    train(other, 25)
    assert_same_state(one, other)
    assert one.take_metrics() == other.take_metrics()


def test_a_lagging_actor_keeps_no_parameter_twice(trainer):
    """Weights that are computed stand for the parameters of vectors and attention."""
    impala = trainer(policy={"features": "random"})
    weights = impala.policy.weights()
    shared = {id(parameter) for parameter in impala.policy.parameters()} & {
        *map(id, weights.values())
    }
    names = {name for name, part in impala.policy.named_parameters() if id(part) in shared}
    assert names == {f"value.{layer}.{part}" for layer in (0, 2) for part in ("weight", "bias")}


def test_an_incomplete_or_foreign_state_is_refused(trainer):
    """A state that lacks something or is of other environments is refused."""
    impala = trainer()
    train(impala, 2)
    state = impala.state()
    for name in ("policy.attention.key.weight", "engine.goal", "sums", "generator", "update"):
        with pytest.raises(KeyError, match=name):
            trainer().restore({other: tensor for other, tensor in state.items() if other != name})
    with pytest.raises(ConfigError, match="state of another engine"):
        trainer(batch_size=4).restore(state)
    with pytest.raises(RuntimeError, match="size"):
        trainer(policy={"key_size": 6}).restore(state)


def test_a_reward_that_is_not_finite_stops_the_training(trainer, monkeypatch):
    """A reward that is no number stops the training and leaves the parameters."""
    impala, undisturbed = trainer(), trainer()
    before = train(impala, 2)
    squares = impala.optimizer.state[impala._flat]["square_avg"].clone()
    step = impala.envs.engine.step

    def poisoned(state, actions):
        state, done = step(state, actions)
        return state, done._replace(reward=np.full_like(done.reward, np.nan))

    monkeypatch.setattr(impala.envs.engine, "step", poisoned)
    with pytest.raises(
        TrainingError, match=r"no longer a finite number in update 3 \(environment steps 32 to 48\)"
    ):
        impala.update()
    assert torch.equal(flat(impala), before)
    assert torch.equal(impala.optimizer.state[impala._flat]["square_avg"], squares)
    assert impala.update_number == 2
    assert impala.take_metrics()["loss"] == pytest.approx(metrics_after(undisturbed, 2)["loss"])
    monkeypatch.undo()
    assert not torch.equal(train(impala, 1), before)
    assert flat(impala).isfinite().all()


def metrics_after(impala, updates):
    train(impala, updates)
    return impala.take_metrics()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_parameter_that_is_no_number_stops_the_training(trainer, value):
    impala = trainer()
    train(impala, 1)
    with torch.no_grad():
        impala.policy.value[2].bias.fill_(value)
    before = flat(impala).clone()
    with refuses("learning_rate", TrainingError):
        impala.update()
    torch.testing.assert_close(flat(impala), before, equal_nan=True, rtol=0, atol=0)


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0, 3])
def test_a_tiny_world_is_learned_within_two_hundred_updates(lag):
    rows = ["abe", "acf", "bdg", "cdh", "adi", "bcj"]
    graph = RecipeGraph.from_recipes([tuple(row) for row in rows])
    world = World.open(graph, WordCraftConfig(part="all", num_distractors=2))
    engine = BatchEngine(world, 16)
    settings = PolicyConfig(features="one-hot", key_size=16, value_size=16)
    policy, _ = make_policy(settings, graph, engine.num_slots)
    config = ImpalaConfig(steps=200 * 32, batch_size=16, learning_rate=0.02, policy_lag=lag)
    impala = Impala(policy, engine.reset(1), config)
    early = metrics_after(impala, 20)
    metrics_after(impala, 150)
    late = metrics_after(impala, 30)
    assert early["success"] < 0.5  # chance is about 1 in 8
    assert late["success"] > 0.9
    assert late["entropy"] < early["entropy"]


CLIPS, LIMITS = ("clip_rho", "clip_c", "clip_pg_rho"), (0.0, 0.4, 1.0, 2.5, math.inf)


def slow_v_trace(
    log_rhos, discounts, rewards, values, bootstrap_value, clip_rho=1.0, clip_c=1.0, clip_pg_rho=1.0
):
    """Espeholt et al. 2018, equation 1 as it stands: for each start a sum over later steps, with
    products of c."""
    steps, batch = rewards.shape
    vs, advantages = np.zeros((steps, batch)), np.zeros((steps, batch))
    for b in range(batch):
        ratio = [math.exp(x) for x in log_rhos[:, b]]
        value = [*values[:, b], bootstrap_value[b]]
        target = [*value]
        for s in range(steps):
            for t in range(s, steps):
                product = 1.0
                for i in range(s, t):
                    product *= discounts[i, b] * min(clip_c, ratio[i])
                delta = min(clip_rho, ratio[t]) * (
                    rewards[t, b] + discounts[t, b] * value[t + 1] - value[t]
                )
                target[s] += product * delta
        for s in range(steps):
            vs[s, b] = target[s]
            error = rewards[s, b] + discounts[s, b] * target[s + 1] - value[s]
            advantages[s, b] = min(clip_pg_rho, ratio[s]) * error
    return vs, advantages


def tensors(arrays):
    return [torch.from_numpy(np.asarray(array)) for array in arrays]


@st.composite
def unrolls(draw):
    shape = draw(st.tuples(st.integers(1, 5), st.integers(1, 3)))
    numbers = npst.arrays(np.float64, shape, elements=st.floats(-3, 3))
    discounts = npst.arrays(np.float64, shape, elements=st.sampled_from([0.0, 0.5, 0.99, 1.0]))
    bootstrap = npst.arrays(np.float64, shape[1:], elements=st.floats(-3, 3))
    return [draw(numbers), draw(discounts), draw(numbers), draw(numbers), draw(bootstrap)]


@given(unrolls(), st.fixed_dictionaries({}, optional=dict.fromkeys(CLIPS, st.sampled_from(LIMITS))))
def test_targets_and_advantages_are_the_papers_sums(unroll, clips):
    """Targets and advantages are those of the papers sum and clips are one by default."""
    inputs = [tensor.requires_grad_() for tensor in tensors(unroll)]
    for one, other in zip(v_trace(*inputs, **clips), slow_v_trace(*unroll, **clips), strict=True):
        assert not one.requires_grad
        np.testing.assert_allclose(one.numpy(), other, rtol=1e-9, atol=1e-9)


FILE = Path(__file__).parents[2] / "examples" / "impala_single_file.py"


@pytest.mark.slow
def test_its_learning_curve_is_that_of_the_trainer(tmp_path):
    example = runpy.run_path(str(FILE))
    assert example["UNROLL"] == 2
    # At the usual rate, differences by rounding grow until the policies choose other slots.
    example["train"].__globals__["LEARNING_RATE"] = 0.001
    example["train"]("kitchen", 7_680, 3, 1, tmp_path / "curve.csv")
    trainer = ImpalaConfig(
        steps=7_680,
        batch_size=128,
        memory_cost=0.0,
        learning_rate=0.001,
        seed=1,
        log_every=2_560,
        eval_every=2_560,
    )
    attention = PolicyConfig("attention")
    config = AgentConfig("kitchen", None, TaskConfig(distractors=3), attention, trainer)
    train_agent(config, tmp_path / "run")
    _, *expected = map(json.loads, (tmp_path / "run" / "metrics.jsonl").read_text().splitlines())
    found = list(csv.DictReader((tmp_path / "curve.csv").open(encoding="utf-8")))
    assert (
        [int(row["step"]) for row in found]
        == [row["step"] for row in expected]
        == [2_560, 5_120, 7_680]
    )
    for row, other in zip(found, expected, strict=True):
        # Counts of the same episodes; losses differ by rounding, because the trainer folds keys
        # into the query.
        assert float(row["success"]) == other["success"]
        assert float(row["test_success"]) == pytest.approx(other["test_success"], abs=1e-12)
        assert float(row["loss"]) == pytest.approx(other["loss"], abs=1e-3)


MEMORY_BATCH = 16

CPU = torch.device("cpu")


def ids(*numbers):
    return torch.tensor(numbers)


def trainer_of_memory(opened, *, depth=1, policy="pairs", updates=50, **config):
    world = World(opened, WordCraftConfig(part="train", depth=depth, num_distractors=2))
    unroll = 2 * depth
    config = {"learning_rate": 0.02, "memory_cost": 2.0, **config}
    config = ImpalaConfig(
        batch_size=MEMORY_BATCH, unroll=unroll, steps=updates * MEMORY_BATCH * unroll, **config
    )
    engine = BatchEngine(world, MEMORY_BATCH)
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


@pytest.mark.parametrize("policy", ["pairs", "attention"])
def test_remembered_are_the_choices_of_pairs_that_won_before(opened, policy):
    impala = trainer_of_memory(opened, policy=policy)
    graph = opened.graph
    won = set()
    for _ in range(30):
        impala.update()
        unroll = impala._unroll
        states = unroll.states
        for t, b in itertools.product(range(len(unroll.won)), range(MEMORY_BATCH)):
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
    for t, b in itertools.product(range(len(unroll.won)), range(MEMORY_BATCH)):
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
    impala = trainer_of_memory(opened, depth=depth, updates=400)
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

    for b in range(MEMORY_BATCH):
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


def test_an_unroll_that_ends_within_an_attempt_is_refused(opened):
    with pytest.raises(ConfigError, match="`unroll` 3: expected an even number"):
        Impala(
            trainer_of_memory(opened).policy, trainer_of_memory(opened).envs, ImpalaConfig(unroll=3)
        )
