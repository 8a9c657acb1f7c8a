"""The page for a link (triple)."""

from collections.abc import Iterator
from operator import attrgetter

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.apps.explorer.predictor import (
    FilteredRank,
    PlacedRecipe,
    PredictedSlot,
    ScoredLink,
    placed_recipes,
    recipes_giving,
)
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, Relation
from wordcraft_kg.models.recipes.outside_evidence import OutsideEvidence
from wordcraft_kg.models.scorers.link_evidence import LinkReason

WITNESSES = 10
CANDIDATES = 10
RECIPES = 10


class LinkState(PageState):
    """Page settings: a triple and a model, by default the first; without head and tail, an example from the book."""

    head: str = ""
    relation: Relation = "combinesWith"
    tail: str = ""
    model: str = ""


class LinkProfile(ScoredLink):
    """A model's prediction for a triple, with the book's recipes and the best other tails and heads."""

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
    graph, split = predictor.graph, predictor.split
    if state.head and state.tail:
        head, relation, tail = (
            graph.id_of(state.head),
            RELATIONS.index(state.relation),
            graph.id_of(state.tail),
        )
    elif state.head or state.tail:
        raise ConfigError("A link has a head and a tail; one end is missing.")
    else:
        triples = split.held_out("test") if len(split.held_out("test")) else graph.triples
        if not len(triples):
            raise ConfigError("The graph has no recipes, so there is no example link.")
        head, relation, tail = triples[0].tolist()
    tails, heads = predictor.slot(head, relation, "tail"), predictor.slot(tail, relation, "head")
    link, finder = predictor.ranked(tails, tail), predictor.scoring.outside
    return LinkProfile(
        head=graph.entities[head],
        relation=RELATIONS[relation],
        tail=graph.entities[tail],
        model=predictor.name,
        has_seen_the_test_recipes=predictor.has_seen_the_test_recipes,
        **{name: getattr(link, name) for name in ScoredLink.__struct_fields__},
        as_tail=link.rank,
        as_head=heads.rank(head),
        reason=predictor.evidence.reason(head, relation, tail, WITNESSES),
        outside=finder.of_link(head, RELATIONS[relation], tail) if finder else (),
        recipes=placed_recipes(split, recipes_giving(graph, head, relation, tail)[:RECIPES]),
        tails=predictor.best(tails, top=CANDIDATES, witnesses=0, truth=0),
        heads=predictor.best(heads, top=CANDIDATES, witnesses=0, truth=0),
    )


def _questions(explored: Explored) -> Iterator[tuple[str, LinkState]]:
    graph, name = explored.opened.graph, next(iter(explored.models))
    for head, relation, tail in explored.opened.split.held_out("test")[:1].tolist():
        link = LinkState(graph.entities[head], RELATIONS[relation], graph.entities[tail])
        verb = "combines with" if relation == COMBINES_WITH else "is an ingredient of"
        yield f"How probable does {name} find it that {link.head} {verb} {link.tail}?", link


PAGE = Page(
    "link",
    LinkState,
    _view,
    exported=lambda _: (),
    questions=_questions,
    is_there=attrgetter("models"),
)
