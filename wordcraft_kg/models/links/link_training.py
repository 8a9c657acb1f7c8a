"""Train a link predictor on the full or partial knowledge graph, into a model folder.

On a CPU, with equal torch versions and threads, a resumed run is bit-identical to an uninterrupted
run.

The page docs/link-prediction.md describes the commands under *Train*.
"""

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import torch
from pykeen.training import TrainingLoop

from wordcraft_kg.base import (
    ConfigError,
    as_lines,
    as_values,
    check_memory,
    dump_json,
    write_atomically,
)
from wordcraft_kg.base.tensors import check_device, copied
from wordcraft_kg.graphs import (
    RELATIONS,
    Folds,
    Ids,
    OpenedGraph,
    RecipeGraph,
    describe_train_sample,
    draw_train_sample,
    is_subsample,
    make_folds,
    triples_hash,
)
from wordcraft_kg.models.links.builders import (
    check_table_fits,
    make_training_loop,
    scorer_tensors,
)
from wordcraft_kg.models.links.fitting import (
    checkpoint_tensors,
    choose,
    fit,
    restore,
    train_epochs,
)
from wordcraft_kg.models.links.link_config import (
    FOLDS,
    ComplExConfig,
    LinkModelConfig,
    LinksConfig,
    LinkSettings,
)
from wordcraft_kg.models.links.link_records import (
    Choice,
    FoldDone,
    LinkMetrics,
    LinkProgress,
    TraceRow,
    training_facts,
)
from wordcraft_kg.models.links.pykeen_bridge import (
    OutsideTriples,
    outside_hashes,
    pykeen_guard,
    read_outside,
    triples_factory,
)
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.models.scorers.score_limits import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.scorer_folder import (
    FOLD_OUTPUTS,
    make_scorer,
    write_folds,
    write_scorer,
)
from wordcraft_kg.runs.checkpoints import Checkpoint, Checkpoints, not_done, train_jobs
from wordcraft_kg.runs.record import RunFiles, scorer_card
from wordcraft_kg.runs.run_folder import Progress, RunFolder, RunKind
from wordcraft_kg.runs.trackers import Log, Tracker
from wordcraft_kg.runs.training import Training, train

LONG = 10.0
"""Shortest training, in seconds, with parallel folds: a process takes seconds to start."""


def decided_folds(settings: LinkSettings, opened: OpenedGraph) -> LinkSettings:
    """Return the settings with a number of folds.

    A given number is kept; otherwise it is :data:`~wordcraft_kg.models.links.link_config.FOLDS`, or
    0 if the graph allows no folds or their tables would be too large.

    Raises:
        ConfigError: if a given number of folds is impossible.
    """
    num_folds = settings.folds
    count = FOLDS if num_folds is None else num_folds
    if settings.kg == "full" or not count:
        return replace(settings, folds=0)
    try:
        make_folds(opened.split, count)
        num_bytes = count * table_bytes(opened.graph.num_entities)
        # ComplEx stores embeddings, which are small.
        if not isinstance(settings, ComplExConfig) and num_bytes > TABLE_LIMIT:
            raise ConfigError(
                f"`folds` {count}: a score table for each fold takes {num_bytes / 2**20:,.0f} MiB; "
                f"expected at most {TABLE_LIMIT / 2**20:.0f} MiB. Use fewer folds or 0, or ComplEx "
                "(wordcraft-kg train-complex)."
            )
    except ConfigError as error:
        if num_folds is not None:
            raise
        logging.getLogger(__name__).info("no folds: %s", error)
        count = 0
    return replace(settings, folds=count)


@dataclass(frozen=True)
class _Job:
    """All that a process needs to train a fold's model; a value that can be sent to a process."""

    folder: Path
    fold: int
    settings: LinkSettings
    graph: RecipeGraph
    triples: Ids
    outside: OutsideTriples | None

    def train(self, after_epoch: Callable[[int], None]) -> None:
        """Train the model, and keep its tensors among the run's checkpoints."""
        size = self.graph.num_entities
        factory = triples_factory(self.graph, self.triples, self.outside)
        model = fit(self.settings, factory, after_epoch, size)
        _, tensors = scorer_tensors(self.settings, model, self.triples, size)
        fold_models(self.folder).save(self.fold, copied(tensors), self.done)

    @property
    def done(self) -> FoldDone:
        """The record of a finished model; a model with another record is trained again."""
        return FoldDone(trained_on=triples_hash(self.triples))


def fold_models(folder: Path) -> Checkpoints[FoldDone]:
    """Return the finished models of folds in a run: all are kept, each belongs to another fold."""
    return Checkpoints(folder, "fold", FoldDone, kept=None)


CHOICE = "choice.json"
"""The chosen regularisation, written before the training begins."""
OUTPUTS = ("model.safetensors", "vocabulary.json", "config.toml", "metrics.json", "trace.jsonl")
"""Files of a model folder without folds."""


