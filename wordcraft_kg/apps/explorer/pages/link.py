"""Pages of predictions: a link (triple) with ranks and reasons, and what a pair makes."""

from operator import attrgetter

import numpy as np

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.predictor import (
    LinkPredictor,
    PlacedRecipe,
    PredictedEntity,
    PredictedSlot,
    placed_recipes,
    recipes_giving,
)
from wordcraft_kg.base import ConfigError, Record
from wordcraft_kg.evaluation.scores import RecipeQuery, RecipeScoring, ScoredAnswer
from wordcraft_kg.graphs import COMBINES_WITH, RELATIONS, Relation
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer

WITNESSES = 10
"""Maximum number of training links that support the link."""
CANDIDATES = 10
"""Listed answers to each of the two queries."""
RECIPES = 10
"""Maximum number of listed recipes that give the link."""
RESULTS = 10
"""Listed results by a recipe scorer."""


class LinkState(PageState):
    """Page settings: a triple and a model.

    Attributes:
        head: label of the head; without head and tail, the page shows an example from the book.
        relation: name of the relation.
        tail: label of the tail.
        model: name of the model; empty for the first.
    """

    head: str = ""
    relation: Relation = "combinesWith"
    tail: str = ""
    model: str = ""


class LinkProfile(Record):
    """A model's prediction for a triple, with the book's recipes and the best tails and heads.

    Attributes:
        head: label of the head.
        relation: name of the relation.
        tail: label of the tail.
        model: name of the model.
        link: the tail as an answer for the head, with training links that support it.
        head_rank: filtered rank of the head as an answer for the tail.
        outside: knowledge from outside the book that supports the link; empty if the model uses
            none.
        recipes: recipes that give the link, at most :data:`RECIPES`.
        tails: the best tails for the head, without training links.
        heads: the best heads for the tail, without training links.
    """

    head: str
    relation: Relation
    tail: str
    model: str
    link: PredictedEntity
    head_rank: float
    outside: tuple[OutsideEvidence, ...]
    recipes: tuple[PlacedRecipe, ...]
    tails: PredictedSlot
    heads: PredictedSlot


def _view(explored: Explored, state: LinkState) -> LinkProfile:
    predictor = explored.predictor(state.model)
    graph = predictor.graph
    head, relation, tail = _triple(predictor, state)
    tails = predictor.slot(head, relation, "tail")
    heads = predictor.slot(tail, relation, "head")
    (link,) = predictor.answers(tails, np.array([tail]), WITNESSES)
    finder = predictor.outside
    recipes = recipes_giving(graph, head, relation, tail)[:RECIPES]
    return LinkProfile(
        head=graph.entities[head],
        relation=RELATIONS[relation],
        tail=graph.entities[tail],
        model=predictor.name,
        link=link,
        head_rank=heads.ranks(np.array([head])).item(),
        outside=finder.of_link(head, RELATIONS[relation], tail) if finder else (),
        recipes=placed_recipes(predictor.split, recipes),
        tails=predictor.best(tails, top=CANDIDATES, witnesses=0, truth=0),
        heads=predictor.best(heads, top=CANDIDATES, witnesses=0, truth=0),
    )


def _triple(predictor: LinkPredictor, state: LinkState) -> tuple[int, int, int]:
    """Return the triple of the settings, or an example, as ids."""
    graph = predictor.graph
    if state.head and state.tail:
        return graph.id_of(state.head), RELATIONS.index(state.relation), graph.id_of(state.tail)
    if state.head or state.tail:
        raise ConfigError("A link has a head and a tail; one end is missing.")
    # A test link is a prediction, a training link only a memory.
    unseen = predictor.split.held_out("test")
    triples = unseen if len(unseen) else graph.triples
    if not len(triples):
        raise ConfigError("The graph has no recipes, so there is no example link.")
    head, relation, tail = triples[0].tolist()
    return head, relation, tail


PAGE = Page(
    "link",
    LinkState,
    _view,
    exported=lambda _: (),
    is_there=attrgetter("models"),
)


class PairState(PageState):
    """Page settings: two ingredients and a model.

    Attributes:
        a: label of an ingredient; without both ingredients, the page shows a pair from the book.
        b: label of the other ingredient, which may be the same.
        model: name of the model; empty for the first.
    """

    a: str = ""
    b: str = ""
    model: str = ""


class PairProfile(Record):
    """A pair with its recipes and a model's predictions.

    Attributes:
        a: label of an ingredient.
        b: label of the other ingredient.
        makes: recipes in the book with both ingredients, perhaps among others.
        model: name of the model; empty without one.
        has_seen_the_test_recipes: whether the model was trained on all recipes; False without a
            model.
        link: prediction for ``a combinesWith b``; None without a model.
        results: most plausible results, best first; None without a model, and for models that only
            score links.
    """

    a: str
    b: str
    makes: tuple[PlacedRecipe, ...]
    model: str
    has_seen_the_test_recipes: bool
    link: PredictedEntity | None
    results: tuple[ScoredAnswer, ...] | None


def _view_pair(explored: Explored, state: PairState) -> PairProfile:
    graph = explored.opened.graph
    a, b = _pair(explored, state)
    a_id = graph.id_of(a)
    b_id = graph.id_of(b)
    predictor = explored.predictor(state.model) if explored.models else None
    link = None
    results = None
    if predictor is not None:
        partners = predictor.slot(a_id, COMBINES_WITH, "tail")
        (link,) = predictor.answers(partners, np.array([b_id]), 0)
        if isinstance(whole_of(predictor.model.scorer), RecipeScorer):
            # The truth of all recipes is indexed once for each model.
            scoring = explored.once(
                ("recipe scores", predictor.name),
                lambda: RecipeScoring(predictor.model, predictor.outside),
            )
            results = tuple(
                scoring.answers([RecipeQuery((a, b, None))], RESULTS, is_explained=True)
            )
    return PairProfile(
        a=a,
        b=b,
        makes=placed_recipes(
            explored.opened.split, recipes_giving(graph, a_id, COMBINES_WITH, b_id)
        ),
        model="" if predictor is None else predictor.name,
        has_seen_the_test_recipes=predictor is not None and predictor.has_seen_the_test_recipes,
        link=link,
        results=results,
    )


def _pair(explored: Explored, state: PairState) -> tuple[str, str]:
    """Return the pair of the settings, or an example, by labels."""
    if state.a and state.b:
        return state.a, state.b
    if state.a or state.b:
        raise ConfigError(
            "A pair has two ingredients, which may be equal; one ingredient is missing."
        )
    split = explored.opened.split
    graph = explored.opened.graph
    # A model has not seen the test recipes, so one of them makes the better example.
    recipes = split.sets("test") if split.is_in("test").any() else graph.sets
    # The first two ingredients; the padding of a recipe of one is no entity.
    recipes = recipes[recipes[:, 1] != graph.num_entities]
    if not len(recipes):
        raise ConfigError("The graph has no recipe, so there is no example pair.")
    a, b = graph.labels(recipes[0, :2].tolist())
    return a, b


PAIR = Page(
    "pair",
    PairState,
    _view_pair,
    title="Pairs",
    exported=lambda _: (),
    is_there=attrgetter("opened.graph.num_recipes"),
)
