"""Records for elicited recipes: metrics, and the output of the command ``elicit``."""

from wordcraft_kg.base.records import Count, Hash, Record, Share


class Agreement(Record, frozen=True, kw_only=True):
    """Agreement between elicited recipes and reference recipes: all graph recipes, or the recipes in one split part.

    Attributes:
        elicited: number of elicited recipes, without recipes that exist in a different split part.
        recipes: number of reference recipes.
        right: number of elicited recipes that are reference recipes.
        precision: right / elicited; None without elicited recipes.
        recall: right / recipes; None without recipes.
        goals: number of distinct results in the reference recipes.
        first_right: share of these goals for which the first elicited pair is right; None without recipes.
    """

    elicited: Count
    recipes: Count
    right: Count
    precision: Share | None
    recall: Share | None
    goals: Count
    first_right: Share | None


class ElicitationMetrics(Record, frozen=True, kw_only=True):
    """Metrics of a model folder (``metrics.json``): counts, and the agreement with the graph.

    Attributes:
        template: hash of the prompt template.
        goals: number of entities in the prompts.
        goals_answered: number of entities with an elicited recipe.
        unread: number of unparsed lines, by reason.
        cut: number of answers cut at the endpoint's length limit.
        models: names of the answering models.
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
    """Number of prompts and tokens that an elicitation needs, before any request is sent.

    Attributes:
        template: hash of the prompt template.
        goals: number of entities in the prompts.
        stored: number of prompts with a stored answer.
        to_send: number of prompts without a stored answer.
        tokens_in: approximate tokens in the prompts to send, a quarter of the characters.
        tokens_out: approximate tokens in the answers, without reasoning.
        answers: folder with stored answers.
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
    """Output of ``elicit --json``: numbers of prompts and tokens; folder and metrics once all prompts are answered."""

    estimate: RequestEstimate
    out: str | None = None
    metrics: ElicitationMetrics | None = None
