"""Search model settings with Optuna by the MRR on validation triples, never on test triples.

A search folder holds ``search.json`` (the definition), ``trials.jsonl`` (a line per finished trial) and ``best.toml``
(the best settings so far, for ``--config``). A trial depends only on the seed, the trial number and earlier trials, so
a resumed search equals an uninterrupted search.
"""

import logging
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState, create_trial

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import OutputExistsError, SplitError, TrainingError
from wordcraft_kg.base.records import Count, Record, Share, as_lines, as_values, parse_lines, read_record
from wordcraft_kg.base.settings import MAX_SIZE, refuse, whole
from wordcraft_kg.base.tensors import check_device
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.links.builders import check_table_fits, scorer_tensors
from wordcraft_kg.models.links.config import MAX_SEED, ComplExConfig, LinkModelConfig, LinkSettings
from wordcraft_kg.models.links.fitting import fit
from wordcraft_kg.models.links.pykeen_bridge import triples_factory
from wordcraft_kg.models.links.regularisation import POPULARITY, split_of_train
from wordcraft_kg.models.scorers.folder import make_scorer
from wordcraft_kg.models.scorers.ranking import MIN_TRIPLES, mean_reciprocal_rank, rank_triples
from wordcraft_kg.runs.config_file import toml_value
from wordcraft_kg.runs.folder import Progress, check_new_run, locked
from wordcraft_kg.runs.interruption import first_interrupt

SEARCH, TRIALS, BEST = "search.json", "trials.jsonl", "best.toml"
_EPOCHS = IntDistribution(20, 100, step=20)
_BATCH = CategoricalDistribution([256, 512, 1024])
_COMPLEX: dict[str, BaseDistribution] = {
    "n3": FloatDistribution(0.005, 0.5, log=True),
    "popularity": CategoricalDistribution(POPULARITY),
    "learning_rate": FloatDistribution(0.03, 0.3, log=True),
}
_OTHERS: dict[str, BaseDistribution] = {
    "dim": CategoricalDistribution([64, 128, 256]),
    "learning_rate": FloatDistribution(1e-3, 0.1, log=True),
    "negatives": CategoricalDistribution([8, 32, 128]),
}


class Trial(Record, frozen=True, kw_only=True):
    """A line of ``trials.jsonl``: a training's settings and validation MRR, None if the loss was not finite."""

    number: Count
    valid_mrr: Share | None
    settings: dict[str, int | float]
    seconds: float


class Search(Record, frozen=True, kw_only=True):
    """Content of ``search.json``: a search definition, without the number of trials."""

    format: Literal["wordcraft-kg search 1"] = "wordcraft-kg search 1"
    graph: str
    split: str
    model: str
    valid_ratio: float
    seed: int
    device: str


class Tuned(Record):
    """Outcome of a search: the best settings and the matching training command.

    Attributes:
        out: search folder.
        config: TOML file with the best settings.
        table: all trials.
    """

    model: str
    command: str
    trials: Count
    valid_mrr: Share
    settings: dict[str, str | int | float]
    out: str
    config: str
    table: tuple[Trial, ...]


@dataclass(frozen=True)
class _Space:
    """A model's search space."""

    model: str
    seed: int
    device: str

    @property
    def is_complex(self) -> bool:
        return self.model.lower() == "complex"

    @property
    def distributions(self) -> dict[str, BaseDistribution]:
        return {"batch_size": _BATCH, "epochs": _EPOCHS, **(_COMPLEX if self.is_complex else _OTHERS)}

    def named(self, drawn: dict[str, Any]) -> dict[str, Any]:
        return drawn if self.is_complex else {"model": self.model, **drawn}

    def settings(self, drawn: dict[str, Any]) -> LinkSettings:
        kind = ComplExConfig if self.is_complex else LinkModelConfig
        return kind(**self.named(drawn), seed=self.seed, device=self.device)


