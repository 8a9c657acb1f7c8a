"""Fit recipe scorers into a model folder.

One is fitted on all train recipes, and for cross-fitting one without each fold in turn. Fits run in
parallel if there are enough CPU cores. A resumed run makes only fits that were not finished.

The page docs/explanation/recipe-scorer.md has the formulas of what is fitted.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from wordcraft_kg.base import ConfigError, Record, cores
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.base.tensors import check_device, torch_threads
from wordcraft_kg.graphs import (
    COMBINES_WITH,
    COMPONENT_OF,
    Folds,
    OpenedGraph,
    RecipeGraph,
    SplitConfig,
    TrainSample,
    draw_train_sample,
    is_subsample,
    make_folds,
    make_split,
    open_graph,
)
from wordcraft_kg.models.knowledge.books import (
    OtherBook,
    Words,
    recipes_together,
    shared_recipes,
    word_features,
    words_of_books,
)
from wordcraft_kg.models.knowledge.outside import LinkTables, is_book, join_books, open_outside
from wordcraft_kg.models.recipes.encoder_fitting import fit_encoder, fit_encoders
from wordcraft_kg.models.recipes.fitting import (
    LeftOut,
    encoders_of,
    fit_recipe_scorers,
    lessons_of,
)
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.recipe_records import (
    FitsTraining,
    RecipeMetrics,
    TrainedRecipes,
    counter,
)
from wordcraft_kg.models.recipes.set_training import SetsTraining
from wordcraft_kg.models.scorers.features import named
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder
from wordcraft_kg.models.scorers.neighbours.pair_features import FEATURES
from wordcraft_kg.models.scorers.neighbours.regression import SMALL
from wordcraft_kg.models.scorers.ranker import Ranker
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.score_limits import check_table, fitting_workers
from wordcraft_kg.models.scorers.scorer_folder import FOLD_OUTPUTS, write_folds, write_scorer
from wordcraft_kg.runs.run_folder import Progress, RunFolder
from wordcraft_kg.runs.training import Training, train


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
        KeyboardInterrupt: after Ctrl-C; the same call makes the fits that are not saved.

    Further errors are those of :func:`~wordcraft_kg.runs.training.train`.

    Example:
        >>> config = RecipesConfig("kitchen", RecipeScorerConfig(folds=3))
        >>> trained = train_recipes(config, "models/kitchen-recipes")
        >>> load_scorer(trained.folder).score_recipes("flour", "water", "dough").shape
        torch.Size([])
    """
    return train(RecipesTraining, config, out, force=force, progress=progress)


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
        is_used = ~np.any([shared_recipes(opened.graph, book) for book in without], axis=0)
        if not is_used.any():
            raise ConfigError(
                f"`without` {', '.join(settings.without)} leaves no recipe of {opened.graph.name}."
            )
        return folds.with_train_sample(TrainSample.of(opened.graph, is_used))
    sample = draw_train_sample(
        split,
        settings.train_fraction,
        settings.label_noise,
        settings.seed,
        of_recipe=folds.of_recipe,
    )
    return folds.with_train_sample(sample)


def encoder_of_books(
    books: Sequence[OtherBook],
    num_own: int,
    features: str,
    *,
    allow_missing: bool = False,
    seed: int = 0,
    device: str = "cpu",
    stop: Callable[[], bool] = lambda: False,
) -> PairEncoder:
    """Fit a pair encoder to the recipes of other books, and keep what scores the graph's entities.

    Link features tell which entities other books combine, and what they are part of; the encoder
    tells what a whole pair makes. Like them, it is the same in all folds.

    Args:
        books: other books without the recipes that they share with the graph, one or more.
        num_own: number of the graph's entities, which come first in each book.
        features: word vectors, through which the encoder knows entities that no book has.
        allow_missing: use zeros for labels without a vector.
        seed: seed of weights, batches and negatives.
        device: where to compute.
        stop: whether to end the fit.

    Raises:
        KeyboardInterrupt: if ``stop`` has returned True.
        ConfigError: if most labels have no vector, and ``allow_missing`` is False.
    """
    # In order of appearance, so that the graph's entities keep their ids.
    labels = tuple(dict.fromkeys(chain.from_iterable(book.labels for book in books)))
    words = words_of_books(features, labels, allow_missing=allow_missing)
    # Rounded as a model stores them.
    vectors = words.unit_vectors.astype(np.float16).astype(np.float32)
    encoder = fit_encoder(
        recipes_together(books, labels),
        torch.from_numpy(vectors),
        torch.Generator().manual_seed(seed),
        device=device,
        stop=stop,
    )
    return encoder.of_first(num_own)


