"""Training the models of the folds: for each fold one on all other train recipes, side by side where cores allow.

A fold that is done is kept beside the run's checkpoints, so that an interrupted run goes on with those that are
missing. What a fold's model becomes depends on the settings and its triples alone, not on the process that trains it
or on the order.
"""

import functools
import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType

import safetensors.torch
import torch

from wordcraft_kg.artefacts import dump_json, write_atomically
from wordcraft_kg.errors import ArtefactError, ConfigError, TrainingError, WordCraftKGError, reason
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.folds import Folds, make_folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import is_in, recipe_triples, triples_hash
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import FOLDS, ComplExConfig, LinkSettings
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.records import FoldDone
from wordcraft_kg.models.scorers.cross_fitting import Fold, FoldsRecord
from wordcraft_kg.models.scorers.folder import FOLDS_RECORD, FOLDS_TENSORS, OF_RECIPE, ScorerKind, make_scorer
from wordcraft_kg.models.scorers.limits import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.records import as_values
from wordcraft_kg.runs.checkpoints import Checkpoints
from wordcraft_kg.tensors import copied

FOLD_OUTPUTS = (FOLDS_RECORD, FOLDS_TENSORS)
LONG = 10.0
"""Seconds of a training from which its folds are trained side by side: a process takes some to import its libraries."""

AfterEpoch = Callable[[int], None]


def decided_folds(settings: LinkSettings, opened: OpenedGraph) -> LinkSettings:
    """Return settings in which the number of folds is decided.

    Raises:
        ConfigError: if the number asked for cannot be.
    """
    asked, kind = settings.folds, opened.split.config.kind
    count = FOLDS if asked is None else asked
    if settings.kg == "full" or not count or (asked is None and kind == "none"):
        return replace(settings, folds=0)
    try:
        make_folds(opened.split, count)
        _check_size(settings, count, opened.graph.num_entities)
    except ConfigError as error:
        if asked is not None:
            raise
        logging.getLogger(__name__).info("no folds: %s", error)
        count = 0
    return replace(settings, folds=count)


def _check_size(settings: LinkSettings, count: int, num_entities: int) -> None:
    """Refuse tables of all scores for each fold where they would be too large together; embeddings are small."""
    needed = count * table_bytes(num_entities)
    if not isinstance(settings, ComplExConfig) and needed > TABLE_LIMIT:
        raise ConfigError(
            f"`folds` {count}: a table of all scores for each fold takes {needed / 2**20:,.0f} MiB; expected at most "
            f"{TABLE_LIMIT / 2**20:.0f} MiB. Use fewer folds or 0, or ComplEx (wordcraft-kg train-complex)."
        )


@dataclass(frozen=True)
class _Job:
    """All that a process needs to train a fold's model; one for each fold."""

    folder: Path
    fold: int
    settings: LinkSettings
    graph: RecipeGraph
    triples: Ids

    def train(self, after_epoch: AfterEpoch) -> None:
        """Train it and keep its tensors beside the checkpoints of the run."""
        model = fit(self.settings, triples_factory(self.graph, self.triples), after_epoch)
        _, tensors = scorer_tensors(self.settings, model, self.triples)
        # A table serves without the parameters that it was computed from.
        wanted = {name: tensor for name, tensor in tensors.items() if not name.startswith("pykeen.")}
        _kept(self.folder).save(self.fold, copied(wanted), self.done)

    @property
    def done(self) -> FoldDone:
        """What is recorded of its model; that of another training is not used."""
        return FoldDone(trained_on=triples_hash(self.triples), epochs=self.settings.epochs)


def _kept(folder: Path) -> Checkpoints[FoldDone]:
    return Checkpoints(folder, "fold", FoldDone, kept=None)