def tune(
    opened: OpenedGraph,
    model: str,
    out: Path,
    *,
    trials: int = 20,
    valid_ratio: float = 0.1,
    seed: int = 0,
    timeout: int | None = None,
    device: str = "cpu",
    force: bool = False,
    progress: Progress | None = None,
) -> Tuned:
    """Search the model settings with the best validation MRR on the partial graph, or add trials to an earlier search.

    Args:
        opened: graph and split; a missing validation part is drawn from the train recipes.
        model: ``complex``, or the PyKEEN name of another model.
        out: search folder.
        trials: number of trials, including earlier ones.
        valid_ratio: share of train pairs, or goals, drawn for validation.
        seed: seed for search, validation split and trainings.
        timeout: seconds after which no new trial begins.
        device: torch device.
        force: replace the folder.
        progress: called after each epoch and trial with the number of finished trials.

    Raises:
        ConfigError: if an argument is out of range or PyKEEN has no such model.
        SplitError: if there are too few validation triples.
        OutputExistsError: if the folder holds another search or other files.
        TrainingError: if no trial had a finite loss.
        KeyboardInterrupt: after Ctrl-C, with the number of saved trials.
    """
    space = _checked_space(opened, model, trials, valid_ratio, seed, timeout, device)
    train, valid = _validation_split(opened, valid_ratio, seed)
    decisive: dict[str, Any] = {"valid_ratio": valid_ratio, "seed": seed, "device": device}
    search = Search(graph=opened.graph.hash, split=opened.split.hash, model=model.lower(), **decisive)
    with _search_folder(out, search, force=force) as done:
        ends = None if timeout is None else time.monotonic() + timeout
        with first_interrupt() as interrupted, _quiet_optuna():
            study = _study_of(space, done)

            def after_epoch(fraction: float) -> None:
                if interrupted.is_set():
                    raise KeyboardInterrupt(_saved(out, done))
                if progress:
                    progress(len(done), trials, {"next trial": fraction, **_best_mrr(done)})

            while len(done) < trials and (ends is None or time.monotonic() < ends or not done):
                done.append(_next_trial(study, space, opened, train, valid, after_epoch))
                _write(out, opened, space, done)
                if progress:
                    progress(len(done), trials, _best_mrr(done))
    best = _best(done)
    if best is None or best.valid_mrr is None:
        raise TrainingError(f"the loss became infinite or not a number in all {len(done)} trials, see '{out}'.")
    command, settings = space.settings(best.settings).command, space.named(best.settings)
    return Tuned(model, command, len(done), best.valid_mrr, settings, str(out), str(out / BEST), tuple(done))


def _checked_space(
    opened: OpenedGraph, model: str, trials: int, valid_ratio: float, seed: int, timeout: int | None, device: str
) -> _Space:
    whole("trials", trials, 1, MAX_SIZE)
    if not 0 < valid_ratio < 1:
        raise refuse("valid_ratio", valid_ratio, "more than 0 and less than 1")
    if timeout is not None:
        whole("timeout", timeout, 1)
    whole("seed", seed, 0, MAX_SEED)
    check_device(device)
    space = _Space(model, seed, device)
    if not space.is_complex:
        check_table_fits(model, opened.graph.num_entities)
    return space


def _validation_split(opened: OpenedGraph, ratio: float, seed: int) -> tuple[Ids, Ids]:
    """Return training and validation triples; a missing validation part is sampled like the test part."""
    train, valid = opened.split.partial, opened.split.held_out("valid")
    if not len(valid):
        try:
            split = split_of_train(opened.split, ratio, seed)
            train, valid = split.partial, split.held_out("test")
        except SplitError:  # the message would name the wrong ratio
            valid = train[:0]
    if len(valid) < MIN_TRIPLES:
        raise SplitError(
            f"only {len(valid)} validation triples; expected at least {MIN_TRIPLES}. Choose a larger `valid_ratio`."
        )
    return train, valid


