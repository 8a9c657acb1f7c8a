"""Asking the prompts that have no kept answer, several at once; each answer is kept as soon as it arrives."""

import asyncio
import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from wordcraft_kg.apps.elicitation.answers import Answer, Answers
from wordcraft_kg.apps.elicitation.config import OpinionsConfig
from wordcraft_kg.apps.elicitation.endpoint import Endpoint
from wordcraft_kg.apps.elicitation.prompts import Prompt, make_prompts
from wordcraft_kg.base.errors import EndpointError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.runs.folder import Progress
from wordcraft_kg.runs.interruption import first_interrupt

TICK = 0.1
"""Seconds between two looks for Ctrl-C."""


@dataclass(frozen=True)
class AskingPlan:
    """All prompts, and of these the ones that have no kept answer yet."""

    prompts: tuple[Prompt, ...]
    waiting: tuple[Prompt, ...]


@stage("looking for answers that are kept")
def plan_asking(config: OpinionsConfig, entities: Sequence[str], answers: Answers) -> AskingPlan:
    """Return the prompts about the entities of a graph, and the ones without a kept answer."""
    prompts = tuple(make_prompts(config, entities))
    return AskingPlan(prompts, tuple(prompt for prompt in prompts if answers.find(prompt.request) is None))


def ask_all(
    plan: AskingPlan, make_endpoint: Callable[[], Endpoint], answers: Answers, progress: Progress | None = None
) -> list[Answer]:
    """Ask the prompts without an answer, and return all answers in the order of the prompts.

    The first Ctrl-C waits for the prompts under way, since they may cost money, and asks no others; the second one
    ends at once. An event loop must not be running: in a notebook, call it in a thread.

    Args:
        plan: prompts, and the ones to ask.
        make_endpoint: makes the client; called only if there is something to ask.
        answers: folder that keeps each answer.
        progress: called after each answer.

    Raises:
        OutputExistsError: if there is a file in place of the folder of answers.
        EndpointError: if a prompt is refused or not answered after all retries; the answers so far are kept.
        KeyboardInterrupt: after Ctrl-C, saying how many answers are kept.
    """
    kept = len(plan.prompts) - len(plan.waiting)
    total, tokens = len(plan.prompts), 0

    def keep(prompt: Prompt, answer: Answer) -> None:
        nonlocal kept, tokens
        answers.keep(prompt.request, answer)
        kept, tokens = kept + 1, tokens + (answer.tokens_in or 0) + (answer.tokens_out or 0)
        if progress:
            progress(kept, total, {"tokens": tokens} if tokens else {})

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
                raise EndpointError(f"{error} {_safe(kept, total)}.") from None
        if is_stopped:
            raise KeyboardInterrupt(f"interrupted; {_safe(kept, total)}")
    return [answer for prompt in plan.prompts if (answer := answers.find(prompt.request))]


def _safe(kept: int, total: int) -> str:
    return f"{kept:,} of {total:,} prompts are answered and kept; the same command goes on with the others"


async def _ask_waiting(
    prompts: Sequence[Prompt],
    endpoint: Endpoint,
    keep: Callable[[Prompt, Answer], None],
    interrupted: threading.Event,
) -> None:
    """Ask prompts until the first error or Ctrl-C; then wait for the ones under way and raise the error."""
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
        is_told = False
        while workers:
            _, workers = await asyncio.wait(workers, timeout=TICK)
            if workers and interrupted.is_set() and not is_told:
                is_told = True
                logging.getLogger(__name__).warning(
                    "waiting for the prompts that are under way; Ctrl-C again ends without them."
                )
    if errors:
        raise errors[0]
