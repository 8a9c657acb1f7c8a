"""Training a link predictor on the full or the partial knowledge graph, into a model folder that serves as a scorer.

On a CPU, with the same torch and number of threads, a resumed run ends bit for bit like an uninterrupted one.
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import as_values, parse_record
from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.base.tensors import check_device
from wordcraft_kg.graphs.doses import Dose, is_dosed, make_dose
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.folds import Folds, make_folds
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.builders import check_table_fits, make_training_loop
from wordcraft_kg.models.links.config import CONFIGS, ComplExConfig, LinkModelConfig, LinksConfig, LinkSettings
from wordcraft_kg.models.links.cross_fitting import decided_folds, train_folds, write_link_folds
from wordcraft_kg.models.links.epochs import Epochs
from wordcraft_kg.models.links.fitting import train_epochs
from wordcraft_kg.models.links.pykeen_bridge import pykeen_guard, quiet_pykeen, seed_everything, triples_factory
from wordcraft_kg.models.links.records import Choice, LinkMetrics, LinkProgress
from wordcraft_kg.models.links.regularisation import choose
from wordcraft_kg.models.links.results import OUTPUTS, model_card, with_folds, write_results
from wordcraft_kg.models.scorers.folder import FOLD_OUTPUTS
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.folder import Progress, RunFolder, RunKind, check_run_output, new_run, resumed_run
from wordcraft_kg.runs.inputs import open_run_graph
from wordcraft_kg.runs.progress import shown
from wordcraft_kg.runs.record import verified_bytes
from wordcraft_kg.runs.trackers import Log, Tracker, checked_trackers, names_of, tracking

CHOICE = "choice.json"
LINKS = RunKind(tuple(CONFIGS), unit="epoch", progress=LinkProgress, judged_by="evaluate-links")


@dataclass(frozen=True)
class TrainedLinks:
    """The outcome of a training run.

    Attributes:
        folder: folder of the model.
        epoch: the last epoch that was trained; a checkpoint holds it if the run was interrupted.
        metrics: content of ``metrics.json``; None for an interrupted run, which :func:`resume_links` can resume.
    """

    folder: Path
    epoch: int
    metrics: LinkMetrics | None

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the run."""
        return self.metrics is None


def train_links(
    config: LinksConfig,
    out: str | Path | None = None,
    *,
    force: bool = False,
    trackers: Iterable[Tracker | str] = (),
    progress: Progress | bool | None = None,
) -> TrainedLinks:
    """Train a link predictor and write its model folder.

    Args:
        config: graph, and the settings of the model and its training.
        out: the folder to write. Default: ``models/<graph's name>-<kg>``, or ``-<model>-<kg>`` for other models.
        force: replace the folder if it exists.
        trackers: where the figures of each epoch go too: tensorboard, wandb, mlflow, or a
            :class:`~wordcraft_kg.runs.trackers.Tracker` of your own.
        progress: called after each epoch; True shows a bar.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False.
        ConfigError: if the settings do not fit the graph or the machine.
        MissingExtraError: if a tracker's library is not installed.
        TrainingError: if the loss is no longer finite.

    Example:
        >>> trained = train_links(LinksConfig("kitchen", ComplExConfig(dim=8, epochs=2)), "models/kitchen")
        >>> trained.folder.name
        'kitchen'
    """
    opened = open_graph(config.graph)
    config = _for_size(config, opened.graph.num_entities)
    config = replace(config, settings=decided_folds(config.settings, opened))
    folder = config.default_folder(opened.graph.name) if out is None else Path(out)
    check_run_output(folder, force=force)
    trackers = checked_trackers(trackers)
    _check_fit(opened, config.settings)
    dose, folds = _learned(opened, config.settings)
    with shown(progress, "links", LINKS.unit) as report, new_run(folder, LINKS, force=force) as run:
        config = _with_choice(run, opened, dose, config, report)
        files = [CHOICE] if (run.path / CHOICE).exists() else []
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash}
        if is_dosed(config.settings.share, config.settings.noise):
            inputs["dose"] = dose.hash
        if folds:
            inputs["folds"] = folds.hash
        run.begin(config, config.settings, inputs=inputs, files=files, trackers=names_of(trackers))
        with tracking(run, trackers, config.values()) as log:
            return _train(run, opened, dose, folds, config, report, log)