@contextmanager
def _search_folder(out: Path, search: Search, *, force: bool) -> Iterator[list[Trial]]:
    """Open and lock a search folder, and yield the trials; remove a folder without trials."""
    if force or not (out / SEARCH).is_file():
        check_new_run(out, force=force)
        shutil.rmtree(out, ignore_errors=True)
    else:
        earlier = as_values(read_record(out / SEARCH, Search))
        other = [name for name, value in as_values(search).items() if earlier[name] != value]
        if other:
            raise OutputExistsError(
                f"'{out}' holds a search with another {' and '.join(other)}. Choose another `out`, or replace the "
                "search with `force`."
            )
    out.mkdir(parents=True, exist_ok=True)
    path = out / TRIALS
    with locked(out):
        try:
            write_atomically(out / SEARCH, dump_json(as_values(search)))
            yield parse_lines(path.read_bytes(), Trial, path) if path.is_file() else []
        finally:
            if not path.is_file():
                shutil.rmtree(out, ignore_errors=True)


def _study_of(space: _Space, done: list[Trial]) -> optuna.Study:
    study = optuna.create_study(direction="maximize")
    for trial in done:
        state = TrialState.FAIL if trial.valid_mrr is None else TrialState.COMPLETE
        study.add_trial(
            create_trial(state=state, params=trial.settings, distributions=space.distributions, value=trial.valid_mrr)
        )
    return study


def _next_trial(
    study: optuna.Study,
    space: _Space,
    opened: OpenedGraph,
    train: Ids,
    valid: Ids,
    after_epoch: Callable[[float], None],
) -> Trial:
    number, began = len(study.trials), time.perf_counter()
    draws = int(np.random.SeedSequence([space.seed, number]).generate_state(1)[0])
    study.sampler = optuna.samplers.TPESampler(seed=draws)
    trial = study.ask(space.distributions)
    settings = space.settings(trial.params)
    factory = triples_factory(opened.graph, train)
    try:
        model = fit(settings, factory, lambda epoch: after_epoch(epoch / settings.epochs))
    except TrainingError:
        mrr = None
        study.tell(trial, state=TrialState.FAIL)
    else:
        scorer = make_scorer(*scorer_tensors(settings, model, train), opened.graph.entities, opened.graph.hash)
        mrr = mean_reciprocal_rank(rank_triples(scorer, valid, np.concatenate([train, valid])))
        study.tell(trial, mrr)
    seconds = round(time.perf_counter() - began, 3)
    return Trial(number=number + 1, valid_mrr=mrr, settings=dict(sorted(trial.params.items())), seconds=seconds)


def _write(out: Path, opened: OpenedGraph, space: _Space, done: list[Trial]) -> None:
    write_atomically(out / TRIALS, as_lines(done), durable=True)
    if best := _best(done):
        lines = [
            f"# validation MRR {best.valid_mrr:.4f}, the best of {len(done)} trials on {opened.graph.name}",
            f"# graph {opened.graph.hash[:12]}, split {opened.split.hash[:12]}, seed {space.seed}",
            f"[{space.settings(best.settings).command}]",
            *(f"{name} = {toml_value(value)}" for name, value in space.named(best.settings).items()),
        ]
        write_atomically(out / BEST, "\n".join(lines) + "\n")


def _best(done: list[Trial]) -> Trial | None:
    finite = (trial for trial in done if trial.valid_mrr is not None)
    return max(finite, key=lambda trial: trial.valid_mrr or 0.0, default=None)


def _best_mrr(done: list[Trial]) -> dict[str, float]:
    best = _best(done)
    return {} if best is None or best.valid_mrr is None else {"best MRR": best.valid_mrr}


def _saved(out: Path, done: list[Trial]) -> str:
    if not done:
        return ""
    best = "".join(f", the best so far in {out / BEST} (validation MRR {mrr:.3f})" for mrr in _best_mrr(done).values())
    trials = "1 trial is" if len(done) == 1 else f"{len(done)} trials are"
    return f"interrupted; {trials} saved in '{out}'{best}. Repeat the command to resume."


@contextmanager
def _quiet_optuna() -> Iterator[None]:
    logger = logging.getLogger("optuna")
    before = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(before)
