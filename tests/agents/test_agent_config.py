"""Settings of the trainer and its tasks: defaults, ranges, and what follows from them."""

import re
from dataclasses import fields

import pytest
from refusals import refuses

from wordcraft_kg import ImpalaConfig, TaskConfig, WordCraftConfig
from wordcraft_kg.base.errors import ConfigError

NAN, INF = float("nan"), float("inf")
COUNTS = ("steps", "batch_size", "unroll", "threads", "log_every", "checkpoint_every")


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        *((name, value) for name in COUNTS for value in (0, -5)),
        *((name, -1) for name in ("policy_lag", "seed", "eval_every")),
        *((name, value) for name in ("learning_rate", "rms_epsilon", "clip") for value in (0.0, -1.0, NAN, INF)),
        *((name, value) for name in ("entropy_cost", "baseline_cost") for value in (-0.1, NAN, INF)),
        *((name, value) for name in ("discount", "rms_decay", "momentum") for value in (-0.1, 1.1, NAN)),
        ("device", "gpu"),
        ("device", ""),
    ],
)
def test_a_setting_out_of_range_is_an_error_that_names_it_and_its_value(setting, value):
    with pytest.raises(ConfigError, match="^" + re.escape(f"`{setting}` {value!r}: expected ")):
        ImpalaConfig(**{setting: value})


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        *((name, 1) for name in COUNTS),
        *((name, 0) for name in ("policy_lag", "seed", "eval_every", "entropy_cost", "baseline_cost")),
        *((name, value) for name in ("discount", "rms_decay", "momentum") for value in (0.0, 1.0)),
        ("device", "cuda"),
        ("device", "cuda:1"),
    ],
)
def test_the_ends_of_the_ranges_are_allowed(setting, value):
    assert getattr(ImpalaConfig(**{setting: value}), setting) == value


def test_the_defaults_are_the_papers():
    config = ImpalaConfig()
    assert (config.steps, config.batch_size, config.unroll, config.discount) == (3_000_000, 128, 2, 0.99)
    assert (config.learning_rate, config.rms_epsilon, config.entropy_cost) == (0.001, 0.01, 0.01)
    # Not in the paper but in its released code.
    assert (config.rms_decay, config.momentum, config.clip, config.baseline_cost) == (0.99, 0.0, 40.0, 0.5)
    assert config.policy_lag == 0


@pytest.mark.parametrize(("steps", "updates"), [(1, 1), (24, 1), (25, 2), (240, 10), (241, 11)])
def test_steps_are_rounded_up_to_whole_updates(steps, updates):
    config = ImpalaConfig(steps=steps, batch_size=8, unroll=3)
    assert config.steps_per_update == 24
    assert config.updates == updates


@pytest.mark.parametrize(
    ("setting", "options"),  # of the environment, which has tests of each
    [
        ("depth", {"depth": 6}),
        ("num_distractors", {"distractors": -1}),
        ("max_attempts", {"depth": 2, "max_attempts": 1}),
    ],
)
def test_a_task_setting_out_of_range_is_an_error_that_names_it(setting, options):
    with refuses(setting):
        TaskConfig(**options)


def test_the_environment_gets_all_settings_of_the_tasks():
    other = {"depth": 2, "max_attempts": 3, "reward": "official", "distractor_weighting": "uniform"}
    other |= {"distractor_policy": "no_shortcut", "task_weighting": "goal", "ambiguity": "last"}
    tasks = TaskConfig(distractors=7, **other)
    assert all(getattr(tasks, field.name) != getattr(TaskConfig(), field.name) for field in fields(TaskConfig))
    assert tasks.environment("test") == WordCraftConfig(part="test", num_distractors=7, **other)
    assert tasks.environment("train", 0) == WordCraftConfig(part="train", num_distractors=0, **other)
    assert TaskConfig().environment("train") == WordCraftConfig(part="train")
