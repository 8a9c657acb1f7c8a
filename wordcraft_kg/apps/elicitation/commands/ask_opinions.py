"""``wordcraft-kg ask-opinions``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.apps.elicitation.config import AskingConfig, OpinionsConfig
from wordcraft_kg.base.artefacts import check_output
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import Book

if TYPE_CHECKING:
    from wordcraft_kg.apps.elicitation.records import AskingEstimate, OpinionMetrics

GROUP = "Link prediction"
EXAMPLES = (
    "wordcraft-kg ask-opinions everyday --endpoint http://localhost:8080/v1 --model local --yes",
    "wordcraft-kg ask-opinions everyday --endpoint https://api.openai.com/v1 --model MODEL",
)


def ask_opinions(
    graph: Book,
    *,
    endpoint: str,
    model: str,
    settings: Annotated[AskingConfig, Parameter(name="*")] = AskingConfig(),
    out: Path = Path("models/opinions"),
    answers: Path | None = None,
    yes: Flag = False,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Elicit recipes from a language model, and save a scorer for agents' u, v and w.

    Prompts contain entity labels and no recipe. Without --yes, the command only estimates the numbers of prompts and
    tokens. Answers are stored, so that no prompt is sent twice.

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
    from wordcraft_kg.apps.elicitation.asking import ask_all, plan_asking, view_asking
    from wordcraft_kg.apps.elicitation.endpoint import Endpoint
    from wordcraft_kg.apps.elicitation.records import OpinionsView
    from wordcraft_kg.base.cache import cache_folder
    from wordcraft_kg.graphs.folder import open_graph

    config = OpinionsConfig(str(graph), endpoint, model, settings)
    opened = open_graph(config.graph)
    kept = Answers(answers or cache_folder("opinions"))
    plan = plan_asking(config, opened.graph.entities, kept)
    estimate = view_asking(plan, opened.graph.name, config, kept.folder)
    if estimate.to_ask and not yes:
        output.result(OpinionsView(estimate), [*_estimate(estimate), "nothing was asked; add --yes to ask"])
        return
    check_output(out, force=force)
    check_extra("opinions")
    from wordcraft_kg.apps.elicitation.folder import write_opinions  # loads torch

    answered = ask_all(plan, lambda: Endpoint(config), kept, output.progress("asking", unit="prompt"))
    folder, metrics = write_opinions(out, opened, config, plan.prompts, answered, force=force)
    following = f"wordcraft-kg evaluate-agent {graph} --scorer {out}"
    text = [*aligned(_outcome(estimate, metrics)), f"wrote {out}/   next: {following}"]
    output.result(OpinionsView(estimate, str(folder), metrics), text)


def _estimate(estimate: "AskingEstimate") -> list[str]:
    tokens = f"about {estimate.tokens_in:,} in (a quarter of the characters) and {estimate.tokens_out:,} out"
    goals = counted(estimate.goals, "thing")
    rows = [
        ("to ask", f"{estimate.model} at {estimate.endpoint} about {goals} of {estimate.graph}"),
        ("prompts", f"{estimate.prompts:,}; {estimate.kept:,} are answered already, {estimate.to_ask:,} are not"),
        ("tokens", f"{tokens} (more if the model thinks aloud)"),
        ("kept in", estimate.answers),
    ]
    return aligned(rows)


def _outcome(estimate: "AskingEstimate", metrics: "OpinionMetrics") -> Iterator[tuple[str, str]]:
    prompts = counted(metrics.prompts, "prompt")
    some = f"{estimate.to_ask:,} of {prompts}, the others were answered already"
    yield "asked", some if estimate.kept else prompts
    goals = counted(metrics.goals, "thing")
    yield "opinions", f"{metrics.opinions:,} about {metrics.goals_with_opinions:,} of {goals}"
    if unread := [f"{number:,} {why}" for why, number in metrics.unread.items() if number]:
        yield "not read", f"{', '.join(unread)}; see unread.txt"
    if metrics.cut:
        yield "cut off", f"{counted(metrics.cut, 'answer')}; smaller --goals-per-prompt help"
    for name, part in metrics.agreement.items():
        if part.recall is not None:
            precision = "none" if part.precision is None else f"{part.precision:.3f}"
            first = f"first pair right for {part.first_right or 0:.3f} of {counted(part.goals, 'thing')}"
            yield f"{name} recipes", f"precision {precision}, recall {part.recall:.3f}, {first}"
