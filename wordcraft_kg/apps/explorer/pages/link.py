"""The page for a link (triple): its score, its ranks, its recipes, and the reasons of a model."""

from operator import attrgetter

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.predictor import (
    FilteredRank,
    LinkPredictor,
    PlacedRecipe,
    PredictedSlot,
    ScoredLink,
    placed_recipes,
    recipes_giving,
)
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.triples import RELATIONS, Relation
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence
from wordcraft_kg.models.scorers.link_evidence import LinkReason

WITNESSES = 10
"""Maximum number of training links that support the link."""
CANDIDATES = 10
"""Listed answers to each of the two queries."""
RECIPES = 10
"""Maximum number of listed recipes that give the link."""


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


class LinkProfile(ScoredLink):
    """A model's prediction for a triple, with the book's recipes and the best tails and heads.

    Attributes:
        head: label of the head.
        relation: name of the relation.
        tail: label of the tail.
        model: name of the model.
        has_seen_the_test_recipes: whether the model was trained on all recipes.
        as_tail: rank of the tail among all entities.
        as_head: rank of the head among all entities.
        reason: training links that support the link.
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
    has_seen_the_test_recipes: bool
    as_tail: FilteredRank
    as_head: FilteredRank
    reason: LinkReason
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
    link = predictor.ranked(tails, tail)
    finder = predictor.scoring.outside
    recipes = recipes_giving(graph, head, relation, tail)[:RECIPES]
    return LinkProfile(
        head=graph.entities[head],
        relation=RELATIONS[relation],
        tail=graph.entities[tail],
        model=predictor.name,
        has_seen_the_test_recipes=predictor.has_seen_the_test_recipes,
        # The fields of a ScoredLink, of which link and profile are kinds.
        **{name: getattr(link, name) for name in ScoredLink.__struct_fields__},
        as_tail=link.rank,
        as_head=heads.rank(head),
        reason=predictor.evidence.reason(head, relation, tail, WITNESSES),
        outside=finder.of_link(head, RELATIONS[relation], tail) if finder else (),
        recipes=placed_recipes(predictor.split, recipes),
        tails=predictor.best(tails, top=CANDIDATES, witnesses=0, truth=0),
        heads=predictor.best(heads, top=CANDIDATES, witnesses=0, truth=0),
    )


def _triple(predictor: LinkPredictor, state: LinkState) -> tuple[int, int, int]:
    """Return the triple of the settings, or an example, as ids."""
    graph = predictor.graph
    if state.head and state.tail:
        relation = RELATIONS.index(state.relation)
        return graph.id_of(state.head), relation, graph.id_of(state.tail)
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
