"""Train a PyKEEN model: in a run folder with validation, trace (metrics per epoch) and checkpoints, or without."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from msgspec.structs import replace
from pykeen.models import Model
from pykeen.training import NonFiniteLossError, TrainingLoop
from pykeen.training.callbacks import TrainingCallback
from pykeen.triples import TriplesFactory
from torch import Tensor

from wordcraft_kg.base.errors import TrainingError
from wordcraft_kg.base.tensors import copied, with_prefix
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.links.builders import make_training_loop, scorer_tensors
from wordcraft_kg.models.links.config import LinkSettings
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, seed_everything
from wordcraft_kg.models.links.records import LinkProgress, TraceRow
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.folder import Progress, RunFolder
from wordcraft_kg.runs.trackers import Log


def train_epochs(
    loop: TrainingLoop,
    factory: TriplesFactory,
    settings: LinkSettings,
    callback: TrainingCallback,
    *,
    is_resumed: bool = False,
) -> None:
    """Train to the last epoch, or until the callback stops the loop; TrainingError if the loss is not finite."""
    try:
        loop.train(
            factory,
            num_epochs=settings.epochs,
            batch_size=settings.batch_size,
            continue_training=is_resumed,
            use_tqdm=False,
            use_tqdm_batch=False,
            pin_memory=torch.device(settings.device).type == "cuda",
            callbacks=callback,
        )
    except NonFiniteLossError:
        raise TrainingError(
            "the loss became infinite or not a number. Train with a lower `learning_rate`."
        ) from None


def fit(
    settings: LinkSettings,
    factory: TriplesFactory,
    after_epoch: Callable[[int], None],
    num_entities: int | None = None,
) -> Model:
    """Return a model as from a run, without a folder; ``after_epoch`` gets each epoch, and may raise to end."""
    with pykeen_guard(settings.seed, settings.threads), quiet_pykeen():
        loop = make_training_loop(settings, factory, num_entities)
        seed_everything(settings.seed, 1)
        train_epochs(loop, factory, settings, _Epochs(settings.seed, after_epoch))
    loop.model.eval()
    return loop.model


class _Epochs(TrainingCallback):
    def __init__(self, seed: int, after_epoch: Callable[[int], None]):
        super().__init__()
        self.seed, self.after_epoch = seed, after_epoch

    def post_epoch(self, epoch: int, epoch_loss: float, **kwargs: Any) -> None:
        self.after_epoch(epoch)
        seed_everything(self.seed, epoch + 1)


QUIET = 20.0
"""Seconds between progress reports within an epoch."""


class Epochs(TrainingCallback):
    """PyKEEN callback for a training in a run folder: validates, logs, saves checkpoints and stops the training.

    Random numbers in epoch ``n`` depend on (seed, n) alone, so a checkpoint needs no generator state. ``so_far`` is the
    progress: trace (metrics per epoch), seconds and best epoch.
    """

    def __init__(
        self,
        run: RunFolder[LinkProgress],
        opened: OpenedGraph,
        triples: Ids,
        num_triples: int,
        settings: LinkSettings,
        progress: Progress | None,
        log: Log,
    ):
        """Start before the first epoch; ``triples``, shape (T, 3), are the graph's, of ``num_triples`` in all."""
        super().__init__()
        self.run, self.opened, self.triples, self.settings = run, opened, triples, settings
        self.report, self.log = progress, log
        self.so_far = LinkProgress(
            seconds=0.0, best_mrr=None, best_epoch=None, has_stopped=False, trace=()
        )
        self._valid = (
            sampled_for(opened.graph, opened.split.held_out("valid"))
            if settings.eval_every
            else None
        )
        self._batches = -(-num_triples // settings.batch_size)
        self._batch = 0
        self._total = settings.epochs * (1 + (settings.folds or 0))
        self._best: dict[str, Tensor] = {}
        self._clock = self._reported = time.perf_counter()

    def post_batch(self, epoch: int, batch: Any, **kwargs: Any) -> None:
        """Report progress in a long epoch, with the estimated remaining time."""
        self._batch += 1
        now = time.perf_counter()
        if self.report and now - self._reported >= QUIET and self._batch < self._batches:
            self._reported = now
            done = self._batch / self._batches
            minutes = (now - self._clock) / done / 60
            left = minutes * (self.settings.epochs - epoch + 1 - done)
            figures = {f"of epoch {epoch}": done, "minutes an epoch": minutes, "minutes left": left}
            self.report(epoch - 1, self._total, figures)

    def post_epoch(self, epoch: int, epoch_loss: float, **kwargs: Any) -> None:
        """Validate, save, log and report after an epoch, if due; stop the training after the last epoch."""
        settings = self.settings
        is_ranked = self._valid is not None and (
            epoch % settings.eval_every == 0 or epoch == settings.epochs
        )
        row = TraceRow(
            epoch=epoch,
            loss=epoch_loss,
            valid_mrr=self._validate() if is_ranked else None,
            seconds=0.0,
        )
        now = time.perf_counter()
        row = replace(row, seconds=round(now - self._clock, 4))
        seconds, self._clock = now - self._clock, now
        self._note(row, seconds)
        is_last = (
            self.so_far.has_stopped or self.run.interrupted.is_set() or epoch == settings.epochs
        )
        if is_last or epoch % settings.checkpoint_every == 0:
            self.run.checkpoints.save(epoch, self._tensors(), self.so_far)
        self._batch, self._reported = 0, now
        begun = time.perf_counter()
        self.log(epoch, {"loss": epoch_loss, "valid_mrr": row.valid_mrr, "seconds": row.seconds})
        self._clock += time.perf_counter() - begun  # exclude tracker time from the epoch
        if self.report:
            figures = {
                "epoch": epoch,
                "loss": epoch_loss,
                "valid_mrr": row.valid_mrr,
                "seconds": row.seconds,
            }
            self.report(
                epoch,
                self._total,
                {name: value for name, value in figures.items() if value is not None},
            )
        if is_last:
            self.training_loop._should_stop = True
        seed_everything(settings.seed, epoch + 1)

    def restore(self, loop: TrainingLoop, checkpoint: Checkpoint[LinkProgress]) -> None:
        """Load a checkpoint into a new loop; ValueError, KeyError or RuntimeError if anything does not fit."""
        if [row.epoch for row in checkpoint.progress.trace] != list(
            range(1, checkpoint.number + 1)
        ):
            raise ValueError("trace and epochs differ")
        loop.model.load_state_dict(with_prefix(checkpoint.tensors, "model."))
        self._best = with_prefix(checkpoint.tensors, "best.")
        state = _optimizer_state(checkpoint.tensors, loop.optimizer.param_groups[0]["params"])
        # Keep the new optimiser's settings.
        loop.optimizer.load_state_dict({**loop.optimizer.state_dict(), "state": state})
        loop._epoch = checkpoint.number
        loop.losses_per_epochs = [row.loss for row in checkpoint.progress.trace]
        self.so_far = checkpoint.progress

    def restore_best(self, loop: TrainingLoop) -> None:
        """Load the best epoch's parameters into the loop's model, if ``patience`` is set."""
        if self.settings.patience and self._best:
            loop.model.load_state_dict(self._best)

    def _note(self, row: TraceRow, seconds: float) -> None:
        before = self.so_far
        now = replace(before, seconds=before.seconds + seconds, trace=(*before.trace, row))
        if row.valid_mrr is not None:
            if before.best_mrr is None or row.valid_mrr > before.best_mrr:
                now = replace(now, best_mrr=row.valid_mrr, best_epoch=row.epoch)
                self._best = copied(self.model.state_dict())
            rankings = [line.valid_mrr for line in now.trace if line.valid_mrr is not None]
            since_best = len(rankings) - 1 - int(np.argmax(rankings))
            now = replace(
                now,
                has_stopped=bool(self.settings.patience) and since_best >= self.settings.patience,
            )
        self.so_far = now

    def _validate(self) -> float:
        self.model.eval()
        graph = self.opened.graph
        tensors = scorer_tensors(self.settings, self.model, self.triples, graph.num_entities)
        scorer = make_scorer(*tensors, graph.entities, graph.hash)
        ranks = rank_triples(scorer, self._valid, graph.triples)  # type: ignore[arg-type]
        self.model.train()
        return mean_reciprocal_rank(ranks)

    def _tensors(self) -> dict[str, Tensor]:
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        tensors |= {f"best.{name}": value for name, value in self._best.items()}
        for index, values in self.optimizer.state_dict()["state"].items():
            tensors |= {
                f"optimizer.{index}.{key}": torch.as_tensor(value) for key, value in values.items()
            }
        return copied(tensors)


def _optimizer_state(
    tensors: dict[str, Tensor], parameters: Sequence[Tensor]
) -> dict[int, dict[str, Tensor]]:
    """Return the optimiser tensors; PyKEEN would check shapes an epoch later."""
    state: dict[int, dict[str, Tensor]] = {index: {} for index in range(len(parameters))}
    for name, value in with_prefix(tensors, "optimizer.").items():
        index, _, key = name.partition(".")
        if value.shape not in ((), parameters[int(index)].shape):
            raise ValueError(f"{name} of the optimiser has shape {tuple(value.shape)}")
        state[int(index)][key] = value
    if any(values.keys() != state[0].keys() for values in state.values()):
        raise ValueError("a part of the optimiser's state is missing")
    return state
