"""``wordcraft-kg evaluate-agent``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.cli.completion import Agent
from wordcraft_kg.cli.console import Output, whole_numbers
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.players import AgentEvaluation

EXAMPLES = (
    "wordcraft-kg evaluate-agent runs/no-kg --part test --distractors 1,8 --draws 5",
    "wordcraft-kg evaluate-agent runs/partial --agent kg-only",
)


def evaluate_agent(
    run: Agent,
    *,
    part: TaskPart = "test",
    distractors: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    draws: int = 5,
    agent: Literal["trained", "random", "oracle", "kg-only"] = "trained",
    graph: str | None = None,
    output: Output = Output(),
) -> None:
    """Let an agent play all tasks of a part, greedily, with fixed draws of distractors.

    Args:
        run: run folder; an unfinished run is evaluated at its last checkpoint.
        part: tasks to play: train, valid, test or all.
        distractors: comma-separated numbers of distractors. Default: as in training.
        draws: draws of distractors for each task; all agents see the same.
        agent: who plays the run's tasks: the trained agent, chance, an oracle, or the run's scorer alone (u + v).
        graph: where the graph is now, if it has moved since the training.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.players import view_evaluation

    whole("draws", draws, 1, MAX_SIZE)
    trained = open_agent(run, graph)
    amounts = whole_numbers("distractors", distractors or [str(trained.config.tasks.distractors)])
    view = view_evaluation(run, trained, agent, part, amounts, draws)
    output.result(view, _text(view))


def _text(view: "AgentEvaluation") -> list[str]:
    who = f"kg-only ({view.scores})" if view.scores else view.agent
    who = f"{Path(view.run).name}, {view.checkpoint}" if view.checkpoint else who
    lines = [f"{who}: {view.part} tasks of depth {view.depth}, greedy"]
    for amount, found in view.success.items():
        title = f"{amount} distractor{'s' * (amount != '1')}"
        lines.append(
            f"{title:<15} success {found.mean:.3f} [{found.ci_low:.3f}, {found.ci_high:.3f}]  "
            f"by a plan {found.by_plan:.3f}  picks {found.picks:.2f}"
        )
        shares = (f"{name.replace('_', ' ')} {share:.1%}" for name, share in view.outcomes[amount].items())
        lines.append(f"{'':<15} {', '.join(shares)}")
    found = next(iter(view.success.values()))
    return [*lines, f"{found.tasks:,} tasks, {found.draws} draws of distractors each; 95 % intervals over tasks"]
