"""Training a PyKEEN model: the epochs of a run, or all of a model that needs no run folder."""

from collections.abc import Callable
from typing import Any

import torch
from pykeen.models import Model
from pykeen.training import NonFiniteLossError, TrainingLoop
from pykeen.training.callbacks import TrainingCallback
from pykeen.triples import TriplesFactory

from wordcraft_kg.base.errors import TrainingError
from wordcraft_kg.models.links.builders import make_training_loop
from wordcraft_kg.models.links.config import LinkSettings
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, seed_everything


def train_epochs(
    loop: TrainingLoop,
    factory: TriplesFactory,
    settings: LinkSettings,
    callback: TrainingCallback,
    *,
    is_resumed: bool = False,
) -> None:
    """Train until the last epoch, or until the callback stops the loop.

    Raises:
        TrainingError: if the loss is no longer finite.
    """
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
        raise TrainingError("the loss is no longer a finite number. Train with a lower `learning_rate`.") from None


def fit(settings: LinkSettings, factory: TriplesFactory, after_epoch: Callable[[int], None]) -> Model:
    """Train a model without a run folder; the same settings and triples give the same model as a run.

    Args:
        settings: of the model and its training.
        factory: the triples.
        after_epoch: called with the number of each epoch; what it raises ends the training.

    Raises:
        ConfigError: if PyKEEN cannot build the model.
        TrainingError: if the loss is no longer finite.
    """
    with pykeen_guard(settings.seed, settings.threads), quiet_pykeen():
        loop = make_training_loop(settings, factory)
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
