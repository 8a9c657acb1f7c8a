"""``wordcraft-kg train-agent``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.agents.config import ImpalaConfig, TaskConfig
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.models.policies.config import PolicyConfig

EXAMPLES = (
    "wordcraft-kg train-agent everyday --out runs/no-kg",
    "wordcraft-kg train-agent graphs/everyday --scorer models/everyday-partial --out runs/partial",
)


def train_agent(
    graph: str,
    *,
    scorer: Path | None = None,
    tasks: Annotated[TaskConfig, Parameter(name="*", group="Tasks")] = TaskConfig(),
    policy: Annotated[PolicyConfig, Parameter(name="*", group="Policy")] = PolicyConfig(),
    trainer: Annotated[ImpalaConfig, Parameter(name="*", group="Training")] = ImpalaConfig(),
    out: Path | None = None,
    force: Flag = False,
    tensorboard: Flag = False,
    output: Output = Output(),
) -> int:
    """Train an agent with IMPALA on a graph's crafting tasks, alone or guided by a scorer.

    Args:
        graph: graph folder, recipe book or known book's name.
        scorer: model folder whose scores are mixed into the policy; the scorer is not trained.
        tasks: what the agent is trained on.
        policy: how it decides.
        trainer: how it learns.
        out: run folder to write. Default: runs/<graph's name>-<scorer's folder or no-kg>.
        force: replace the folder if it exists.
        tensorboard: also write TensorBoard's event files (needs the extra tensorboard).
    """
    from wordcraft_kg.agents.config import AgentConfig
    from wordcraft_kg.agents.training import train_agent
    from wordcraft_kg.cli.training import report_agent

    config = AgentConfig(graph, None if scorer is None else str(scorer), tasks, policy, trainer)
    progress = output.progress("agent", unit="step")
    trained = train_agent(config, out, force=force, tensorboard=tensorboard, progress=progress)
    return report_agent(trained, graph, output)
