"""``wordcraft-kg elicit``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.apps.elicitation.config import ElicitationConfig, RequestConfig
from wordcraft_kg.base.artefacts import check_output
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import Book

if TYPE_CHECKING:
    from wordcraft_kg.apps.elicitation.records import ElicitationMetrics, RequestEstimate

GROUP = "Link prediction"
EXAMPLES = (
    "wordcraft-kg elicit everyday --endpoint http://localhost:8080/v1 --model local --yes",
    "wordcraft-kg elicit everyday --endpoint https://api.openai.com/v1 --model MODEL",
)


def elicit(
    graph: Book,
    *,
    endpoint: str,
    model: str,
    settings: Annotated[RequestConfig, Parameter(name="*")] = RequestConfig(),
    out: Path = Path("models/elicited"),
    answers: Path | None = None,
    yes: Flag = False,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Elicit recipes from a language model, and save a scorer for agents.

    Prompts contain entity labels and no recipe. Without --yes, the command only estimates the numbers of prompts and
    tokens. Answers are stored, so no prompt is sent twice.

    Args:
        graph: graph folder, recipe book or known book's name.
        endpoint: OpenAI-compatible address, such as http://localhost:8080/v1.
        model: the endpoint's name for the language model.
        settings: prompts and requests.
        out: model folder to write.
        answers: answer folder. Default: the cache, see wordcraft-kg books --cache.
        yes: send the prompts.
        force: replace an existing model folder.
    """
    from wordcraft_kg.apps.elicitation.answers import Answers
    from wordcraft_kg.apps.elicitation.endpoint import Endpoint
    from wordcraft_kg.apps.elicitation.records import ElicitationView
    from wordcraft_kg.apps.elicitation.requests import estimate_requests, plan_requests, request_all
    from wordcraft_kg.base.cache import cache_folder
    from wordcraft_kg.graphs.folder import open_graph

    config = ElicitationConfig(str(graph), endpoint, model, settings)
    opened = open_graph(config.graph)
    kept = Answers(answers or cache_folder("elicited"))
    plan = plan_requests(config, opened.graph.entities, kept)
    estimate = estimate_requests(plan, opened.graph.name, config, kept.folder)
    if estimate.to_send and not yes:
        output.result(ElicitationView(estimate), [*_estimate(estimate), "nothing was sent; add --yes to send"])
        return
    check_output(out, force=force)
    check_extra("elicit")
    from wordcraft_kg.apps.elicitation.folder import write_elicited  # loads torch

    answered = request_all(plan, lambda: Endpoint(config), kept, output.progress("requesting", unit="prompt"))
    folder, metrics = write_elicited(out, opened, config, plan.prompts, answered, force=force)
    following = f"wordcraft-kg evaluate-agent {graph} --scorer {out}"
    text = [*aligned(_outcome(estimate, metrics)), f"wrote {out}/   next: {following}"]
    output.result(ElicitationView(estimate, str(folder), metrics), text)


def _estimate(estimate: "RequestEstimate") -> list[str]:
    tokens = f"about {estimate.tokens_in:,} in (a quarter of the characters) and {estimate.tokens_out:,} out"
    goals = counted(estimate.goals, "entity", "entities")
    rows = [
        ("model", f"{estimate.model} at {estimate.endpoint}"),
        ("prompts", f"{estimate.prompts:,} about {goals} in {estimate.graph}; {estimate.stored:,} already answered"),
        ("tokens", f"{tokens} (more with reasoning)"),
        ("answers", estimate.answers),
    ]
    return aligned(rows)


def _outcome(estimate: "RequestEstimate", metrics: "ElicitationMetrics") -> Iterator[tuple[str, str]]:
    yield "prompts", f"{estimate.to_send:,} sent, {estimate.stored:,} already answered"
    goals = counted(metrics.goals, "entity", "entities")
    yield "elicited", f"{metrics.elicited:,} recipes for {metrics.goals_answered:,} of {goals}"
    if unread := [f"{number:,} {why}" for why, number in metrics.unread.items() if number]:
        yield "unparsed", f"{', '.join(unread)}; see unread.txt"
    if metrics.cut:
        yield "cut off", f"{counted(metrics.cut, 'answer')}; reduce --goals-per-prompt"
    for name, part in metrics.agreement.items():
        if part.recall is not None:
            precision = "none" if part.precision is None else f"{part.precision:.3f}"
            first = f"first pair correct for {part.first_right or 0:.3f} of {part.goals:,} goals"
            yield f"{name} recipes", f"precision {precision}, recall {part.recall:.3f}, {first}"
