"""Training a link predictor on the full or the partial knowledge graph, into a model folder that serves as a scorer.

The folder grows as ``<out>.unfinished`` and becomes ``<out>`` when it is whole. Epoch ``n`` draws its randomness from
(seed, n) alone, so a checkpoint needs no generator states and a resumed run is bit-identical on CPU.
"""

import json
import logging
import math
import shutil
import signal
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.torch
import torch
from pykeen.losses import loss_resolver
from pykeen.models import Model, model_resolver
from pykeen.training import TrainingLoop, training_loop_resolver
from pykeen.training.callbacks import TrainingCallback
from pykeen.triples import TriplesFactory

from wordcraft_kg.artefacts import check_output, dump_json, read_json, replace_folder, write_atomically
from wordcraft_kg.errors import ArtefactError, ConfigError, GraphMismatchError, OutputExistsError, nearest
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.recipe_graph import Ids
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.complex import DIM, INIT_SCALE, N3_WEIGHT, ComplExN3
from wordcraft_kg.models.link_prediction import rank_triples, ranking_metrics
from wordcraft_kg.models.pykeen_bridge import pykeen_guard, seed_everything, triples_factory
from wordcraft_kg.models.scorers import ComplExScorer, Scorer, TableScorer, read_tensors
from wordcraft_kg.models.symmetric_lcwa import IndexedSymmetricLCWATrainingLoop
from wordcraft_kg.runs import end_run, read_run, start_run

UNFINISHED = ".unfinished"
Progress = Callable[[int, int, dict[str, float]], None]
"""Called after each epoch with the epoch, the number of epochs and the latest figures."""


@dataclass(frozen=True)
class TrainingConfig:
    """What every link predictor's training has.

    Attributes:
        kg: triples to train on: partial (those of the train recipes) or full (all of them, test recipes included).
        epochs: passes over the triples.
        batch_size: triples a step.
        eval_every: epochs between rankings of the validation triples; 0 never ranks them.
        patience: rankings without a better validation MRR before training stops and returns to the best epoch; 0
            never stops early.
        checkpoint_every: epochs between checkpoints.
        seed: root seed of initialisation and batches.
        device: torch device to train on, such as cpu or cuda.
        threads: CPU threads; 1 is rarely slower for models this small, and much faster on a busy machine.
    """

    kg: Literal["partial", "full"] = "partial"
    epochs: int = 50
    batch_size: int = 512
    eval_every: int = 0
    patience: int = 0
    checkpoint_every: int = 10
    seed: int = 0
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        for name in ("epochs", "batch_size", "checkpoint_every", "threads"):
            _require(self, name, getattr(self, name) >= 1, "1 or more")
        for name in ("eval_every", "patience", "seed"):
            _require(self, name, getattr(self, name) >= 0, "0 or more")
        if self.patience and not self.eval_every:
            raise ConfigError("patience counts rankings of the validation triples; give --eval-every too, such as 5.")


@dataclass(frozen=True)
class ComplExConfig(TrainingConfig):
    """ComplEx with the paper's objective.

    Attributes:
        dim: complex dimensions; 128 is the paper's.
        learning_rate: of Adagrad; 0.1 as in Lacroix et al. 2018.
        n3: weight of the N3 regulariser. Default: 0.1 on the partial graph, chosen on validation parts; 0 on the full
            graph, which is there to be remembered, not generalised from.
        init_scale: standard deviation of the initial embeddings; 0.001 as in the paper's released code.
    """

    dim: int = DIM
    learning_rate: float = 0.1
    n3: float | None = None
    init_scale: float = INIT_SCALE

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self, "dim", self.dim >= 1, "1 or more")
        for name in ("learning_rate", "init_scale"):
            value = getattr(self, name)
            _require(self, name, math.isfinite(value) and value > 0, "more than 0")
        if self.n3 is None:
            object.__setattr__(self, "n3", N3_WEIGHT if self.kg == "partial" else 0.0)
        _require(self, "n3", math.isfinite(self.n3 or 0) and (self.n3 or 0) >= 0, "0 or more")

    @property
    def command(self) -> str:
        """The command that takes this configuration."""
        return "train-complex"

    def training_loop(self, factory: TriplesFactory) -> TrainingLoop:
        """Build the PyKEEN model and its training loop."""
        model = ComplExN3(
            triples_factory=factory,
            embedding_dim=self.dim,
            init_scale=self.init_scale,
            regularizer="powersum" if self.n3 else None,
            regularizer_kwargs={"weight": self.n3} if self.n3 else None,
            random_seed=self.seed,
        ).to(self.device)
        return IndexedSymmetricLCWATrainingLoop(
            model, triples_factory=factory, optimizer="Adagrad", optimizer_kwargs={"lr": self.learning_rate}
        )

    def scorer(self, model: Model, opened: OpenedGraph) -> tuple[Scorer, dict[str, torch.Tensor]]:
        """Return the scorer of a trained model, and the tensors that the model folder keeps of it."""
        entity, relation = (
            representation[0]().detach().cpu()
            for representation in (model.entity_representations, model.relation_representations)
        )
        tensors = {
            "entity_real": entity.real.contiguous(),
            "entity_imag": entity.imag.contiguous(),
            "relation_real": relation.real.contiguous(),
            "relation_imag": relation.imag.contiguous(),
        }
        return ComplExScorer(tensors, opened.graph.entities, opened.graph.hash), tensors


