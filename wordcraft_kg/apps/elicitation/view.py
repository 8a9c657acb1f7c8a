"""What asking for opinions would take, and what came of it."""

from pathlib import Path

from wordcraft_kg.apps.elicitation.asking import AskingPlan
from wordcraft_kg.apps.elicitation.config import OpinionsConfig
from wordcraft_kg.apps.elicitation.folder import WrittenOpinions
from wordcraft_kg.apps.elicitation.prompts import TEMPLATE_HASH
from wordcraft_kg.apps.elicitation.records import OpinionMetrics
from wordcraft_kg.base.records import Count, Hash, Record

MILLION = 1_000_000


class AskingEstimate(Record):
    """What asking takes, before anything is asked.

    Attributes:
        template: hash of the wording of the prompts.
        goals: entities that are asked about.
        prompts: number of prompts.
        kept: prompts whose answers are kept from before.
        to_ask: prompts that have to be asked.
        tokens_in: about how many tokens these have: a quarter of their characters.
        tokens_out: about how many tokens their answers will have, if as many pairs are named as are asked for; a model
            that thinks aloud needs more.
        price: about what they cost, in the currency of the prices; None without prices.
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
    """The estimate, and what came of it: the folder and its figures, None if nothing was asked."""

    estimate: AskingEstimate
    out: str | None
    metrics: OpinionMetrics | None


def view_asking(
    plan: AskingPlan,
    graph: str,
    config: OpinionsConfig,
    answers: Path,
    *,
    price_in: float | None = None,
    price_out: float | None = None,
) -> AskingEstimate:
    """Return what asking takes.

    Args:
        plan: prompts, and the answers that are there.
        graph: name of the graph.
        config: model and settings.
        answers: folder of answers.
        price_in: price of a million tokens of prompts.
        price_out: price of a million tokens of answers.
    """
    price = None
    if price_in is not None or price_out is not None:
        price = (plan.tokens_in * (price_in or 0.0) + plan.tokens_out * (price_out or 0.0)) / MILLION
    return AskingEstimate(
        graph=graph,
        endpoint=config.endpoint,
        model=config.model,
        template=TEMPLATE_HASH,
        goals=sum(len(prompt.goals) for prompt in plan.prompts),
        prompts=len(plan.prompts),
        kept=len(plan.prompts) - len(plan.waiting),
        to_ask=len(plan.waiting),
        tokens_in=plan.tokens_in,
        tokens_out=plan.tokens_out,
        price=price,
        answers=str(answers),
    )


def view_opinions(estimate: AskingEstimate, written: WrittenOpinions | None = None) -> OpinionsView:
    """Return the estimate with what came of it."""
    if written is None:
        return OpinionsView(estimate, None, None)
    return OpinionsView(estimate, str(written.folder), written.metrics)
