"""Concurrent requests for the prompts without a stored answer; each answer is stored on arrival."""

import asyncio
import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.apps.elicitation.answers import Answer, Answers
from wordcraft_kg.apps.elicitation.config import ElicitationConfig
from wordcraft_kg.apps.elicitation.endpoint import Endpoint
from wordcraft_kg.apps.elicitation.prompts import TEMPLATE_HASH, Prompt, make_prompts
from wordcraft_kg.apps.elicitation.records import RequestEstimate
from wordcraft_kg.base.errors import EndpointError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.runs.folder import Progress
from wordcraft_kg.runs.interruption import first_interrupt

_TICK = 0.1  # seconds between checks for Ctrl-C


@dataclass(frozen=True)
class RequestPlan:
    """All prompts, and the waiting prompts: prompts without a stored answer."""

    prompts: tuple[Prompt, ...]
    waiting: tuple[Prompt, ...]


@stage("looking up stored answers")
def plan_requests(config: ElicitationConfig, entities: Sequence[str], answers: Answers) -> RequestPlan:
    """Return the prompts for all graph entities (labels in id order), and the prompts without a stored answer."""
    prompts = tuple(make_prompts(config, entities))
    return RequestPlan(prompts, tuple(prompt for prompt in prompts if answers.find(prompt.request) is None))


def estimate_requests(plan: RequestPlan, graph: str, config: ElicitationConfig, answers: Path) -> RequestEstimate:
    """Return the number of prompts and tokens in a plan; the graph's name and the folder of answers are for display."""
    return RequestEstimate(
        graph=graph,
        endpoint=config.endpoint,
        model=config.model,
        template=TEMPLATE_HASH,
        goals=sum(len(prompt.goals) for prompt in plan.prompts),
        prompts=len(plan.prompts),
        stored=len(plan.prompts) - len(plan.waiting),
        to_send=len(plan.waiting),
        tokens_in=sum(prompt.request.tokens for prompt in plan.waiting),
        tokens_out=sum(prompt.answer_tokens for prompt in plan.waiting),
        answers=str(answers),
    )


def request_all(
    plan: RequestPlan, make_endpoint: Callable[[], Endpoint], answers: Answers, progress: Progress | None = None
) -> list[Answer]:
    """Send the prompts without a stored answer; return the answers to all prompts, in prompt order.

    The first Ctrl-C waits for pending requests, which may cost money; the second Ctrl-C stops immediately. The function
    starts an event loop; in a notebook, which has a running event loop, call the function in a thread.

    Args:
        plan: all prompts and the prompts to send.
        make_endpoint: creates the client, if there are prompts to send.
        answers: folder with stored answers.
        progress: called after each answer, with the numbers of stored answers and of all prompts.

    Raises:
        OutputExistsError: if the answer folder is a file.
        EndpointError: for a rejected prompt, or no answer after all retries; earlier answers are stored.
        KeyboardInterrupt: after Ctrl-C; the message counts the stored answers.
    """
    total = len(plan.prompts)
    kept = total - len(plan.waiting)

    def keep(prompt: Prompt, answer: Answer) -> None:
        nonlocal kept
        answers.keep(prompt.request, answer)
        kept += 1
        if progress:
            progress(kept, total, {})

    if plan.waiting:
        endpoint = make_endpoint()
        answers.open()
        is_stopped = False
        with first_interrupt() as interrupted:
            try:
                asyncio.run(_ask_waiting(plan.waiting, endpoint, keep, interrupted))
                is_stopped = interrupted.is_set()
            except KeyboardInterrupt:
                is_stopped = True
            except EndpointError as error:
                raise EndpointError(f"{error} {_progress(kept, total)}.") from None
        if is_stopped:
            raise KeyboardInterrupt(f"interrupted; {_progress(kept, total)}")
    return [answer for prompt in plan.prompts if (answer := answers.find(prompt.request))]


def _progress(kept: int, total: int) -> str:
    return f"{kept:,} of {total:,} answers are stored; repeat the command to resume"


async def _ask_waiting(
    prompts: Sequence[Prompt], endpoint: Endpoint, keep: Callable[[Prompt, Answer], None], interrupted: threading.Event
) -> None:
    todo = iter(prompts)
    errors: list[Exception] = []

    async def work() -> None:
        for prompt in todo:
            try:
                keep(prompt, await endpoint.ask(prompt.request))
            except Exception as error:
                errors.append(error)
            if errors or interrupted.is_set():
                return

    async with endpoint:
        workers = {asyncio.create_task(work()) for _ in range(endpoint.config.settings.at_once)}
        has_warned = False
        while workers:
            _, workers = await asyncio.wait(workers, timeout=_TICK)
            if workers and interrupted.is_set() and not has_warned:
                has_warned = True
                logging.getLogger(__name__).warning("waiting for running requests; press Ctrl-C again to stop now.")
    if errors:
        raise errors[0]