@dataclass(frozen=True)
class LinkModelConfig(TrainingConfig):
    """Any other PyKEEN model, since the paper's method takes any link predictor.

    Attributes:
        model: PyKEEN's name, such as rotate, transe, distmult, tucker.
        dim: embedding dimensions.
        learning_rate: of Adam.
        loop: how triples become training examples: slcwa (sampled negatives) or symmetric (softmax over all heads and
            all tails, the paper's objective; slow for models whose scores need large tensors).
        negatives: sampled per triple, with slcwa.
    """

    model: str = "rotate"
    dim: int = 128
    learning_rate: float = 0.01
    loop: Literal["slcwa", "symmetric"] = "slcwa"
    negatives: int = 32

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("dim", "negatives"):
            _require(self, name, getattr(self, name) >= 1, "1 or more")
        _require(self, "learning_rate", math.isfinite(self.learning_rate) and self.learning_rate > 0, "more than 0")
        if self.model.lower() not in model_resolver.lookup_dict:
            hint = nearest(self.model.lower(), model_resolver.lookup_dict)
            raise ConfigError(f"PyKEEN has no model '{self.model}'.{hint}")

    @property
    def command(self) -> str:
        """The command that takes this configuration."""
        return "train-links"

    def training_loop(self, factory: TriplesFactory) -> TrainingLoop:
        """Build the PyKEEN model and its training loop."""
        softmax = self.loop == "symmetric"
        loss = loss_resolver.make("crossentropy") if softmax else loss_resolver.make("nssa")
        try:
            model = model_resolver.make(
                self.model, triples_factory=factory, embedding_dim=self.dim, loss=loss, random_seed=self.seed
            ).to(self.device)
        except TypeError as error:
            raise ConfigError(f"the model '{self.model}' cannot be set up with these options: {error}") from None
        loop = training_loop_resolver.lookup("symmetriclcwa" if softmax else "slcwa")
        sampling = {} if softmax else {"negative_sampler_kwargs": {"num_negs_per_pos": self.negatives}}
        return loop(
            model,
            triples_factory=factory,
            optimizer="Adam",
            optimizer_kwargs={"lr": self.learning_rate},
            **sampling,
        )

    def scorer(self, model: Model, opened: OpenedGraph) -> tuple[Scorer, dict[str, torch.Tensor]]:
        """Return the scorer of a trained model, a table of all scores, and the tensors that the folder keeps."""
        everything = torch.arange(opened.graph.num_entities, device=model.device)
        with torch.no_grad():
            scores = torch.stack(
                [
                    torch.cat(
                        [
                            model.score_t(torch.stack([heads, torch.full_like(heads, relation)], dim=1))
                            for heads in everything.split(64)
                        ]
                    )
                    for relation in range(len(RELATIONS))
                ]
            ).cpu()
        tensors = {"scores": scores} | {f"pykeen.{name}": value for name, value in model.state_dict().items()}
        return TableScorer(scores, opened.graph.entities, opened.graph.hash), tensors


LinkConfig = ComplExConfig | LinkModelConfig


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
    check_output(out, force=force)
    folder = out.with_name(out.name + UNFINISHED)
    if folder.exists() and not force:
        raise OutputExistsError(
            f"an unfinished run is in '{folder}'. Go on with `wordcraft-kg resume {folder}`, or start anew with --force."
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
        inputs={"graph": opened.graph.hash, "split": opened.split.hash},
    )
    return _run(opened, config, out, folder, run, progress)


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
    unfinished = folder if folder.name.endswith(UNFINISHED) else folder.with_name(folder.name + UNFINISHED)
    if not unfinished.is_dir():
        state = "is finished; there is nothing to resume" if folder.is_dir() else "does not exist"
        raise ArtefactError(f"'{folder}' {state}. Train a model with `wordcraft-kg train-complex`.")
    out = unfinished.with_name(unfinished.name.removesuffix(UNFINISHED))
    run = read_run(unfinished)
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
        config = type(config)(**{**asdict(config), "epochs": epochs})
        write_atomically(unfinished / "config.toml", _config_toml(opened, config, out))
    write_atomically(unfinished / "run.json", dump_json(run | {"status": "running", "ended": None}))
    return _run(opened, config, out, unfinished, run, progress)