@dataclass(frozen=True)
class TrainedLinks:
    """Outcome of :func:`train_links`.

    Attributes:
        folder: the model folder.
        metrics: content of ``metrics.json``.
    """

    folder: Path
    metrics: LinkMetrics


def train_links(
    config: LinksConfig,
    out: str | Path | None = None,
    *,
    force: bool = False,
    trackers: Iterable[Tracker | str] = (),
    progress: Progress | bool | None = None,
) -> TrainedLinks:
    """Train a link predictor into a model folder, or resume an interrupted run with equal settings.

    Args:
        config: graph, and settings of the model and its training.
        out: the model folder. Default: ``models/<graph name>-<kg>``, or ``-<model>-<kg>`` except
            for ComplEx.
        force: replace the folder if it exists.
        trackers: further places for each epoch's metrics: tensorboard, or a
            :class:`~wordcraft_kg.runs.trackers.Tracker` of your own.
        progress: called after each epoch; True shows a bar, None or False nothing.

    Raises:
        OutputExistsError: if ``out`` holds other files or a finished run, and ``force`` is False.
        ConfigError: if the settings do not fit the graph or the machine.
        MissingExtraError: if a tracker's library is not installed.
        GraphMismatchError: if an input belongs to another graph.
        ArtefactError: if a graph folder, a knowledge folder or an interrupted run is damaged, or
            another process trains in the folder.
        TrainingError: if the loss is not finite, or a process of a fold dies.
        RecipeFileError: if there is no such graph, or a book cannot be read.
        KeyboardInterrupt: after Ctrl-C; the same call resumes the run.

    Example:
        >>> config = LinksConfig("kitchen", ComplExConfig(dim=8, epochs=2))
        >>> trained = train_links(config, "models/kitchen")
        >>> trained.folder.name
        'kitchen'
    """
    return train(LinksTraining, config, out, force=force, trackers=trackers, progress=progress)