def tables_alone(outside: LinkTables, words: Words) -> RecipeKnowledge:
    """Return a scorer of mean standardised tables: ``parts[a, c] + parts[b, c] + pairs[a, b]``.

    Args:
        outside: the tables, shape (E, E) each.
        words: word vectors; they are kept, and have weight 0.
    """
    size = len(words.vectors)

    def mean(tables: Sequence[Tensor]) -> Tensor:
        scaled = [torch.from_numpy(standardised(table.numpy())) for table in tables]
        return torch.stack(scaled).float().mean(0) if scaled else torch.zeros(size, size)

    tables = {COMBINES_WITH: mean(outside.pairs), COMPONENT_OF: mean(outside.parts)}
    no_recipes = np.empty((0, 3), dtype=np.int64)
    knowledge = RecipeKnowledge.of_recipes(no_recipes, words.vectors, words.near)
    # A ranker that adds two features with two hidden units: relu(x) - relu(-x) is x.
    signs = torch.tensor([1.0, -1.0])
    first = torch.zeros(len(FEATURES), 2)
    first[FEATURES.index("component_sum")] = signs
    first[FEATURES.index("combines_pair")] = signs
    ranker = Ranker(first, torch.zeros(2), signs.clone(), torch.zeros(()))
    return knowledge.with_link_tables(tables).with_ranker(ranker)


