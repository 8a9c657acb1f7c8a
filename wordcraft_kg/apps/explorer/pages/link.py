"""A link: its score, its ranks, what is known of it, and why a model believes in it."""

from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State, has_models, nowhere
from wordcraft_kg.apps.explorer.views.link_profiles import LinkProfile, view_link_profile
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.triples import RELATIONS, Relation


class Link(State):
    """A link by a model.

    Attributes:
        head: label of its head; without head and tail an example is shown.
        relation: its relation.
        tail: label of its tail.
        model: the model; the first if it is empty.
    """

    head: str = ""
    relation: Relation = "combinesWith"
    tail: str = ""
    model: str = ""


def _view(explored: Explored, state: Link) -> LinkProfile:
    predictor = asked.predictor(explored, state.model)
    if state.head and state.tail:
        return view_link_profile(predictor, state.head, state.relation, state.tail)
    if state.head or state.tail:
        raise ConfigError("A link has a head and a tail; one of them is missing.")
    split = explored.opened.split
    triples = split.held_out("test") if len(split.held_out("test")) else split.graph.triples
    if not len(triples):
        raise ConfigError("The graph has no recipe, and so no link.")
    head, relation, tail = triples[0].tolist()
    return view_link_profile(predictor, split.graph.entities[head], RELATIONS[relation], split.graph.entities[tail])


PAGE = Page("link", Link, _view, exported=nowhere, is_there=has_models)
