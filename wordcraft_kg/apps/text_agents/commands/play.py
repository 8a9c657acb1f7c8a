"""``wordcraft-kg play``."""

import io
import secrets
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.base import MAX_SIZE, ConfigError, for_terminal, whole
from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.options import Book, Force
from wordcraft_kg.graphs import TaskPart, open_graph

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.conversation import Conversation
    from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, Play

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg play",
    "wordcraft-kg play kitchen --depth 2 --attempts 4 --seed 3",
    "wordcraft-kg play everyday --open-ended",
    "wordcraft-kg play kitchen --browser",
    "wordcraft-kg play kitchen --export game.html",
)
TASK_DEFAULTS = (GameSettings.depth, GameSettings.distractors, "all", None, 0)
"""Options of tasks if none is set: depth, distractors, part, seed and episodes."""
HOST = "127.0.0.1"
PORT = 8767
HELP = """
Name two items to combine them, such as water + earth or 1 2. An item is its number, its name, or \
the start of its name. ? shows this help, q quits.
"""
SET_HELP = """
Name the items to combine, such as water + earth + fire or 1 + 2 + 2. An item is its number, its \
name, or the start of its name. ? shows this help, q quits.
"""
_WIDTH = 80
"""Columns of the terminal."""


class Quit(Exception):
    """The player stops, or the input has ended."""


@dataclass(frozen=True)
class Terminal:
    """A game as lines of text on a stream, and answers from stdin.

    Attributes:
        stream: stream for texts: stdout, or stderr if stdout has the result as JSON.
    """

    stream: TextIO

    def __post_init__(self) -> None:
        if isinstance(sys.stdin, io.TextIOWrapper) and sys.stdin.errors != "replace":
            # Bytes that are no text are bad input, to be asked for again, and not a failure.
            sys.stdin.reconfigure(errors="replace")

    def say(self, *texts: str) -> None:
        """Show texts, each on lines of its own."""
        for line in "\n".join(texts).split("\n"):
            print(textwrap.fill(for_terminal(line), _WIDTH), file=self.stream, flush=True)

    def play(self, talk: "Conversation") -> None:
        """Play a game to its end; ``q``, ``quit`` and the end of the input raise :class:`Quit`."""
        while not talk.is_over:
            print("> ", end="", file=self.stream, flush=True)
            # Without a console, Python may have no stdin at all.
            line = sys.stdin.readline() if sys.stdin else ""
            typed = line.strip()
            if not line or not sys.stdin.isatty():
                self.say(typed)  # a terminal has shown the line already
            if not line or typed.casefold() in ("q", "quit"):
                raise Quit
            if typed.casefold() in ("?", "help"):
                self.say(help_text(talk))
                continue
            reply = talk.hear(typed)
            # A mistake changes nothing, and the list of items may be long.
            self.say(talk.outcome if talk.is_invalid else reply)

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


def help_text(talk: "Conversation") -> str:
    """Return the rules of a game for a person at a terminal."""
    return f"{talk.game.rules}\n{SET_HELP if talk.game.most_picks else HELP}"


