"""Run folders of agents: reading the records, and opening the trained agent.

Files may be damaged, or written to by a training at this moment. So everything is verified by the
hashes in ``run.json``, and damage is an ArtefactError that names the file.
"""

import logging
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_config import AgentConfig
from wordcraft_kg.agents.agent_records import (
    AgentProgress,
    AgentSummary,
    MetricsRow,
    read_metrics,
    read_summary,
)
from wordcraft_kg.base import GraphMismatchError, WordCraftKGError, read_small_file
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.graphs.graph_folder import GraphLike, OpenedGraph
from wordcraft_kg.models.model_folder import open_model, read_history
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.policy_folder import load_policy, read_policy
from wordcraft_kg.models.policies.sources import W
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidenceFinder
from wordcraft_kg.models.scorers.scorer_folder import WEIGHTS
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.record import RunFiles, RunRecord, run_name
from wordcraft_kg.runs.run_folder import RunKind

AGENTS = RunKind(AgentConfig.commands, "agent", unit="step", progress=AgentProgress)
METRICS_FILE = "metrics.jsonl"
"""Name of the file with the training's metrics, a line for each point in time."""
INPUTS = ("policy.json", "constants.safetensors")
"""Files in a run folder that never change during training; ``run.json`` hashes them."""


@dataclass(frozen=True, eq=False)
class AgentRun:
    """The records in an agent's run folder, finished or not, without graph and weights.

    Attributes:
        name: display name, see :func:`~wordcraft_kg.runs.record.run_name`.
        checkpoint: ``final``, ``step N`` for an unfinished run, or empty before the first
            checkpoint.
        config: training settings.
        run: ``run.json``: command, versions, hashes and status.
        metrics: lines in ``metrics.jsonl``.
        evaluation: the final evaluation; None for an unfinished run.
    """

    name: str
    checkpoint: str
    config: AgentConfig
    run: RunRecord
    metrics: list[MetricsRow]
    evaluation: AgentSummary | None

    @property
    def provenance(self) -> dict[str, str]:
        """Command, end, weights, versions and input hashes, as texts for reports."""
        run = self.run
        weights = f"{self.checkpoint} {run.outputs.get('policy.safetensors', '')}"
        facts = {
            "trained by": " ".join(run.argv),
            "finished": run.ended or "",
            "weights": weights.rstrip(),
            "versions": ", ".join(f"{name} {number}" for name, number in run.versions.items()),
        }
        inputs = ("graph", "split", "scorer", "scorer_folds")
        return facts | {name: run.inputs[name] for name in inputs if name in run.inputs}


@dataclass(frozen=True, eq=False)
class OpenedAgent(AgentRun):
    """An agent ready for evaluation.

    Attributes:
        policy: the policy with the weights at ``checkpoint``.
        opened: the graph and split of the training, verified by hash.
    """

    policy: Policy
    opened: OpenedGraph

    @cached_property
    def outside(self) -> OutsideEvidenceFinder | None:
        """Evidence of the agent's outside knowledge.

        None without outside knowledge, or with a warning if the scorer's folder has changed: an
        explanation without this evidence is better than none.
        """
        if self.config.scorer is None or W.name not in self.policy.sources:
            return None
        try:
            return OutsideEvidenceFinder.open(
                self.config.scorer, self.opened, self.run.inputs.get("scorer")
            )
        except WordCraftKGError as error:
            logging.getLogger(__name__).warning("no evidence from outside knowledge: %s", error)
            return None

    @cached_property
    def made_by_other_books(self) -> frozenset[str] | None:
        """Labels that another book in the scorer's training makes.

        None without another book, or if the scorer's folder has moved or changed.
        """
        if self.config.scorer is None:
            return None
        with suppress(WordCraftKGError):
            history = read_history(self.config.scorer, self.run.inputs.get("scorer", ""))
            return None if history is None else history.made_by_other_books
        return None

    @cached_property
    def trained_on(self) -> NDArray[np.bool_]:
        """Recipes that the scorer was trained on, shape (num_recipes,).

        If the scorer's folder has moved or changed, with a warning all recipes of the recorded
        kind, such as all train recipes, of which the training may have had a sample.
        """
        if self.config.scorer is not None:
            with suppress(WordCraftKGError):
                model = open_model(self.config.scorer, self.opened.source)
                if model.run.outputs[WEIGHTS] == self.run.inputs.get("scorer"):
                    return model.train_sample.is_trained_on & ~model.train_sample.is_wrong
            logging.getLogger(__name__).warning(
                "the scorer's folder '%s' has moved or changed: recipes count as in-sample by the "
                "record of the run (knowledge graph: %s), even if the scorer had a sample of them.",
                self.config.scorer,
                self.run.kg,
            )
        return self.opened.train_sample(self.run.kg or "none").is_trained_on


