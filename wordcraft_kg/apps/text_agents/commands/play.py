"""``wordcraft-kg play``."""

import io
import secrets
import sys
import textwrap
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from wordcraft_kg.base import MAX_SIZE, ConfigError, for_terminal, whole
from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.options import Book, Force
from wordcraft_kg.graphs import TaskPart, open_graph

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.conversation import Conversation
    from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, TaskGames

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg play",
    "wordcraft-kg play kitchen --depth 2 --attempts 4 --seed 3",
    "wordcraft-kg play everyday --open-ended",
    "wordcraft-kg play kitchen --browser",
    "wordcraft-kg play kitchen --export game.html",
)
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


def say(stream: TextIO, *texts: str) -> None:
    """Show texts, each on lines of its own."""
    for line in "\n".join(texts).split("\n"):
        print(textwrap.fill(for_terminal(line), _WIDTH), file=stream, flush=True)


def converse(talk: "Conversation", stream: TextIO) -> None:
    """Play a game to its end.

    Raises:
        EOFError: at ``q``, ``quit`` and the end of the input.
    """
    while not talk.is_over:
        print("> ", end="", file=stream, flush=True)
        # Without a console, Python may have no stdin at all.
        line = sys.stdin.readline() if sys.stdin else ""
        if not line:
            raise EOFError
        typed = line.strip()
        if not sys.stdin.isatty():
            say(stream, typed)  # a terminal has shown the line already
        if typed.casefold() in ("q", "quit"):
            raise EOFError
        if typed.casefold() in ("?", "help"):
            say(stream, help_text(talk))
            continue
        reply = talk.hear(typed)
        # A mistake changes nothing, and the list of items may be long.
        say(stream, talk.outcome if talk.is_invalid else reply)


def help_text(talk: "Conversation") -> str:
    """Return the rules of a game for a person at a terminal."""
    return f"{talk.game.rules}\n{SET_HELP if talk.game.most_picks else HELP}"


def play(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    depth: int = 1,
    distractors: int = 8,
    part: TaskPart = "all",
    attempts: int | None = None,
    seed: int | None = None,
    open_ended: Flag = False,
    browser: Flag = False,
    export: Path | None = None,
    force: Force = False,
    host: str = "127.0.0.1",
    port: int = 8767,
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
        open_ended: play without goals: start with the base entities and discover as many entities
            as you can.
        browser: serve the book as a game in the browser: discover items, or make goals. No
            accounts; nothing is stored but in the player's browser. Ctrl-C stops the server.
        export: write the game to this file, which opens from disk; at most 10,000 recipes.
        host: address to listen on with --browser; this machine's address in a network lets a
            classroom play.
        port: port to listen on with --browser; 0 selects a free port.
    """
    has_task_options = (depth, distractors, part, seed) != (1, 8, "all", None)
    if browser or export:
        if has_task_options or open_ended or attempts is not None:
            raise ConfigError("--browser and --export have their own tasks: leave out the options.")
        _play_page(graph, export, browser, host, port, force, output)
        return
    if (host, port) != ("127.0.0.1", 8767):
        raise ConfigError("--host and --port are for a server; add --browser.")
    if open_ended and has_task_options:
        raise ConfigError("--open-ended has no tasks; the only option is attempts.")
    if seed is None:
        # Shown at the end and short enough to type, so that the same tasks can be played again.
        seed = secrets.randbelow(1_000_000)
    whole("seed", seed, 0)
    if isinstance(sys.stdin, io.TextIOWrapper):
        # Bytes that are no text are bad input, to be asked for again, and not a failure.
        sys.stdin.reconfigure(errors="replace")
    from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, open_play

    # With --json, stdout is for the result alone.
    stream = sys.stderr if output.json else sys.stdout
    # A person corrects a typing error as often as it takes.
    if open_ended:
        games = DiscoveryGames(open_graph(graph), attempts=attempts, max_invalid=MAX_SIZE)
        _play_open_world(games, stream, output)
    else:
        tasks = open_play(graph, part, depth, distractors, attempts, max_invalid=MAX_SIZE)
        _play_tasks(tasks, seed, stream, output)


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


def _play_tasks(games: "TaskGames", seed: int, stream: TextIO, output: Output) -> None:
    import numpy as np

    tasks = games.world.tasks
    rng = np.random.default_rng(seed)
    made: list[bool] = []
    # Ctrl-C ends the game as ``q`` does.
    with suppress(EOFError, KeyboardInterrupt):
        while True:
            task = int(rng.integers(len(tasks)))
            talk = games.begin(task, distractor_seed=len(made))
            if not made:
                say(stream, help_text(talk))
            say(stream, f"{len(made) + 1}.", talk.game.state)
            converse(talk, stream)
            made.append(talk.game.is_made)
            plans = tasks[task].plans
            title = "Solution" if len(plans) == 1 else f"One of {len(plans)} solutions"
            say(stream, f"{title}: {'; '.join(map(str, plans[0]))}\n")
    say(stream, "")
    tally = f"goals made: {sum(made)} of {len(made)}   to repeat these tasks: --seed {seed}"
    output.result({"seed": seed, "episodes": len(made), "successes": sum(made)}, [tally])


def _play_open_world(games: "DiscoveryGames", stream: TextIO, output: Output) -> None:
    talk = games.begin()
    say(stream, help_text(talk), talk.game.state)
    with suppress(EOFError, KeyboardInterrupt):
        converse(talk, stream)
    say(stream, "")
    values = {
        "reachable": games.discovery.reachable,
        "known": len(talk.game.labels),
        "attempted": len(talk.game.pairs),
        "discovered": talk.game.labels[len(games.settings.base) :],
    }
    tally = "known items: {known} of {reachable} after {attempted} attempts".format_map(values)
    output.result(values, [tally])
