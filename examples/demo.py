"""The tour of `make demo`: graph, scorers, agents and a planner, compared on unseen recipes.

python examples/demo.py                                         # as `make demo`, in demo/
python examples/demo.py --book kitchen --steps 2000 --out tour  # half a minute, to see how it works

Each stage is a command of `wordcraft-kg`. `commands.txt` has all of them, to copy, with their
output.
"""

import argparse
import io
import json
import os
import shlex
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from wordcraft_kg.agents.agent_folder import open_agent
from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.cli import main
from wordcraft_kg.cli.console import aligned
from wordcraft_kg.envs.world import World

LOG = "commands.txt"
DISTRACTORS = {1: "8", 2: "4"}
"""Distractors on a table by depth. With more at depth 2, hardly a player makes the goal."""

TASKS = 5_000
"""Most tasks that scripted players play: of some 20,000 with two attempts, a quarter will do."""


class Stages:
    """Runs commands in this process, which imports torch once, and prints a line for each.

    Attributes:
        log: file that gets all commands with their output.
        is_hidden: whether progress is hidden: in a log file, each line would stay.
    """

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder / LOG
        self.log.write_text("")
        self.is_hidden = not sys.stderr.isatty()

    def __call__(self, title: str, *words: object) -> str:
        """Run a command and return its output; leave this program if the command fails."""
        command = [str(word) for word in words]
        began = time.monotonic()
        printed = io.StringIO()
        with redirect_stdout(printed):
            code = main([*command, *(["--quiet"] if self.is_hidden else [])])
        with self.log.open("a") as log:
            log.write(f"$ wordcraft-kg {shlex.join(command)}\n{printed.getvalue()}\n")
        if code:
            raise SystemExit(code)
        print(f"{time.monotonic() - began:6.1f} s  {title}", flush=True)
        return printed.getvalue()


def first_solved(run: Path) -> tuple[int | None, int]:
    """Find a task to explain: the first that the agent solves by the task's own, unseen recipe.

    Args:
        run: run folder of the agent.

    Returns:
        The number of the task, and the number of such tasks; None without any. Each test task is
        played at its first table.
    """
    agent = open_agent(run)
    world = World(agent.opened, agent.config.tasks.environment("test"))
    played = Evaluator(world, distractor_seeds=1)(PolicyPlayer(agent.policy))
    # All plans of a test task use a test recipe, so `by_plan` leaves out other ways to the goal.
    solved = played.tasks[played.by_plan[:, 0]]
    return (int(solved[0]) if len(solved) else None), len(solved)


def table(agents: dict[str, Any], played: dict[int, Any], scorer: str) -> Iterator[list[str]]:
    """Yield the rows of the final table, from weak to strong.

    Args:
        agents: success of each run by its name, from `compare`.
        played: success of scripted players by depth, from `evaluate-agent`.
        scorer: name of the recipe scorer's folder, which begins the names of its players.
    """
    scripted = {}
    for depth, view in played.items():
        for row in view["rows"]:
            scripted[row["player"], depth] = shown(row["success"], row["low"], row["high"])

    def trained(run: str) -> str:
        success = agents[run]["success"][DISTRACTORS[1]]
        return shown(success["mean"], *success["task_ci"])

    def scripted_row(name: str, player: str) -> list[str]:
        return [name, scripted[player, 1], scripted[player, 2]]

    yield ["solved test tasks [95 % interval]", "one attempt", "two attempts"]
    yield scripted_row("chance", "random, distinct")
    yield scripted_row("nearest words", "nearest words")
    yield scripted_row("votes of similar train recipes", "partial KG, votes")
    # Trained for one attempt.
    yield ["agent without a graph", trained("no-kg"), "-"]
    yield ["agent with ComplEx", trained("partial"), "-"]
    yield ["agent with the recipe scorer", trained("recipes"), "-"]
    yield scripted_row("recipe scorer alone", f"{scorer}, w, best pair")
    yield scripted_row("planner with the recipe scorer", f"{scorer}, planner")
    yield scripted_row("oracle, knows all recipes", "recipe oracle")