def resume_links(
    folder: str | Path,
    *,
    graph: str | None = None,
    epochs: int | None = None,
    trackers: Iterable[Tracker] = (),
    progress: Progress | bool | None = None,
) -> TrainedLinks:
    """Resume an interrupted training run from its last checkpoint.

    Args:
        folder: folder of the model.
        graph: where the graph is now, if it has moved.
        epochs: train up to this many epochs instead of the original number.
        trackers: trackers of your own, besides those that the run was begun with by name.
        progress: called after each epoch; True shows a bar.

    Raises:
        ArtefactError: if there is nothing to resume, it is damaged, or another process is training it.
        GraphMismatchError: if the graph or its split is not the one that the run began with.
    """
    with shown(progress, "links", LINKS.unit) as report, resumed_run(Path(folder), LINKS) as run:
        verified_bytes(run.path, run.record, "config.toml")
        config = LinksConfig.read(run.path)
        config = replace(config, graph=graph or config.graph)
        opened = open_run_graph(run.path, run.record, config.graph)
        if epochs is not None:
            config = replace(config, settings=replace(config.settings, epochs=epochs))
        check_device(config.settings.device)
        _check_memory(opened, config.settings)
        dose, folds = _learned(opened, config.settings)
        checkpoint = run.checkpoints.load()
        all_trackers = checked_trackers([*run.record.trackers, *trackers])
        with tracking(run, all_trackers, config.values(), checkpoint.number) as log:
            return _train(run, opened, dose, folds, config, report, log, checkpoint)


def _for_size(config: LinksConfig, num_entities: int) -> LinksConfig:
    """Decide what depends on the size of the graph, and say so if the objective does."""
    settings = config.settings.for_size(num_entities)
    if isinstance(settings, ComplExConfig) and settings != config.settings and settings.negatives:
        logging.getLogger(__name__).warning(
            "%s entities: the softmax is over %s sampled for each batch, because all of them would take too long "
            "(negatives = 0 takes all).",
            f"{num_entities:,}",
            f"{settings.negatives:,}",
        )
    return replace(config, settings=settings)


def _with_choice(
    run: RunFolder[LinkProgress], opened: OpenedGraph, dose: Dose, config: LinksConfig, progress: Progress | None
) -> LinksConfig:
    """Decide what regularisation is left open, before the run begins; where it is chosen, write ``choice.json``."""
    settings = config.settings
    if not isinstance(settings, ComplExConfig):
        return config

    def after_epoch(done: int, total: int) -> None:
        if run.interrupted.is_set():
            raise KeyboardInterrupt
        if progress:
            progress(0, settings.epochs * (1 + (settings.folds or 0)), {"choosing weights": done / total})

    choice = choose(opened, settings, after_epoch, recipes=dose.recipes)
    if choice:
        write_atomically(run.path / CHOICE, dump_json(as_values(choice)), durable=True)
        settings = replace(settings, n3=choice.n3, popularity=choice.popularity)
    return replace(config, settings=settings.fixed())


def _learned(opened: OpenedGraph, settings: LinkSettings) -> tuple[Dose, Folds | None]:
    """Return what is learned from, and its folds; their draw depends on no setting, so all models of a split share it.

    Raises:
        ConfigError: if there are too few recipes for `share` and `noise`.
    """
    if settings.kg == "full":
        return opened.dose("full"), None
    folds = make_folds(opened.split, settings.folds) if settings.folds else None
    of_recipe = folds.of_recipe if folds else None
    dose = make_dose(opened.split, settings.share, settings.noise, settings.seed, of_recipe=of_recipe)
    return dose, folds.dosed(dose) if folds else None


def _read_choice(run: RunFolder[LinkProgress]) -> Choice | None:
    if CHOICE not in run.record.inputs:
        return None
    return parse_record(verified_bytes(run.path, run.record, CHOICE), Choice, run.path / CHOICE)


