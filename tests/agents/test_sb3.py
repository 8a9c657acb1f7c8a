"""Our policies as Stable-Baselines3's: PPO, A2C and MaskablePPO train them on plain ids."""

import copy
import importlib
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg import PolicyConfig, WordCraftConfig, World, open_graph
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.base.errors import ActionError, ConfigError, MissingExtraError
from wordcraft_kg.models.policies.policy_folder import make_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import SymbolicScorer

DISTRACTORS = 3
SHORT = {
    "PPO": {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "learning_rate": 1e-3},
    "MaskablePPO": {"n_steps": 64, "batch_size": 32, "n_epochs": 2, "learning_rate": 1e-3},
    "A2C": {"n_steps": 16},
}
SMALL = {"features": "random", "key_size": 24, "value_size": 24, "hidden_size": 24}
KINDS = {
    "guided": {},
    "guided-random": {"features": "random"},
    "kg-only": {"kg_only": True, "mixing": "softmax"},
    "alone-one-hot": {"is_guided": False, "features": "one-hot"},
    "mlp": {"is_guided": False, "policy": "mlp"},
}
every_kind = pytest.mark.parametrize("kind", KINDS)


def both(test):
    algorithms = [pytest.param("PPO", marks=pytest.mark.slow), "MaskablePPO"]
    return pytest.mark.interop(pytest.mark.parametrize("algorithm", algorithms)(test))


def ours():
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("sb3_contrib")
    return importlib.import_module("wordcraft_kg.agents.sb3")


def make_env(**settings):
    return gym.make(
        "WordCraft-v0", **{"graph": "kitchen", "num_distractors": DISTRACTORS, **settings}
    )


def make_network(*, is_guided=True, **settings):
    config = PolicyConfig(**SMALL | settings)
    opened = open_graph("kitchen")
    scorer = SymbolicScorer(opened.graph, opened.split.partial) if is_guided else None
    slots = make_env().unwrapped.num_slots
    return make_policy(config, opened.graph, slots, scorer=scorer, observed=opened.split.partial)[0]


def make_model(algorithm, network=None, env=None, **settings):
    module = ours()
    library = importlib.import_module(
        "sb3_contrib" if algorithm == "MaskablePPO" else "stable_baselines3"
    )
    policy = module.MaskableSB3Policy if algorithm == "MaskablePPO" else module.SB3Policy
    settings = {
        **SHORT[algorithm],
        "policy_kwargs": {"network": network or make_network()},
        **settings,
    }
    return getattr(library, algorithm)(policy, env or make_env(), seed=0, device="cpu", **settings)


def states(count=64, **settings):
    """States of random play, half of them with something in hand: what an environment gives,
    stacked."""
    env, rng, seen = make_env(**settings), np.random.default_rng(0), []
    observation, _ = env.reset(seed=0)
    while len(seen) < count:
        seen.append(observation)
        observation, _, over, *_ = env.step(rng.choice(np.flatnonzero(observation["action_mask"])))
        if over:
            observation, _ = env.reset()
    return {key: np.stack([row[key] for row in seen]) for key in seen[0]}


def tensors(observations):
    return {key: torch.as_tensor(value) for key, value in observations.items()}


def outputs_of(network, observations):
    """Probabilities and values according to the policy itself, without the library."""
    with torch.no_grad():
        ids = (torch.as_tensor(observations[key]) for key in ("goal", "selection", "table"))
        output = network(States(*ids))
    return torch.softmax(output.logits, dim=1), output.value


@pytest.mark.interop
@pytest.mark.parametrize(
    "algorithm",
    ["MaskablePPO", *(pytest.param(name, marks=pytest.mark.slow) for name in ("PPO", "A2C"))],
)
def test_training_changes_the_parameters_of_a_copy_and_no_scores(algorithm):
    network = make_network()
    before = copy.deepcopy(network.state_dict())
    model = make_model(algorithm, network)
    model.learn(64)
    after = model.policy.network.state_dict()
    constants = {name for name, _ in network.named_buffers()} & set(after)
    assert constants == {"vectors.vectors", "sources.u.scores", "sources.v.scores"}
    for name, tensor in after.items():
        assert torch.equal(network.state_dict()[name], before[name]), name
        assert torch.equal(tensor, before[name]) == (name in constants), name
        assert torch.isfinite(tensor).all(), name
    assert before["sources.u.scores"].count_nonzero() > 0
    trained = [
        parameter for group in model.policy.optimizer.param_groups for parameter in group["params"]
    ]
    assert {id(parameter) for parameter in trained} == {
        id(p) for p in model.policy.network.parameters()
    }
    assert len(list(model.policy.parameters())) == len(trained)  # nothing of the library's own


@both
@every_kind
def test_probabilities_and_values_are_the_policys(algorithm, kind):
    """Probabilities and values are those of the policy and empty slots have probability zero."""
    network, seen = make_network(**KINDS[kind]), states()
    assert (seen["action_mask"] == 0).any()
    model = make_model(algorithm, network)
    expected, values = outputs_of(network, seen)
    obs = tensors(seen)
    with torch.no_grad():
        found = model.policy.get_distribution(obs).distribution.probs
        torch.testing.assert_close(found, expected)
        assert (found[torch.as_tensor(seen["action_mask"]) == 0] == 0).all()
        torch.testing.assert_close(model.policy.predict_values(obs), values[:, None])
        actions, from_forward, log_probs = model.policy(obs)
    torch.testing.assert_close(from_forward, values[:, None])
    torch.testing.assert_close(log_probs, expected.gather(1, actions[:, None])[:, 0].log())
    assert expected.unique(dim=0).shape[0] > 10


