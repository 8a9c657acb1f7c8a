"""JSON records in a recipe scorer's model folder, and steps that all its trainings share.

The page docs/architecture.md, *On disk*, lists the files of a model folder.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

from threadpoolctl import threadpool_limits

from wordcraft_kg.base import (
    ArtefactError,
    Count,
    Record,
    Share,
    as_values,
    dump_json,
    write_atomically,
)
from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs import TrainedOn, describe_train_sample
from wordcraft_kg.models.knowledge.books import OutsideSource
from wordcraft_kg.models.knowledge.outside import describe_source
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig
from wordcraft_kg.runs.checkpoints import Checkpoint
from wordcraft_kg.runs.record import RunFiles, scorer_card
from wordcraft_kg.runs.run_folder import Progress, RunFolder, RunKind
from wordcraft_kg.runs.trackers import Log
from wordcraft_kg.runs.training import Training

OUTPUTS = ("model.safetensors", "vocabulary.json", "config.toml", "metrics.json")


class RecipeMetrics(Record, frozen=True, kw_only=True):
    """Content of ``metrics.json``: metrics from the training of a recipe scorer.

    Attributes:
        kg: training recipes, as in the settings.
        train_fraction: fraction of the train recipes, as in the settings.
        label_noise: fraction of recipes with a wrong result, as in the settings.
        recipes: number of training recipes.
        features: entity vectors; minilm or glove if the setting is auto.
        seconds: duration of all fits.
        folds: number of fold models; 0 without cross-fitting.
        fold_mrr: out-of-sample mean reciprocal rank (MRR) on train triples, by the fold models;
            None without them.
        fold_in_sample_mrr: in-sample MRR on the same triples, by the main model; None likewise.
        outside: sources of outside knowledge, in the order of the settings.
    """

    kg: TrainedOn
    train_fraction: float = 1.0
    label_noise: float = 0.0
    recipes: Count
    features: str = ""
    seconds: float
    folds: Count
    fold_mrr: Share | None
    fold_in_sample_mrr: Share | None
    outside: tuple[OutsideSource, ...] = ()

    def facts(self) -> dict[str, str]:
        """Return facts about the training by name, for reports and the model card."""
        facts = {
            "what it is": f"rankers fitted on {self.recipes:,} recipes, each held out in turn; "
            f"words: {self.features}",
            "training": f"{self.seconds:.1f} s",
        }
        if self.outside:
            facts["outside knowledge"] = "; ".join(map(describe_source, self.outside))
        if self.folds:
            facts["cross-fitted"] = cross_fitted_words(
                self.folds, self.fold_mrr, self.fold_in_sample_mrr
            )
        return facts


class SetMetrics(Record, frozen=True, kw_only=True):
    """Content of ``metrics.json`` of a model of sets.

    Attributes:
        kg: training recipes, as in the settings.
        recipes: number of training recipes.
        goals: number of entities that they make.
        ingredients: number of entities that they use.
        parts: source of parts, a file by its name; none without.
        features: word vectors; one-hot for none.
        seconds: duration of all fits.
        folds: number of parts of the train goals, each scored without its recipes.
        fold_top: share of these goals with a right set among the first 1, 3, 5 and 10.
        lost: parts that recipes lose, with the share of train recipes that bring the part and
            whose goal lacks it.
        shared: parts that several ingredients of a set bring, with their mean number.
    """

    kg: TrainedOn
    recipes: Count
    goals: Count
    ingredients: Count
    parts: str
    features: str
    seconds: float
    folds: Count
    fold_top: tuple[Share, ...]
    lost: dict[str, Share]
    shared: dict[str, float]

    def facts(self) -> dict[str, str]:
        """Return facts about the training by name, for reports, model card and command line."""
        first, *_, fifth, _ = (f"{share:.1%}" for share in self.fold_top)
        facts = {
            "fitted": f"{self.recipes:,} sets of {self.ingredients:,} ingredients for "
            f"{self.goals:,} goals ({self.kg} graph); parts: {self.parts}, words: {self.features}",
            "unseen goals": f"first set right in {first}, one of five in {fifth} ({self.folds} "
            "folds of train)",
            "time": f"{self.seconds:.1f} s",
        }
        if self.lost:
            facts["recipes lose"] = ", ".join(
                f"{part} {share}" for part, share in self.lost.items()
            )
        if self.shared:
            facts["shared"] = ", ".join(
                f"{part} (in {mean} ingredients)" for part, mean in self.shared.items()
            )
        return facts


@dataclass(frozen=True)
class TrainedRecipes:
    """Outcome of :func:`~wordcraft_kg.models.recipes.recipe_training.train_recipes`.

    Attributes:
        folder: model folder.
        metrics: content of ``metrics.json``.
    """

    folder: Path
    metrics: RecipeMetrics | SetMetrics


def read_metrics(files: RunFiles) -> RecipeMetrics | SetMetrics:
    """Return the metrics in a folder of ``train-recipes``.

    Raises:
        ArtefactError: if the file is missing, damaged or has changed.
    """
    # Models of sets alone have this input.
    is_of_sets = "parts" in files.run.inputs
    kind: type[RecipeMetrics | SetMetrics] = SetMetrics if is_of_sets else RecipeMetrics
    return files.record("metrics.json", kind)


def recipes_history(files: RunFiles) -> History:
    """Return a recipe scorer's training history: settings and metrics.

    Raises:
        ArtefactError: if a file is missing, damaged or has changed.
    """
    config = RecipesConfig.read(files.folder)
    metrics = read_metrics(files)
    settings = [f"{name} {value}" for name, value in vars(config.settings).items()]
    facts = {
        "trained by": " ".join(files.run.argv),
        **metrics.facts(),
        "settings": ", ".join(settings),
    }
    # A model of sets has no other books.
    sources = metrics.outside if isinstance(metrics, RecipeMetrics) else ()
    labels = [frozenset(source.makes) for source in sources if source.kind == "book"]
    made_by_other_books = frozenset().union(*labels) if labels else None
    return History(config, facts, metrics, made_by_other_books=made_by_other_books)


class FitsTraining(Training[RecipesConfig, Record, TrainedRecipes]):
    """Base of trainings that save each finished fit; a resumed run makes the missing ones."""

    kind: ClassVar[RunKind[Any]] = RunKind(
        RecipesConfig.commands, "recipes", unit="part", progress=Record, kept=None
    )
    config_type = RecipesConfig

    @abstractmethod
    def inputs(self) -> dict[str, str]:
        """Return the hashes of all inputs by name."""

    @abstractmethod
    def make(self, run: RunFolder[Record], report: Progress | None) -> TrainedRecipes:
        """Make and save all fits that are not saved yet, and write the model folder."""

    def begin(  # noqa: D102 - inherited
        self, run: RunFolder[Record], report: Progress | None
    ) -> Mapping[str, Any]:
        return {"inputs": self.inputs()}

    def restored(self, run: RunFolder[Record]) -> None:
        """Return None in place of a checkpoint: a resumed run reads all saved fits."""

    def fit(  # noqa: D102 - inherited
        self,
        run: RunFolder[Record],
        report: Progress | None,
        log: Log,
        checkpoint: Checkpoint[Record] | None,
    ) -> TrainedRecipes:
        # A fit has no epochs, so `log` gets nothing, and `checkpoint` is None.
        if not run.is_live:
            # Fits of one run must have the same inputs, or folds and main model would differ in
            # more than the recipes that they leave out.
            for name, sha256 in self.inputs().items():
                if sha256 != run.record.inputs.get(name):
                    raise ArtefactError(
                        f"`{name}` has changed since '{run.path}' began. Restore the earlier "
                        "files, or train again with `force`."
                    )
            run.resume(self.config)
        threads = self.config.settings.threads
        # For small arrays, further threads mostly wait, at full load. NumPy has one, so that a
        # loaded scorer makes the lists of its training, to the bit.
        with torch_threads(threads), threadpool_limits({"blas": 1, "openmp": threads}):
            return self.make(run, report)

    def finish(
        self,
        run: RunFolder[Record],
        metrics: RecipeMetrics | SetMetrics,
        fold_files: Sequence[str],
        title: str,
        answers: str,
        usage: Sequence[str],
    ) -> TrainedRecipes:
        """Write the metrics and the model card, and end the run.

        Args:
            run: the run's folder.
            metrics: of the training.
            fold_files: names of the files of models without each fold.
            title: of the card.
            answers: what the scorer answers.
            usage: lines of Python that ask the scorer.
        """
        settings = self.config.settings
        sample = describe_train_sample(settings.train_fraction, settings.label_noise)
        # The most special setting is described last, and stays.
        training_data = f"{sample or 'the train recipes'} only."
        if settings.kg == "full":
            training_data = (
                "all recipes, test recipes included: the scores show memory, not prediction."
            )
        if settings.without:
            training_data = f"recipes that are not in {', '.join(settings.without)}."
        if settings.kg == "none":
            training_data = "outside knowledge only: this book's recipes are unseen."
        card = scorer_card(
            self.opened,
            title,
            f"{answers} Fitted on {training_data}",
            metrics.facts(),
            "`config.toml` reproduces the training; `run.json` records all versions. For the "
            "quality on unseen recipes, run\n`wordcraft-kg evaluate-links`.",
            usage,
        )
        write_atomically(run.path / "metrics.json", dump_json(as_values(metrics)))
        run.finish((*OUTPUTS, *fold_files), card)
        return TrainedRecipes(run.path, metrics)

    @classmethod
    def outcome(cls, files: RunFiles) -> TrainedRecipes:  # noqa: D102 - inherited
        return TrainedRecipes(files.folder, read_metrics(files))


def counter(run: RunFolder[Record], report: Progress | None, total: int) -> Callable[[], None]:
    """Return a function that reports a finished part, and ends the training after Ctrl-C.

    Args:
        run: the run's folder.
        report: progress callback; None reports nothing.
        total: number of all parts.
    """
    # Parts that an interrupted run has saved are not made again.
    numbers = count(1 + len(run.checkpoints.records()))

    def after() -> None:
        if run.interrupted.is_set():
            raise KeyboardInterrupt
        number = next(numbers)
        if report:
            report(min(number, total), total, {})

    return after
