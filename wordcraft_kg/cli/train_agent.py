"""``wordcraft-kg train-agent``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.cli.console import Output, split_labels
from wordcraft_kg.cli.options import Force, Graph, Seeds, Trackers
from wordcraft_kg.cli.training import AgentsTraining, train
from wordcraft_kg.models.policies.config import PolicyConfig

EXAMPLES = (
    "wordcraft-kg train-agent everyday --out runs/no-kg",
    "wordcraft-kg train-agent graphs/everyday --scorer models/everyday --out runs/partial",
    "wordcraft-kg train-agent everyday --seeds 0-4 --out runs/no-kg-seeds",
)

# Settings of the paper's released code, or chosen once for all by studies.
FILE_ONLY = [
    "--ambiguity",
    "--baseline-cost",
    "--batch-size",
    "--checkpoint-every",
    "--clip",
    "--compile",
    "--discount",
    "--distractor-policy",
    "--distractor-weighting",
    "--dropout",
    "--embedding-size",
    "--entropy-cost",
    "--hidden-size",
    "--key-size",
    "--log-every",
    "--memory-cost",
    "--momentum",
    "--pair-size",
    "--pays-held-out",
    "--plan-width",
    "--policy-lag",
    "--pooling",
    "--rms-decay",
    "--rms-epsilon",
    "--scale",
    "--sees-attempts",
    "--self-edges",
    "--tables",
    "--task-weighting",
    "--unroll",
    "--value-readout",
    "--value-size",
    "--vector-noise",
]


def train_agent(  # noqa: PLR0913 - parameters are the command's options
    graph: Graph,
    *,
    scorer: Path | None = None,
    tasks: Annotated[TaskConfig, Parameter(name="*", group="Tasks")] = TaskConfig(),
    policy: Annotated[PolicyConfig, Parameter(name="*", group="Policy")] = PolicyConfig(),
    trainer: Annotated[ImpalaConfig, Parameter(name="*", group="Training")] = ImpalaConfig(),
    seeds: Seeds = None,
    out: Path | None = None,
    force: Force = False,
    track: Trackers = None,
    output: Output = Output(),
) -> int:
    """Train an agent with IMPALA on the crafting tasks of a graph, alone or guided by a scorer.

    Args:
        scorer: model folder with scores to mix into the policy; the scorer is not trained.
        out: run folder to write. Default: runs/<graph name>-<scorer folder or no-kg>.
    """
    config = AgentConfig(graph, None if scorer is None else str(scorer), tasks, policy, trainer)
    config.check_preset()
    return train(
        AgentsTraining(),
        config,
        out,
        force,
        output,
        seeds=seeds,
        trackers=split_labels(track or ()),
    )