def _check_fit(opened: OpenedGraph, settings: LinkSettings) -> None:
    if isinstance(settings, LinkModelConfig):
        check_table_fits(settings.model, opened.graph.num_entities)
    if settings.kg == "partial" and opened.split.config.kind == "none":
        raise ConfigError(
            "the split of this graph holds nothing out, so there is no partial graph to train on. Use `kg` full, or "
            "build the graph with another split, such as by-recipe."
        )
    if settings.eval_every and not len(opened.split.held_out("valid")):
        raise ConfigError(
            "`eval_every` needs validation triples and this split has none. Build the graph with a validation part, "
            "such as `train_ratio` 0.8 and `valid_ratio` 0.1."
        )
    check_device(settings.device)
    _check_memory(opened, settings)


def _check_memory(opened: OpenedGraph, settings: LinkSettings) -> None:
    """Refuse dimensions and batches that cannot fit; what a model needs beside these is not counted."""
    graph = opened.graph
    parameters = 4 * settings.dim * (graph.num_entities + len(RELATIONS)) * (1 + isinstance(settings, ComplExConfig))
    # Their gradients, and what the optimiser keeps for each.
    check_memory("dim", settings.dim, f"training vectors of {graph.num_entities:,} entities", 3 * parameters)
    if isinstance(settings, LinkModelConfig) and settings.loop == "slcwa":
        triples = min(settings.batch_size, len(opened.triples(settings.kg)))
        needed = 4 * settings.dim * settings.negatives * triples
        check_memory("negatives", settings.negatives, f"the vectors of the negatives of {triples:,} triples", needed)


def _train(
    run: RunFolder[LinkProgress],
    opened: OpenedGraph,
    dose: Dose,
    folds: Folds | None,
    config: LinksConfig,
    progress: Progress | None,
    log: Log,
    checkpoint: Checkpoint[LinkProgress] | None = None,
) -> TrainedLinks:
    """Train from the start, or from a checkpoint, until the end or the first Ctrl-C."""
    settings, choice = config.settings, _read_choice(run)
    factory = triples_factory(opened.graph, dose.triples)
    with pykeen_guard(settings.seed, settings.threads), quiet_pykeen():
        loop = make_training_loop(settings, factory)
        epochs = Epochs(run, opened, dose.triples, settings, progress, log)
        if checkpoint is not None:
            with run.restoring():
                epochs.restore(loop, checkpoint)
            if settings.epochs < loop._epoch:
                raise ConfigError(
                    f"`epochs` {settings.epochs}: the run has done {loop._epoch} already; give {loop._epoch} or more."
                )
            run.go_on(config)
        if loop._epoch < settings.epochs and not epochs.so_far.has_stopped:
            seed_everything(settings.seed, loop._epoch + 1)
            train_epochs(loop, factory, settings, epochs, is_resumed=checkpoint is not None)
        if loop._epoch < settings.epochs and not epochs.so_far.has_stopped:
            run.interrupt()
            return TrainedLinks(run.path, loop._epoch, None)
        epochs.restore_best(loop)
        scorer, metrics = write_results(run.path, loop.model, dose, settings, epochs.so_far, choice)
    outputs: tuple[str, ...] = OUTPUTS
    if folds:
        try:
            _cross_fit(run, folds, settings, metrics, progress)
        except KeyboardInterrupt:
            if not run.interrupted.is_set():
                raise
            run.interrupt()
            return TrainedLinks(run.path, metrics.epochs, None)
        record = write_link_folds(run.path, folds, scorer, settings)
        metrics = with_folds(run.path, metrics, record)
        outputs += FOLD_OUTPUTS
    run.finish(outputs, model_card(opened, settings, metrics))
    return TrainedLinks(run.path, metrics.epochs, metrics)


def _cross_fit(
    run: RunFolder[LinkProgress], folds: Folds, settings: LinkSettings, metrics: LinkMetrics, progress: Progress | None
) -> None:
    """Train the models of the folds with the settings that the one of all train recipes ended with."""
    ended = metrics.best_epoch if settings.patience and metrics.best_epoch else metrics.epochs
    everything, told = settings.epochs * (1 + folds.count), set[int]()

    def after_epoch(done: int, total: int) -> None:
        if run.interrupted.is_set():
            raise KeyboardInterrupt
        if progress and done not in told:
            told.add(done)
            progress(everything - total + done, everything, {"of the folds": done / total})

    train_folds(run.path, folds, replace(settings, epochs=ended), seconds=metrics.seconds, after_epoch=after_epoch)
