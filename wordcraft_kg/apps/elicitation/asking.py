"""Asking what has not been answered yet, several prompts at once, and keeping each answer as soon as it is there."""

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from wordcraft_kg.apps.elicitation.answers import Answer, Answers
from wordcraft_kg.apps.elicitation.config import OpinionsConfig
from wordcraft_kg.apps.elicitation.endpoint import Endpoint, Stopped
from wordcraft_kg.apps.elicitation.prompts import Prompt, make_prompts
from wordcraft_kg.base.errors import EndpointError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.runs.folder import Progress
from wordcraft_kg.runs.interruption import first_interrupt

TICK = 0.1
"""Seconds after which somebody who waits for an answer looks whether to stop."""


@dataclass(frozen=True)
class AskingPlan:
    """All prompts, and the answers that are there already.

    Attributes:
        prompts: all of them.
        found: the answer to each; None for one that has to be asked.
    """

    prompts: tuple[Prompt, ...]
    found: tuple[Answer | None, ...]

    @property
    def waiting(self) -> list[Prompt]:
        """The prompts that have to be asked."""
        return [prompt for prompt, answer in zip(self.prompts, self.found, strict=True) if answer is None]

    @property
    def tokens_in(self) -> int:
        """About how many tokens asking them takes."""
        return sum(prompt.request.tokens for prompt in self.waiting)

    @property
    def tokens_out(self) -> int:
        """About how many tokens the answers will have."""
        return sum(prompt.answer_tokens for prompt in self.waiting)


@stage("looking for answers that are kept")
def plan_asking(config: OpinionsConfig, entities: Sequence[str], answers: Answers) -> AskingPlan:
    """Return what there is to ask about the entities of a graph, and which answers are kept already."""
    prompts = tuple(make_prompts(config, entities))
    return AskingPlan(prompts, tuple(answers.find(prompt.request) for prompt in prompts))


def ask_all(
    plan: AskingPlan, make_endpoint: Callable[[], Endpoint], answers: Answers, progress: Progress | None = None
) -> list[Answer]:
    """Ask what is not answered yet, and return all answers, in the order of the prompts.

    The first Ctrl-C waits for the prompts that are under way, since they may cost money, and asks nothing more; the
    second one ends at once.

    Args:
        plan: prompts and answers.
        make_endpoint: makes what is asked; called only if there is something to ask.
        answers: where each answer is kept.
        progress: called after each answer.

    Raises:
        OutputExistsError: if answers cannot be kept where they should be.
        EndpointError: if a prompt is refused or not answered after all retries; what is answered is kept.
        KeyboardInterrupt: after Ctrl-C, saying how much is kept.
    """
    waiting = plan.waiting
    if not waiting:
        return [answer for answer in plan.found if answer is not None]
    endpoint, total = make_endpoint(), len(plan.prompts)
    answers.open()
    todo: queue.SimpleQueue[Prompt] = queue.SimpleQueue()
    done: queue.SimpleQueue[Answer | BaseException | None] = queue.SimpleQueue()
    for prompt in waiting:
        todo.put(prompt)

    def work() -> None:
        try:
            while not endpoint.stop.is_set():
                prompt = todo.get_nowait()
                answer = endpoint.ask(prompt.request)
                answers.keep(prompt.request, answer)
                done.put(answer)
        except (queue.Empty, Stopped):
            pass
        except BaseException as error:
            endpoint.stop.set()
            done.put(error)
        finally:
            done.put(None)

    workers = min(endpoint.config.settings.at_once, len(waiting))
    kept, tokens = total - len(waiting), 0
    errors: list[BaseException] = []

    def collect(interrupted: threading.Event) -> None:
        nonlocal kept, tokens
        left = workers
        while left:
            if interrupted.is_set() and not endpoint.stop.is_set():
                endpoint.stop.set()
                logging.getLogger(__name__).warning(
                    "waiting for the prompts that are under way; Ctrl-C again ends without them."
                )
            try:
                found = done.get(timeout=TICK)
            except queue.Empty:
                continue
            if found is None:
                left -= 1
            elif isinstance(found, Answer):
                kept, tokens = kept + 1, tokens + (found.tokens_in or 0) + (found.tokens_out or 0)
                if progress:
                    progress(kept, total, {"tokens": tokens} if tokens else {})
            else:
                errors.append(found)

    with first_interrupt() as interrupted:
        try:
            for number in range(workers):
                # A second Ctrl-C has not to wait for them.
                threading.Thread(target=work, name=f"prompts {number}", daemon=True).start()
            collect(interrupted)
        except KeyboardInterrupt:
            interrupted.set()
            endpoint.stop.set()
    safe = f"{kept:,} of {total:,} prompts are answered and kept; the same command goes on with the others"
    if interrupted.is_set():
        raise KeyboardInterrupt(f"interrupted; {safe}")
    if errors and isinstance(errors[0], EndpointError):
        raise EndpointError(f"{errors[0]} {safe}.")
    if errors:
        raise errors[0]
    given = (answers.find(prompt.request) for prompt in plan.prompts)
    return [answer for answer in given if answer is not None]
