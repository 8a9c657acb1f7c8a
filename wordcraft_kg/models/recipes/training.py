"""Fit recipe scorers into a model folder.

One is fitted on all train recipes, and for cross-fitting one without each fold in turn. Fits run in
parallel if there are enough CPU cores. A resumed run makes only fits that were not finished.
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
"""Largest number of recipes for a single process: starting another one takes as long as a fit."""
_STEPS = 3
"""Steps of a fit besides those for its folds: the unknown entities, and two link rankers."""


@dataclass(frozen=True)
class TrainedRecipes:
    """Outcome of :func:`train_recipes`.

    Attributes:
        folder: model folder.
        metrics: content of ``metrics.json``.
    """

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

    Args:
        config: all settings.
        out: model folder; None for ``models/<graph name>-recipes``.
        force: replace the folder.
        progress: called after each fitting step; True shows a bar, None or False nothing.

    Raises:
        KeyboardInterrupt: after Ctrl-C, with the number of saved fits.

    Further errors are those of :func:`~wordcraft_kg.runs.training.train`.

    Example:
        >>> config = RecipesConfig("kitchen", RecipeScorerConfig(folds=3))
        >>> trained = train_recipes(config, "models/kitchen-recipes")
        >>> load_scorer(trained.folder).score_recipes("flour", "water", "dough").shape
        torch.Size([])
    """
    return train(RecipesTraining, config, out, force=force, progress=progress)


def _fit_bytes(opened: OpenedGraph, settings: RecipeScorerConfig) -> int:
    """Return the bytes of memory that a fit by tables takes."""
    graph = opened.graph
    return fit_bytes(graph.num_entities, graph.num_recipes, settings.folds)


def _check_fit(opened: OpenedGraph, settings: RecipeScorerConfig) -> None:
    """Raise ConfigError if a fit by tables does not fit into memory."""
    check_dense("a recipe scorer", opened.graph.num_entities, _fit_bytes(opened, settings))


def _check_outside(opened: OpenedGraph, settings: RecipeScorerConfig) -> None:
    """Raise ConfigError for outside knowledge, whose tables would be too large for a large book."""
    size = opened.graph.num_entities
    if settings.with_ or settings.kg == "none":
        raise ConfigError(
            f"`with` {', '.join(settings.with_)} is compared with all pairs of {size:,} entities; "
            f"expected at most {MOST_WITH_TABLES:,}. Leave out `with`, or use a smaller graph."
        )


def _folds(
    opened: OpenedGraph,
    settings: RecipeScorerConfig,
    without: Sequence[RecipeGraph],
) -> Folds:
    """Return the folds of the training recipes.

    Args:
        opened: the graph with its split.
        settings: which recipes to train on.
        without: books whose recipes are left out.

    Raises:
        ConfigError: if the settings do not fit the graph or each other.
    """
    split = opened.split
    if settings.kg == "full":
        split = make_split(opened.graph, SplitConfig("none"))
    elif split.config.kind == "none":
        raise ConfigError(
            "the graph has no test part and therefore no partial graph. Use `kg` full, or build "
            "the graph with another split, such as by-recipe."
        )
    # Leaving out one fold must leave at least two for the rankers.
    if settings.kg == "partial" and settings.folds < 3:
        raise ConfigError(
            "`folds` 2: expected 3 or more, because rankers need two folds besides the left-out "
            "fold."
        )
    folds = make_folds(split, settings.folds)
    if without:
        return folds.with_train_sample(_sample_without(opened.graph, settings, without))
    sample = draw_train_sample(
        split,
        settings.train_fraction,
        settings.label_noise,
        settings.seed,
        of_recipe=folds.of_recipe,
    )
    return folds.with_train_sample(sample)