def read_config(folder: Path) -> tuple[LinkConfig, str]:
    """Return the configuration of a model folder, and its graph as a path or a book's name.

    Raises:
        ArtefactError: if ``config.toml`` is missing or damaged.
    """
    path = folder / "config.toml"
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        ((command, table),) = content.items()
        graph = table.pop("graph")
        # The path is kept relative to the model folder, so that both can be moved together.
        beside = folder / graph
        kind: type[LinkConfig] = {"train-complex": ComplExConfig, "train-links": LinkModelConfig}[command]
        return kind(**table), str(beside) if beside.exists() else graph
    except FileNotFoundError:
        raise ArtefactError(f"{path} is missing; '{folder}' is incomplete. Train the model again.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, ValueError, KeyError, TypeError) as error:
        raise ArtefactError(f"{path} is damaged ({error}). Train the model again, or restore a copy.") from None


def check_inputs(folder: Path, run: dict[str, Any], opened: OpenedGraph) -> None:
    """Make sure that a graph and its split are those that a run was made with.

    Raises:
        GraphMismatchError: naming both.
    """
    for what, found in (("graph", opened.graph.hash), ("split", opened.split.hash)):
        expected = run["inputs"][what]
        if found != expected:
            raise GraphMismatchError(
                f"'{folder}' was trained on {what} {expected[:12]} but '{opened.source}' has {found[:12]}. "
                "Give the right one with --graph, or train again."
            )


def _require(config: Any, name: str, holds: bool, expected: str) -> None:
    if not holds:
        option = "--" + name.replace("_", "-")
        raise ConfigError(f"{option} {getattr(config, name)}: expected {expected}.")


def _check_fit(opened: OpenedGraph, config: LinkConfig) -> None:
    if config.eval_every and not len(opened.split.held_out("valid")):
        raise ConfigError(
            "--eval-every needs validation triples and this split has none. Build the graph with a validation part, "
            "such as --train-ratio 0.8 --valid-ratio 0.1."
        )
    try:
        torch.empty(0, device=config.device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"--device {config.device} is not to be had here ({reason}). Use --device cpu.") from None


def _config_toml(opened: OpenedGraph, config: LinkConfig, out: Path) -> str:
    source = Path(opened.source)
    graph = str(_relative(source.resolve(), out.resolve())) if source.exists() else opened.source
    lines = [f"[{config.command}]", f"graph = {json.dumps(graph)}"]
    lines += [f"{field.name} = {json.dumps(getattr(config, field.name))}" for field in fields(config)]
    return "\n".join(lines) + "\n"


def _relative(path: Path, start: Path) -> Path:
    """Return ``path`` relative to the folder ``start``, with ``..`` where needed."""
    common = [a for a, b in zip(path.parts, start.parts, strict=False) if a == b]
    depth = next((i for i, (a, b) in enumerate(zip(path.parts, start.parts, strict=False)) if a != b), len(common))
    return Path(*[".."] * (len(start.parts) - depth), *path.parts[depth:])


def _run(
    opened: OpenedGraph,
    config: LinkConfig,
    out: Path,
    folder: Path,
    run: dict[str, Any],
    progress: Progress | None,
) -> TrainedLinks:
    split = opened.split
    triples = split.partial if config.kg == "partial" else opened.graph.triples
    factory = triples_factory(opened.graph, triples)
    try:
        with pykeen_guard(config.seed, config.threads), _quiet_pykeen(), _first_interrupt() as interrupted:
            loop = config.training_loop(factory)
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
                    callbacks=state,
                )
            if interrupted.is_set() and loop._epoch < config.epochs:
                end_run(folder, run, "interrupted")
                return TrainedLinks(folder, {}, True, loop._epoch)
            state.restore_best(loop)
            metrics = _finish(opened, config, folder, loop, state, triples)
    except BaseException:
        end_run(folder, run, "failed")
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
    scorer, tensors = config.scorer(model, opened)
    vocabulary = {
        "format": "wordcraft-kg vocabulary 1",
        "scorer": "complex" if isinstance(config, ComplExConfig) else "table",
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
        "train_mrr": ranking_metrics(rank_triples(scorer, triples, triples))["mrr"],
    }
    write_atomically(folder / "model.safetensors", safetensors.torch.save(tensors))
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

    def restore(self, loop: TrainingLoop) -> bool:
        """Load the last checkpoint into a training loop; return whether there was one."""
        if not (self.folder / "last.json").exists():
            return False
        record = read_json(self.folder / "last.json")
        path = self.folder / record["tensors"]
        tensors = read_tensors(path, path.read_bytes())
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
        write_atomically(self.folder / name, safetensors.torch.save(_copy(tensors)))
        record = {
            "epoch": epoch,
            "tensors": name,
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
        scorer, _ = self.config.scorer(self.model, self.opened)
        ranks = rank_triples(scorer, self._valid, self.opened.graph.triples)  # type: ignore[arg-type]
        self.model.train()
        return ranking_metrics(ranks)["mrr"]


def _copy(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}


def _with_prefix(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


@contextmanager
def _first_interrupt() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C into a request to stop after the epoch; the second one acts at once."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = signal.getsignal(signal.SIGINT)

    def ask(signum: int, frame: Any) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _quiet_pykeen() -> Iterator[None]:
    """Keep PyKEEN's advice about its own command line out of ours."""
    logger = logging.getLogger("pykeen")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


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
