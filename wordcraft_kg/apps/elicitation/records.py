"""Metrics of elicited recipes, and the output of ``elicit``."""

from wordcraft_kg.base.records import Count, Hash, Record, Share


class Agreement(Record, frozen=True, kw_only=True):
    """Agreement between elicited recipes and the graph recipes, or the recipes in one split part.

    Attributes:
        elicited: evaluated elicited recipes; recipes in other split parts are ignored.
        recipes: recipes to find.
        right: elicited recipes that exist.
        precision: right / elicited; None without elicited recipes.
        recall: right / recipes; None without recipes.
        goals: distinct results.
        first_right: share of goals with a correct first pair; None without recipes.
    """

    elicited: Count
    recipes: Count
    right: Count
    precision: Share | None
    recall: Share | None
    goals: Count
    first_right: Share | None


class ElicitationMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: counts, and the agreement with the graph.

    Attributes:
        template: prompt template's hash.
        goals: entities in the prompts.
        goals_answered: entities with an elicited recipe.
        unread: unparsed lines, by reason.
        cut: answers cut at the endpoint's length limit.
        models: answering models.
        agreement: agreement with ``all`` recipes and with ``test`` recipes.
    """

    template: Hash
    prompts: Count
    goals: Count
    goals_answered: Count
    elicited: Count
    unread: dict[str, Count]
    cut: Count
    models: tuple[str, ...]
    agreement: dict[str, Agreement]


class RequestEstimate(Record):
    """Prompts and tokens before any request.

    Attributes:
        template: prompt template's hash.
        goals: entities in the prompts.
        stored: prompts with a stored answer.
        to_send: prompts without a stored answer.
        tokens_in: approximate tokens in these prompts, a quarter of the characters.
        tokens_out: approximate tokens in the answers, without reasoning.
        answers: answer folder.
    """

    graph: str
    endpoint: str
    model: str
    template: Hash
    goals: Count
    prompts: Count
    stored: Count
    to_send: Count
    tokens_in: Count
    tokens_out: Count
    answers: str


class ElicitationView(Record):
    """Output of ``elicit --json``: the estimate; folder and metrics once all prompts are answered."""

    estimate: RequestEstimate
    out: str | None = None
    metrics: ElicitationMetrics | None = None