def train_folds(
    folder: Path, folds: Folds, settings: LinkSettings, *, seconds: float, after_epoch: Callable[[int, int], None]
) -> None:
    """Train the models of the folds that are not there yet.

    Args:
        folder: folder of the run.
        folds: the folds.
        settings: with which the model of all train recipes was trained; ``epochs`` are those that it ended with.
        seconds: how long that took, which decides whether more processes are worth their start.
        after_epoch: called with the epochs that are done, of all folds, and their total; what it raises ends the
            training. Called regularly, also while no epoch ends.

    Raises:
        TrainingError: if a loss is no longer finite, or a process dies.
    """
    settings = replace(settings, eval_every=0, patience=0, folds=0)
    graph = folds.split.graph
    jobs = [_Job(folder, fold, settings, graph, folds.triples([fold])) for fold in range(folds.count)]
    waiting = [job for job in jobs if not _is_done(job)]
    epochs = {job.fold: 0 if job in waiting else settings.epochs for job in jobs}

    def note(fold: int | None = None, epoch: int = 0) -> None:
        if fold is not None:
            epochs[fold] = epoch
        after_epoch(sum(epochs.values()), settings.epochs * len(jobs))

    workers = min(len(waiting), max(_cores() // settings.threads, 1))
    if seconds < LONG or torch.device(settings.device).type != "cpu" or workers == 1:
        for job in waiting:
            job.train(functools.partial(note, job.fold))
    else:
        _side_by_side(waiting, workers, note)


def _is_done(job: _Job) -> bool:
    kept = _kept(job.folder)
    if job.fold not in kept.records():
        return False
    try:
        return kept.read(job.fold).progress == job.done
    except ArtefactError as error:
        logging.getLogger(__name__).warning("%s Training fold %s again.", error, job.fold)
        return False


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _side_by_side(jobs: Sequence[_Job], workers: int, note: Callable[..., None]) -> None:
    """Train in processes of their own: PyKEEN seeds global generators, which threads would share.

    They are ended, not asked to end, when anything goes wrong or the user presses Ctrl-C: an epoch may take minutes.
    """
    running = dict(_started(jobs[number::workers]) for number in range(workers))
    try:
        while running:
            for ready in wait(list(running), timeout=0.2):
                assert isinstance(ready, Connection)
                try:
                    message = ready.recv()
                except EOFError:  # it has no more to say: it is done, or was killed
                    process = running.pop(ready)
                    process.join()
                    if process.exitcode:
                        raise TrainingError(
                            f"a process that trained folds ended with code {process.exitcode}; perhaps there is too "
                            "little memory for several at once. Take more `threads`, or fewer `folds`."
                        ) from None
                    continue
                if isinstance(message, Exception):
                    raise message
                note(*message)
            note()
    finally:
        for process in running.values():
            process.terminate()
            process.join()


def _started(jobs: Sequence[_Job]) -> tuple[Connection, BaseProcess]:
    """Start a process for some jobs; what it has to say comes from the connection."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sender, jobs), daemon=True)
    with _own_start():
        process.start()
    sender.close()
    return receiver, process


@contextmanager
def _own_start() -> Iterator[None]:
    """Keep the caller's program and Ctrl-C out of a process that starts in this block.

    A new process would import the program that was started, and thereby run it if it has no ``__main__`` guard; ours
    needs nothing of it. Ctrl-C on a terminal goes to all processes; this one hears it and ends the others.
    """
    program = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    can_block = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if can_block else set()
    try:
        yield
    finally:
        sys.modules["__main__"] = program
        if can_block:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(connection: Connection, jobs: Sequence[_Job]) -> None:
    """Do jobs in a process of its own: send fold and number of each epoch, or the error that ended it."""
    with suppress(BrokenPipeError):  # nobody is there any more
        try:
            for job in jobs:
                job.train(lambda epoch, fold=job.fold: connection.send((fold, epoch)))  # type: ignore[misc]
        except WordCraftKGError as error:
            connection.send(error)
        except Exception as error:
            connection.send(TrainingError(f"a fold could not be trained ({reason(error)})."))


def write_folds(folder: Path, folds: Folds, whole: Scorer) -> FoldsRecord:
    """Write the files of the folds, all of which are trained; return what is known of them.

    Args:
        folder: folder of the run.
        folds: the folds.
        whole: the scorer of all train recipes.
    """
    graph, kept = folds.split.graph, _kept(folder)
    tensors = {OF_RECIPE: torch.from_numpy(folds.of_recipe.copy())}
    found = []
    for number in range(folds.count):
        part = kept.read(number)
        tensors |= {f"fold{number}.{name}": tensor for name, tensor in part.tensors.items()}
        trained_on = folds.triples([number])
        own = recipe_triples(graph.recipes[folds.of_recipe == number])
        queries = sampled_for(graph, own[~is_in(own, trained_on, graph.num_entities)])
        kind: ScorerKind = "table" if "scores" in part.tensors else "complex"
        others = make_scorer(kind, part.tensors, graph.entities, graph.hash)
        mrr, in_sample = (
            mean_reciprocal_rank(rank_triples(scorer, queries, graph.triples)) if len(queries) else None
            for scorer in (others, whole)
        )
        found.append(
            Fold(
                trained_on=part.progress.trained_on,
                triples=len(trained_on),
                queries=2 * len(queries),
                mrr=mrr,
                in_sample_mrr=in_sample,
            )
        )
    record = FoldsRecord(seed=folds.seed, hash=folds.hash, folds=tuple(found))
    write_atomically(folder / FOLDS_TENSORS, safetensors.torch.save(tensors))
    write_atomically(folder / FOLDS_RECORD, dump_json(as_values(record)))
    return record
