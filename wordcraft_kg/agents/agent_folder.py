"""The run folder of an agent: its settings, its checkpoints, and opening it for evaluation."""

import hashlib
import json
import logging
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import safetensors.torch
from torch import Tensor

from wordcraft_kg.agents.config import ImpalaConfig, TaskConfig
from wordcraft_kg.artefacts import dump_json, read_json, write_atomically
from wordcraft_kg.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.features import NAMED
from wordcraft_kg.models.model_folder import open_run_graph
from wordcraft_kg.models.policies import Policy
from wordcraft_kg.models.policy_config import PolicyConfig
from wordcraft_kg.models.policy_folder import read_policy
from wordcraft_kg.models.scorers import read_tensors
from wordcraft_kg.runs import read_run, toml_value, verified_bytes

KIND = "train-agent"
PATHS = ("graph", "scorer")
INPUTS = ("config.toml", "policy.json", "constants.safetensors")
"""Files that are there from the start and never change; their hashes stand in ``run.json``."""
KEPT = 2
"""Checkpoints: if the last one is damaged, the one before is still there."""


@dataclass(frozen=True)
class AgentConfig:
    """All that makes a run, as ``config.toml`` keeps it.

    Attributes:
        graph: folder, book's file or known book's name.
        scorer: model folder, or None.
        tasks: what is trained on.
        policy: what decides.
        trainer: how it learns.
    """

    graph: str
    scorer: str | None
    tasks: TaskConfig
    policy: PolicyConfig
    trainer: ImpalaConfig

    def values(self) -> dict[str, Any]:
        """Return the settings by option name; those that are None are left out."""
        found: dict[str, Any] = {"graph": self.graph, "scorer": self.scorer}
        for part in (self.tasks, self.policy, self.trainer):
            found |= {field.name: getattr(part, field.name) for field in fields(part)}
        return {name: value for name, value in found.items() if value is not None}

    def differing(self) -> dict[str, Any]:
        """Return the settings that are not at their default."""
        default = AgentConfig("", None, TaskConfig(), PolicyConfig(), ImpalaConfig()).values()
        return {name: value for name, value in self.values().items() if default.get(name) != value}

    def write(self, folder: Path) -> None:
        """Write ``config.toml`` and ``config.diff.toml``; paths become relative to the folder, so both can move."""
        for name, values in (("config.toml", self.values()), ("config.diff.toml", self.differing())):
            keys = PATHS if values.get("features") in NAMED else (*PATHS, "features")
            there = [key for key in keys if key in values and Path(values[key]).exists()]
            relative = {key: os.path.relpath(values[key], folder) for key in there}
            lines = (f"{key} = {toml_value(value)}" for key, value in {**values, **relative}.items())
            write_atomically(folder / name, "\n".join([f"[{KIND}]", *lines]) + "\n")

    @classmethod
    def read(cls, folder: Path) -> "AgentConfig":
        """Read ``config.toml``.

        Raises:
            ArtefactError: if it is missing or damaged.
        """
        path = folder / "config.toml"
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))[KIND]
            paths = {key: table.pop(key, None) for key in PATHS}
            for key, value in paths.items():
                if value is not None and (folder / value).exists():
                    paths[key] = os.path.normpath(folder / value)
            tasks, policy, trainer = (
                {field.name: table.pop(field.name) for field in fields(kind) if field.name in table}
                for kind in (TaskConfig, PolicyConfig, ImpalaConfig)
            )
            if table:
                raise ValueError(f"there is no option '{next(iter(table))}'")
            return cls(
                paths["graph"], paths["scorer"], TaskConfig(**tasks), PolicyConfig(**policy), ImpalaConfig(**trainer)
            )
        except FileNotFoundError:
            raise ArtefactError(f"{path} is missing; '{folder}' is incomplete. Train the agent again.") from None
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ArtefactError(f"{path} is damaged ({error}). Train the agent again, or restore a copy.") from None


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
        data: the graph and split it was trained on, checked by hash.
        run: its ``run.json``.
        metrics: the lines of ``metrics.jsonl``.
        evaluation: ``evaluation.json``, empty if the run is not done.
    """

    name: str
    policy: Policy
    checkpoint: str
    config: AgentConfig
    data: OpenedGraph
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
    data = open_run_graph(folder, run, graph or config.graph)
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
    return OpenedAgent(folder.resolve().name, policy, checkpoint, config, data, run, metrics, evaluation)


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
