"""The knowledge of recipe scorers in sources: of one model, or of all folds' models together."""

from collections.abc import Iterable, Mapping

from torch import Tensor

from wordcraft_kg.base.tensors import lazily_zero
from wordcraft_kg.models.policies.sources.source import ScoreView, Source, check_constants
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import (
    LINK_TABLES,
    WITH_ENCODER,
    RecipeKnowledge,
    num_features,
    stored_names,
)
from wordcraft_kg.models.scorers.neighbours.link_rows import OF_COMBINES, OF_COMPONENTS
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer


def _of_ranker(prefix: str, features: str) -> dict[str, str]:
    """Return axis names and types of a ranker's weights, whose names begin with ``prefix``."""
    return {
        f"{prefix}first": f"models {features} {prefix}hidden float32",
        f"{prefix}first_bias": f"models {prefix}hidden float32",
        f"{prefix}second": f"models {prefix}hidden float32",
        f"{prefix}bias": "models float32",
    }


# Axis names and types of the buffers, for `check_constants`.
_LAYOUTS = {
    "num_own": "one int32",
    "vectors": "T D float16",
    "near_words": "T K int32",
    "recipes": "recipes three int32",
    "seen": "models recipes bool",
    **_of_ranker("", "F"),
    **_of_ranker("combinesWith_", "pairs"),
    **_of_ranker("componentOf_", "parts"),
    **dict.fromkeys(LINK_TABLES, "models side side float16"),
}

_OF_ENCODER = {
    "encoder_used": "models T U float16",
    "encoder_made": "models T Z float16",
    "encoder_bias": "models T float32",
    "encoder_first": "models inputs V float32",
    "encoder_first_bias": "models V float32",
    "encoder_second": "models V Z float32",
    "encoder_second_bias": "models Z float32",
    "encoder_pair": "models V float32",
    "encoder_pair_bias": "models float32",
    "encoder_used_words": "models D U float32",
    "encoder_used_bias": "models U float32",
    "encoder_made_words": "models D Z float32",
    "encoder_made_bias": "models Z float32",
    "encoder_bias_words": "models D float32",
    "encoder_bias_base": "models float32",
    **_of_ranker("results_", "F"),
}


def knowledge_of_models(scorer: TripleScorer, view: ScoreView) -> RecipeKnowledge:
    """Return the knowledge of a recipe scorer, on the CPU, which shares its tensors.

    Of a cross-fitted scorer, if ``view`` has tasks to score: K + 1 models, on all folds and without
    each fold.

    Args:
        scorer: a recipe scorer, cross-fitted or not.
        view: the tasks to score.

    Raises:
        LeakError: if a left-out model was trained on other recipes than its folds say.
        GraphMismatchError: if the tasks' graph has another number of recipes than the scorer's.
    """
    whole = whole_of(scorer)
    assert isinstance(whole, RecipeScorer)
    folded = folds_of(scorer)
    models = [whole.knowledge]
    if folded is not None and view.tasks is not None:
        for fold in range(folded.count):
            folded.trained_on(fold, view.tasks.graph)  # raises LeakError
            left_out = folded.left_out(fold)
            assert isinstance(left_out, RecipeScorer)
            models.append(left_out.knowledge)
    # Stacked even if alone, because moving a module moves its tensors in place.
    return RecipeKnowledge.stacked(models).cpu()


def empty_knowledge(
    constants: Mapping[str, Tensor],
    num_entities: int,
    models: int,
) -> RecipeKnowledge:
    """Return knowledge whose tensors have the saved shapes, before values are loaded.

    Args:
        constants: the saved tensors by name, as found, perhaps damaged.
        num_entities: E.
        models: number of models M.

    Raises:
        KeyError: if a tensor is missing.
        ValueError: if a tensor has an unexpected type or shape.
    """
    names = stored_names(constants)
    has_encoder = names == WITH_ENCODER
    layouts = _LAYOUTS
    sizes = {}
    if has_encoder:
        layouts = _LAYOUTS | _OF_ENCODER
        # A pair has the sum, the product and the distance of two vectors.
        sizes["inputs"] = 3 * (constants["encoder_used"].shape or [0])[-1]
    check_constants(
        constants,
        layouts,
        models=models,
        F=num_features(has_encoder=has_encoder),
        pairs=len(OF_COMBINES),
        parts=len(OF_COMPONENTS),
        one=1,
        three=3,
        **sizes,
    )
    return RecipeKnowledge({name: lazily_zero(constants[name]) for name in names}, num_entities)


def share_lists(sources: Iterable[Source]) -> None:
    """Let sources of the same recipes share neighbour lists, which are made when first needed."""
    every = [source.knowledge for source in sources if hasattr(source, "knowledge")]
    of_recipes = [each for each in every if isinstance(each, RecipeKnowledge)]
    for knowledge in of_recipes[1:]:
        knowledge.share_lists(of_recipes[0])
