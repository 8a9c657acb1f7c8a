"""``wordcraft-kg evaluate-agent``."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output
from wordcraft_kg.graphs.tasks import TaskPart

EXAMPLES = (
    "wordcraft-kg evaluate-agent runs/no-kg --part test --distractors 1,8 --draws 5",
    "wordcraft-kg evaluate-agent runs/partial --agent kg-only",
)


def evaluate_agent(
    run: Path,
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
        run: run folder; one that is not done is judged at its last checkpoint.
        part: tasks to play: train, valid, test or all.
        distractors: numbers of distractors, commas separate. Default: as trained.
        draws: draws of distractors for each task; all agents see the same.
        agent: who plays the run's tasks: the trained agent, chance, an oracle, or the run's scorer alone (u + v).
        graph: where the graph is now, if it has moved since the training.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.agents.evaluation import Evaluator, player_of
    from wordcraft_kg.cli.console import whole_numbers
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.errors import ConfigError

    if draws < 1:
        raise ConfigError(f"--draws {draws}: expected 1 or more.")
    trained = open_agent(run, graph)
    amounts = whole_numbers("distractors", distractors or [str(trained.config.tasks.distractors)])
    player = player_of(trained.policy, agent)
    world = World(trained.opened, trained.config.tasks.environment(part, amounts[0]))
    success: dict[str, Any] = {}
    outcomes: dict[str, Any] = {}
    for amount in amounts:
        found = Evaluator(world.variant(num_distractors=amount), draws=draws)(player)
        success[str(amount)], outcomes[str(amount)] = found.figures(), found.shares()
    depth, policy = trained.config.tasks.depth, trained.config.policy
    scores = f"{policy.use}, scale {policy.scale}, self edges {policy.self_edges}" if agent == "kg-only" else None
    checkpoint = trained.checkpoint if agent == "trained" else None
    values = {
        "run": str(run),
        "agent": agent,
        "checkpoint": checkpoint,
        "scores": scores,
        "part": part,
        "depth": depth,
        "success": success,
        "outcomes": outcomes,
    }
    output.result(values, _text(values))


def _text(values: dict[str, Any]) -> list[str]:
    who = f"kg-only ({values['scores']})" if values["agent"] == "kg-only" else values["agent"]
    who = who if values["agent"] != "trained" else f"{Path(values['run']).name}, {values['checkpoint']}"
    lines = [f"{who}: {values['part']} tasks of depth {values['depth']}, greedy"]
    for amount, found in values["success"].items():
        title = f"{amount} distractor{'s' * (amount != '1')}"
        lines.append(
            f"{title:<15} success {found['mean']:.3f} [{found['ci_low']:.3f}, {found['ci_high']:.3f}]  "
            f"by a plan {found['by_plan']:.3f}  picks {found['picks']:.2f}"
        )
        shares = (f"{name.replace('_', ' ')} {share:.1%}" for name, share in values["outcomes"][amount].items())
        lines.append(f"{'':<15} {', '.join(shares)}")
    found = next(iter(values["success"].values()))
    return [*lines, f"{found['tasks']:,} tasks, {found['draws']} draws of distractors each; 95 % intervals over tasks"]
