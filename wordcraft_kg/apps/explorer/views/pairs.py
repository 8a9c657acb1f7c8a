"""A pair of entities: what it makes in the book, and what a model says of it."""

from wordcraft_kg.apps.explorer.views.entities import PlacedRecipe, placed_recipes
from wordcraft_kg.apps.explorer.views.predictor import JudgedLink, LinkPredictor, recipes_giving
from wordcraft_kg.base.records import Record
from wordcraft_kg.evaluation.recipe_scores import RecipeScoring, ScoredRecipe, view_open_recipe
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import COMBINES_WITH
from wordcraft_kg.models.scorers.queries import RecipeQuery

RESULTS = 10


class PairProfile(Record):
    """A pair.

    Attributes:
        makes: what it makes in the book.
        model: name of the model that was asked; empty without one.
        has_seen_the_test_recipes: whether that was trained on all recipes.
        link: what it says of ``a combinesWith b``; None without a model.
        results: what it expects the pair to make, best first; None if it scores links only, and without a model.
    """

    a: str
    b: str
    makes: tuple[PlacedRecipe, ...]
    model: str
    has_seen_the_test_recipes: bool
    link: JudgedLink | None
    results: tuple[ScoredRecipe, ...] | None


def view_pair(
    split: Split, a: str, b: str, predictor: LinkPredictor | None = None, recipes: RecipeScoring | None = None
) -> PairProfile:
    """Return what a pair makes and what a model says of it.

    Args:
        split: graph and split.
        a: label of an ingredient.
        b: label of the other one, which may be the same.
        predictor: the model to ask; None to ask none.
        recipes: the same model's scores of recipes, if it has them.

    Raises:
        UnknownEntityError: if the graph does not have an entity of this label.
    """
    graph = split.graph
    one, other = graph.id_of(a), graph.id_of(b)
    link = None if predictor is None else predictor.judged(predictor.slot(one, COMBINES_WITH, "tail"), other)
    found = None if recipes is None else view_open_recipe(recipes, RecipeQuery(a, b, None), RESULTS).top
    return PairProfile(
        a=a,
        b=b,
        makes=placed_recipes(split, recipes_giving(graph, one, COMBINES_WITH, other)),
        model="" if predictor is None else predictor.name,
        has_seen_the_test_recipes=predictor is not None and predictor.has_seen_the_test_recipes,
        link=link,
        results=found,
    )
