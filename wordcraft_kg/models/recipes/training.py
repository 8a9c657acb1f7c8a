"""Fit recipe scorers into a model folder: on all train recipes, and for cross-fitting without each fold in turn.

Fits run in parallel if there are enough CPU cores. A resumed run makes only fits that were not finished.
"""

import hashlib
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_limits
from torch import Tensor

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.settings import memory
from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.folds import Folds, make_folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.graphs.train_samples import (
    TrainSample,
    describe_train_sample,
    draw_train_sample,
    is_subsample,
)
from wordcraft_kg.graphs.triples import triples_hash
from wordcraft_kg.models.recipes.base import LinkTables
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.fitting import fit_recipe_scorer, scorer_tensors
from wordcraft_kg.models.recipes.method import MOST_WITH_TABLES, check_lists, uses_lists
from wordcraft_kg.models.recipes.neighbour_fitting import LeftOut, Words, fit_by_neighbours
from wordcraft_kg.models.recipes.outside import (
    describe_source,
    is_book,
    open_outside,
    shared_recipes,
    text_of,
)
from wordcraft_kg.models.recipes.records import FitDone, RecipeMetrics
from wordcraft_kg.models.recipes.zero_shot import join_books, tables_alone
from wordcraft_kg.models.scorers.config import check_dense, fit_bytes
from wordcraft_kg.models.scorers.features import make_features, named
from wordcraft_kg.models.scorers.folder import FOLD_OUTPUTS, write_folds, write_scorer
from wordcraft_kg.models.scorers.neighbours.scorer import NeighbourRecipeScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.runs.cards import scorer_card
from wordcraft_kg.runs.checkpoints import Checkpoint, Checkpoints
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.folder import Progress, RunFolder, RunKind
from wordcraft_kg.runs.parallel import cores, not_done, train_jobs
from wordcraft_kg.runs.trackers import Log
from wordcraft_kg.runs.training import Training, train

OUTPUTS = ("model.safetensors", "vocabulary.json", "config.toml", "metrics.json")
ALONE = 1_000
"""Largest number of recipes for a single process: starting another process takes as long as a fit."""


@dataclass(frozen=True)
class TrainedRecipes:
    """Outcome of :func:`train_recipes`: model folder, and the content of ``metrics.json``."""

    folder: Path
    metrics: RecipeMetrics


def train_recipes(
    config: RecipesConfig,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Progress | bool | None = None,
) -> TrainedRecipes:
    """Fit a recipe scorer into a model folder, or resume an interrupted run with the same settings.

    ``out`` is by default ``models/<graph name>-recipes``; ``force`` replaces the folder. ``progress`` is called after
    each fitting step; True shows a bar. Errors are those of :func:`~wordcraft_kg.runs.training.train`, and
    KeyboardInterrupt after Ctrl-C, with the number of saved fits.

    Example:
        >>> trained = train_recipes(RecipesConfig("kitchen", RecipeScorerConfig(folds=3)), "models/kitchen-recipes")
        >>> load_scorer(trained.folder).score_recipes("flour", "water", "dough").shape
        torch.Size([])
    """
    return train(RecipesTraining, config, out, force=force, progress=progress)


def _fit_bytes(opened: OpenedGraph, settings: RecipeScorerConfig) -> int:
    graph = opened.graph
    return fit_bytes(graph.num_entities, graph.num_recipes, settings.folds)


def _check_fit(opened: OpenedGraph, settings: RecipeScorerConfig) -> None:
    check_dense("a recipe scorer", opened.graph.num_entities, _fit_bytes(opened, settings))


def _check_outside(opened: OpenedGraph, settings: RecipeScorerConfig) -> None:
    """Raise ConfigError for outside knowledge, whose tables would be too large for a large book."""
    size = opened.graph.num_entities
    if settings.with_ or settings.kg == "none":
        raise ConfigError(
            f"`with` {', '.join(settings.with_)} is compared with all pairs of {size:,} entities; expected at most "
            f"{MOST_WITH_TABLES:,}. Leave out `with`, or use a smaller graph."
        )


