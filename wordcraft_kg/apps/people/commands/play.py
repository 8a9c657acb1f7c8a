"""``wordcraft-kg play``."""

import io
import secrets
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

from cyclopts import Parameter

from wordcraft_kg.base import MAX_SIZE, ActionError, ConfigError, for_terminal, whole
from wordcraft_kg.base.answers import read_set
from wordcraft_kg.base.labels import read_pair
from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.options import Book, Force
from wordcraft_kg.envs.config import MAX_ATTEMPTS, WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg play",
    "wordcraft-kg play kitchen --depth 2 --attempts 4 --seed 3",
    "wordcraft-kg play everyday --open-ended",
    "wordcraft-kg play kitchen --browser",
    "wordcraft-kg play kitchen --export game.html",
)

HELP = """Name two items to combine them, such as water + earth or 1 2; new items are
added. Ingredients are not used up, and you may combine an item with itself. An
item is its number, its name, or the start of its name. ? shows this help, q
quits."""
SET_HELP = """Name the items to combine, such as water + earth + fire or 1 + 2 + 2; an item that is
needed twice is written twice, and new items are added. Ingredients are not used
up. An item is its number, its name, or the start of its name. ? shows this
help, q quits."""
ATTEMPTS = 100
"""Default number of attempts in open-ended mode."""
TASK_DEFAULTS = (
    WordCraftConfig.depth,
    WordCraftConfig.num_distractors,
    "all",
    None,
    None,
    0,
    False,
    None,
)
"""Options of tasks if none is set: depth, distractors, part, attempts, seed, episodes, open-ended
and base."""
HOST = "127.0.0.1"
PORT = 8767
WIDTH = 80
"""Columns of the terminal."""


class Quit(Exception):
    """The player stops, or the input has ended."""


@dataclass(frozen=True)
class Terminal:
    """A game as lines of text on a stream, and typed pairs from stdin.

    Attributes:
        stream: stream for texts: stdout, or stderr if stdout has the result as JSON.
    """

    stream: TextIO

    def __post_init__(self) -> None:
        if isinstance(sys.stdin, io.TextIOWrapper) and sys.stdin.errors != "replace":
            # Bytes that are no text are bad input, to be asked for again, and not a failure.
            sys.stdin.reconfigure(errors="replace")

    def say(self, *lines: str) -> None:
        """Show lines of text."""
        for line in lines:
            for part in line.split("\n"):
                print(for_terminal(part), file=self.stream, flush=True)

    @contextmanager
    def until_quit(self, tally: Callable[[], str]) -> Iterator[None]:
        """Run a game in a ``with`` block until :class:`Quit`.

        After Ctrl-C, the message of the KeyboardInterrupt has the result so far from ``tally``.
        """
        try:
            yield
        except Quit:
            self.say("")
        except KeyboardInterrupt:
            self.say("")
            raise KeyboardInterrupt(f"interrupted; {tally()}") from None

    def ask(self, prompt: str) -> str:
        """Return a typed line; ``q`` and the end of the input raise :class:`Quit`."""
        print(prompt, end="", file=self.stream, flush=True)
        # Without a console, Python may have no stdin at all.
        line = sys.stdin.readline() if sys.stdin else ""
        if not line or not sys.stdin.isatty():
            self.say(line.strip())  # a terminal has shown the line already
        if not line or line.strip().casefold() == "q":
            raise Quit
        return line.strip()

    def picks(self, labels: Sequence[str], prompt: str, most: int = 0) -> tuple[int, ...]:
        """Show items and ask for some of them until the input is valid; return their indices.

        Args:
            labels: the items, in the order of their numbers.
            prompt: the question.
            most: most items of a set; 0 asks for two items.
        """
        from wordcraft_kg.envs.words import numbered

        # Once for each table, not after each mistake: the list may be long.
        self.say(textwrap.fill(numbered(labels), WIDTH))
        while True:
            typed = self.ask(prompt)
            if typed == "?":
                self.say(SET_HELP if most else HELP)
                continue
            try:
                return read_set(typed, labels, most) if most else read_pair(typed, labels)
            except ActionError as error:
                self.say(textwrap.fill(str(error), WIDTH))


