"""Metrics for a model folder with opinions, and the output of ``ask-opinions``."""

from wordcraft_kg.base.records import Count, Hash, Record, Share


class Agreement(Record, frozen=True, kw_only=True):
    """Agreement between opinions and the graph's recipes, or one part's recipes.

    Attributes:
        opinions: evaluated opinions; recipes in other parts are left out.
        right: opinions among the recipes.
        precision: share of opinions among the recipes; None without opinions.
        recall: share of recipes among the opinions; None without recipes.
        goals: different results of the recipes.
        first_right: share of goals whose first opinion is a recipe; None without recipes.
    """

    opinions: Count
    recipes: Count
    right: Count
    precision: Share | None
    recall: Share | None
    goals: Count
    first_right: Share | None


class OpinionMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: numbers, and the agreement with the graph.

    Attributes:
        template: prompt template's hash.
        goals: entities in the prompts.
        goals_with_opinions: entities with an opinion.
        unread: lines without an opinion, by reason.
        cut: answers that ended at the endpoint's length limit.
        models: answering models.
        agreement: agreement with ``all`` recipes and with ``test`` recipes.
    """

    template: Hash
    prompts: Count
    goals: Count
    goals_with_opinions: Count
    opinions: Count
    unread: dict[str, Count]
    cut: Count
    models: tuple[str, ...]
    agreement: dict[str, Agreement]


class AskingEstimate(Record):
    """Prompts and tokens before any request.

    Attributes:
        template: prompt template's hash.
        goals: entities in the prompts.
        kept: prompts with a stored answer.
        to_ask: prompts without a stored answer.
        tokens_in: approximate tokens in prompts to ask, a quarter of the characters.
        tokens_out: approximate tokens in answers, without a model's thoughts.
        answers: answer folder.
    """

    graph: str
    endpoint: str
    model: str
    template: Hash
    goals: Count
    prompts: Count
    kept: Count
    to_ask: Count
    tokens_in: Count
    tokens_out: Count
    answers: str


class OpinionsView(Record):
    """Output of ``ask-opinions --json``: the estimate; folder and metrics, if answers were requested."""

    estimate: AskingEstimate
    out: str | None = None
    metrics: OpinionMetrics | None = None
