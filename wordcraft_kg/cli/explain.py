"""``wordcraft-kg explain``."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.base.wording import quoted
from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.options import MovedGraph, Part

if TYPE_CHECKING:
    from wordcraft_kg.agents.explanation import ExplainedEpisode, ExplainedStep

EXAMPLES = (
    "wordcraft-kg explain runs/partial --goal bread --episodes 3",
    "wordcraft-kg explain runs/no-kg --part train --distractors 1",
    "wordcraft-kg explain runs/deep --task 12",
)


def explain(
    run: Path,
    *,
    goal: str | None = None,
    task: int | None = None,
    episodes: int | None = None,
    part: Part = "test",
    distractors: int | None = None,
    graph: MovedGraph = None,
    output: Output = Output(),
) -> None:
    """Explain an agent's actions.

    Split each logit into contributions by attention and knowledge sources.

    With recipe scores (w), show the best slots' partners, the supporting train recipes, and
    evidence from outside knowledge. With plans (p), show the most probable plan, with the
    probability of each expected result.

    Args:
        run: run folder.
        goal: entity to make. Default: tasks spread evenly over the part.
        task: number of the task, from 0.
        episodes: episodes to play; several of a task have different distractors. Default: 3, or 1
            with `task`.
        distractors: number of distractors on the table. Default: as in training.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.players import view_explanation

    if goal is not None and task is not None:
        raise ConfigError("`goal` and `task` both choose tasks; give one of them.")
    if episodes is None:
        episodes = 3 if task is None else 1
    episodes = whole("episodes", episodes, 1, MAX_SIZE)
    agent = open_agent(run, graph)
    view = view_explanation(run, agent, part, distractors, goal, episodes, task=task)
    lines: list[str] = []
    for number, episode in enumerate(view.episodes, 1):
        lines += _text(number, episode)
    output.result(view, [*_legend(view.episodes[0].steps[0], lines), "", *lines])


def _legend(step: "ExplainedStep", lines: Sequence[str]) -> Iterator[str]:
    from wordcraft_kg.evaluation.scores import BECAUSE
    from wordcraft_kg.models.policies.sources import label_of

    labels = [label_of(name) for name in step.slots[0].sources]
    rows = [(label.symbol, label.meaning or label.words) for label in labels]
    if step.lambdas:
        rows.append(
            (
                "λ",
                "mixing weights of these scores; each product, such as λα·α, is a contribution to "
                "β",
            )
        )
    rows += [
        ("β", "the slot's logit"),
        ("π", "the action's probability"),
        ("V", "the value of the state"),
    ]
    rows += [(">", "the action"), ("*", "an ingredient for the goal in a plan")]
    yield from aligned(rows)
    if any(" because " in line for line in lines):
        yield f"because: {BECAUSE}"


def _text(number: int, episode: "ExplainedEpisode") -> Iterator[str]:
    plans = "; ".join(", then ".join(plan) for plan in episode.plans)
    yield f"Episode {number}: make {episode.goal}   ({plans})"
    for step in episode.steps:
        yield from _step(step)
    yield from ("  made it" if episode.outcome == "goal" else "  did not make it", "")


def _step(step: "ExplainedStep") -> Iterator[str]:
    from wordcraft_kg.evaluation.scores import because
    from wordcraft_kg.models.policies.sources import label_of

    lambdas = []
    for name, value in step.lambdas.items():
        coefficient = label_of(name).coefficient
        lambdas.append(f"{coefficient} {value:z.2f}")
    held = step.selection or "nothing"
    line = f"  holding {held}   V {step.value:z.2f}   {'  '.join(lambdas)}"
    yield ""
    yield line.rstrip()
    symbols = [label_of(name).symbol for name in step.slots[0].sources]
    # Without mixing weights there are no products to show.
    products = [f"λ{symbol}·{symbol}" for symbol in symbols] if step.lambdas else []
    rows = [("  ", *symbols, *products, "β", "π")]
    for slot in sorted(step.slots, key=lambda slot: -slot.logit):
        figures = [*slot.sources.values()]
        if step.lambdas:
            figures += slot.contributions.values()
        figures.append(slot.logit)
        cells = [f"{figure:z.2f}" for figure in figures]
        pointer = ">" if slot.entity == step.action else " "
        star = " *" if slot.is_part else ""
        label = f"  {pointer} {slot.entity or 'combine'}{star}"
        rows.append((label, *cells, f"{slot.probability:.1%}"))
    yield from aligned(rows, numbers=True)
    for entity, evidence in step.best_evidence():
        support = f" because {because(evidence.because)}" if evidence.because else ""
        yield f"  {label_of(evidence.source).symbol}: {entity} + {evidence.partner}{support}"
        if evidence.plan:
            yield f"     plan: {', then '.join(map(str, evidence.plan))}"
        yield from (f"     {piece}" for piece in evidence.outside)
    if step.made:
        yield f"  made {', '.join(map(quoted, step.made))}"