def play(  # noqa: PLR0913 - parameters are the command's options
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
    browser: Flag = False,
    export: Path | None = None,
    force: Force = False,
    host: str = HOST,
    port: int = PORT,
    output: Output = Output(),
) -> None:
    """Play crafting tasks by hand, in open-ended mode, or as a game in the browser.

    Args:
        graph: graph folder, recipe book file, or built-in book name.
        depth: minimum number of attempts to solve a task, 1 to 5.
        distractors: number of distractors on the table.
        part: tasks to play: train, valid, test or all.
        attempts: attempts per episode. Default: depth; 100 in open-ended mode.
        seed: seed for tasks and tables. Default: a random seed, which is shown.
        episodes: number of episodes; 0 plays until you quit.
        open_ended: play without goals: start with the base entities and discover as many entities
            as you can.
        base: comma-separated entities known at the start in open-ended mode. Default: the base
            entities of the graph.
        browser: serve the book as a game in the browser: discover items, or make goals. No
            accounts; nothing is stored but in the player's browser. Ctrl-C stops the server.
        export: write the game to this file, which opens from disk; at most 10,000 recipes.
        host: address to listen on with --browser; this machine's address in a network lets a
            classroom play.
        port: port to listen on with --browser; 0 selects a free port.
    """
    if browser or export:
        tasks = (depth, distractors, part, attempts, seed, episodes, open_ended, base)
        if tasks != TASK_DEFAULTS:
            raise ConfigError("--browser and --export have their own tasks: leave out the options.")
        if export:
            _export(graph, export, force, output)
        if browser:
            _serve(graph, host, port, output)
        return
    if (host, port) != (HOST, PORT):
        raise ConfigError("--host and --port are for a server; add --browser.")
    # With --json, stdout is for the result alone.
    terminal = Terminal(sys.stderr if output.json else sys.stdout)
    if open_ended:
        tasks = (depth, distractors, part, None, seed, episodes, False, None)
        if tasks != TASK_DEFAULTS:
            raise ConfigError("--open-ended has no tasks; the only options are attempts and base.")
        _play_open_world(terminal, graph, split_labels(base) if base else None, attempts, output)
    elif base:
        raise ConfigError(f"--base {','.join(base)}: tasks have no base; add --open-ended.")
    else:
        settings = {
            "part": part,
            "depth": depth,
            "num_distractors": distractors,
            "max_attempts": attempts,
        }
        _play_tasks(terminal, graph, settings, seed, episodes, output)


def _export(source: str, path: Path, force: bool, output: Output) -> None:
    from wordcraft_kg.base.extras import check_extra
    from wordcraft_kg.graphs.folder import open_graph

    check_extra("explore")
    from wordcraft_kg.apps.people.game import export_game, icons_of

    graph = open_graph(source).graph
    export_game(graph, path, icons_of(source, graph), force=force)
    output.result({"game": str(path)}, [f"wrote {path}: open it in a browser"])


def _serve(source: str, host: str, port: int, output: Output) -> None:
    from wordcraft_kg.base.extras import check_extra
    from wordcraft_kg.graphs.folder import open_graph

    check_extra("explore")
    from wordcraft_kg.apps.people.game import icons_of, make_game_app
    from wordcraft_kg.apps.web.serving import listen, serve

    graph = open_graph(source).graph
    app = make_game_app(graph, host, icons_of(source, graph))

    def started(address: str) -> None:
        output.result({"address": address}, [f"{address}   Ctrl-C stops the server"])

    listening = listen(host, port)
    try:
        serve(app, listening, started, in_browser=True)
    finally:
        listening.close()


