"""Opening the run folder of an agent for evaluation."""

from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.agents.config import AgentConfig
from wordcraft_kg.agents.records import AgentProgress, AgentSummary, MetricsRow, read_metrics, read_summary
from wordcraft_kg.artefacts import read_small_file
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.policies.folder import read_policy
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.folder import RunKind
from wordcraft_kg.runs.inputs import open_run_graph
from wordcraft_kg.runs.record import RunRecord, verified_bytes
from wordcraft_kg.runs.seeds import run_name
from wordcraft_kg.tensors import read_tensors, with_prefix

AGENTS = RunKind((AgentConfig.command,), unit="step", progress=AgentProgress, judged_by="evaluate-agent")
INPUTS = ("policy.json", "constants.safetensors")
"""Files that exist from the start and never change; their hashes are in ``run.json``."""


@dataclass(frozen=True)
class OpenedAgent:
    """An agent with everything that its evaluation needs.

    Attributes:
        name: name of its folder, see :func:`~wordcraft_kg.runs.seeds.run_name`.
        policy: has the weights of ``checkpoint``.
        checkpoint: ``final``, or ``step N`` for a run that is not done.
        config: its settings.
        opened: the graph and split it was trained on, checked by hash.
        run: its ``run.json``.
        metrics: the lines of ``metrics.jsonl``.
        evaluation: ``evaluation.json``, None if the run is not done.
    """

    name: str
    policy: Policy
    checkpoint: str
    config: AgentConfig
    opened: OpenedGraph
    run: RunRecord
    metrics: list[MetricsRow]
    evaluation: AgentSummary | None

    @property
    def provenance(self) -> dict[str, str]:
        """Facts for a report."""
        run = self.run
        facts = {
            "trained by": " ".join(run.argv),
            "finished": run.ended or "",
            "weights": f"{self.checkpoint} {run.outputs.get('policy.safetensors', '')}".rstrip(),
            "versions": ", ".join(f"{name} {number}" for name, number in run.versions.items()),
        }
        return facts | {
            name: run.inputs[name] for name in ("graph", "split", "scorer", "scorer_folds") if name in run.inputs
        }


def open_agent(folder: str | Path, graph: str | None = None) -> OpenedAgent:
    """Open a run folder; one that is not done is opened at its last checkpoint.

    Args:
        folder: written by ``train-agent``.
        graph: where the graph is now, if it has moved.

    Raises:
        ArtefactError: if there is no such run, it has no checkpoint yet, or a file is damaged.
        GraphMismatchError: if the graph or its split is not the one that it was trained on.

    Example:
        >>> open_agent("runs/kitchen").config.tasks.distractors
        8
    """
    folder = Path(folder)
    run = AGENTS.read_record(folder)
    config = read_run_config(folder, run)
    opened = open_run_graph(folder, run, graph or config.graph)
    path = folder / "metrics.jsonl"
    evaluation = None
    if run.status == "done":
        weights = "policy.safetensors"
        parameters = read_tensors(folder / weights, verified_bytes(folder, run, weights))
        policy = read_policy(folder, verified_bytes(folder, run, "constants.safetensors"), parameters)
        checkpoint, evaluation = "final", read_summary(folder, run)
        lines = verified_bytes(folder, run, path.name)
    else:
        found = AGENTS.checkpoints(folder).load()
        policy = policy_at(folder, run, found)
        checkpoint = f"step {found.number:,}"
        lines = read_small_file(path)
        lines = lines[: lines.rfind(b"\n") + 1]  # the last one may be half written
    metrics = read_metrics(lines, path)
    return OpenedAgent(run_name(folder), policy, checkpoint, config, opened, run, metrics, evaluation)


def policy_at(folder: Path, run: RunRecord, checkpoint: Checkpoint[AgentProgress]) -> Policy:
    """Return the policy of a checkpoint.

    Raises:
        ArtefactError: if the folder's files do not fit each other.
    """
    constants = verified_bytes(folder, run, "constants.safetensors")
    return read_policy(folder, constants, with_prefix(checkpoint.tensors, "policy."))


def read_run_config(folder: Path, run: RunRecord) -> AgentConfig:
    """Read the settings of a run, after checking that they are those that it began with.

    Raises:
        ArtefactError: if ``config.toml`` or ``policy.json`` is missing or was changed.
    """
    for name in ("config.toml", "policy.json"):
        verified_bytes(folder, run, name)
    return AgentConfig.read(folder)