def _sample_without(
    graph: RecipeGraph,
    settings: RecipeScorerConfig,
    without: Sequence[RecipeGraph],
) -> TrainSample:
    """Return a graph's recipes that no book in ``without`` has.

    Raises:
        ConfigError: if there are none, or another book in ``with`` brings left-out recipes back.
    """
    is_shared = [shared_recipes(graph, book) for book in without]
    is_kept = ~np.any(is_shared, axis=0)
    if not is_kept.any():
        raise ConfigError(
            f"`without` {', '.join(settings.without)} leaves no recipe of {graph.name}."
        )
    for spec, book in itertools.product(filter(is_book, settings.with_), without):
        other = open_graph(spec).graph
        # Recipes that the graph has too are left out of the other book anyway.
        of_other_alone = ~shared_recipes(other, graph)
        if (shared_recipes(other, book) & of_other_alone).any():
            raise ConfigError(
                f"`with` '{spec}' has recipes of {book.name}, which `without` leaves out. Omit one."
            )
    return TrainSample.of(graph, is_kept)


@contextmanager
def _threads(number: int) -> Iterator[None]:
    """Limit the CPU threads of torch and NumPy.

    For small arrays, further threads mostly wait, at full load.
    """
    with torch_threads(number), threadpool_limits(number):
        yield


@dataclass(frozen=True)
class _Job:
    """A fit by tables, in this process or another one.

    Attributes:
        folder: model folder.
        fold: number of the fit: 0 with all recipes, k + 1 without fold k.
        folds: folds of the training recipes.
        text: word cosines, shape (E, E).
        outside: features from outside knowledge.
        own: entities of a zero-shot scorer, shape (n,): those of the graph in a joint graph. None
            for other scorers.
        settings: settings of the scorer.
    """

    folder: Path
    fold: int
    folds: Folds
    text: Tensor
    outside: LinkTables
    own: Tensor | None
    settings: RecipeScorerConfig

    @property
    def left_out(self) -> tuple[int, ...]:
        """The fold that is left out, if any."""
        return (self.fold - 1,) if self.fold else ()

    @property
    def done(self) -> FitDone:
        """The record of the finished fit."""
        return FitDone(trained_on=triples_hash(self.folds.triples(self.left_out)))

    def train(self, after: Callable[[int], None]) -> None:
        """Fit and save; ``after`` is called with the number of steps done."""
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
        # A zero-shot scorer is fitted on a joint graph, and saved for the graph alone.
        if self.own is not None:
            knowledge = knowledge.of_entities(self.own)
            # Ids of other books' recipes mean nothing in the graph.
            recipes = recipes[:0]
        tensors = scorer_tensors(knowledge, rankers, recipes)
        _kept(self.folder).save(self.fold, tensors, self.done)


def _kept(folder: Path) -> Checkpoints[FitDone]:
    """Return the saved fits of a run: all are kept until it ends."""
    return Checkpoints(folder, "fit", FitDone, kept=None)