class LinksTraining(Training[LinksConfig, LinkProgress, TrainedLinks]):
    """Trainer for link predictors; folds are equal for all models on a split.

    Attributes:
        kind: commands, file formats and units of these runs.
    """

    kind: ClassVar[RunKind[Any]] = RunKind(
        LinksConfig.commands, "links", unit="epoch", progress=LinkProgress
    )
    config_type = LinksConfig
    decided = ("folds", "n3", "popularity", "negatives")

    def __init__(self, config: LinksConfig, opened: OpenedGraph):
        """Decide all settings that depend on the graph, and draw the training recipes.

        Raises:
            ConfigError: if the settings do not fit the graph or the machine.
            ArtefactError: if a knowledge folder is incomplete or damaged.
        """
        folders = getattr(config.settings, "with_", ())
        self.outside = read_outside(folders, opened.graph.entities)
        num_nodes = opened.graph.num_entities
        if self.outside:
            num_nodes += self.outside.summary.nodes
        # Decided now and stored with the run: a default that changes later must not change a
        # resumed training.
        settings = decided_folds(config.settings.for_size(num_nodes), opened)
        super().__init__(replace(config, settings=settings), opened)
        _check_fit(opened, settings, num_nodes)
        folds = make_folds(opened.split, settings.folds) if settings.folds else None
        if settings.kg == "full":
            self.train_sample = opened.train_sample("full")
        else:
            self.train_sample = draw_train_sample(
                opened.split,
                settings.train_fraction,
                settings.label_noise,
                settings.seed,
                of_recipe=folds.of_recipe if folds else None,
            )
        # All models for a split share the folds, also with a sample of the train recipes.
        self.folds = folds.with_train_sample(self.train_sample) if folds else None

    @classmethod
    def input_hashes(cls, config: LinksConfig) -> Mapping[str, str]:  # noqa: D102 - inherited
        return outside_hashes(getattr(config.settings, "with_", ()))

    def begin(  # noqa: D102 - inherited
        self, run: RunFolder[LinkProgress], report: Progress | None
    ) -> Mapping[str, Any]:
        self._decide_regularisation(run, report)
        settings = self.config.settings
        inputs = dict(self.input_hashes(self.config))
        if is_subsample(settings.train_fraction, settings.label_noise):
            inputs["train_sample"] = self.train_sample.hash
        if self.folds:
            inputs["folds"] = self.folds.hash
        # The choice is an input by its hash: a resumed run must train with the same weights.
        return {"inputs": inputs, "files": [CHOICE] if (run.path / CHOICE).exists() else []}

    def _decide_regularisation(self, run: RunFolder[LinkProgress], report: Progress | None) -> None:
        """Choose open weights, and write the choice before the first checkpoint."""
        settings = self.config.settings
        if not isinstance(settings, ComplExConfig):
            return

        def after_epoch(done: int, total: int) -> None:
            # Ctrl-C only sets the flag; here nothing is half-written, so the run may end.
            if run.interrupted.is_set():
                raise KeyboardInterrupt
            if report:
                everything = settings.epochs * (1 + (settings.folds or 0))
                report(0, everything, {"choosing settings, percent": 100 * done / total})

        choice = choose(
            self.opened,
            settings,
            after_epoch,
            recipes=self.train_sample.sets,
            outside=self.outside,
        )
        if choice:
            # Durable, because the choice took a training's time and a checkpoint may follow at
            # once.
            write_atomically(run.path / CHOICE, dump_json(as_values(choice)), durable=True)
            settings = replace(settings, n3=choice.n3, popularity=choice.popularity)
        self.config = replace(self.config, settings=settings.fixed())

    def fit(  # noqa: D102 - inherited
        self,
        run: RunFolder[LinkProgress],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[Any] | None,
    ) -> TrainedLinks:
        settings = self.config.settings
        graph = self.opened.graph
        triples = self.train_sample.triples
        factory = triples_factory(graph, triples, self.outside)
        trace: list[TraceRow] = []
        with pykeen_guard(settings.seed, settings.threads):
            loop = make_training_loop(settings, factory, graph.num_entities)
            if checkpoint is not None:
                with run.restoring():
                    restore(loop, checkpoint)
                trace += checkpoint.progress.trace
                run.resume(self.config)
            # A run that was killed after its last epoch has nothing left to train.
            if loop._epoch < settings.epochs:
                after_epoch = self._after_epoch(run, loop, trace, report, log)
                train_epochs(loop, factory, settings, after_epoch)
            if loop._epoch < settings.epochs:
                raise KeyboardInterrupt
            loop.model.eval()
            kind, tensors = scorer_tensors(settings, loop.model, triples, graph.num_entities)
            write_scorer(run.path, kind, tensors, graph)
            write_atomically(run.path / "trace.jsonl", as_lines(trace))
            scorer = make_scorer(kind, tensors, graph.entities, graph.hash)
            # Ranking all training triples of a large graph would take longer than an epoch.
            ranks = rank_triples(scorer, sampled_for(graph, triples), triples)
        record = None
        if self.folds:
            # Finished folds stay among the checkpoints, so the same command trains the missing
            # ones.
            self._train_folds(run, self.folds, sum(row.seconds for row in trace), report)
            models = fold_models(run.path)
            record = write_folds(
                run.path, self.folds, scorer, kind, lambda fold: models.read(fold).tensors
            )
        files = RunFiles(run.path, run.record)
        metrics = LinkMetrics(
            kg=settings.kg,
            train_fraction=settings.train_fraction,
            label_noise=settings.label_noise,
            triples=len(triples),
            epochs=len(trace),
            seconds=round(sum(row.seconds for row in trace), 3),
            parameters=sum(parameter.numel() for parameter in loop.model.parameters()),
            loss=trace[-1].loss,
            train_mrr=mean_reciprocal_rank(ranks),
            outside=self.outside.summary if self.outside else None,
            choice=files.record(CHOICE, Choice) if CHOICE in run.record.inputs else None,
            folds=record.count if record else 0,
            fold_mrr=record.mrr if record else None,
            fold_in_sample_mrr=record.in_sample_mrr if record else None,
        )
        write_atomically(run.path / "metrics.json", dump_json(as_values(metrics)))
        outputs = (*OUTPUTS, *(FOLD_OUTPUTS if record else ()))
        run.finish(outputs, _model_card(self.opened, settings, metrics))
        return TrainedLinks(run.path, metrics)

    def _after_epoch(
        self,
        run: RunFolder[LinkProgress],
        loop: TrainingLoop,
        trace: list[TraceRow],
        report: Progress | None,
        log: Log,
    ) -> Callable[[int, float], None]:
        """Return a function that logs, saves and reports an epoch, and stops after Ctrl-C.

        Args:
            run: the run's folder.
            loop: PyKEEN's loop.
            trace: metrics of the epochs so far; each epoch adds a row.
            report: called with epoch, total and metrics; None for no reports.
            log: writes an epoch's metrics to ``metrics.jsonl`` and trackers.
        """
        settings = self.config.settings
        began = time.perf_counter()

        def after_epoch(epoch: int, loss: float) -> None:
            nonlocal began
            seconds = round(time.perf_counter() - began, 4)
            trace.append(TraceRow(epoch=epoch, loss=loss, seconds=seconds))
            is_last = run.interrupted.is_set() or epoch == settings.epochs
            if is_last or epoch % settings.checkpoint_every == 0:
                progress = LinkProgress(trace=tuple(trace))
                run.checkpoints.save(epoch, checkpoint_tensors(loop), progress)
            log(epoch, {"loss": loss, "seconds": seconds})
            if report:
                # Epochs of the main model and of each fold's model.
                total = settings.epochs * (1 + (settings.folds or 0))
                report(epoch, total, {"epoch": epoch, "loss": loss, "seconds": seconds})
            # PyKEEN offers callbacks no public way to stop a loop.
            loop._should_stop = is_last
            # Without checkpoints and trackers.
            began = time.perf_counter()

        return after_epoch

    def _train_folds(
        self, run: RunFolder[LinkProgress], folds: Folds, seconds: float, report: Progress | None
    ) -> None:
        """Train all missing fold models: for each fold, a model of the remaining train recipes.

        Args:
            run: the run's folder.
            folds: the folds and the training recipes.
            seconds: duration of the main training, which decides whether more processes are worth
                their start.
            report: called with the epochs of the main model and of all folds.

        Raises:
            TrainingError: if a loss is not finite, or a process dies.
            KeyboardInterrupt: after Ctrl-C.
        """
        settings = replace(self.config.settings, folds=0)
        jobs = [
            _Job(run.path, fold, settings, self.opened.graph, folds.triples([fold]), self.outside)
            for fold in range(folds.count)
        ]
        # Models that an interrupted run has finished, with the same triples and epochs, are not
        # trained again.
        waiting = not_done(jobs, fold_models(run.path))
        epochs = {job.fold: settings.epochs for job in jobs}
        epochs.update({job.fold: 0 for job in waiting})

        def note(fold: int | None = None, epoch: int = 0) -> None:
            if run.interrupted.is_set():
                raise KeyboardInterrupt
            # Without a fold, only to let the user interrupt the training.
            if fold is None:
                return
            epochs[fold] = epoch
            if report:
                num_epochs = sum(epochs.values())
                total = settings.epochs * (1 + folds.count)
                number = min(1 + num_epochs // settings.epochs, folds.count)
                report(settings.epochs + num_epochs, total, {"fold": number, "folds": folds.count})

        # On a GPU, several processes would share one device.
        is_long = seconds >= LONG and torch.device(settings.device).type == "cpu"
        train_jobs(waiting, settings.threads, note, is_long=is_long)

    @classmethod
    def outcome(cls, files: RunFiles) -> TrainedLinks:  # noqa: D102 - inherited
        return TrainedLinks(files.folder, files.record("metrics.json", LinkMetrics))


def _check_fit(opened: OpenedGraph, settings: LinkSettings, num_nodes: int) -> None:
    """Raise ConfigError if the settings do not fit the graph, its split or the machine."""
    if isinstance(settings, LinkModelConfig):
        check_table_fits(settings.model, opened.graph.num_entities)
    if settings.kg == "partial" and opened.split.config.kind == "none":
        raise ConfigError(
            "the graph has no test part and therefore no partial graph. Use `kg` full, or build "
            "the graph with another split, such as by-recipe."
        )
    check_device(settings.device)
    # Memory: models may need more. 4 bytes a number; complex dimensions have two.
    numbers = settings.dim * (2 if isinstance(settings, ComplExConfig) else 1)
    parameters = 4 * numbers * (num_nodes + len(RELATIONS))
    purpose = f"training vectors for {num_nodes:,} entities"
    # Parameters, gradients and optimiser state.
    check_memory("dim", settings.dim, purpose, 3 * parameters)
    if isinstance(settings, LinkModelConfig) and settings.loop == "slcwa":
        triples = min(settings.batch_size, len(opened.triples(settings.kg)))
        num_bytes = 4 * settings.dim * settings.negatives * triples
        purpose = f"the negatives' vectors for {triples:,} triples"
        check_memory("negatives", settings.negatives, purpose, num_bytes)


def _model_card(opened: OpenedGraph, settings: LinkSettings, metrics: LinkMetrics) -> str:
    name = "ComplEx" if isinstance(settings, ComplExConfig) else settings.model
    if settings.kg == "full":
        training_data = (
            "all triples, test recipes included: the scores show memory, not prediction."
        )
    else:
        sample = describe_train_sample(settings.train_fraction, settings.label_noise)
        training_data = f"the triples of {sample or 'the train recipes'} only."
    usage = "; `scorer.probability` returns probabilities for triples outside training"
    return scorer_card(
        opened,
        f"{name} on the {settings.kg} knowledge graph of {opened.graph.name}",
        "Scores triples (head, relation, tail) with the relations `combinesWith` and "
        f"`componentOf`. Trained on {training_data}",
        training_facts(settings, metrics),
        "`config.toml` reproduces the training; `run.json` records all versions. For the quality "
        "on unseen triples, "
        "run\n"
        "`wordcraft-kg evaluate-links`; the MRR above shows memory. Scores are not "
        f"probabilities{usage if metrics.folds else ''}.",
        [f'scorer.top(None, "componentOf", {opened.graph.entities[0]!r})'],
    )
