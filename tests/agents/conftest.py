"""The kitchen with its split, and a small agent of it that is trained once."""

import pytest

from wordcraft_kg import AgentConfig, ImpalaConfig, TaskConfig, train_agent


@pytest.fixture(scope="session")
def config():
    """100 updates of 16 steps."""
    trainer = ImpalaConfig(
        steps=1_600, batch_size=8, unroll=2, log_every=160, eval_every=800, checkpoint_every=320
    )
    return AgentConfig("kitchen", None, TaskConfig(distractors=3), trainer=trainer)


@pytest.fixture(scope="session")
def done(config, made_once):
    """The run folder of this training; read only."""
    return made_once("kitchen-agent", lambda out: train_agent(config, out))