def shown(mean: float, low: float, high: float) -> str:
    """Return a success rate with its interval as text."""
    return f"{mean:.3f} [{low:.3f}, {high:.3f}]"


def tour(book: str, steps: int, out: Path) -> None:
    """Run all stages and print what they show."""
    run = Stages(out)
    graph = out / "graphs" / book
    partial = out / "models" / f"{book}-partial"
    recipes = out / "models" / f"{book}-recipes"
    runs = {name: out / "runs" / name for name in ("no-kg", "partial", "recipes")}
    report = out / "reports" / "agents"

    def to(folder: Path) -> tuple[object, ...]:
        return "--out", folder, "--force"

    def agent(title: str, name: str, *knowledge: object) -> None:
        run(title, "train-agent", graph, "--steps", steps, *knowledge, *to(runs[name]))

    run(f"graph of the book {book}, split into train and test", "build-graph", book, *to(graph))
    # Two folds train side by side on two cores. With 50 epochs and 3 folds, in more than twice the
    # time, MRR is .098 in place of .097, and an agent trained by the paper's preset solves .54 in
    # place of .51.
    short = ("--epochs", 25, "--folds", 2)
    run("ComplEx, trained on links", "train-complex", graph, *short, *to(partial))
    run("recipe scorer, trained on recipes", "train-recipes", graph, *to(recipes))
    run("ComplEx ranks unseen links", "evaluate-links", partial)
    run("recipe scorer ranks unseen links", "evaluate-links", recipes)
    agent("agent without a graph", "no-kg")
    agent("agent with ComplEx", "partial", "--scorer", partial)
    use = ("--use", "combines,component,recipe")
    agent("agent with the recipe scorer", "recipes", "--scorer", recipes, *use)
    # The report as a file, for people; its numbers as JSON.
    compared = run("agents compared", "compare", *runs.values(), *to(report), "--json")
    played = {}
    for depth, amount in DISTRACTORS.items():
        tasks = ("--depth", depth, "--distractors", amount, "--limit", TASKS, "--json")
        title = f"baselines and planner, depth {depth}"
        played[depth] = json.loads(run(title, "evaluate-agent", graph, "--scorer", recipes, *tasks))
    number, solved = first_solved(runs["recipes"])
    explained = ""
    if number is not None:
        explained = run("one decision explained", "explain", runs["recipes"], "--task", number)

    # Without an activated environment, the command is not on the path.
    program = "wordcraft-kg"
    if shutil.which(program) is None:
        program = os.path.relpath(Path(sys.executable).with_name(program))
    print()
    agents = json.loads(compared)["agents"]
    print(*aligned(table(agents, played, recipes.name), numbers=True), sep="\n")
    print(
        f"""
Each task needs a recipe that no train data hold, on a table with {DISTRACTORS[1]} distractors, or
{DISTRACTORS[2]} with two attempts. The agents were trained for one attempt, and shortly; for longer
trainings: {program} reference everyday --distractors {DISTRACTORS[1]}
"""
    )
    if explained:
        share = f"{solved:,} of {played[1]['tasks']:,} test tasks"
        print(f"The agent with the recipe scorer solves {share} by their own recipe.")
        print("The first of them, explained; no scorer and no agent has learned this recipe:")
        print(explained.rstrip())
    else:
        print("The agent with the recipe scorer solves no test task by its own recipe.")
    models = f"--model {recipes} --run {runs['recipes']}"
    print(
        f"""
Next:
  open {report}/index.html           the agents: success, curves, decisions
  {program} explore {graph} {models}
  {program} check-book examples/my-book.csv     your own recipes: see README.md"""
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--book", default="everyday")
    # A sixth of the paper's steps.
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--out", type=Path, default=Path("demo"))
    given = parser.parse_args()
    tour(given.book, given.steps, given.out)
