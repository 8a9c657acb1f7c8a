"""Cross-fitting: train a model for each fold of the train recipes on all remaining folds.

Folds are trained in parallel if cores allow it. Finished models are saved among the run's
checkpoints, so a resumed run trains only missing models. A fold's model depends on settings and
triples alone, not on process or order, so it has the same bits with one process or with many.

The page docs/explanation/cross-fitting.md explains what the folds are for.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import copied
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.folds import Folds, make_folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import triples_hash
from wordcraft_kg.models.links.builders import scorer_kind, scorer_tensors
from wordcraft_kg.models.links.config import FOLDS, ComplExConfig, LinkSettings
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.outside import OutsideTriples
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.records import FoldDone
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.cross_fitting import FoldsRecord
from wordcraft_kg.models.scorers.folder import write_folds
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.checkpoints import Checkpoints, not_done, train_jobs

LONG = 10.0
"""Shortest training, in seconds, with parallel folds: a process takes seconds to start."""

AfterEpoch = Callable[[int], None]
"""Called with the number of finished epochs; may raise to end the training."""


def decided_folds(settings: LinkSettings, opened: OpenedGraph) -> LinkSettings:
    """Return the settings with a number of folds.

    A given number is kept; otherwise it is :data:`~wordcraft_kg.models.links.config.FOLDS`, or 0 if
    the graph allows no folds or their tables would be too large.

    Raises:
        ConfigError: if a given number of folds is impossible.
    """
    num_folds = settings.folds
    count = FOLDS if num_folds is None else num_folds
    has_no_test_part = opened.split.config.kind == "none"
    if settings.kg == "full" or not count or (num_folds is None and has_no_test_part):
        return replace(settings, folds=0)
    try:
        make_folds(opened.split, count)
        _check_size(settings, count, opened.graph.num_entities)
    except ConfigError as error:
        if num_folds is not None:
            raise
        logging.getLogger(__name__).info("no folds: %s", error)
        count = 0
    return replace(settings, folds=count)


def _check_size(settings: LinkSettings, count: int, num_entities: int) -> None:
    # ComplEx stores embeddings, which are small.
    num_bytes = count * table_bytes(num_entities)
    if not isinstance(settings, ComplExConfig) and num_bytes > TABLE_LIMIT:
        raise ConfigError(
            f"`folds` {count}: a score table for each fold takes {num_bytes / 2**20:,.0f} MiB; "
            f"expected at most {TABLE_LIMIT / 2**20:.0f} MiB. Use fewer folds or 0, or ComplEx "
            "(wordcraft-kg train-complex)."
        )


@dataclass(frozen=True)
class _Job:
    """All that a process needs to train a fold's model; a value that can be sent to a process."""

    folder: Path
    fold: int
    settings: LinkSettings
    graph: RecipeGraph
    triples: Ids
    outside: OutsideTriples | None

    def train(self, after_epoch: AfterEpoch) -> None:
        """Train the model, and keep its tensors among the run's checkpoints."""
        size = self.graph.num_entities
        factory = triples_factory(self.graph, self.triples, self.outside)
        model = fit(self.settings, factory, after_epoch, size)
        _, tensors = scorer_tensors(self.settings, model, self.triples, size)
        # A table needs no model parameters.
        stored = {
            name: tensor for name, tensor in tensors.items() if not name.startswith("pykeen.")
        }
        _kept(self.folder).save(self.fold, copied(stored), self.done)

    @property
    def done(self) -> FoldDone:
        """The record of a finished model; a model with another record is trained again."""
        return FoldDone(trained_on=triples_hash(self.triples), epochs=self.settings.epochs)


def _kept(folder: Path) -> Checkpoints[FoldDone]:
    # All are kept, not only the last: each belongs to another fold.
    return Checkpoints(folder, "fold", FoldDone, kept=None)


def train_folds(
    folder: Path,
    folds: Folds,
    settings: LinkSettings,
    outside: OutsideTriples | None = None,
    *,
    seconds: float,
    after_epoch: Callable[[int, int], None],
) -> None:
    """Train all missing fold models: for each fold, a model of the remaining train recipes.

    Args:
        folder: folder of the run.
        folds: the folds and the training recipes.
        settings: settings of the main model, with the number of ``epochs`` that it was trained for.
        outside: triples from outside the book, in every fold's training; None without.
        seconds: duration of the main training, which decides whether more processes are worth their
            start.
        after_epoch: called with the finished and the total epochs over all folds, regularly, also
            while no epoch ends; may raise to end the training.

    Raises:
        TrainingError: if a loss is not finite, or a process dies.
    """
    # The number of epochs is decided; validation triples belong to the main model.
    settings = replace(settings, eval_every=0, folds=0)
    graph = folds.split.graph
    jobs = [
        _Job(folder, fold, settings, graph, folds.triples([fold]), outside)
        for fold in range(folds.count)
    ]
    # Models that an interrupted run has finished, with the same triples and epochs, are not trained
    # again.
    waiting = not_done(jobs, _kept(folder))
    epochs = {job.fold: settings.epochs for job in jobs}
    epochs.update({job.fold: 0 for job in waiting})

    def note(fold: int | None = None, epoch: int = 0) -> None:
        # Without a fold, only to let the caller interrupt the training.
        if fold is not None:
            epochs[fold] = epoch
        after_epoch(sum(epochs.values()), settings.epochs * len(jobs))

    # On a GPU, several processes would share one device.
    is_long = seconds >= LONG and torch.device(settings.device).type == "cpu"
    train_jobs(waiting, settings.threads, note, is_long=is_long)


def write_link_folds(
    folder: Path, folds: Folds, whole: Scorer, settings: LinkSettings
) -> FoldsRecord:
    """Write the scorers of all folds into the model folder.

    Args:
        folder: folder of the run, which holds the finished models of all folds.
        folds: the folds and the training recipes.
        whole: the scorer trained on all folds.
        settings: settings of the models.

    Returns:
        metrics of the folds' models, compared with ``whole``.

    Raises:
        ArtefactError: if the finished model of a fold is missing or damaged.
    """
    checkpoints = _kept(folder)

    def part(fold: int) -> tuple[str, dict[str, torch.Tensor]]:
        checkpoint = checkpoints.read(fold)
        return checkpoint.progress.trained_on, checkpoint.tensors

    return write_folds(folder, folds, whole, scorer_kind(settings, len(whole.entities)), part)
