"""What pages about links and predictions ask for again and again, made once."""

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.views.link_ranks import RankedTriples, rank_graph
from wordcraft_kg.apps.explorer.views.predictor import LinkPredictor
from wordcraft_kg.evaluation.recipe_scores import RecipeScoring
from wordcraft_kg.graphs.planner import Planner
from wordcraft_kg.models.scorers.features import EntityFeatures, glove_features


def predictor(explored: Explored, name: str = "") -> LinkPredictor:
    """Return a model that can be asked about links; without a name the first.

    Raises:
        ConfigError: if there is none, or it cannot be asked.
        UnknownEntityError: if none has this name.
    """
    found = explored.model(name)
    return explored.once(("predictor", found.name), lambda: LinkPredictor.of(found.name, found.model, found.scoring))


def ranked(explored: Explored, name: str = "") -> RankedTriples:
    """Return the ranks of all triples by a model, which takes seconds the first time."""
    found = predictor(explored, name)
    return explored.once(("ranks", found.name), lambda: rank_graph(found))


def recipe_scoring(explored: Explored, name: str = "") -> RecipeScoring | None:
    """Return a model's scores of recipes; None if it scores links only."""
    found = predictor(explored, name)
    if not found.scores_recipes:
        return None
    return explored.once(("recipe scores", found.name), lambda: RecipeScoring.of(found.scoring))


def planner(explored: Explored) -> Planner:
    """Return the cheapest derivations of the graph."""
    return explored.once("planner", lambda: Planner(explored.opened.graph))


def words(explored: Explored) -> EntityFeatures:
    """Return the vectors of the entities' words."""
    return explored.once("words", lambda: glove_features(explored.opened.graph.entities))
