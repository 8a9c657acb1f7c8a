"""The page with suggested recipes, to tick and to save as a file."""

from functools import partial

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.base import ConfigError, Record
from wordcraft_kg.evaluation.suggestions import Suggestions, Wish, can_suggest, suggest, table_lines

TOP = 40
"""Suggestions of the page: two pages of the command, as a screen has room."""


class SuggestionsState(PageState):
    """Page settings; without an item and a goal the page is for the whole book.

    Attributes:
        item: label of an ingredient.
        goal: label of a result.
        model: name of the model; empty for the first that suggests recipes.
    """

    item: str = ""
    goal: str = ""
    model: str = ""


class SuggestionsProfile(Record):
    """Suggestions of a model.

    Attributes:
        model: name of the model.
        models: names of the models that suggest recipes.
        answer: the suggestions; None if they cannot be made.
        fault: why they cannot be made, and the remedy.
        header: first line of their table.
        lines: line of each suggestion, with an empty last cell for the tick.
    """

    model: str
    models: tuple[str, ...]
    answer: Suggestions | None
    fault: str
    header: str
    lines: tuple[str, ...]


def _models(explored: Explored) -> tuple[str, ...]:
    return tuple(
        name for name, predictor in explored.models.items() if can_suggest(predictor.model)
    )


def _view(explored: Explored, state: SuggestionsState) -> SuggestionsProfile:
    names = _models(explored)
    predictor = explored.predictor(state.model or next(iter(names), ""))
    answer = None
    fault = ""
    make = partial(suggest, predictor.model, Wish(state.goal or None, state.item or None), TOP)
    is_for_book = not (state.goal or state.item)
    # The form stays for another wish.
    try:
        # 0.3 s for everyday, and more for larger books; any visitor may ask again.
        answer = explored.once(("suggestions", predictor.name), make) if is_for_book else make()
    except ConfigError as error:
        fault = str(error)
    rows = answer.suggestions if answer is not None else ()
    header, *lines = (line.removesuffix("\n") for line in table_lines(rows))
    return SuggestionsProfile(predictor.name, names, answer, fault, header, tuple(lines))


PAGE = Page("suggestions", SuggestionsState, _view, title="Suggestions", is_there=_models)
