"""States: parts of a batch, and observations in any number type and shape."""

import gymnasium as gym
import numpy as np
import pytest
import torch

import wordcraft_kg  # noqa: F401 - registers the environments
from wordcraft_kg.models.policies.states import Attempts, States


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
