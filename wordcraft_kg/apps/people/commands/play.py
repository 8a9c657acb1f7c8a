"""``wordcraft-kg play``."""

import secrets
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.apps.people.terminal import Commands, Terminal, numbered_columns
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.options import Book
from wordcraft_kg.envs.config import MAX_ATTEMPTS, WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.apps.people.session_file import Session
    from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
    from wordcraft_kg.graphs.recipes import Recipe

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg play",
    "wordcraft-kg play kitchen --depth 2 --attempts 4 --seed 3",
    "wordcraft-kg play everyday --open-ended --out game.jsonl",
    "wordcraft-kg play everyday --protocol paper --out human.jsonl",
)

HELP = """Select two items to combine them; new items are added to the table. Ingredients
are not used up, and you may select the same item twice. Type an item's number,
its name, or the start of its name. u undoes the first selection, ? shows this
help, q quits."""
INTRODUCTION = """This session follows the protocol of the paper: 40 practice tasks with feedback,
then 40 test tasks without feedback. Every goal can be made in one attempt, from
two items on the table or from one item combined with itself."""
NAMES = {"train": "practice", "test": "test"}
COMMANDS: Commands = {"?": lambda: [HELP]}


def play(
    graph: Book = "everyday",
    *,
    depth: int = WordCraftConfig.depth,
    distractors: int = WordCraftConfig.num_distractors,
    part: TaskPart = "all",
    attempts: int | None = None,
    seed: int | None = None,
    episodes: int = 0,
    open_ended: Flag = False,
    base: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    protocol: Literal["paper"] | None = None,
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Play crafting tasks by hand, play in open-ended mode, or take the human protocol of the paper.

    Args:
        graph: graph folder, recipe book file, or built-in book name.
        depth: minimum number of attempts to solve a task, 1 to 5.
        distractors: number of distractors on the table.
        part: tasks to play: train, valid, test or all.
        attempts: attempts per episode. Default: depth; 100 in open-ended mode.
        seed: seed for tasks and tables. Default: a random seed, which is shown; with a protocol, the seed in the
            file, or 0 for a new file.
        episodes: number of episodes; 0 plays until you quit.
        open_ended: play without goals: start with the base entities and discover as many entities as you can.
        base: comma-separated entities known at the start in open-ended mode. Default: the base entities of the graph.
        protocol: paper: 40 train tasks with feedback, then 40 test tasks without feedback, at depth 1 with one attempt.
        out: JSON lines file for protocol answers or an open-ended game. Repeat the command to resume.
    """
    terminal = Terminal(sys.stderr if output.json else sys.stdout)
    is_untouched = (depth, distractors, part, seed, episodes) == (1, WordCraftConfig.num_distractors, "all", None, 0)
    if open_ended:
        from wordcraft_kg.apps.people.open_world import play_open_world

        if protocol is not None or not is_untouched:
            raise ConfigError("--open-ended has no tasks; the only options are attempts, base and out.")
        play_open_world(terminal, graph, split_labels(base) if base else None, attempts, out, output)
    elif base:
        raise ConfigError(f"--base {','.join(base)}: tasks have no base; add --open-ended.")
    elif protocol is None:
        if out is not None:
            raise ConfigError(
                f"--out {out}: only protocol answers and open-ended games are saved; add --protocol paper."
            )
        settings = {"part": part, "depth": depth, "num_distractors": distractors, "max_attempts": attempts}
        _play_tasks(terminal, graph, settings, seed, episodes, output)
    elif out is None:
        raise ConfigError("--protocol paper: name a file for the answers, such as --out human.jsonl.")
    elif (depth, part, attempts in (None, 1), episodes) != (1, "all", True, 0):
        raise ConfigError("--protocol paper fixes depth, part, attempts and episodes; leave these options out.")
    else:
        session = _play_protocol(terminal, graph, distractors, seed, out)
        output.result(*_protocol_result(session, out))


def _select(terminal: Terminal, table: Sequence[str], left: int) -> tuple[tuple[int, int], float]:
    terminal.say(*numbered_columns(table))
    began = time.monotonic()
    slots = terminal.select_two(f"first item: {{}}   attempts left: {left} > ", table, COMMANDS)
    return slots, time.monotonic() - began


def _recipes(recipes: "Iterable[Recipe]") -> str:
    return "; ".join(f"{a} + {b} -> {result}" for a, b, result in recipes)


def _play_tasks(
    terminal: Terminal, graph: str, settings: dict[str, Any], seed: int | None, episodes: int, output: Output
) -> None:
    from wordcraft_kg.apps.people.protocol import episode_seed
    from wordcraft_kg.envs.wordcraft import WordCraftEnv

    whole("episodes", episodes, 0, MAX_SIZE)
    if settings["max_attempts"] is not None:
        whole("attempts", settings["max_attempts"], settings["depth"], MAX_ATTEMPTS)
    seed = secrets.randbelow(1_000_000) if seed is None else seed
    env = WordCraftEnv(graph, **settings)
    played = successes = 0

    def tally() -> str:
        return f"goals made: {successes} of {played}   to repeat these tasks: --seed {seed}"

    with terminal.until_quit(tally):
        while not episodes or played < episodes:
            observation, _ = env.reset(seed=episode_seed(seed, env.config.part, played + 1))
            number = f"{played + 1} of {episodes}" if episodes else f"{played + 1}"
            so_far = f"   (goals made: {successes} of {played})" if played else ""
            terminal.say("" if played else f"{HELP}\n", f"{number}. Goal: {env.task.goal}{so_far}")
            successes += _play_task(terminal, env, observation)
            played += 1
    config = env.config
    values = {
        "graph": env.world.graph.name,
        "depth": config.depth,
        "distractors": config.num_distractors,
        "part": config.part,
        "attempts": config.attempts,
        "seed": seed,
        "episodes": played,
        "successes": successes,
    }
    output.result(values, [tally()])


def _play_task(terminal: Terminal, env: "WordCraftEnv", observation: "Observation") -> bool:
    from wordcraft_kg.envs.words import combined, results_of, table_labels

    outcome = "in_progress"
    while outcome == "in_progress":
        table = table_labels(env, observation)
        (one, other), _ = _select(terminal, table, int(observation["attempts_left"]))
        env.step(one)
        observation, _, _, _, info = env.step(other)
        outcome, actions = info["outcome"], (table[one], table[other])
        terminal.say(combined(actions, results_of(env, *actions)))
    goal, plans = env.task.goal, env.task.plans
    made = outcome == "goal"
    terminal.say(
        f"You made the goal: {goal}." if made else f"You have no attempts left. You did not make {goal}.",
        f"{'Solution' if len(plans) == 1 else f'One of {len(plans)} solutions'}: {_recipes(plans[0])}",
    )
    return made


def _play_protocol(terminal: Terminal, graph: str, distractors: int, seed: int | None, out: Path) -> "Session":
    from wordcraft_kg.apps.people.protocol import HumanProtocol
    from wordcraft_kg.apps.people.session_file import append_answer, open_session, read_session
    from wordcraft_kg.envs.words import combined

    if seed is None:
        seed = read_session(out).header.seed if out.exists() else 0
    protocol = HumanProtocol(graph, distractors, seed)
    session = open_session(out, protocol)
    if session.is_finished:
        terminal.say(f"{out} is complete; nothing was changed.")
        return session
    terminal.say(INTRODUCTION, HELP)
    if session.answers:
        terminal.say(f"Resuming after {len(session.answers)} answers.")
    with terminal.until_quit(
        lambda: f"{len(session.answers)} answers are saved in {out}; repeat the command to resume"
    ):
        for part, number in protocol.turns[len(session.answers) :]:
            task = protocol.task(part, number)
            if (part, number) == ("test", 1):
                terminal.say("", "The test begins. From now on there is no feedback.")
            terminal.say("", f"{NAMES[part]} {number} of {session.tasks}. Goal: {task.goal}")
            answer = protocol.answer(task, *_select(terminal, task.table, 1))
            session = append_answer(out, session, answer)
            if part == "train":
                line = f"{'correct' if answer.success else 'incorrect'}: {combined(answer.actions, answer.made)}"
                terminal.say(line, f"solution: {_recipes(task.plans[:1])}")
    return session


def _protocol_result(session: "Session", out: Path) -> tuple[dict[str, Any], list[str]]:
    from wordcraft_kg.apps.people.protocol import HUMAN_PARTS

    answered, finished, tasks = len(session.answers), session.is_finished, len(HUMAN_PARTS) * session.tasks
    values = {"out": str(out), "answered": answered, "tasks": tasks, "finished": finished}
    if not finished:  # test results appear only at the end
        return values, [f"answered {answered} of {tasks}; repeat the command to resume {out}"]
    correct = {part: sum(answer.success for answer in session.answers if answer.part == part) for part in HUMAN_PARTS}
    shown = ", ".join(f"{part} {count} of {session.tasks}" for part, count in correct.items())
    return values | {"successes": correct}, [f"correct: {shown}   next: wordcraft-kg people summary {out}"]