class RecipesTraining(Training[RecipesConfig, FitDone, TrainedRecipes]):
    """Trainer for recipe scorers.

    Attributes:
        kind: the kind of run.
        uses_lists: whether fits are by neighbour lists, not by tables.
        without: books whose recipes are left out.
        own: the graph's entities in a joint graph, shape (E,); None unless ``kg`` is none.
        folds: folds of the training recipes.
        outside: outside knowledge.
        words: word vectors; minilm or glove if the setting is auto.
        features: hash of the vectors.
        text: word cosines, shape (E, E); for tables only.
        vectors: unit word vectors, shape (E, D); for neighbour lists only.
    """

    kind: ClassVar[RunKind[Any]] = RunKind(
        RecipesConfig.commands,
        "recipes",
        unit="fit",
        progress=FitDone,
    )
    config_type = RecipesConfig

    def __init__(self, config: RecipesConfig, opened: OpenedGraph):
        """Draw the cross-fitting folds, look up word vectors and open outside knowledge.

        Args:
            config: all settings.
            opened: the graph with its split.

        Raises:
            ConfigError: if the settings do not fit the graph.
        """
        super().__init__(config, opened)
        settings = config.settings
        sources = (settings.with_, opened, settings.features)
        self.uses_lists = uses_lists(opened.graph.num_entities)
        # Limits of memory first: files are read and folds drawn only for a fit that can be made.
        if self.uses_lists:
            _check_outside(opened, settings)
        else:
            _check_fit(opened, settings)
        self.without = [open_graph(book).graph for book in settings.without]
        self.own: Tensor | None = None
        with _threads(settings.threads):
            if settings.kg == "none":
                joint = join_books(
                    *sources,
                    folds=settings.folds,
                    allow_missing=settings.allow_missing,
                )
                opened, self.own, self.folds, self.outside = joint
                # Again, with the entities of the other books.
                _check_fit(opened, settings)
            else:
                self.folds = _folds(opened, settings, self.without)
                self.outside = open_outside(*sources, allow_missing=settings.allow_missing)
            self.words = named(settings.features, opened.graph.entities)
            if self.uses_lists:
                self._read_words(opened.graph)
                return
            features = make_features(
                self.words,
                opened.graph.entities,
                allow_missing=settings.allow_missing,
            )
            self._bytes = _fit_bytes(opened, settings)
            self.text = text_of(features)
            self.features = features.sha256

    def _read_words(self, graph: RecipeGraph) -> None:
        """Set the unit vectors for neighbour lists; ConfigError if memory does not suffice."""
        if self.words == "one-hot":
            # No words: E x E vectors would say the same, at the cost of all pairs.
            self.vectors = np.zeros((graph.num_entities, 0), dtype=np.float32)
            self.features = hashlib.sha256(f"one-hot {graph.num_entities}".encode()).hexdigest()
        else:
            features = make_features(
                self.words,
                graph.entities,
                allow_missing=self.config.settings.allow_missing,
            )
            self.vectors = features.unit_vectors
            self.features = features.sha256
        dim = self.vectors.shape[1]
        check_lists(graph.num_entities, len(self.folds.recipes()), dim, cores())

    def begin(  # noqa: D102 - inherited
        self,
        run: RunFolder[FitDone],
        report: Progress | None,
    ) -> Mapping[str, Any]:
        settings = self.config.settings
        inputs = {"features": self.features, **self._outside_hashes()}
        # The inputs are in the run's record: a resumed run compares those that files may change.
        inputs |= {f"without {other.name}": other.hash for other in self.without}
        if settings.kg == "partial":
            inputs["folds"] = self.folds.hash
        if is_subsample(settings.train_fraction, settings.label_noise):
            inputs["train_sample"] = self.folds.train_sample.hash
        return {"inputs": inputs}

    def _outside_hashes(self) -> dict[str, str]:
        """Return the hashes of outside knowledge by input; two sources may have one name."""
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
            inputs = {"features": self.features, **self._outside_hashes()}
            for name, sha256 in inputs.items():
                if sha256 != run.record.inputs.get(name):
                    raise ArtefactError(
                        f"`{name}` has changed since '{run.path}' began. Restore the earlier "
                        "files, or train again."
                    )
            run.resume(self.config)
        began = time.perf_counter()
        kept = _kept(run.path)
        fit = self._fit_lists if self.uses_lists else self._fit_tables
        fit(run, report, kept)
        with _threads(settings.threads):
            return self._finish(run, kept, time.perf_counter() - began)

    def _fit_lists(
        self,
        run: RunFolder[FitDone],
        report: Progress | None,
        kept: Checkpoints[FitDone],
    ) -> None:
        """Make and save all fits that are not saved yet, by neighbour lists."""
        settings = self.config.settings
        folds = self.folds
        number = folds.count if settings.kg == "partial" else 0
        every: list[LeftOut] = [(), *((fold,) for fold in range(number))]
        # A resumed run makes only the fits that are missing.
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
                    folds,
                    words,
                    wanted,
                    seed=settings.seed,
                    workers=cores(),
                    after=after,
                )
                for left_out, knowledge in fitted:
                    tensors = dict(knowledge.constants())
                    if left_out:
                        # The main model has the words for all folds.
                        for name in NeighbourRecipeScorer.shared:
                            tensors.pop(name, None)
                    trained_on = triples_hash(folds.triples(left_out))
                    done = FitDone(trained_on=trained_on)
                    kept.save(every.index(left_out), tensors, done)
        except KeyboardInterrupt:
            raise self._interrupted(run, len(kept.records()), len(every)) from None
        if report:
            report(total, total, {})

    def _interrupted(self, run: RunFolder[FitDone], saved: int, number: int) -> KeyboardInterrupt:
        """Return the exception that ends a run: ``saved`` of ``number`` fits are saved."""
        done = f"interrupted; {saved} of {number} fits are saved in '{run.path}'."
        return KeyboardInterrupt(f"{done} Repeat the command to make the rest.")

    def _fit_tables(
        self,
        run: RunFolder[FitDone],
        report: Progress | None,
        kept: Checkpoints[FitDone],
    ) -> None:
        """Make and save all fits that are not saved yet, by tables of all pairs."""
        settings = self.config.settings
        folds = self.folds
        number = folds.count if settings.kg == "partial" else 0
        tables = self.outside.tables
        jobs = [
            _Job(run.path, fold, folds, self.text, tables, self.own, settings)
            for fold in range(1 + number)
        ]
        waiting = not_done(jobs, kept)
        steps_of_fit = settings.folds + _STEPS
        total = len(jobs) * steps_of_fit
        # Steps by fit; a saved fit has all.
        so_far = {job.fold: steps_of_fit for job in jobs if job not in waiting}

        def note(fold: int | None = None, steps: int = 0) -> None:
            if run.interrupted.is_set():
                raise KeyboardInterrupt
            if fold is not None:
                so_far[fold] = steps
                if report:
                    report(sum(so_far.values()), total, {})

        # Parallel fits only if all have memory and each takes longer than a process's start.
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
        self,
        run: RunFolder[FitDone],
        kept: Checkpoints[FitDone],
        seconds: float,
    ) -> TrainedRecipes:
        """Write the scorers from the saved fits, their metrics and the model card."""
        graph = self.opened.graph
        settings = self.config.settings
        folds = self.folds
        tensors = kept.read(0).tensors
        scorer: type[RecipeScorer] = NeighbourRecipeScorer if self.uses_lists else RecipeScorer
        write_scorer(run.path, scorer.kind, tensors, graph)
        outputs: tuple[str, ...] = OUTPUTS
        record = None
        if settings.kg == "partial":
            # Tensors that are the same in all fits are saved with the main model alone.
            shared = {name: tensors[name] for name in scorer.shared}

            def part(fold: int) -> tuple[str, dict[str, Tensor]]:
                fit = kept.read(fold + 1)
                return fit.progress.trained_on, shared | fit.tensors

            whole = scorer(tensors, graph.entities, graph.hash)
            record = write_folds(run.path, folds, whole, scorer.kind, part)
            outputs += FOLD_OUTPUTS
        # Scores of link prediction are measured only where there are models without each fold.
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
    """Return the README of a model folder.

    Args:
        opened: the graph with its split.
        metrics: of the training.
        without: names of books whose recipes are left out.
    """
    sample = describe_train_sample(metrics.train_fraction, metrics.label_noise)
    # The most special setting is described last, and stays.
    seen = f"{sample or 'the train recipes'} only."
    if metrics.kg == "full":
        seen = "all recipes, test recipes included: the scores show memory, not prediction."
    if without:
        seen = f"recipes that are not in {', '.join(without)}."
    if metrics.kg == "none":
        seen = "outside knowledge only: this book's recipes are unseen."
    points = [f"{metrics.recipes:,} recipes; words: {metrics.features}"]
    points += [f"outside knowledge: {line}" for line in map(describe_source, metrics.outside)]
    if metrics.fold_mrr is not None:
        points.append(
            f"{metrics.folds} folds: MRR {metrics.fold_mrr:.3f} out-of-sample, "
            f"{metrics.fold_in_sample_mrr:.3f} in-sample, on train triples"
        )
    # Any recipe serves as an example that runs.
    a, b, result = opened.graph.recipe_labels()[0]
    return scorer_card(
        opened,
        f"A recipe scorer of the {metrics.kg} knowledge graph of {opened.graph.name}",
        "Scores recipes, `score_recipes(a, b, result)`, and triples with the relations "
        f"`combinesWith` and `componentOf`. Fitted on {seen}",
        points,
        "`config.toml` reproduces the training; `run.json` records all versions. For the quality "
        "on unseen triples, run\n`wordcraft-kg evaluate-links`.",
        [
            f"scorer.score_recipes({a!r}, {b!r}, {result!r})  # nats: higher is more plausible",
            f"scorer.supporting_recipes({a!r}, {b!r}, {result!r})  # supporting evidence",
        ],
    )
