"""Training a link predictor on the full or the partial knowledge graph, into a model folder that serves as a scorer.

The folder grows as ``<out>.unfinished`` and becomes ``<out>`` when it is whole. Epoch ``n`` draws its randomness from
(seed, n) alone, so a checkpoint needs no generator states and a resumed run is bit-identical on CPU.
"""

import hashlib
import json
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from pykeen.training import NonFiniteLossError, TrainingLoop
from pykeen.training.callbacks import TrainingCallback

from wordcraft_kg.artefacts import (
    check_output,
    dump_json,
    read_json,
    replace_folder,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.errors import ArtefactError, ConfigError, OutputExistsError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.builders import make_training_loop, model_class, scorer_tensors
from wordcraft_kg.models.links.config import ComplExConfig, LinkConfig, LinkModelConfig, read_config
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, seed_everything, triples_factory
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples
from wordcraft_kg.models.scorers.tables import TABLE_LIMIT
from wordcraft_kg.runs.inputs import check_inputs
from wordcraft_kg.runs.interruption import first_interrupt
from wordcraft_kg.runs.record import end_run, read_run, resume_run, start_run, toml_value
from wordcraft_kg.tensors import check_device, read_tensors

UNFINISHED = ".unfinished"
RANKED_IN_TRAIN = 20_000
"""Training triples that are ranked at the end of a training, at most."""
Progress = Callable[[int, int, dict[str, float]], None]
"""Called after each epoch with the epoch, the number of epochs and the latest figures."""


@dataclass(frozen=True)
class TrainedLinks:
    """What a training run came to.

    Attributes:
        folder: the finished model folder, or the unfinished one of an interrupted run.
        metrics: content of ``metrics.json``; empty for an interrupted run.
        interrupted: whether Ctrl-C ended it; ``resume`` goes on.
        epoch: the last epoch that is safe on disk.
    """

    folder: Path
    metrics: dict[str, Any]
    interrupted: bool
    epoch: int


def train_links(
    opened: OpenedGraph, config: LinkConfig, out: Path, *, force: bool = False, progress: Progress | None = None
) -> TrainedLinks:
    """Train a link predictor and write its model folder.

    Raises:
        OutputExistsError: if ``out``, or an unfinished run of the same name, exists and ``force`` is False.
        ConfigError: if the settings do not fit the graph or the machine.
    """
    out = with_a_name(out)
    check_output(out, force=force)
    folder = out.with_name(out.name + UNFINISHED)
    if folder.exists() and not force:
        raise OutputExistsError(
            f"an unfinished run is in '{folder}'. Go on: wordcraft-kg resume {folder}, or start anew with --force."
        )
    _check_fit(opened, config)
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    write_atomically(folder / "config.toml", _config_toml(opened, config, out))
    run = start_run(
        folder,
        config.command,
        seed=config.seed,
        device=config.device,
        threads=config.threads,
        replaces=force,
        inputs={"graph": opened.graph.hash, "split": opened.split.hash},
    )
    return _run(opened, config, out, folder, run, progress)


def interruption_message(folder: Path, epoch: int) -> str:
    """Say what an interrupted run has kept and how to go on."""
    return f"interrupted; epoch {epoch} is saved. Go on with: wordcraft-kg resume {folder}"


def resume_links(
    folder: Path, *, graph: str | None = None, epochs: int | None = None, progress: Progress | None = None
) -> TrainedLinks:
    """Go on with an interrupted training run from its last checkpoint.

    On CPU, with the same torch and the same number of threads, the result is bit-identical to an undisturbed run.

    Args:
        folder: the unfinished folder, or the name it will have when finished.
        graph: where the graph is now, if it has moved.
        epochs: train up to this many epochs instead of the number first asked for.
        progress: called after each epoch.

    Raises:
        ArtefactError: if there is nothing to resume, or it is damaged.
        GraphMismatchError: if the graph or its split is not the one that the run began with.
    """
    folder = with_a_name(folder)
    unfinished = folder if folder.name.endswith(UNFINISHED) else folder.with_name(folder.name + UNFINISHED)
    if not unfinished.is_dir():
        state = "is finished; there is nothing to resume" if folder.is_dir() else "does not exist"
        raise ArtefactError(f"'{folder}' {state}. Train a model with `wordcraft-kg train-complex`.")
    out = unfinished.with_name(unfinished.name.removesuffix(UNFINISHED))
    run = read_run(unfinished)
    check_output(out, force=run.get("replaces", False))
    config, recorded_graph = read_config(unfinished)
    opened = open_graph(graph or recorded_graph)
    check_inputs(unfinished, run, opened)
    if run["versions"].get("torch") != torch.__version__:
        logging.getLogger(__name__).warning(
            "the run began with torch %s and goes on with %s: the result may differ in the last bits.",
            run["versions"].get("torch"),
            torch.__version__,
        )
    if epochs is not None:
        config = replace(config, epochs=epochs)
        done = _Checkpoints.last_epoch(unfinished)
        if epochs < done:
            raise ConfigError(f"--epochs {epochs}: the run has done {done} already; give {done} or more.")
    write_atomically(unfinished / "config.toml", _config_toml(opened, config, out))
    resume_run(unfinished, run)
    return _run(opened, config, out, unfinished, run, progress)


def _check_fit(opened: OpenedGraph, config: LinkConfig) -> None:
    if isinstance(config, LinkModelConfig):
        model_class(config.model)
        if len(RELATIONS) * opened.graph.num_entities**2 * 4 > TABLE_LIMIT:
            raise ConfigError(
                f"'{config.model}' is served from a table of all scores, too large for {opened.graph.num_entities:,} "
                "entities. Use train-complex."
            )
    if config.kg == "partial" and opened.split.config.kind == "none":
        raise ConfigError(
            "the split of this graph holds nothing out, so there is no partial graph to train on. Use --kg full, or "
            "build the graph with a split, such as --split by-recipe."
        )
    if config.kg == "full" and config.eval_every:
        raise ConfigError("--eval-every: the full graph holds the validation triples too; validate with --kg partial.")
    if config.eval_every and not len(opened.split.held_out("valid")):
        raise ConfigError(
            "--eval-every needs validation triples and this split has none. Build the graph with a validation part, "
            "such as --train-ratio 0.8 --valid-ratio 0.1."
        )
    check_device(config.device)


def _config_toml(opened: OpenedGraph, config: LinkConfig, out: Path) -> str:
    source = Path(opened.source)
    graph = os.path.relpath(source, out) if source.exists() else opened.source
    values = {"graph": graph} | {field.name: getattr(config, field.name) for field in fields(config)}
    lines = [f"[{config.command}]", *(f"{name} = {toml_value(value)}" for name, value in values.items())]
    return "\n".join(lines) + "\n"


def _run(
    opened: OpenedGraph,
    config: LinkConfig,
    out: Path,
    folder: Path,
    run: dict[str, Any],
    progress: Progress | None,
) -> TrainedLinks:
    triples = opened.triples(config.kg)
    factory = triples_factory(opened.graph, triples)
    try:
        with pykeen_guard(config.seed, config.threads), quiet_pykeen(), first_interrupt() as interrupted:
            loop = make_training_loop(config, factory)
            state = _Checkpoints(folder, opened, config, interrupted, progress)
            begun = state.restore(loop)
            if loop._epoch < config.epochs and not state.has_stopped:
                seed_everything(config.seed, loop._epoch + 1)
                loop.train(
                    factory,
                    num_epochs=config.epochs,
                    batch_size=config.batch_size,
                    continue_training=begun,
                    use_tqdm=False,
                    use_tqdm_batch=False,
                    pin_memory=torch.device(config.device).type == "cuda",
                    callbacks=state,
                )
            if interrupted.is_set() and loop._epoch < config.epochs and not state.has_stopped:
                end_run(folder, run, "interrupted")
                return TrainedLinks(folder, {}, True, loop._epoch)
            state.restore_best(loop)
            metrics = _finish(opened, config, folder, loop, state, triples)
    except BaseException as error:
        if (folder / "checkpoints" / "last.json").exists():
            end_run(folder, run, "interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
            if isinstance(error, KeyboardInterrupt):
                done = _Checkpoints.last_epoch(folder)
                raise KeyboardInterrupt(interruption_message(folder, done)) from None
        else:
            shutil.rmtree(folder)  # nothing in it to go on with
        if isinstance(error, NonFiniteLossError):
            raise ConfigError("the loss is no longer a finite number; train with a lower --learning-rate.") from None
        raise
    shutil.rmtree(folder / "checkpoints")
    end_run(folder, run, "done", ("model.safetensors", "vocabulary.json", "config.toml", "metrics.json", "trace.jsonl"))
    replace_folder(folder, out)
    return TrainedLinks(out, metrics, False, loop._epoch)


def _finish(
    opened: OpenedGraph,
    config: LinkConfig,
    folder: Path,
    loop: TrainingLoop,
    state: "_Checkpoints",
    triples: Ids,
) -> dict[str, Any]:
    model = loop.model
    model.eval()
    kind, tensors = scorer_tensors(config, model)
    scorer = make_scorer(kind, tensors, opened.graph.entities, opened.graph.hash)
    sample = triples
    if len(triples) > RANKED_IN_TRAIN:
        sample = triples[np.sort(np.random.default_rng(0).permutation(len(triples))[:RANKED_IN_TRAIN])]
    vocabulary = {
        "format": "wordcraft-kg vocabulary 1",
        "scorer": kind,
        "graph": opened.graph.hash,
        "entities": opened.graph.entities,
        "relations": RELATIONS,
    }
    metrics = {
        "kg": config.kg,
        "triples": len(triples),
        "epochs": loop._epoch,
        "best_epoch": state.best_epoch,
        "seconds": round(state.seconds, 3),
        "seconds_per_epoch": round(state.seconds / max(loop._epoch, 1), 4),
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
        "loss": state.trace[-1]["loss"],
        "valid_mrr": state.best_mrr,
        # Filtered by the training triples themselves: how well the model remembers, not how well it predicts.
        # On large graphs a fixed sample is enough.
        "train_mrr": mean_reciprocal_rank(rank_triples(scorer, sample, triples)),
        "train_mrr_triples": len(sample),
    }
    write_atomically(folder / "model.safetensors", safetensors.torch.save(_copy(tensors)))
    write_atomically(folder / "vocabulary.json", dump_json(vocabulary))
    write_atomically(folder / "metrics.json", dump_json(metrics))
    write_atomically(folder / "trace.jsonl", [json.dumps(row) + "\n" for row in state.trace])
    write_atomically(folder / "README.md", _model_card(opened, config, metrics))
    return metrics


class _Checkpoints(TrainingCallback):
    """After each epoch: validate, trace, save, reseed for the next epoch, and stop when asked to."""

    def __init__(
        self,
        folder: Path,
        opened: OpenedGraph,
        config: LinkConfig,
        interrupted: threading.Event,
        progress: Progress | None,
    ):
        super().__init__()
        self.folder = folder / "checkpoints"
        self.opened = opened
        self.config = config
        self.interrupted = interrupted
        self.progress = progress
        self.trace: list[dict[str, float]] = []
        self.seconds = 0.0
        self.best_mrr: float | None = None
        self.best_epoch: int | None = None
        self.has_stopped = False
        self._valid = opened.split.held_out("valid") if config.eval_every else None
        self._best: dict[str, torch.Tensor] = {}
        self._clock = time.perf_counter()

    def post_epoch(self, epoch: int, epoch_loss: float, **kwargs: Any) -> None:
        config = self.config
        row = {"epoch": epoch, "loss": epoch_loss}
        if self._valid is not None and (epoch % config.eval_every == 0 or epoch == config.epochs):
            row["valid_mrr"] = mrr = self._validate()
            if self.best_mrr is None or mrr > self.best_mrr:
                self.best_mrr, self.best_epoch = mrr, epoch
                self._best = _copy(self.model.state_dict())
            rankings = [line["valid_mrr"] for line in self.trace if "valid_mrr" in line] + [mrr]
            since_best = len(rankings) - 1 - int(np.argmax(rankings))
            self.has_stopped = bool(config.patience) and since_best >= config.patience
        now = time.perf_counter()
        row["seconds"] = round(now - self._clock, 4)
        self.seconds += now - self._clock
        self._clock = now
        self.trace.append(row)
        last = self.has_stopped or self.interrupted.is_set() or epoch == config.epochs
        if last or epoch % config.checkpoint_every == 0:
            self._save(epoch)
        if self.progress:
            self.progress(epoch, config.epochs, row)
        if last:
            self.training_loop._should_stop = True
        seed_everything(config.seed, epoch + 1)

    @staticmethod
    def last_epoch(folder: Path) -> int:
        """Return the epoch of the last checkpoint in a run's folder, 0 if there is none."""
        path = folder / "checkpoints" / "last.json"
        return int(read_json(path)["epoch"]) if path.exists() else 0

    def restore(self, loop: TrainingLoop) -> bool:
        """Load the last checkpoint into a training loop; return whether there was one.

        Raises:
            ArtefactError: if it is damaged.
        """
        path = self.folder / "last.json"
        if not path.exists():
            return False
        record = read_json(path)
        try:
            data = (self.folder / record["tensors"]).read_bytes()
            if hashlib.sha256(data).hexdigest() != record["sha256"]:
                raise ArtefactError(
                    f"{self.folder / record['tensors']} is damaged: its SHA-256 is not the one written."
                )
            tensors = read_tensors(self.folder / record["tensors"], data)
            loop.model.load_state_dict(_with_prefix(tensors, "model."))
            self._best = _with_prefix(tensors, "best.")
            values: dict[int, dict[str, Any]] = {}
            for name, value in _with_prefix(tensors, "optimizer.").items():
                index, _, key = name.partition(".")
                values.setdefault(int(index), {})[key] = value
            loop.optimizer.load_state_dict({"state": values, "param_groups": record["param_groups"]})
            loop._epoch = record["epoch"]
            loop.losses_per_epochs = [row["loss"] for row in record["trace"]]
            self.trace = record["trace"]
            self.seconds = record["seconds"]
            self.best_mrr, self.best_epoch = record["best_mrr"], record["best_epoch"]
            self.has_stopped = record["has_stopped"]
        except (KeyError, TypeError, AttributeError, RuntimeError, OSError) as error:
            raise ArtefactError(
                f"{path} is not a checkpoint of this run ({type(error).__name__}: {error}). Train anew."
            ) from None
        return True

    def restore_best(self, loop: TrainingLoop) -> None:
        """Return to the best epoch, if patience was asked for."""
        if self.config.patience and self._best:
            loop.model.load_state_dict(self._best)

    def _save(self, epoch: int) -> None:
        optimizer = self.optimizer.state_dict()
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        tensors |= {f"best.{name}": value for name, value in self._best.items()}
        for index, values in optimizer["state"].items():
            tensors |= {f"optimizer.{index}.{key}": torch.as_tensor(value) for key, value in values.items()}
        self.folder.mkdir(exist_ok=True)
        # A new file each time, then the record that names it: at every moment one complete checkpoint is named.
        name = f"epoch-{epoch}.safetensors"
        data = safetensors.torch.save(_copy(tensors))
        write_atomically(self.folder / name, data)
        record = {
            "epoch": epoch,
            "tensors": name,
            "sha256": hashlib.sha256(data).hexdigest(),
            "param_groups": optimizer["param_groups"],
            "trace": self.trace,
            "seconds": self.seconds,
            "best_mrr": self.best_mrr,
            "best_epoch": self.best_epoch,
            "has_stopped": self.has_stopped,
        }
        write_atomically(self.folder / "last.json", dump_json(record))
        for old in self.folder.glob("epoch-*.safetensors"):
            if old.name != name:
                old.unlink()

    def _validate(self) -> float:
        self.model.eval()
        graph = self.opened.graph
        scorer = make_scorer(*scorer_tensors(self.config, self.model), graph.entities, graph.hash)
        ranks = rank_triples(scorer, self._valid, graph.triples)  # type: ignore[arg-type]
        self.model.train()
        return mean_reciprocal_rank(ranks)


def _copy(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}


def _with_prefix(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _model_card(opened: OpenedGraph, config: LinkConfig, metrics: dict[str, Any]) -> str:
    name = "ComplEx" if isinstance(config, ComplExConfig) else config.model
    seen = (
        "It was trained on all triples, those of the test recipes included: its scores say what it remembers."
        if config.kg == "full"
        else "It was trained on the triples of the train recipes only."
    )
    return f"""# {name} on the {config.kg} knowledge graph of {opened.graph.name}

Scores triples (head, relation, tail) with the relations `combinesWith` and `componentOf`. {seen}

- graph `{opened.graph.hash[:12]}`: {opened.graph.num_entities:,} entities; split `{opened.split.config.kind}`, seed \
{opened.split.config.seed}; {metrics["triples"]:,} training triples
- {metrics["epochs"]} epochs, {metrics["parameters"]:,} parameters, MRR on its own training triples \
{metrics["train_mrr"]:.3f}

`config.toml` reproduces it; `run.json` says with which versions it was made. Its quality on unseen triples is what
`wordcraft-kg evaluate-links` reports, not the figure above. Scores are not calibrated probabilities.

```python
from wordcraft_kg.models import load_scorer

scorer = load_scorer("this folder")
scorer.top(None, "componentOf", {opened.graph.entities[0]!r})
```
"""
