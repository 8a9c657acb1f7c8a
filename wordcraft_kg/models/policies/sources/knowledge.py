"""The knowledge of recipe scorers in sources: of one model, or of all folds' models together."""

from collections.abc import Iterable

from wordcraft_kg.models.policies.sources.source import ScoreView, Source
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer


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
    main_model = whole_of(scorer)
    assert isinstance(main_model, RecipeScorer)
    folded = folds_of(scorer)
    models = [main_model.knowledge]
    if folded is not None and view.tasks is not None:
        for fold in range(folded.count):
            folded.trained_on(fold, view.tasks.graph)  # raises LeakError
            left_out = folded.left_out(fold)
            assert isinstance(left_out, RecipeScorer)
            models.append(left_out.knowledge)
    # Stacked even if alone, because moving a module moves its tensors in place.
    return RecipeKnowledge.stacked(models).cpu()


def share_lists(sources: Iterable[Source]) -> None:
    """Let sources of the same recipes share neighbour lists, which are made when first needed."""
    every = [source.knowledge for source in sources if hasattr(source, "knowledge")]
    recipe_models = [each for each in every if isinstance(each, RecipeKnowledge)]
    for knowledge in recipe_models[1:]:
        knowledge.share_lists(recipe_models[0])
