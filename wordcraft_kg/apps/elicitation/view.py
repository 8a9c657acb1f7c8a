"""The estimate of asking, and its outcome."""

from pathlib import Path

from wordcraft_kg.apps.elicitation.asking import AskingPlan
from wordcraft_kg.apps.elicitation.config import OpinionsConfig
from wordcraft_kg.apps.elicitation.prompts import TEMPLATE_HASH
from wordcraft_kg.apps.elicitation.records import OpinionMetrics
from wordcraft_kg.base.records import Count, Hash, Record

MILLION = 1_000_000


class AskingEstimate(Record):
    """The work and cost of asking, before anything is asked.

    Attributes:
        template: hash of the wording of the prompts.
        goals: entities that are asked about.
        prompts: number of prompts.
        kept: prompts whose answers are kept from before.
        to_ask: prompts that have to be asked.
        tokens_in: about the tokens of these: a quarter of their characters.
        tokens_out: about the tokens of their answers, if as many pairs are named as are asked for; a model that thinks
            aloud needs more.
        price: about their cost, in the currency of the prices; None without prices.
        answers: folder in which answers are kept.
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
    price: float | None
    answers: str


class OpinionsView(Record):
    """The estimate, and its outcome: the folder and its figures, None if nothing was asked."""

    estimate: AskingEstimate
    out: str | None = None
    metrics: OpinionMetrics | None = None


def view_asking(
    plan: AskingPlan,
    graph: str,
    config: OpinionsConfig,
    answers: Path,
    *,
    price_in: float | None = None,
    price_out: float | None = None,
) -> AskingEstimate:
    """Return the estimate for the prompts of a graph; prices are those of a million tokens."""
    tokens_in = sum(prompt.request.tokens for prompt in plan.waiting)
    tokens_out = sum(prompt.answer_tokens for prompt in plan.waiting)
    has_prices = price_in is not None or price_out is not None
    return AskingEstimate(
        graph=graph,
        endpoint=config.endpoint,
        model=config.model,
        template=TEMPLATE_HASH,
        goals=sum(len(prompt.goals) for prompt in plan.prompts),
        prompts=len(plan.prompts),
        kept=len(plan.prompts) - len(plan.waiting),
        to_ask=len(plan.waiting),
        tokens_in=tokens_in,
        tokens_out=tokens_out,
        price=(tokens_in * (price_in or 0.0) + tokens_out * (price_out or 0.0)) / MILLION if has_prices else None,
        answers=str(answers),
    )
