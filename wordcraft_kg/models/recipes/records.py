"""Records that the folder of a recipe scorer holds beside its tensors."""

from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.models.recipes.config import RecipesConfig
from wordcraft_kg.runs.files import RunFiles


class FitDone(Record, frozen=True, kw_only=True):
    """Record of a fit in an unfinished run: the hash of its triples."""

    trained_on: Hash


class RecipeMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: the figures of a recipe scorer.

    Attributes:
        kg: knowledge graph of the fit: partial or full.
        train_fraction: training fraction: share of the train recipes.
        label_noise: label noise: share of these with a wrong result.
        recipes: number of training recipes.
        seconds: duration of all fits.
        folds: number of cross-fitting folds.
        fold_mrr: out-of-sample MRR of train triples by the folds' models, if any.
        fold_in_sample_mrr: in-sample MRR of the same triples by the main model.
    """

    kg: KG
    train_fraction: float = 1.0
    label_noise: float = 0.0
    recipes: Count
    seconds: float
    folds: Count
    fold_mrr: Share | None
    fold_in_sample_mrr: Share | None


def recipes_history(files: RunFiles) -> History:
    """Return the history of a recipe scorer."""
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
