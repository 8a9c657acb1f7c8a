"""``wordcraft-kg explain``."""

from pathlib import Path
from typing import Any

from wordcraft_kg.cli.console import Output
from wordcraft_kg.graphs.tasks import TaskPart

EXAMPLES = (
    "wordcraft-kg explain runs/partial --goal bread --episodes 3",
    "wordcraft-kg explain runs/no-kg --part train --distractors 1",
)
SYMBOLS = {"alpha": "α", "u": "u", "v": "v"}


def explain(
    run: Path,
    *,
    goal: str | None = None,
    episodes: int = 3,
    part: TaskPart = "test",
    distractors: int | None = None,
    graph: str | None = None,
    output: Output = Output(),
) -> None:
    """Show why an agent picked what it picked: each logit, split into what attention, u and v contributed.

    Args:
        run: run folder.
        goal: entity to make. Default: tasks from all over the part.
        episodes: how many to play.
        part: tasks to play: train, valid, test or all.
        distractors: on the table. Default: as trained.
        graph: where the graph is now, if it has moved since the training.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.agents.explanation import explain_episodes
    from wordcraft_kg.envs.world import World
    from wordcraft_kg.errors import ConfigError

    if episodes < 1:
        raise ConfigError(f"--episodes {episodes}: expected 1 or more.")
    agent = open_agent(run, graph)
    world = World(agent.opened, agent.config.tasks.environment(part, distractors))
    found = explain_episodes(agent.policy, world, goal=goal, episodes=episodes)
    values = {"run": str(run), "checkpoint": agent.checkpoint, "part": part, "episodes": found}
    output.result(values, [line for number, episode in enumerate(found, 1) for line in _text(number, episode)])


def _text(number: int, episode: dict[str, Any]) -> list[str]:
    plans = "; ".join(", then ".join(plan) for plan in episode["plans"])
    lines = [f"Episode {number}: make {episode['goal']}   ({plans})"]
    for step in episode["steps"]:
        weights = "  ".join(f"λ{SYMBOLS[name]} {value:.2f}" for name, value in step["lambdas"].items())
        held = f"holding {step['held']}" if step["held"] else "holding nothing"
        lines += ["", f"  {held}   V {step['value']:.2f}   {weights}".rstrip()]
        names = list(step["slots"][0]["sources"])
        width = max(16, *(len(slot["entity"]) + 4 for slot in step["slots"]))
        columns = [SYMBOLS[name] for name in names]
        if step["lambdas"]:
            columns += [f"λ{symbol}·{symbol}" for symbol in columns]
        lines.append(f"  {'':<{width}}" + "".join(f"{column:>8}" for column in (*columns, "β", "π")))
        for slot in sorted(step["slots"], key=lambda slot: -slot["logit"]):
            mark = ">" if slot["entity"] == step["picked"] else " "
            label = f"{mark} {slot['entity']}{' *' if slot['is_part'] else ''}"
            figures = [*slot["sources"].values(), *(slot["contributions"].values() if step["lambdas"] else ())]
            cells = "".join(f"{figure:>8.2f}" for figure in (*figures, slot["logit"]))
            lines.append(f"  {label:<{width}}{cells}{slot['probability']:>8.1%}")
        if step["made"]:
            lines.append(f"  made {', '.join(step['made'])}")
    ending = "made it" if episode["outcome"] == "goal" else "did not make it"
    return [*lines, f"  {ending}   (> picked, * part of the goal in a plan)", ""]