@pytest.mark.interop
def test_masks_of_the_user_take_slots_out_and_revive_none():
    model, seen = make_model("MaskablePPO"), states()
    everything, _ = outputs_of(model.policy.network, seen)
    mask = np.random.default_rng(1).random(everything.shape) < 0.6
    mask[:, 0] = True
    mask[:, -1] = True  # always empty before the last attempt
    assert (seen["action_mask"][:, -1] == 0).all()
    with torch.no_grad():
        found = model.policy.get_distribution(tensors(seen), mask).distribution.probs
        values, _, entropy = model.policy.evaluate_actions(
            tensors(seen), torch.zeros(len(mask)), mask
        )
    kept = everything * torch.as_tensor(mask)
    expected = kept / kept.sum(1, keepdim=True)
    torch.testing.assert_close(found, expected)
    assert (found[torch.as_tensor(~mask)] == 0).all()
    assert (found[:, -1] == 0).all()
    torch.testing.assert_close(entropy, torch.special.entr(expected).sum(1))
    torch.testing.assert_close(values, model.policy.predict_values(tensors(seen)))
    one = {key: value[0] for key, value in seen.items()}
    only = np.arange(mask.shape[1]) == 1
    assert all(model.predict(one, action_masks=only)[0] == 1 for _ in range(20))
    with pytest.raises(ActionError, match="without a slot to choose"):
        model.predict(one, action_masks=np.arange(mask.shape[1]) == mask.shape[1] - 1)


@both
def test_a_deterministic_prediction_is_the_best_slot(algorithm):
    model, seen = make_model(algorithm), states()
    best = outputs_of(model.policy.network, seen)[0].argmax(1).numpy()
    together, _ = model.predict(seen, deterministic=True)
    np.testing.assert_array_equal(together, best)
    singles = [
        model.predict({key: value[i] for key, value in seen.items()}, deterministic=True)[0]
        for i in range(9)
    ]
    np.testing.assert_array_equal(singles, best[:9])
    assert all(np.shape(single) == () for single in singles)
    np.testing.assert_array_equal(model.policy(tensors(seen), deterministic=True)[0], best)
    assert len(set(best.tolist())) > 1


@both
def test_a_saved_model_predicts_the_same_and_trains_on(algorithm, tmp_path):
    model, seen = make_model(algorithm), states()
    untrained, _ = outputs_of(model.policy.network, seen)
    model.learn(64)
    expected, values = outputs_of(model.policy.network, seen)
    assert not torch.allclose(expected, untrained)
    model.save(tmp_path / "model.zip")
    loaded = type(model).load(tmp_path / "model.zip", env=make_env(), device="cpu")
    model.policy.save(tmp_path / "policy.pt")
    alone = type(model.policy).load(tmp_path / "policy.pt", device="cpu")
    for policy in (loaded.policy, alone):
        probabilities, again = outputs_of(policy.network, seen)
        assert torch.equal(probabilities, expected)
        assert torch.equal(again, values)
        chosen, _ = policy.predict(seen, deterministic=True)
        np.testing.assert_array_equal(chosen, model.predict(seen, deterministic=True)[0])
    loaded.learn(64)
    assert not torch.equal(outputs_of(loaded.policy.network, seen)[0], expected)


@pytest.mark.interop
def test_what_does_not_fit_is_refused():
    network = make_network()
    for env in (gym.wrappers.FlattenObservation(make_env()), gym.make("CartPole-v1")):
        with pytest.raises(ConfigError, match="expected goal, selection and table as ids"):
            make_model("PPO", network, env)
    with pytest.raises(ConfigError, match="knows 80 entities but the environment has "):
        make_model("MaskablePPO", network, make_env(graph="paper-examples"))
    with pytest.raises(TypeError, match="net_arch"):
        make_model("MaskablePPO", network, policy_kwargs={"network": network, "net_arch": [8]})


@pytest.mark.parametrize("package", ["stable_baselines3", "sb3_contrib"])
def test_without_the_library_the_error_names_the_extra(package, monkeypatch):
    monkeypatch.delitem(sys.modules, "wordcraft_kg.agents.sb3", raising=False)
    for name in [package, *(name for name in sys.modules if name.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'sb3-contrib>="):
        importlib.import_module("wordcraft_kg.agents.sb3")


@both
@pytest.mark.slow
def test_training_lifts_success_far_above_chance(algorithm):
    settings = {
        "n_steps": 512,
        "batch_size": 128,
        "n_epochs": 8,
        "learning_rate": 1e-3,
        "gamma": 0.9,
    }
    success = Evaluator(
        World.open("kitchen", WordCraftConfig(num_distractors=DISTRACTORS)), distractor_seeds=3
    )
    for is_guided, steps, before, after in ((False, 8192, 0.15, 0.6), (True, 1024, 0.93, 0.96)):
        model = make_model(
            algorithm, make_network(is_guided=is_guided, key_size=64, value_size=64), **settings
        )
        player = PolicyPlayer(model.policy.network)
        assert success(player).success.mean() < before
        model.learn(steps)
        assert success(player).success.mean() > after
