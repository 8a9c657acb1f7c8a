"""``wordcraft-kg ask-opinions``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.apps.elicitation.config import AskingConfig, OpinionsConfig
from wordcraft_kg.base.artefacts import check_output
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.base.settings import number_in
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import Book

if TYPE_CHECKING:
    from wordcraft_kg.apps.elicitation.records import OpinionMetrics
    from wordcraft_kg.apps.elicitation.view import AskingEstimate

GROUP = "Link prediction"
EXAMPLES = (
    "wordcraft-kg ask-opinions everyday --endpoint http://localhost:8080/v1 --model local --yes",
    "wordcraft-kg ask-opinions everyday --endpoint https://api.openai.com/v1 --model MODEL --price-in 1 --price-out 4",
)


def ask_opinions(
    graph: Book,
    *,
    endpoint: str,
    model: str,
    settings: Annotated[AskingConfig, Parameter(name="*")] = AskingConfig(),
    out: Path = Path("models/opinions"),
    answers: Path | None = None,
    price_in: float | None = None,
    price_out: float | None = None,
    yes: Flag = False,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Ask a language model which pairs make which thing, and keep its opinions as a scorer: u, v and w for agents.

    Prompts hold the labels of the graph's entities and no recipe. Without --yes nothing is asked: the command says how
    much there is to ask, and about what it costs. Answers are kept, so that the same command never asks twice.

    Args:
        graph: graph folder, recipe book or known book's name.
        endpoint: address of an endpoint that speaks as OpenAI's, such as http://localhost:8080/v1.
        model: name of the language model there.
        settings: how it is asked.
        out: model folder to write.
        answers: folder in which answers are kept. Default: the cache, see wordcraft-kg books --cache.
        price_in: price of a million tokens of prompts, for the estimate.
        price_out: price of a million tokens of answers.
        yes: ask, without looking at the estimate first.
        force: replace the folder if it exists.
    """
    from wordcraft_kg.apps.elicitation.answers import Answers
    from wordcraft_kg.apps.elicitation.asking import ask_all, plan_asking
    from wordcraft_kg.apps.elicitation.endpoint import Endpoint
    from wordcraft_kg.apps.elicitation.view import OpinionsView, view_asking
    from wordcraft_kg.base.cache import cache_folder
    from wordcraft_kg.graphs.folder import open_graph

    config = OpinionsConfig(str(graph), endpoint, model, settings)
    for name, price in (("price_in", price_in), ("price_out", price_out)):
        if price is not None:
            number_in(name, price, 0, 1e9, "0 or more, for a million tokens")
    opened = open_graph(config.graph)
    kept = Answers(answers or cache_folder("opinions"))
    plan = plan_asking(config, opened.graph.entities, kept)
    estimate = view_asking(plan, opened.graph.name, config, kept.folder, price_in=price_in, price_out=price_out)
    if estimate.to_ask and not yes:
        output.result(OpinionsView(estimate), [*_estimate(estimate), "nothing was asked; add --yes to ask"])
        return
    check_output(out, force=force)
    check_extra("opinions")
    said = ask_all(plan, lambda: Endpoint(config), kept, output.progress("asking", unit="prompt"))
    from wordcraft_kg.apps.elicitation.folder import write_opinions

    written = write_opinions(out, opened, config, plan.prompts, said, force=force)
    following = f"wordcraft-kg evaluate-agent {graph} --scorer {out}"
    text = [*_outcome(estimate, written.metrics), f"wrote {out}/   next: {following}"]
    output.result(OpinionsView(estimate, str(written.folder), written.metrics), text)


def _estimate(found: "AskingEstimate") -> list[str]:
    rows = [
        ("to ask", f"{found.model} at {found.endpoint} about {counted(found.goals, 'thing')} of {found.graph}"),
        ("prompts", f"{found.prompts:,}; {found.kept:,} are answered already, {found.to_ask:,} are not"),
        (
            "tokens",
            f"about {found.tokens_in:,} in (a quarter of the characters) and {found.tokens_out:,} out (more if the "
            "model thinks aloud)",
        ),
        ("price", "no prices given" if found.price is None else f"about {found.price:,.4f}, at the prices given"),
        ("kept in", found.answers),
    ]
    return aligned(rows)


def _outcome(estimate: "AskingEstimate", found: "OpinionMetrics") -> list[str]:
    asked = f"{estimate.to_ask:,} of {counted(found.prompts, 'prompt')}, the others were answered already"
    unread = [f"{number:,} {why}" for why, number in found.unread.items() if number]
    rows = [
        ("asked", asked if estimate.kept else counted(found.prompts, "prompt")),
        ("opinions", f"{found.opinions:,} about {found.goals_with_opinions:,} of {counted(found.goals, 'thing')}"),
        *([("not read", f"{', '.join(unread)}; see unread.txt")] if unread else []),
        *([("cut off", f"{counted(found.cut, 'answer')}; smaller --goals-per-prompt help")] if found.cut else []),
        *_agreement(found),
    ]
    if found.tokens_in is not None and found.tokens_out is not None:
        rows.append(("tokens", f"{found.tokens_in:,} in and {found.tokens_out:,} out, as the endpoint counts them"))
    return aligned(rows)


def _agreement(found: "OpinionMetrics") -> Iterator[tuple[str, str]]:
    for name, of in found.agreement.items():
        if of.recall is None:
            continue
        precision = "none" if of.precision is None else f"{of.precision:.3f}"
        yield (
            f"{name} recipes",
            f"precision {precision}, recall {of.recall:.3f}, first pair right for {of.first_right or 0:.3f} of "
            f"{counted(of.goals, 'thing')}",
        )
