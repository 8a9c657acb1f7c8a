"""``wordcraft-kg train-agent``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.agents.config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.options import Book, Scorer, Words
from wordcraft_kg.cli.training import ToldAgents, train
from wordcraft_kg.models.policies.config import PolicyConfig

EXAMPLES = (
    "wordcraft-kg train-agent everyday --out runs/no-kg",
    "wordcraft-kg train-agent graphs/everyday --scorer models/everyday --out runs/partial",
    "wordcraft-kg train-agent everyday --seeds 0-4 --out runs/no-kg-seeds",
)


def train_agent(
    graph: Book,
    *,
    scorer: Scorer = None,
    tasks: Annotated[TaskConfig, Parameter(name="*", group="Tasks")] = TaskConfig(),
    policy: Annotated[PolicyConfig, Parameter(name="*", group="Policy")] = PolicyConfig(),
    trainer: Annotated[ImpalaConfig, Parameter(name="*", group="Training")] = ImpalaConfig(),
    seeds: str | None = None,
    out: Path | None = None,
    force: Flag = False,
    track: Words = None,
    output: Output = Output(),
) -> int:
    """Train an agent with IMPALA on a graph's crafting tasks, alone or guided by a scorer.

    Args:
        graph: graph folder, recipe book or known book's name.
        scorer: model folder whose scores are mixed into the policy; the scorer is not trained.
        tasks: what the agent is trained on.
        policy: how it decides.
        trainer: how it learns.
        seeds: seeds to train one after the other, such as 0-4 or 0,3,7, each in a folder seed-N of its own. Seeds that
            are done are kept, so the same command goes on after Ctrl-C.
        out: run folder to write. Default: runs/<graph's name>-<scorer's folder or no-kg>.
        force: replace the folder if it exists.
        track: where the metrics go too, comma-separated: tensorboard, wandb (offline), mlflow (a local file); each
            needs the extra of its name.
    """
    config = AgentConfig(graph, None if scorer is None else str(scorer), tasks, policy, trainer)
    return train(ToldAgents(), config, out, force, output, seeds=seeds, trackers=split_labels(track or ()))
