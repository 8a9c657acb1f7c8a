"""``wordcraft-kg play``."""

import io
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

from wordcraft_kg.cli.console import Output
from wordcraft_kg.settings import whole

if TYPE_CHECKING:
    from wordcraft_kg.agents.human import Session
    from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
    from wordcraft_kg.graphs.recipes import Recipe

EXAMPLES = (
    "wordcraft-kg play",
    "wordcraft-kg play kitchen --depth 2 --attempts 4",
    "wordcraft-kg play everyday --protocol paper --distractors 8 --out human.jsonl",
)

WIDTH = 80  # columns
HELP = """Two picks make an attempt: the two are combined, and their results come to the
table. Nothing is used up, and the same thing may be picked twice. Type the
number of a thing, its word, or the word's beginning. ? shows this, q quits."""
INTRODUCTION = """The paper's protocol: 40 train tasks, each with its answer afterwards, then 40
test tasks without. Every goal can be made in one attempt, from two things on
the table or from one with itself."""


def play(
    graph: str = "everyday",
    *,
    depth: int = 1,
    distractors: int | None = None,
    part: Literal["all", "train", "valid", "test"] = "all",
    attempts: int | None = None,
    seed: int = 0,
    episodes: int = 0,
    protocol: Literal["paper"] | None = None,
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Play the crafting task by hand, or take the paper's test for people and save the answers to a file.

    Args:
        graph: graph folder, recipe book or known book's name.
        depth: fewest attempts that solve a task, 1 to 5.
        distractors: entities on the table that no plan needs. Default: 4; 8 with a protocol.
        part: tasks to play: train, valid, test or all.
        attempts: attempts in an episode. Default: depth.
        seed: seed of tasks and tables.
        episodes: number of episodes to play; 0 plays until you quit.
        protocol: paper asks 40 train tasks with their answers and then 40 test tasks, at depth 1 with one attempt.
        out: file for the protocol's answers (JSON lines). An interrupted session continues where it stopped.
    """
    from wordcraft_kg.errors import ConfigError

    terminal = Terminal(sys.stderr if output.json else sys.stdout)
    if protocol is None:
        from wordcraft_kg.envs.config import MAX_ATTEMPTS
        from wordcraft_kg.envs.wordcraft import WordCraftEnv

        if out is not None:
            raise ConfigError(f"--out {out}: only a protocol's answers are saved; add --protocol paper.")
        whole("episodes", episodes, 0)
        if attempts is not None:
            whole("attempts", attempts, depth, MAX_ATTEMPTS)
        num_distractors = 4 if distractors is None else distractors
        env = WordCraftEnv(graph, part=part, depth=depth, num_distractors=num_distractors, max_attempts=attempts)
        values = _play_freely(terminal, env, seed, episodes)
        output.result(values, [f"episodes played: {values['episodes']}   goal made: {values['successes']}"])
    else:
        if out is None:
            raise ConfigError("--protocol paper: name a file for the answers, such as --out human.jsonl.")
        if (depth, part, attempts in (None, 1), episodes) != (1, "all", True, 0):
            raise ConfigError("--protocol paper fixes depth, part, attempts and episodes; leave these options out.")
        session = _play_protocol(terminal, graph, 8 if distractors is None else distractors, seed, out)
        output.result(*_protocol_result(session, out))


# --- terminal --------------------------------------------------------------------------------------------------------


class Quit(Exception):
    """The player wants to stop, or the input has ended."""


@dataclass(frozen=True)
class Terminal:
    """Shows the game, and reads what is typed on stdin."""

    stream: TextIO

    def __post_init__(self) -> None:
        if isinstance(sys.stdin, io.TextIOWrapper) and sys.stdin.errors != "replace":
            sys.stdin.reconfigure(errors="replace")  # stray bytes are bad input, not a failure

    def say(self, *lines: str) -> None:
        """Show lines of text."""
        for line in lines:
            print(line, file=self.stream, flush=True)

    def ask(self, prompt: str) -> str:
        """Return a line that was typed.

        Raises:
            Quit: for ``q`` and at the end of the input.
        """
        print(prompt, end="", file=self.stream, flush=True)
        line = sys.stdin.readline() if sys.stdin else ""
        if not line or not sys.stdin.isatty():
            self.say(line.strip())  # a terminal has shown it already
        if not line or line.strip().casefold() == "q":
            raise Quit
        return line.strip()

    def pick(self, prompt: str, table: Sequence[str]) -> int:
        """Return the slot that the player picks, asking until it is one."""
        from wordcraft_kg.agents.human import read_pick
        from wordcraft_kg.errors import ActionError

        while True:
            typed = self.ask(prompt)
            if typed == "?":
                self.say(HELP)
                continue
            try:
                return read_pick(typed, table)
            except ActionError as error:
                self.say(str(error))


def _cells(table: Sequence[str]) -> Iterable[str]:
    """Lay a table out in numbered columns."""
    cells = [f"{slot:>3} {label}" for slot, label in enumerate(table, start=1)]
    width = max(map(len, cells)) + 2
    per_line = max(1, WIDTH // width)
    for first in range(0, len(cells), per_line):
        yield "".join(f"{cell:<{width}}" for cell in cells[first : first + per_line]).rstrip()


@dataclass(frozen=True)
class Attempt:
    """Two picks and their results."""

    table: tuple[str, ...]
    picks: tuple[str, str]
    made: tuple[str, ...]
    seconds: float
    observation: "Observation"
    outcome: str


def _attempt(terminal: Terminal, env: "WordCraftEnv", observation: "Observation") -> Attempt:
    """Show the table, ask for two picks and carry them out."""
    from wordcraft_kg.agents.human import results_of, table_labels

    table = table_labels(env, observation)
    terminal.say(*_cells(table))
    began = time.monotonic()
    left = f"attempts left: {observation['attempts_left']} >"
    one = terminal.pick(f"hand: nothing   {left} ", table)
    other = terminal.pick(f"hand: {table[one]}   {left} ", table)
    seconds = time.monotonic() - began
    env.step(one)
    observation, _, _, _, info = env.step(other)
    picks = (table[one], table[other])
    return Attempt(table, picks, results_of(env, *picks), seconds, observation, info["outcome"])


def _recipes(recipes: Iterable["Recipe"]) -> str:
    return "; ".join(f"{a} + {b} -> {result}" for a, b, result in recipes)


def _combined(picks: Sequence[str], made: Sequence[str]) -> str:
    return f"{' + '.join(picks)} -> {', '.join(made) or 'nothing'}"


# --- free play -------------------------------------------------------------------------------------------------------


def _play_freely(terminal: Terminal, env: "WordCraftEnv", seed: int, episodes: int) -> dict[str, Any]:
    from wordcraft_kg.agents.human import episode_seed

    config, played, successes = env.config, 0, 0
    try:
        while not episodes or played < episodes:
            observation, _ = env.reset(seed=episode_seed(seed, config.part, played + 1))
            terminal.say("" if played else f"{HELP}\n", f"{played + 1}. Make: {env.task.goal}")
            successes += _play_episode(terminal, env, observation)
            played += 1
    except Quit:
        terminal.say("")
    return {
        "graph": env.world.graph.name,
        "depth": config.depth,
        "distractors": config.num_distractors,
        "part": config.part,
        "attempts": config.attempts,
        "seed": seed,
        "episodes": played,
        "successes": successes,
    }


def _play_episode(terminal: Terminal, env: "WordCraftEnv", observation: "Observation") -> bool:
    """Play an episode to its end, show the outcome, and return whether the goal was made."""
    outcome = "in_progress"
    while outcome == "in_progress":
        attempt = _attempt(terminal, env, observation)
        observation, outcome = attempt.observation, attempt.outcome
        terminal.say(_combined(attempt.picks, attempt.made))
    goal, plans = env.task.goal, env.task.plans
    terminal.say(
        f"You made {goal}." if outcome == "goal" else f"No attempt is left; {goal} was not made.",
        f"{'The plan' if len(plans) == 1 else f'One of {len(plans)} plans'}: {_recipes(plans[0])}",
    )
    return outcome == "goal"


# --- protocol --------------------------------------------------------------------------------------------------------


def _play_protocol(terminal: Terminal, graph: str, distractors: int, seed: int, out: Path) -> "Session":
    from wordcraft_kg.agents.human import SCHEDULE, TASKS_PER_PART, Answer, HumanProtocol, append_answer, open_session

    protocol = HumanProtocol(graph, distractors, seed)
    session = open_session(out, protocol)
    if session.is_finished:
        terminal.say(f"{out} is finished; nothing was changed.")
        return session
    terminal.say(INTRODUCTION, HELP)
    if session.answers:
        terminal.say(f"Continuing after {len(session.answers)} answers.")
    try:
        for part, number in SCHEDULE[len(session.answers) :]:
            env, observation = protocol.pose(part, number)
            goal, plans = env.task.goal, env.task.plans
            if (part, number) == ("test", 1):
                terminal.say("", "The test begins; no answers are shown from here on.")
            terminal.say("", f"{part} {number} of {TASKS_PER_PART}. Make: {goal}")
            done = _attempt(terminal, env, observation)
            is_made = done.outcome == "goal"
            answer = Answer(part, number, goal, done.table, done.picks, done.made, is_made, round(done.seconds, 2))
            session = append_answer(out, session, answer)
            if part == "train":
                verdict = "right" if is_made else "wrong"
                terminal.say(f"{verdict}: {_combined(done.picks, done.made)}", f"answer: {_recipes(plans[0])}")
    except Quit:
        terminal.say("")
    except KeyboardInterrupt:
        kept = f"interrupted; {len(session.answers)} answers are in {out}, the same command continues"
        raise KeyboardInterrupt(kept) from None
    return session


def _protocol_result(session: "Session", out: Path) -> tuple[dict[str, Any], list[str]]:
    from wordcraft_kg.agents.human import HUMAN_PARTS, SCHEDULE, TASKS_PER_PART

    answered, finished = len(session.answers), session.is_finished
    values = {"out": str(out), "answered": answered, "tasks": len(SCHEDULE), "finished": finished}
    if not finished:  # the number of right test answers is shown at the end only
        return values, [f"answered {answered} of {len(SCHEDULE)}; the same command continues {out}"]
    right = {part: sum(answer.success for answer in session.answers if answer.part == part) for part in HUMAN_PARTS}
    shown = ", ".join(f"{part} {count} of {TASKS_PER_PART}" for part, count in right.items())
    return values | {"successes": right}, [f"right: {shown}   next: wordcraft-kg human-summary {out}"]
