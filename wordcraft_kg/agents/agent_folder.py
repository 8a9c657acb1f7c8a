"""The run folder of an agent: its settings, its checkpoints, and opening it for evaluation."""

import hashlib
import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors.torch
from torch import Tensor

from wordcraft_kg.agents.config import KIND, AgentConfig
from wordcraft_kg.artefacts import dump_json, read_json, write_atomically
from wordcraft_kg.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.policies.folder import read_policy
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.runs.inputs import open_run_graph
from wordcraft_kg.runs.record import read_run, verified_bytes
from wordcraft_kg.tensors import read_tensors

INPUTS = ("config.toml", "policy.json", "constants.safetensors")
"""Files that are there from the start and never change; their hashes stand in ``run.json``."""
KEPT = 2
"""Checkpoints: if the last one is damaged, the one before is still there."""


@dataclass(frozen=True)
class Checkpoint:
    """What :class:`Checkpoints` found: the trainer's tensors, and what was noted with them."""

    tensors: dict[str, Tensor]
    record: dict[str, Any]


class Checkpoints:
    """The last checkpoints of a run: ``checkpoints/step-N.safetensors``, each with a record of its hash beside it."""

    def __init__(self, folder: Path):
        """Take the run's folder."""
        self.run_folder = folder
        self.folder = folder / "checkpoints"

    def records(self) -> list[Path]:
        """Return the records that are there, latest first."""
        return sorted(self.folder.glob("step-*.json"), key=lambda path: int(path.stem.partition("-")[2]), reverse=True)

    def save(self, step: int, tensors: Mapping[str, Tensor], **facts: Any) -> None:
        """Write a checkpoint, then its record, then remove those before the last two."""
        self.folder.mkdir(exist_ok=True)
        data = safetensors.torch.save(dict(tensors))
        path = self.folder / f"step-{step}.safetensors"
        write_atomically(path, data, durable=True)
        record = {"step": step, "sha256": hashlib.sha256(data).hexdigest(), **facts}
        write_atomically(path.with_suffix(".json"), dump_json(record), durable=True)
        for old in self.records()[KEPT:]:
            old.unlink()
            old.with_suffix(".safetensors").unlink(missing_ok=True)

    def load(self) -> Checkpoint | None:
        """Return the last whole checkpoint, with a warning for each damaged one after it; None if there never was one.

        Raises:
            ArtefactError: if all are damaged.
        """
        damaged = []
        for path in self.records():
            tensors_path = path.with_suffix(".safetensors")
            try:
                record = read_json(path)
                data = tensors_path.read_bytes()
                if hashlib.sha256(data).hexdigest() != record["sha256"]:
                    raise ArtefactError(f"{tensors_path} is damaged: its SHA-256 is not the one written.")
                found = Checkpoint(read_tensors(tensors_path, data), record)
            except (WordCraftKGError, OSError, KeyError, TypeError) as error:
                damaged.append(str(error))
                continue
            for message in damaged:
                logging.getLogger(__name__).warning("%s Going on from the checkpoint before, %s.", message, path.stem)
            return found
        if damaged:
            raise ArtefactError(f"no checkpoint of '{self.run_folder}' is whole: {damaged[0]} Train the agent again.")
        return None


@dataclass(frozen=True)
class OpenedAgent:
    """An agent with everything that its evaluation needs.

    Attributes:
        name: of its folder.
        policy: with the weights of ``checkpoint``.
        checkpoint: ``final``, or ``step N`` of a run that is not done.
        config: its settings.
        opened: the graph and split it was trained on, checked by hash.
        run: its ``run.json``.
        metrics: the lines of ``metrics.jsonl``.
        evaluation: ``evaluation.json``, empty if the run is not done.
    """

    name: str
    policy: Policy
    checkpoint: str
    config: AgentConfig
    opened: OpenedGraph
    run: dict[str, Any]
    metrics: list[dict[str, Any]]
    evaluation: dict[str, Any]


def open_agent(folder: Path, graph: str | None = None) -> OpenedAgent:
    """Open a run folder; one that is not done is opened at its last checkpoint.

    Args:
        folder: written by ``train-agent``.
        graph: where its graph is now, if it has moved.

    Raises:
        ArtefactError: if there is no such run, it has no checkpoint yet, or a file is damaged.
        GraphMismatchError: if the graph or its split is not the one that it was trained on.
    """
    run = read_agent_run(folder)
    config = read_run_config(folder, run)
    opened = open_run_graph(folder, run, graph or config.graph)
    evaluation: dict[str, Any] = {}
    if run["status"] == "done":
        parameters = read_tensors(folder, verified_bytes(folder, run, "policy.safetensors"))
        checkpoint = "final"
        evaluation = json.loads(verified_bytes(folder, run, "evaluation.json"))
    else:
        found = Checkpoints(folder).load()
        if found is None:
            raise ArtefactError(f"'{folder}' is {run['status']} and has no checkpoint yet. Wait, or train it again.")
        parameters = {
            name.removeprefix("policy."): value for name, value in found.tensors.items() if name.startswith("policy.")
        }
        checkpoint = f"step {found.record['step']:,}"
    policy = read_policy(folder, constants_of(folder, run), parameters)
    lines = (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    if run["status"] != "done" and lines and not lines[-1].endswith("}"):
        lines.pop()  # cut off while it was written
    try:
        metrics = [json.loads(line) for line in lines]
    except ValueError as error:
        raise ArtefactError(f"{folder / 'metrics.jsonl'} is damaged ({error}). Restore a copy.") from None
    return OpenedAgent(folder.resolve().name, policy, checkpoint, config, opened, run, metrics, evaluation)


def read_agent_run(folder: Path) -> dict[str, Any]:
    """Read ``run.json`` of an agent's run.

    Raises:
        ArtefactError: if it is none.
    """
    if not folder.exists():
        raise ArtefactError(f"'{folder}' does not exist. Make it with `wordcraft-kg train-agent`.")
    run = read_run(folder)
    if run["kind"] != KIND:
        raise ArtefactError(f"'{folder}' was written by {run['kind']}; expected a run of train-agent.")
    return run


def read_run_config(folder: Path, run: dict[str, Any]) -> AgentConfig:
    """Read the settings of a run, after making sure that its inputs are those that it began with.

    Raises:
        ArtefactError: if ``config.toml`` or ``policy.json`` is missing or was changed.
    """
    for name in INPUTS[:2]:
        _input_bytes(folder, run, name)
    return AgentConfig.read(folder)


def constants_of(folder: Path, run: dict[str, Any]) -> bytes:
    """Return the bytes of ``constants.safetensors`` if they are those that the run began with.

    Raises:
        ArtefactError: if the file is missing or damaged.
    """
    return _input_bytes(folder, run, "constants.safetensors")


def _input_bytes(folder: Path, run: dict[str, Any], name: str) -> bytes:
    return verified_bytes(folder, {"outputs": run["inputs"]}, name)
