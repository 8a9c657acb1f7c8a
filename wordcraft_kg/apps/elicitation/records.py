"""Metrics of a model folder of opinions, and the output of ``ask-opinions``."""

from wordcraft_kg.base.records import Count, Hash, Record, Share


class Agreement(Record, frozen=True, kw_only=True):
    """Agreement of opinions with all recipes of the graph, or with the recipes of a part.

    Attributes:
        opinions: number of evaluated opinions; recipes of other parts are left out.
        recipes: number of recipes.
        right: number of opinions among the recipes.
        precision: share of opinions among the recipes; None without opinions.
        recall: share of recipes among the opinions; None without recipes.
        goals: number of results of the recipes.
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
    """``metrics.json``: numbers of prompts and opinions, and the agreement with the graph.

    Attributes:
        template: hash of the prompt template.
        prompts: number of prompts.
        goals: number of entities in the prompts.
        goals_with_opinions: number of entities with an opinion.
        opinions: number of opinions.
        unread: number of lines without an opinion, by reason.
        cut: number of answers that ended at the endpoint's length limit.
        models: names of the answering models.
        agreement: agreement with ``all`` recipes and with those of the ``test`` part.
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
    """Amount of work before any request.

    Attributes:
        template: hash of the prompt template.
        goals: number of entities in the prompts.
        prompts: number of prompts.
        kept: number of prompts with a stored answer.
        to_ask: number of prompts without a stored answer.
        tokens_in: approximate tokens of the prompts to ask, a quarter of their characters.
        tokens_out: approximate tokens of their answers, without a model's thoughts.
        answers: folder of stored answers.
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