def _play_tasks(
    terminal: Terminal,
    graph: str,
    settings: dict[str, Any],
    seed: int | None,
    episodes: int,
    output: Output,
) -> None:
    from wordcraft_kg.apps.people.protocol import episode_seed
    from wordcraft_kg.envs.wordcraft import WordCraftEnv

    # Checked before a graph is read, which may take long.
    whole("episodes", episodes, 0, MAX_SIZE)
    if settings["max_attempts"] is not None:
        whole("attempts", settings["max_attempts"], settings["depth"], MAX_ATTEMPTS)
    if seed is None:
        # Shown at the end and short enough to type, so that the same tasks can be played again.
        seed = secrets.randbelow(1_000_000)
    env = WordCraftEnv(graph, **settings)
    played = successes = 0

    def tally() -> str:
        return f"goals made: {successes} of {played}   to repeat these tasks: --seed {seed}"

    with terminal.until_quit(tally):
        while not episodes or played < episodes:
            observation, _ = env.reset(seed=episode_seed(seed, env.config.part, played + 1))
            number = f"{played + 1} of {episodes}" if episodes else f"{played + 1}"
            so_far = f"   (goals made: {successes} of {played})" if played else ""
            text = SET_HELP if env.world.has_combine else HELP
            terminal.say("" if played else f"{text}\n", f"{number}. Goal: {env.task.goal}{so_far}")
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
        most = env.world.graph.most_ingredients if env.world.has_combine else 0
        slots = terminal.picks(table, f"attempts left: {observation['attempts_left']} > ", most)
        # The largest set is complete with its last item; others are combined by the last action.
        combine = (env.num_slots - 1,) if len(slots) < most else ()
        for action in (*slots, *combine):
            observation, _, _, _, info = env.step(action)
        outcome = info["outcome"]
        picked_labels = [table[slot] for slot in slots]
        terminal.say(combined(picked_labels, results_of(env, *picked_labels)))
    goal = env.task.goal
    plans = env.task.plans
    has_made_goal = outcome == "goal"
    if has_made_goal:
        terminal.say(f"You made the goal: {goal}.")
    else:
        terminal.say(f"You have no attempts left. You did not make {goal}.")
    title = "Solution" if len(plans) == 1 else f"One of {len(plans)} solutions"
    steps = "; ".join(map(str, plans[0]))
    terminal.say(f"{title}: {steps}")
    return has_made_goal


def _play_open_world(
    terminal: Terminal, graph: str, base: Sequence[str] | None, attempts: int | None, output: Output
) -> None:
    from wordcraft_kg.envs.open_ended import OpenEndedEnv
    from wordcraft_kg.envs.words import PROMPTS, combined

    env = OpenEndedEnv(
        graph,
        base=base,
        max_attempts=whole("attempts", ATTEMPTS if attempts is None else attempts, 1),
    )
    env.reset()
    names = env.graph
    discovery = env.discovery
    attempted = repeated = 0
    is_over = False

    def tally() -> str:
        known_labels = f"{len(discovery.known)} of {discovery.reachable}"
        return f"known items: {known_labels} after {attempted} attempts"

    terminal.say(f"{HELP}\n")
    with terminal.until_quit(tally):
        while not is_over:
            known_labels = names.labels(discovery.known)
            attempts_left = env.max_attempts - attempted
            prompt = f"known items: {len(known_labels)}   attempts left: {attempts_left} > "
            pair = [known_labels[place] for place in terminal.picks(known_labels, prompt)]
            _, _, is_over, _, info = env.step([names.id_of(label) for label in pair])
            attempted += 1
            line = combined(pair, names.labels(info["new_entities"]), PROMPTS["nothing_new"])
            if info["repeated"]:
                repeated += 1
                line += PROMPTS["tried"]
            terminal.say(line)
    values = {
        "graph": names.name,
        "hash": names.hash,
        "base": names.labels(discovery.base),
        "reachable": discovery.reachable,
        "known": len(discovery.known),
        "attempts": env.max_attempts,
        "attempted": attempted,
        "repeated": repeated,
        "discovered": names.labels(discovery.known)[len(discovery.base) :],
    }
    output.result(values, [tally()])
