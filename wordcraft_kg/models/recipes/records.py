"""Records that the folder of a recipe scorer holds beside its tensors."""

from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.models.recipes.config import RecipesConfig
from wordcraft_kg.runs.files import RunFiles


class FitDone(Record, frozen=True, kw_only=True):
    """What is recorded beside the tensors of a fit until the run is done: the hash of its triples."""

    trained_on: Hash


class RecipeMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: the figures of a recipe scorer.

    Attributes:
        kg: recipes that it was fitted on: partial or full.
        share: share of the train recipes that it was fitted on.
        noise: share of these that had a wrong result.
        recipes: their number.
        seconds: time of all fits.
        folds: number of folds of cross-fitting.
        fold_mrr: MRR of triples of the train recipes by models that have not seen them, None without folds.
        fold_in_sample_mrr: MRR of the same triples by the model of all train recipes.
    """

    kg: KG
    share: float = 1.0
    noise: float = 0.0
    recipes: Count
    seconds: float
    folds: Count
    fold_mrr: Share | None
    fold_in_sample_mrr: Share | None


def recipes_history(files: RunFiles) -> History:
    """Read how a recipe scorer was fitted."""
    config, metrics = RecipesConfig.read(files.folder), files.record("metrics.json", RecipeMetrics)
    facts = {
        "trained by": " ".join(files.run.argv),
        "what it is": f"rankers on what {metrics.recipes:,} recipes say about recipes held out of them",
        "training": f"{metrics.seconds:.1f} s",
        "settings": ", ".join(f"{name} {value}" for name, value in vars(config.settings).items()),
    }
    if metrics.folds:
        facts["cross-fitted"] = cross_fitted_words(metrics.folds, metrics.fold_mrr, metrics.fold_in_sample_mrr)
    return History(config, facts, metrics)