def _folds(
    opened: OpenedGraph, settings: RecipeScorerConfig, without: Sequence[RecipeGraph]
) -> Folds:
    split = opened.split
    if settings.kg == "full":
        split = make_split(opened.graph, SplitConfig("none"))
    elif split.config.kind == "none":
        raise ConfigError(
            "the graph has no test part and therefore no partial graph. Use `kg` full, or build the graph with "
            "another split, such as by-recipe."
        )
    # Leaving out one fold must leave at least two for the rankers.
    if settings.kg == "partial" and settings.folds < 3:
        raise ConfigError(
            "`folds` 2: expected 3 or more, because rankers need two folds besides the left-out fold."
        )
    folds = make_folds(split, settings.folds)
    if without:
        is_kept = ~np.any([shared_recipes(opened.graph, other) for other in without], axis=0)
        if not is_kept.any():
            raise ConfigError(
                f"`without` {', '.join(settings.without)} leaves no recipe of {opened.graph.name}."
            )
        for spec, book in itertools.product(filter(is_book, settings.with_), without):
            other = open_graph(spec).graph
            if (shared_recipes(other, book) & ~shared_recipes(other, opened.graph)).any():
                raise ConfigError(
                    f"`with` '{spec}' has recipes of {book.name}, which `without` leaves out. Omit one."
                )
        return folds.with_train_sample(TrainSample.of(opened.graph, is_kept))
    return folds.with_train_sample(
        draw_train_sample(
            split,
            settings.train_fraction,
            settings.label_noise,
            settings.seed,
            of_recipe=folds.of_recipe,
        )
    )


@contextmanager
def _threads(number: int) -> Iterator[None]:
    """Limit the CPU threads of torch and NumPy: for small arrays, further threads mostly wait, at full load."""
    with torch_threads(number), threadpool_limits(number):
        yield


@dataclass(frozen=True)
class _Job:
    """A fit: number 0 with all recipes, number k + 1 without fold k; ``own`` are the entities of a zero-shot scorer."""

    folder: Path
    fold: int
    folds: Folds
    text: Tensor
    outside: LinkTables
    own: Tensor | None
    settings: RecipeScorerConfig

    @property
    def left_out(self) -> tuple[int, ...]:
        return (self.fold - 1,) if self.fold else ()

    @property
    def done(self) -> FitDone:
        return FitDone(trained_on=triples_hash(self.folds.triples(self.left_out)))

    def train(self, after: Callable[[int], None]) -> None:
        steps = 0

        def step() -> None:
            nonlocal steps
            steps += 1
            after(steps)

        recipes = self.folds.recipes(self.left_out)
        with _threads(self.settings.threads):
            if len(recipes):
                knowledge, rankers = fit_recipe_scorer(
                    self.folds,
                    self.text,
                    outside=self.outside,
                    left_out=self.left_out,
                    seed=self.settings.seed,
                    after=step,
                )
            else:
                knowledge, rankers = tables_alone(self.outside, self.text)
        if self.own is not None:
            knowledge, recipes = knowledge.of_entities(self.own), recipes[:0]
        _kept(self.folder).save(self.fold, scorer_tensors(knowledge, rankers, recipes), self.done)


def _kept(folder: Path) -> Checkpoints[FitDone]:
    return Checkpoints(folder, "fit", FitDone, kept=None)