class RecipesTraining(FitsTraining):
    """Trainer for recipe scorers.

    Attributes:
        every: the folds that each fit leaves out, in the order of the fits.
        without: books whose recipes are left out.
        own: the graph's entities in a joint graph, shape (E,); None unless ``kg`` is none.
        folds: folds of the training recipes.
        outside: outside knowledge.
        words: name of the word vectors; minilm or glove if the setting is auto.
        features: the word vectors.
        workers: sets of lists that are made at once.
        encoders: the folds that each pair encoder leaves out, in the order of their fits; empty
            without, and () alone for that of other books' recipes.
        has_encoder_of_others: whether there is one of other books' recipes.
    """

    def __init__(self, config: RecipesConfig, opened: OpenedGraph):
        """Draw the cross-fitting folds, look up word vectors and open outside knowledge.

        Args:
            config: all settings.
            opened: the graph with its split.

        Raises:
            ConfigError: if the settings do not fit the graph, the machine or each other.
            RecipeFileError: if a book in ``without`` cannot be read.
            ArtefactError: if a folder of outside knowledge, vectors or a graph is damaged.
        """
        super().__init__(config, opened)
        settings = config.settings
        sources = (settings.with_, opened, settings.features)
        # Outside knowledge is tables of all pairs: said before files are read and folds drawn.
        if settings.with_ and not (settings.kg == "none" and all(map(is_book, settings.with_))):
            check_table("outside knowledge (`with`)", opened.graph.num_entities)
        self.without = [open_graph(book).graph for book in settings.without]
        self.own: Tensor | None = None
        with torch_threads(settings.threads), threadpool_limits(settings.threads):
            if settings.kg == "none":
                opened, self.own, self.folds, self.outside = join_books(
                    *sources,
                    folds=settings.folds,
                    allow_missing=settings.allow_missing,
                )
            else:
                self.folds = _folds(opened, settings, self.without)
                self.outside = open_outside(
                    *sources,
                    allow_missing=settings.allow_missing,
                )
        graph = opened.graph
        self.words = named(settings.features, graph.entities)
        # The graph's own labels need vectors, whatever the labels of other books in a joint graph.
        self.features = word_features(
            self.words, self.opened.graph.entities, allow_missing=settings.allow_missing
        )
        if self.own is not None:
            self.features = words_of_books(
                self.words, graph.entities, allow_missing=settings.allow_missing
            )
        dim = self.features.vectors.shape[1]
        num_recipes = len(self.folds.recipes())
        num_other_recipes = sum(len(book.recipes) for book in self.outside.books)
        self.has_encoder_of_others = settings.has_encoder_of_others(num_other_recipes)
        if self.has_encoder_of_others:
            # The largest vocabulary that its fit may have: that of all books.
            labels = graph.num_entities + sum(len(book.labels) for book in self.outside.books)
            fitting_workers(labels, num_other_recipes, dim, most=1, encoders=1)
        # Also where no encoder uses it: a wrong name is noticed before the book grows.
        check_device(settings.device)
        num_folds = self.folds.count if settings.kg == "partial" else 0
        self.every: list[LeftOut] = [(), *((fold,) for fold in range(num_folds))]
        self.encoders: list[LeftOut] = []
        if settings.has_encoder(num_recipes):
            self.encoders = encoders_of(self.folds, self.every)
        self.workers = fitting_workers(
            graph.num_entities, num_recipes, dim, cores(), len(self.encoders)
        )
        if self.has_encoder_of_others:
            self.encoders = [()]

    @classmethod
    def of(  # noqa: D102 - inherited
        cls, config: RecipesConfig, opened: OpenedGraph
    ) -> Training[Any, Any, Any]:
        if config.settings.parts is not None or bool((opened.graph.sizes != 2).any()):
            return SetsTraining(config, opened)
        return cls(config, opened)

    def inputs(self) -> dict[str, str]:  # noqa: D102 - inherited
        settings = self.config.settings
        inputs = {"features": self.features.sha256}
        # Two sources may have one name.
        for place, source in enumerate(self.outside.sources, 1):
            inputs[f"with {place}: {source.name}"] = source.sha256
        inputs |= {f"without {book.name}": book.hash for book in self.without}
        if settings.kg == "partial":
            inputs["folds"] = self.folds.hash
        if is_subsample(settings.train_fraction, settings.label_noise):
            inputs["train_sample"] = self.folds.train_sample.hash
        return inputs

    def make(  # noqa: D102 - inherited
        self, run: RunFolder[Record], report: Progress | None
    ) -> TrainedRecipes:
        began = time.perf_counter()
        # A set serves two lessons that leave out the same folds.
        num_lists = len(
            {frozenset([*key[0], key[1]]) for key in lessons_of(self.folds, self.every)}
        )
        total = num_lists + len(self.encoders) + len(self.every)
        after = counter(run, report, total)
        words = Words.of(self.features)
        fitted = self._fitted(run, words, self._encoders(run, words, after), after)
        made: dict[LeftOut, RecipeKnowledge] = {}
        for left_out, knowledge in fitted:
            # For their lists, which only a small book's fits keep.
            if left_out and knowledge.num_entities <= SMALL:
                made[left_out] = knowledge
            # The main model has the words for all folds.
            skipped = RecipeScorer.shared if left_out else ()
            constants = knowledge.constants().items()
            tensors = {name: tensor for name, tensor in constants if name not in skipped}
            run.checkpoints.save(self._number_of(left_out), tensors, Record())
        if report:
            report(total, total, {})
        return self._write(run, made, time.perf_counter() - began)

    def _number_of(self, left_out: LeftOut) -> int:
        """Return the number of a fit among the saved parts, from 1: encoders come first."""
        return 1 + len(self.encoders) + self.every.index(left_out)

    def _encoders(
        self, run: RunFolder[Record], words: Words, after: Callable[[], None]
    ) -> dict[LeftOut, PairEncoder]:
        """Return all pair encoders: saved ones, and new ones, which are fitted and saved.

        Args:
            run: the run's folder.
            words: word vectors of all entities.
            after: called after each new encoder.
        """
        saved = run.checkpoints.records()
        missing = [part for number, part in enumerate(self.encoders, 1) if number not in saved]
        for left_out, encoder in self._new_encoders(run, words, missing):
            number = 1 + self.encoders.index(left_out)
            run.checkpoints.save(number, encoder._asdict(), Record())
            after()
        return {
            left_out: PairEncoder(**run.checkpoints.read(number).tensors)
            for number, left_out in enumerate(self.encoders, 1)
        }

    def _new_encoders(
        self, run: RunFolder[Record], words: Words, missing: Sequence[LeftOut]
    ) -> Iterator[tuple[LeftOut, PairEncoder]]:
        """Fit pair encoders; yield the folds that each leaves out, and the encoder."""
        settings = self.config.settings
        if not self.has_encoder_of_others:
            yield from fit_encoders(
                self.folds,
                torch.from_numpy(words.vectors).float(),
                missing,
                seed=settings.seed,
                workers=self.workers,
                device=settings.device,
                stop=run.interrupted.is_set,
            )
            return
        # At most one, of other books.
        for left_out in missing:
            encoder = encoder_of_books(
                self.outside.books,
                self.opened.graph.num_entities,
                settings.features,
                allow_missing=settings.allow_missing,
                seed=settings.seed,
                device=settings.device,
                stop=run.interrupted.is_set,
            )
            dim = words.vectors.shape[1]
            if len(encoder.used_words) != dim:
                # `auto` finds better words for the graph's labels than for those of all books.
                encoder = encoder.without_words(dim)
            yield left_out, encoder

    def _fitted(
        self,
        run: RunFolder[Record],
        words: Words,
        encoders: dict[LeftOut, PairEncoder],
        after: Callable[[], None],
    ) -> Iterator[tuple[LeftOut, RecipeKnowledge]]:
        """Yield the folds left out and the knowledge fitted without them, for each missing fit.

        Args:
            run: the run's folder.
            words: word vectors of all entities.
            encoders: pair encoders by the folds that they leave out.
            after: called after each set of lists and each fit.
        """
        if not len(self.folds.recipes()):
            yield (), tables_alone(self.outside.tables, words)
            return
        outside = self.outside.tables
        if self.has_encoder_of_others:
            outside = outside._replace(encoder=encoders[()])
            encoders = {}
        saved = run.checkpoints.records()
        fitted = fit_recipe_scorers(
            self.folds,
            words,
            [left_out for left_out in self.every if self._number_of(left_out) not in saved],
            outside=outside,
            encoders=encoders,
            seed=self.config.settings.seed,
            workers=self.workers,
            after=after,
        )
        for left_out, knowledge in fitted:
            # A zero-shot scorer is fitted on a joint graph, and saved for the graph alone.
            yield left_out, knowledge if self.own is None else knowledge.of_entities(self.own)

    def _write(
        self,
        run: RunFolder[Record],
        made: Mapping[LeftOut, RecipeKnowledge],
        seconds: float,
    ) -> TrainedRecipes:
        """Write the scorers from the saved fits, their metrics and the model card.

        Args:
            run: the run's folder.
            made: knowledge by the folds left out, of the fits since the last resume; none of a
                large book.
            seconds: time of these fits.
        """
        graph = self.opened.graph
        settings = self.config.settings
        folds = self.folds
        tensors = run.checkpoints.read(self._number_of(())).tensors
        write_scorer(run.path, RecipeScorer.kind, tensors, graph)
        record = None
        if settings.kg == "partial":
            # Tensors that are the same in all fits are saved with the main model alone.
            shared = {name: tensors[name] for name in RecipeScorer.shared}

            def part(fold: int) -> dict[str, Tensor]:
                return shared | run.checkpoints.read(self._number_of((fold,))).tensors

            def restored(fold: int, tensors: Mapping[str, Tensor]) -> RecipeScorer:
                scorer = RecipeScorer(tensors, graph.entities, graph.hash)
                scorer.knowledge.share_lists(made.get((fold,), scorer.knowledge))
                return scorer

            main = RecipeScorer(tensors, graph.entities, graph.hash)
            record = write_folds(
                run.path,
                folds,
                main,
                RecipeScorer.kind,
                part,
                restored=restored,
                workers=self.workers,
            )
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
        # Any recipe serves as an example that runs.
        a, b, result = graph.recipe_labels()[0]
        return self.finish(
            run,
            metrics,
            FOLD_OUTPUTS if record else (),
            f"A recipe scorer of the {metrics.kg} knowledge graph of {graph.name}",
            "Scores recipes, `score_recipes(a, b, result)`, and triples with the relations "
            "`combinesWith` and `componentOf`.",
            [
                f"scorer.score_recipes({a!r}, {b!r}, {result!r})  # nats: higher is more plausible",
                f"scorer.supporting_recipes({a!r}, {b!r}, {result!r})  # supporting evidence",
            ],
        )
