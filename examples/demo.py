"""The tour of `make demo`: graph, scorers, agents and a planner, compared on unseen recipes.

python examples/demo.py                                         # as `make demo`, in demo/
python examples/demo.py --book kitchen --steps 2000 --out tour  # half a minute, to see how it works

Each stage is a command of `wordcraft-kg`. `commands.txt` has all of them, to copy, with their
output. The stages with the recipe scorer and those without it run beside each other, on two cores.
"""

import argparse
import io
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
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

TASKS = 2_000
"""Most tasks that scripted players play, of some 20,000 with two attempts.

Their intervals are then as wide as those of the 1,275 tasks with one attempt: some .02 each way.
"""

FLAT = 100_000
"""Most steps for the agent with the recipe scorer.

Its success on test tasks hardly rises: untrained .80, here .806, after 200,000 steps .808.
"""


class Stages:
    """Runs commands and prints a line for each.

    Commands of a call run in this process, which imports torch once. Those of :meth:`beside` run at
    the same time, one after the other; their lines are printed between those of the calls.

    Attributes:
        log: file that gets all commands with their output.
        is_hidden: whether progress is hidden: in a log file, each line would stay.
    """

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder / LOG
        self.log.write_text("")
        self.is_hidden = not sys.stderr.isatty()
        # A single thread, so that commands keep their order.
        self._second = ThreadPoolExecutor(max_workers=1)
        self._waiting: list[Future[tuple[str, list[str], str, float]]] = []

    def __call__(self, title: str, *words: object) -> str:
        """Run a command and return its output; leave this program if the command fails."""
        command = [str(word) for word in words]
        began = time.monotonic()
        printed = io.StringIO()
        with redirect_stdout(printed):
            code = main([*command, *(["--quiet"] if self.is_hidden else [])])
        if code:
            self._second.shutdown(wait=False, cancel_futures=True)
            raise SystemExit(code)
        self._note(title, command, printed.getvalue(), time.monotonic() - began)
        while self._waiting and self._waiting[0].done():
            self._note(*self._waiting.pop(0).result())
        return printed.getvalue()

    def beside(self, title: str, *words: object) -> None:
        """Run a command at the same time, in a process; the commands before it come first."""
        command = [str(word) for word in words]

        def perform() -> tuple[str, list[str], str, float]:
            began = time.monotonic()
            # Quiet: two bars on one terminal would overwrite each other.
            process = [sys.executable, "-m", "wordcraft_kg", *command, "--quiet"]
            done = subprocess.run(process, stdout=subprocess.PIPE, text=True, check=False)
            if done.returncode:
                self._second.shutdown(wait=False, cancel_futures=True)
                raise SystemExit(done.returncode)
            return title, command, done.stdout, time.monotonic() - began

        self._waiting.append(self._second.submit(perform))

    def join(self) -> None:
        """Wait for all commands of :meth:`beside`."""
        for future in self._waiting:
            self._note(*future.result())
        self._waiting = []
        self._second.shutdown()

    def _note(self, title: str, command: list[str], output: str, seconds: float) -> None:
        with self.log.open("a") as log:
            log.write(f"$ wordcraft-kg {shlex.join(command)}\n{output}\n")
        print(f"{seconds:6.1f} s  {title}", flush=True)


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
            # Nearest words name their vectors in brackets.
            player = row["player"].partition(" (")[0]
            scripted[player, depth] = shown(row["success"], row["low"], row["high"])

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
    began = time.monotonic()
    run = Stages(out)
    graph = out / "graphs" / book
    partial = out / "models" / f"{book}-partial"
    recipes = out / "models" / f"{book}-recipes"
    runs = {name: out / "runs" / name for name in ("no-kg", "partial", "recipes")}
    report = out / "reports" / "agents"

    def to(folder: Path) -> tuple[object, ...]:
        return "--out", folder, "--force"

    def agent(name: str, steps: int, *knowledge: object) -> tuple[object, ...]:
        return "train-agent", graph, "--steps", steps, *knowledge, *to(runs[name])

    run(f"graph of the book {book}, split into train and test", "build-graph", book, *to(graph))
    # Two folds train side by side on two cores. With 25 epochs in place of 15, MRR is .097 in place
    # of .095, and an agent solves .525 in place of .532.
    short = ("--epochs", 15, "--folds", 2)
    run.beside("ComplEx, trained on links", "train-complex", graph, *short, *to(partial))
    run.beside("ComplEx ranks unseen links", "evaluate-links", partial)
    run.beside("agent without a graph", *agent("no-kg", steps))
    run.beside("agent with ComplEx", *agent("partial", steps, "--scorer", partial))
    run("recipe scorer, trained on recipes", "train-recipes", graph, *to(recipes))
    run("recipe scorer ranks unseen links", "evaluate-links", recipes)
    use = ("--scorer", recipes, "--use", "combines,component,recipe")
    run("agent with the recipe scorer", *agent("recipes", min(steps, FLAT), *use))
    played = {}
    for depth, amount in DISTRACTORS.items():
        tasks = ("--depth", depth, "--distractors", amount, "--limit", TASKS, "--json")
        title = f"baselines and planner, depth {depth}"
        played[depth] = json.loads(run(title, "evaluate-agent", graph, "--scorer", recipes, *tasks))
    run.join()
    # The report as a file, for people; its numbers as JSON.
    compared = run("agents compared", "compare", *runs.values(), *to(report), "--json")
    number, solved = first_solved(runs["recipes"])
    explained = ""
    if number is not None:
        explained = run("one decision explained", "explain", runs["recipes"], "--task", number)
    print(f"{time.monotonic() - began:6.1f} s  in all, two stages at a time")

    # Without an activated environment, the command is not on the path.
    program = "wordcraft-kg"
    if shutil.which(program) is None:
        program = os.path.relpath(Path(sys.executable).with_name(program))
    print()
    agents = json.loads(compared)["agents"]
    print(*aligned(table(agents, played, recipes.name), numbers=True), sep="\n")
    one, two = (f"{played[depth]['tasks']:,}" for depth in DISTRACTORS)
    print(
        f"""
Each task needs a recipe that no train data hold. One attempt: {one} tasks, on a table with
{DISTRACTORS[1]} distractors; two attempts: {two} tasks, {DISTRACTORS[2]} distractors.
The agents were trained for one attempt, and shortly: {steps:,} steps, with the recipe scorer
{min(steps, FLAT):,}. Longer trainings: docs/results.md
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
  open {report}/index.html           the agents: success and curves
  {program} explore {graph} {models}
  {program} check-book examples/my-book.csv     your own recipes: see README.md"""
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--book", default="everyday")
    # A ninth of the paper's steps: agents that score pairs hardly learn more from further ones.
    parser.add_argument("--steps", type=int, default=350_000)
    parser.add_argument("--out", type=Path, default=Path("demo"))
    given = parser.parse_args()
    tour(given.book, given.steps, given.out)
