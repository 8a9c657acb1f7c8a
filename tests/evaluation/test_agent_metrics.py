"""What each source adds to an agent (the agent plays again with the source's scores set to 0), and bins."""

import numpy as np
import pytest
import torch

from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.agent_metrics import OPEN_END, binned, source_gains
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.folder import make_policy
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.baselines import SymbolicScorer


@pytest.fixture(scope="module")
def policy(opened_kitchen):
    """A policy with u and v of all known links."""
    graph = opened_kitchen.graph
    config = PolicyConfig(features="random", self_edges="keep", key_size=5, value_size=4)
    scorer = SymbolicScorer(graph, graph.triples)
    return make_policy(config, graph, 4, scorer=scorer)[0]


@pytest.fixture(scope="module")
def evaluator(opened_kitchen):
    world = World(opened_kitchen, WordCraftConfig("test", num_distractors=4))
    return Evaluator(world, distractor_seeds=2)


def follow(policy, **weights):
    """Set the mixing weights, equal in all states."""
    last = policy.mixture[2]
    with torch.no_grad():
        last.weight.zero_()
        for place, label in enumerate(policy.labels):
            last.bias[place] = weights.get(label.name, 0.0)


def test_a_source_with_weight_0_adds_nothing(policy, evaluator):
    follow(policy, v=1.0)
    result = evaluator(PolicyPlayer(policy))
    gains = source_gains([policy], evaluator, [result])
    assert gains.keys() == {"combines (u)", "component (v)"}
    unused = gains["combines (u)"]
    assert (unused.without, unused.gain) == (result.success.mean(), 0)
    assert unused.gain_ci == (0, 0)
    assert unused.adds_nothing
    expected = f"adds nothing: with its scores set to 0 the agent makes {unused.without:.3f}, "
    assert unused.sentence == expected + "a difference of +0.000 [+0.000, +0.000]"


def test_a_source_that_the_agent_follows_adds_its_paired_difference(policy, evaluator):
    follow(policy, u=1.0, v=1.0)
    result = evaluator(PolicyPlayer(policy))
    used = source_gains([policy], evaluator, [result])["component (v)"]
    assert used.without == evaluator(PolicyPlayer(policy, silent=["v"])).success.mean()
    assert used.gain == pytest.approx(result.success.mean() - used.without)
    assert used.gain_ci[0] > 0
    assert not used.adds_nothing
    assert used.sentence.startswith("adds to success")


def test_a_source_that_hurts_adds_nothing(policy, evaluator):
    follow(policy, u=1.0, v=-1.0)
    found = source_gains([policy], evaluator, [evaluator(PolicyPlayer(policy))])["component (v)"]
    assert found.gain < 0
    assert found.adds_nothing


def test_several_runs_count_together(policy, evaluator):
    follow(policy, v=1.0)
    results = [evaluator(PolicyPlayer(policy))] * 2
    once = source_gains([policy], evaluator, results[:1])
    assert source_gains([policy, policy], evaluator, results) == once


def test_silent_sources_score_0_and_others_as_before(policy):
    states = States(torch.tensor([0]), torch.tensor([1]), torch.tensor([[1, 2, 3, 4]]))
    scores = policy.external_scores(states)
    silenced = policy.external_scores(states, ["u"])
    assert scores[:, 0].any()
    assert not silenced[:, 0].any()
    assert torch.equal(silenced[:, 1], scores[:, 1])


def test_bins_hold_their_bounds_and_are_named_by_them():
    values = np.array([0, 1, 2, 3, 4, 9, 10, 1_000])
    found = {
        name: values[mask].tolist()
        for name, mask in binned(values, ((0, 0), (1, 3), (5, 9), (10, OPEN_END)))
    }
    assert found == {"0": [0], "1–3": [1, 2, 3], "5–9": [9], "10+": [10, 1_000]}


def test_the_name_of_the_last_bin_can_be_in_words():
    assert [name for name, _ in binned(np.arange(3), ((2, OPEN_END),), more=" or more")] == [
        "2 or more"
    ]
