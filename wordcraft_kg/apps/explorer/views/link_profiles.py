"""A link: how a model scores it, where it ranks, what is known of it, and why."""

from wordcraft_kg.apps.explorer.views.entities import PlacedRecipe, placed_recipes
from wordcraft_kg.apps.explorer.views.predictor import (
    FilteredRank,
    LinkPredictor,
    PredictedSlot,
    Status,
    recipes_giving,
)
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.evaluation.scores import Known
from wordcraft_kg.graphs.triples import RELATIONS, Relation
from wordcraft_kg.models.scorers.link_evidence import LinkReason

WITNESSES = 10
CANDIDATES = 10
RECIPES = 10


class LinkProfile(Record):
    """A link by a model.

    Attributes:
        model: name of the model.
        has_seen_the_test_recipes: whether it was trained on all recipes.
        score: higher is more plausible, on a scale of the model's own.
        status: whether it is learned, or else true.
        known: the part whose recipes give it.
        probability: of a link that training does not contain; None for others, and without a calibration.
        as_tail: rank of the tail among all entities.
        as_head: rank of the head.
        reason: what speaks for it.
        recipes: recipes of the book that give it, at most :data:`RECIPES`.
        tails: the best tails for its head, those that were learned left out.
        heads: the best heads for its tail.
    """

    head: str
    relation: Relation
    tail: str
    model: str
    has_seen_the_test_recipes: bool
    score: float
    status: Status
    known: Known
    probability: Share | None
    as_tail: FilteredRank
    as_head: FilteredRank
    reason: LinkReason
    recipes: tuple[PlacedRecipe, ...]
    tails: PredictedSlot
    heads: PredictedSlot


def view_link_profile(predictor: LinkPredictor, head: str, relation: Relation, tail: str) -> LinkProfile:
    """Return what a model says of a link.

    Raises:
        UnknownEntityError: if the graph does not have an entity of this label.
    """
    graph = predictor.graph
    one, other, of = graph.id_of(head), graph.id_of(tail), RELATIONS.index(relation)
    tails, heads = predictor.slot(one, of, "tail"), predictor.slot(other, of, "head")
    link = predictor.judged(tails, other)
    return LinkProfile(
        head=head,
        relation=relation,
        tail=tail,
        model=predictor.name,
        has_seen_the_test_recipes=predictor.has_seen_the_test_recipes,
        score=link.score,
        status=link.status,
        known=link.known,
        probability=link.probability,
        as_tail=link.rank,
        as_head=heads.rank(one),
        reason=predictor.evidence.reason(one, of, other, WITNESSES),
        recipes=placed_recipes(predictor.split, recipes_giving(graph, one, of, other)[:RECIPES]),
        tails=predictor.best(tails, top=CANDIDATES, witnesses=0, truth=0),
        heads=predictor.best(heads, top=CANDIDATES, witnesses=0, truth=0),
    )
