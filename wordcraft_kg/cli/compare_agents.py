"""``wordcraft-kg compare-agents``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.cli.completion import Agent
from wordcraft_kg.cli.console import Flag, Output, whole_numbers
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.agents import AgentSuccess, AgentsView

EXAMPLES = (
    "wordcraft-kg compare-agents runs/no-kg runs/partial",
    "wordcraft-kg compare-agents runs/no-kg-0 runs/no-kg-1 runs/partial-0 runs/partial-1 --out reports/agents",
    "wordcraft-kg compare-agents runs/no-kg-seeds runs/partial-seeds --distractors 1,2,8",
)


def compare_agents(
    *runs: Agent,
    part: TaskPart = "test",
    distractors: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    draws: int = 5,
    episodes: int = 2,
    graph: str | None = None,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Evaluate agents on the same tables and write a report; runs that differ only in the seed count as one agent.

    Args:
        runs: run folders on one graph and split, or folders of seeds (train-agent --seeds); the first agent is the
            reference.
        part: tasks to play: train, valid, test or all.
        distractors: comma-separated numbers of distractors. Default: 1, 8 and those trained with.
        draws: draws of distractors for each task.
        episodes: number of episodes to explain for each agent.
        graph: where the graph is now, if it has moved since the training.
        out: folder to write. Default: reports/<the agents' names>.
        force: replace the report if it exists.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.base.artefacts import check_output
    from wordcraft_kg.base.errors import ConfigError
    from wordcraft_kg.evaluation.agents import group_agents, summarise_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report
    from wordcraft_kg.runs.seeds import run_folders

    if not runs:
        raise ConfigError("compare-agents needs at least one run folder.")
    whole("draws", draws, 1, MAX_SIZE)
    whole("episodes", episodes, 0, MAX_SIZE)
    amounts = whole_numbers("distractors", distractors) if distractors else None
    groups = group_agents([open_agent(folder, graph) for run in runs for folder in run_folders(run)])
    source = next(iter(groups.values()))[0].opened.source
    folder = out or Path("reports") / "-and-".join(groups)
    check_output(folder, force=force)
    report = make_agent_report(groups, part=part, distractors=amounts, draws=draws, episodes=episodes)
    write_report(report, folder, force=force)
    page = folder / "index.html"
    output.result(
        summarise_agents(report.view, str(page)), [*_text(report.view, source), f"wrote {folder}/   open {page}"]
    )


def _text(view: "AgentsView", graph: str) -> Iterator[str]:
    width = max(len(agent.name) for agent in view.agents)
    for amount in map(str, view.distractors):
        yield f"{view.part} tasks of depth {view.depth}, {amount} distractor{'s' * (amount != '1')}"
        for agent in view.agents:
            found = agent.success.get(amount)
            figures = f"plays with {agent.trained_with} distractors only" if found is None else _figures(found)
            yield f"  {agent.name:<{width}}  {figures}"
    if view.references:
        amounts = ",".join(map(str, view.distractors))
        options = f"--part {view.part} --depth {view.depth} --distractors {amounts}"
        yield f"for comparison: wordcraft-kg reference {graph} {options}"


def _figures(found: "AgentSuccess") -> str:
    low, high = found.seed_ci or found.task_ci
    over = f"over {len(found.seeds)} seeds" if found.seed_ci else "over tasks, one seed"
    text = f"{found.mean:.3f} [{low:.3f}, {high:.3f}] {over}"
    if found.difference is not None and found.difference_ci is not None:
        down, up = found.difference_ci
        text += f"  {found.difference:+.3f} [{down:+.3f}, {up:+.3f}] over tasks"
    if found.p_better is not None:
        text += f"  P(better) {found.p_better:.2f}"
    return text