class RecipesTraining(Training[RecipesConfig, FitDone, TrainedRecipes]):
    """Trainer for recipe scorers."""

    kind: ClassVar[RunKind[Any]] = RunKind(
        RecipesConfig.commands, "recipes", unit="fit", progress=FitDone
    )
    config_type = RecipesConfig

    def __init__(self, config: RecipesConfig, opened: OpenedGraph):
        """Draw the cross-fitting folds, look up word vectors and open outside knowledge.

        ConfigError if the settings do not fit the graph.
        """
        super().__init__(config, opened)
        settings = config.settings
        sources = settings.with_, opened, settings.features
        self.uses_lists = uses_lists(opened.graph.num_entities)
        if self.uses_lists:
            _check_outside(opened, settings)
        else:
            _check_fit(opened, settings)
        self.without = [open_graph(book).graph for book in settings.without]
        self.own: Tensor | None = None
        with _threads(settings.threads):
            if settings.kg == "none":
                joint = join_books(
                    *sources, folds=settings.folds, allow_missing=settings.allow_missing
                )
                opened, self.own, self.folds, self.outside = joint
                _check_fit(opened, settings)  # with the entities of the other books
            else:
                self.folds = _folds(opened, settings, self.without)
                self.outside = open_outside(*sources, allow_missing=settings.allow_missing)
            self.words = named(settings.features, opened.graph.entities)
            if self.uses_lists:
                self._read_words(opened.graph)
                return
            features = make_features(
                self.words, opened.graph.entities, allow_missing=settings.allow_missing
            )
            self._bytes = _fit_bytes(opened, settings)
            self.text, self.features = text_of(features), features.sha256

    def _read_words(self, graph: RecipeGraph) -> None:
        """Set the unit vectors for neighbour lists; ConfigError if memory does not suffice."""
        if self.words == "one-hot":
            # No words: E x E vectors would say the same, at the cost of all pairs.
            self.vectors = np.zeros((graph.num_entities, 0), dtype=np.float32)
            self.features = hashlib.sha256(f"one-hot {graph.num_entities}".encode()).hexdigest()
        else:
            features = make_features(
                self.words, graph.entities, allow_missing=self.config.settings.allow_missing
            )
            self.vectors = features.unit_vectors
            self.features = features.sha256
        check_lists(graph.num_entities, len(self.folds.recipes()), self.vectors.shape[1], cores())

    def begin(self, run: RunFolder[FitDone], report: Progress | None) -> Mapping[str, Any]:  # noqa: D102 - inherited
        settings, inputs = (
            self.config.settings,
            {"features": self.features, **self._outside_hashes()},
        )
        inputs |= {f"without {other.name}": other.hash for other in self.without}
        if settings.kg == "partial":
            inputs["folds"] = self.folds.hash
        if is_subsample(settings.train_fraction, settings.label_noise):
            inputs["train_sample"] = self.folds.train_sample.hash
        return {"inputs": inputs}

    def _outside_hashes(self) -> dict[str, str]:
        return {
            f"with {place}: {source.name}": source.sha256
            for place, source in enumerate(self.outside.sources, 1)
        }

    def restored(self, run: RunFolder[FitDone]) -> None:
        """Return None in place of a checkpoint: a resumed run skips all saved fits."""

    def fit(  # noqa: D102 - inherited
        self,
        run: RunFolder[FitDone],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[FitDone] | None,
    ) -> TrainedRecipes:
        settings = self.config.settings
        if not run.is_live:
            for name, sha256 in {"features": self.features, **self._outside_hashes()}.items():
                if sha256 != run.record.inputs.get(name):
                    raise ArtefactError(
                        f"`{name}` has changed since '{run.path}' began. Restore the earlier files, or train again."
                    )
            run.resume(self.config)
        began = time.perf_counter()
        kept = _kept(run.path)
        fit = self._fit_lists if self.uses_lists else self._fit_tables
        fit(run, report, kept)
        with _threads(settings.threads):
            return self._finish(run, kept, time.perf_counter() - began)

    def _fit_lists(
        self, run: RunFolder[FitDone], report: Progress | None, kept: Checkpoints[FitDone]
    ) -> None:
        """Make and save all fits that are not saved yet, by neighbour lists."""
        settings = self.config.settings
        folds = self.folds
        number = folds.count if settings.kg == "partial" else 0
        every: list[LeftOut] = [(), *((fold,) for fold in range(number))]
        saved = set(kept.records())
        wanted = [left_out for fit, left_out in enumerate(every) if fit not in saved]
        # Sets of lists: without each fold, and without each two folds.
        total = folds.count + number * (folds.count - 1) // 2
        steps = 0

        def after() -> None:
            nonlocal steps
            if run.interrupted.is_set():
                raise KeyboardInterrupt
            steps += 1
            if report:
                report(min(steps, total), total, {})

        try:
            with _threads(settings.threads):
                words = Words.of(self.vectors)
                fitted = fit_by_neighbours(
                    folds, words, wanted, seed=settings.seed, workers=cores(), after=after
                )
                for left_out, knowledge in fitted:
                    tensors = knowledge.constants()
                    if left_out:
                        # The main model has the words for all folds.
                        tensors = {
                            name: tensor
                            for name, tensor in tensors.items()
                            if name not in NeighbourRecipeScorer.shared
                        }
                    trained_on = triples_hash(folds.triples(left_out))
                    kept.save(every.index(left_out), tensors, FitDone(trained_on=trained_on))
        except KeyboardInterrupt:
            raise self._interrupted(run, len(kept.records()), len(every)) from None
        if report:
            report(total, total, {})

    def _interrupted(self, run: RunFolder[FitDone], saved: int, number: int) -> KeyboardInterrupt:
        done = f"interrupted; {saved} of {number} fits are saved in '{run.path}'."
        return KeyboardInterrupt(f"{done} Repeat the command to make the rest.")

    def _fit_tables(
        self, run: RunFolder[FitDone], report: Progress | None, kept: Checkpoints[FitDone]
    ) -> None:
        """Make and save all fits that are not saved yet, by tables of all pairs."""
        settings = self.config.settings
        folds = self.folds
        is_partial = settings.kg == "partial"
        jobs = [
            _Job(run.path, number, folds, self.text, self.outside.tables, self.own, settings)
            for number in range(1 + folds.count * is_partial)
        ]
        waiting = not_done(jobs, kept)
        total = len(jobs) * (settings.folds + 3)
        so_far = dict.fromkeys((job.fold for job in jobs if job not in waiting), settings.folds + 3)

        def note(fold: int | None = None, steps: int = 0) -> None:
            if run.interrupted.is_set():
                raise KeyboardInterrupt
            if fold is not None:
                so_far[fold] = steps
                if report:
                    report(sum(so_far.values()), total, {})

        at_once = min(len(waiting), max(cores() // settings.threads, 1))
        fits_memory = at_once * self._bytes <= memory()
        is_long = len(folds.recipes()) > ALONE and fits_memory
        try:
            train_jobs(waiting, settings.threads, note, is_long=is_long)
        except KeyboardInterrupt:
            raise self._interrupted(run, len(kept.records()), len(jobs)) from None
        if report:
            report(total, total, {})

    def _finish(
        self, run: RunFolder[FitDone], kept: Checkpoints[FitDone], seconds: float
    ) -> TrainedRecipes:
        graph, settings, folds = self.opened.graph, self.config.settings, self.folds
        tensors = kept.read(0).tensors
        scorer: type[RecipeScorer] = NeighbourRecipeScorer if self.uses_lists else RecipeScorer
        write_scorer(run.path, scorer.kind, tensors, graph)
        outputs: tuple[str, ...] = OUTPUTS
        record = None
        if settings.kg == "partial":

            def part(fold: int) -> tuple[str, dict[str, Tensor]]:
                fit = kept.read(fold + 1)
                return fit.progress.trained_on, shared | fit.tensors

            shared = {name: tensors[name] for name in scorer.shared}
            whole = scorer(tensors, graph.entities, graph.hash)
            record = write_folds(run.path, folds, whole, scorer.kind, part)
            outputs += FOLD_OUTPUTS
        metrics = RecipeMetrics(
            kg=settings.kg,
            train_fraction=settings.train_fraction,
            label_noise=settings.label_noise,
            recipes=len(folds.recipes()),
            features=self.words,
            seconds=round(seconds, 3),
            folds=record.count if record else 0,
            fold_mrr=record.mrr if record else None,
            fold_in_sample_mrr=record.in_sample_mrr if record else None,
            outside=self.outside.sources,
        )
        write_atomically(run.path / "metrics.json", dump_json(as_values(metrics)))
        run.finish(outputs, _model_card(self.opened, metrics, settings.without))
        return TrainedRecipes(run.path, metrics)

    @classmethod
    def outcome(cls, files: RunFiles) -> TrainedRecipes:  # noqa: D102 - inherited
        return TrainedRecipes(files.folder, files.record("metrics.json", RecipeMetrics))


def _model_card(opened: OpenedGraph, metrics: RecipeMetrics, without: Sequence[str]) -> str:
    seen = f"{describe_train_sample(metrics.train_fraction, metrics.label_noise) or 'the train recipes'} only."
    if metrics.kg == "full":
        seen = "all recipes, test recipes included: the scores show memory, not prediction."
    if without:
        seen = f"recipes that are not in {', '.join(without)}."
    if metrics.kg == "none":
        seen = "outside knowledge only: this book's recipes are unseen."
    points = [f"{metrics.recipes:,} recipes; words: {metrics.features}"]
    points += [f"outside knowledge: {line}" for line in map(describe_source, metrics.outside)]
    if metrics.fold_mrr is not None:
        figures = (
            f"MRR {metrics.fold_mrr:.3f} out-of-sample, {metrics.fold_in_sample_mrr:.3f} in-sample"
        )
        points.append(f"{metrics.folds} folds: {figures}, on train triples")
    a, b, result = opened.graph.recipe_labels()[0]
    return scorer_card(
        opened,
        f"A recipe scorer of the {metrics.kg} knowledge graph of {opened.graph.name}",
        "Scores recipes, `score_recipes(a, b, result)`, and triples with the relations `combinesWith` and "
        f"`componentOf`. Fitted on {seen}",
        points,
        "`config.toml` reproduces the training; `run.json` records all versions. For the quality on unseen triples, "
        "run\n`wordcraft-kg evaluate-links`.",
        [
            f"scorer.score_recipes({a!r}, {b!r}, {result!r})  # nats: higher is more plausible",
            f"scorer.supporting_recipes({a!r}, {b!r}, {result!r})  # supporting evidence",
        ],
    )