def play(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    depth: int = GameSettings.depth,
    distractors: int = GameSettings.distractors,
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
    has_task_options = (depth, distractors, part, seed, episodes) != TASK_DEFAULTS
    if browser or export:
        if has_task_options or open_ended or base or attempts is not None:
            raise ConfigError("--browser and --export have their own tasks: leave out the options.")
        _play_page(graph, export, browser, host, port, force, output)
        return
    if (host, port) != (HOST, PORT):
        raise ConfigError("--host and --port are for a server; add --browser.")
    if open_ended and has_task_options:
        raise ConfigError("--open-ended has no tasks; the only options are attempts and base.")
    # Checked before a graph is read, which may take long.
    settings = GameSettings(
        part=GameSettings.part if open_ended else part,
        depth=depth,
        distractors=distractors,
        attempts=attempts,
        open_ended=open_ended,
        base=split_labels(base) if base else None,
    )
    whole("episodes", episodes, 0, MAX_SIZE)
    if seed is None:
        # Shown at the end and short enough to type, so that the same tasks can be played again.
        seed = secrets.randbelow(1_000_000)
    whole("seed", seed, 0)
    from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, Play

    # A person corrects a typing error as often as it takes.
    games = Play.open(graph, settings, max_invalid=MAX_SIZE)
    # With --json, stdout is for the result alone.
    terminal = Terminal(sys.stderr if output.json else sys.stdout)
    if isinstance(games, DiscoveryGames):
        _play_open_world(terminal, games, output)
    else:
        _play_tasks(terminal, games, seed, episodes, output)


def _play_page(
    source: str,
    export: Path | None,
    browser: bool,
    host: str,
    port: int,
    force: bool,
    output: Output,
) -> None:
    from wordcraft_kg.base.extras import check_extra

    check_extra("explore")
    from wordcraft_kg.apps.text_agents.browser_game import export_game, icons_of, make_game_app
    from wordcraft_kg.apps.web.serving import listen, serve

    graph = open_graph(source).graph
    icons = icons_of(source, graph)
    if export:
        export_game(graph, export, icons, force=force)
        output.result({"game": str(export)}, [f"wrote {export}: open it in a browser"])
    if browser:
        app = make_game_app(graph, host, icons)

        def started(address: str) -> None:
            output.result({"address": address}, [f"{address}   Ctrl-C stops the server"])

        with listen(host, port) as listening:
            serve(app, listening, started, in_browser=True)


def _play_tasks(
    terminal: Terminal, games: "Play", seed: int, episodes: int, output: Output
) -> None:
    import numpy as np

    tasks = games.world.tasks
    rng = np.random.default_rng(seed)
    made: list[bool] = []

    def tally() -> str:
        return f"goals made: {sum(made)} of {len(made)}   to repeat these tasks: --seed {seed}"

    with terminal.until_quit(tally):
        while not episodes or len(made) < episodes:
            task = int(rng.integers(len(tasks)))
            talk = games.begin(task, distractor_seed=len(made))
            if not made:
                terminal.say(help_text(talk))
            number = f"{len(made) + 1} of {episodes}" if episodes else f"{len(made) + 1}"
            so_far = f"   (goals made: {sum(made)} of {len(made)})" if made else ""
            terminal.say(f"{number}.{so_far}", talk.game.state)
            terminal.play(talk)
            plans = tasks[task].plans
            title = "Solution" if len(plans) == 1 else f"One of {len(plans)} solutions"
            terminal.say(f"{title}: {'; '.join(map(str, plans[0]))}\n")
            made.append(talk.game.is_made)
    settings = games.settings
    values = {
        "graph": settings.graph,
        "depth": settings.depth,
        "distractors": settings.distractors,
        "part": settings.part,
        "attempts": settings.attempts,
        "seed": seed,
        "episodes": len(made),
        "successes": sum(made),
    }
    output.result(values, [tally()])


def _play_open_world(terminal: Terminal, games: "DiscoveryGames", output: Output) -> None:
    from wordcraft_kg.apps.text_agents.games import DiscoveryGame

    reachable = games.discovery.reachable
    talk = games.begin()
    game = talk.game
    assert isinstance(game, DiscoveryGame)

    def tally() -> str:
        attempts = len(game.known_after)
        return f"known items: {len(game.labels)} of {reachable} after {attempts} attempts"

    terminal.say(help_text(talk), game.state)
    with terminal.until_quit(tally):
        terminal.play(talk)
    base = games.settings.base
    values = {
        "graph": games.settings.graph,
        "hash": games.settings.graph_hash,
        "base": base,
        "reachable": reachable,
        "known": len(game.labels),
        "attempts": games.settings.attempts,
        "attempted": len(game.known_after),
        "repeated": game.repeated,
        "discovered": game.labels[len(base) :],
    }
    output.result(values, [tally()])