def read_agent_run(folder: str | Path) -> AgentRun:
    """Read the records in an agent's run folder; the run may still be training.

    Raises:
        ArtefactError: if the run does not exist, or a file is damaged.
    """
    folder = Path(folder)
    files = RunFiles(folder, AGENTS.read_record(folder))
    for name in (CONFIG_FILE, "policy.json"):
        files.bytes(name)  # unchanged since the start
    config = AgentConfig.read(folder)
    name = run_name(folder)
    if files.run.status == "done":
        metrics = read_metrics(files.bytes(METRICS_FILE), folder / METRICS_FILE)
        return AgentRun(name, "final", config, files.run, metrics, read_summary(files))
    last = next(iter(AGENTS.checkpoints(folder).records()), None)
    checkpoint = "" if last is None else f"step {last:,}"
    path = folder / METRICS_FILE
    lines = read_small_file(path) if path.exists() else b""
    # Another process may be writing the last line at this moment.
    complete = lines[: lines.rfind(b"\n") + 1]
    metrics = read_metrics(complete, path)
    return AgentRun(name, checkpoint, config, files.run, metrics, None)


def open_agent(folder: str | Path, graph: GraphLike | None = None) -> OpenedAgent:
    """Open an agent's run folder for evaluation; an unfinished run at its last checkpoint.

    Args:
        folder: run folder, written by ``train_agent``.
        graph: new location of a moved graph, or the opened graph; None for the recorded location.

    Raises:
        ArtefactError: if the run does not exist or has no checkpoint yet, its graph is not found,
            or a file is damaged.
        GraphMismatchError: if the graph or split differs from training.

    Example:
        >>> open_agent("runs/kitchen").config.tasks.distractors
        8
    """
    folder = Path(folder)
    records = read_agent_run(folder)
    files = RunFiles(folder, records.run)
    checkpoint = records.checkpoint
    source = files.graph(graph or records.config.graph)
    if records.run.status == "done":
        policy = load_policy(folder)
    else:
        last = AGENTS.checkpoints(folder).load()
        policy = policy_at(files, last)
        # Training may have written a checkpoint since the records were read.
        checkpoint = f"step {last.number:,}"
    # The record may name another graph than the run: ids would stand for other entities.
    is_of_graph = policy.graph_hash == source.graph.hash
    if not is_of_graph or tuple(policy.entities) != tuple(source.graph.entities):
        raise GraphMismatchError(
            f"{folder / 'policy.json'} has other entities than '{source.source}', or another graph "
            f"({policy.graph_hash[:12]} instead of {source.graph.hash[:12]}). Restore a copy of "
            "the folder, or train again."
        )
    return OpenedAgent(
        **{**vars(records), "checkpoint": checkpoint},
        policy=policy,
        opened=source,
    )


def policy_at(files: RunFiles, checkpoint: Checkpoint[AgentProgress]) -> Policy:
    """Load a run's policy with the weights at a checkpoint.

    Raises:
        ArtefactError: if a file is missing or has changed, or the files do not fit each other.
    """
    files.bytes("policy.json")
    parameters = with_prefix(checkpoint.tensors, "policy.")
    return read_policy(files.folder, files.bytes("constants.safetensors"), parameters)
