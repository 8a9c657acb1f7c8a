"""JSON records in a recipe scorer's model folder.

The page docs/architecture.md, *On disk*, lists the files of a model folder.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.graphs.graph_folder import TrainedOn
from wordcraft_kg.models.knowledge.books import OutsideSource
from wordcraft_kg.models.knowledge.outside import describe_source
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig
from wordcraft_kg.runs.record import RunFiles


class FitDone(Record, frozen=True, kw_only=True):
    """Record saved with a finished fit in an unfinished run.

    Attributes:
        trained_on: hash of the training triples; of the recipes, for an encoder of other books.
    """

    trained_on: Hash


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
class TrainedSets:
    """Outcome of the training of a model of sets.

    Attributes:
        folder: model folder.
        metrics: content of ``metrics.json``.
    """

    folder: Path
    metrics: SetMetrics


def is_of_sets(files: RunFiles) -> bool:
    """Return whether a folder of ``train-recipes`` holds a model of sets."""
    return "parts" in files.run.inputs


def fitting_facts(metrics: RecipeMetrics) -> dict[str, str]:
    """Return facts about a training by name, for reports and the model card."""
    facts = {
        "what it is": f"rankers fitted on {metrics.recipes:,} recipes, each held out in turn; "
        f"words: {metrics.features}",
        "training": f"{metrics.seconds:.1f} s",
    }
    if metrics.outside:
        facts["outside knowledge"] = "; ".join(map(describe_source, metrics.outside))
    if metrics.folds:
        facts["cross-fitted"] = cross_fitted_words(
            metrics.folds,
            metrics.fold_mrr,
            metrics.fold_in_sample_mrr,
        )
    return facts


def recipes_history(files: RunFiles) -> History:
    """Return a recipe scorer's training history: settings and metrics.

    Raises:
        ArtefactError: if a file is missing, damaged or has changed.
    """
    config = RecipesConfig.read(files.folder)
    trained_by = {"trained by": " ".join(files.run.argv)}
    if is_of_sets(files):
        set_metrics = files.record("metrics.json", SetMetrics)
        return History(config, trained_by | set_metrics.facts(), set_metrics)
    metrics = files.record("metrics.json", RecipeMetrics)
    settings = [f"{name} {value}" for name, value in vars(config.settings).items()]
    facts = {
        **trained_by,
        **fitting_facts(metrics),
        "settings": ", ".join(settings),
    }
    labels = made_by_other_books(metrics.outside)
    return History(config, facts, metrics, made_by_other_books=labels)


def made_by_other_books(sources: Sequence[OutsideSource]) -> frozenset[str] | None:
    """Return the labels that any other book among the sources makes; None without a book."""
    labels = [frozenset(source.makes) for source in sources if source.kind == "book"]
    return frozenset().union(*labels) if labels else None
