"""``wordcraft-kg serve openenv``."""

import logging
import sys
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, LookUps
from wordcraft_kg.base import ConfigError, number_in, one_of, whole
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.cli.console import Output, split_labels, whole_numbers
from wordcraft_kg.cli.options import Book, Words
from wordcraft_kg.graphs.tasks import MAX_DEPTH

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.conversation import Play

GROUP = "Text agents"
FILE_ONLY = ("--attempts", "--look-ups")
SUBJECT = "Serve games to programs that train language models: openenv."
EXAMPLES = (
    "wordcraft-kg serve openenv everyday --depth 1,2 --port 8000",
    "wordcraft-kg serve openenv everyday --part train,valid --distractors 2,8 --reward official",
    "wordcraft-kg serve openenv --track craft-8-lite --out games.jsonl",
)
Parts = Literal["train", "valid", "test"]
_MOST_SESSIONS = 10_000
_LONGEST_IDLE = 86_400.0


def serve_openenv(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    part: Words = None,
    depth: Words = None,
    distractors: Words = None,
    attempts: int | None = None,
    difficulty: str | None = None,
    reward: Literal["sparse", "official"] = "sparse",
    knowledge: LookUps = "none",
    look_ups: int = LOOK_UPS,
    track: str | None = None,
    host: str = "127.0.0.1",
    port: int = 8000,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    sessions: int = 256,
    idle: float = 900.0,
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Serve games to language models by OpenEnv, until Ctrl-C: TRL, verifiers and others connect.

    Each client has a session with a game of its own. The same task and seed give the same table,
    which is that of all other players.

    Args:
        graph: graph folder, recipe book or known book's name.
        part: comma-separated parts of the split that clients may play: train, valid, test. Tasks of
            other parts are refused. Default: train.
        depth: comma-separated depths of tasks, 1 to 5. Default: 1.
        distractors: comma-separated numbers of distractors on a table. Default: 8.
        attempts: attempts in a game. Default: the task's depth.
        difficulty: least and largest difficulty of tasks, such as .2:.8: the share of games that
            nearest words, a learner and a planner lose; measured for everyday. Default: all.
        reward: sparse (1 for the goal), or official (shaped as in the paper's released code).
        knowledge: look-up source: none, or partial (train recipes that do not make the goal from
            the table).
        look_ups: look-ups in a game.
        track: track of the benchmark, such as craft-8-lite, instead of other games; fits with
            --knowledge only.
        host: address to listen on; any but 127.0.0.1, such as 0.0.0.0, opens the games to other
            machines.
        port: port to listen on; 0 selects a free port.
        allow_host: additional server name or address, as with --host 0.0.0.0 or a proxy;
            repeatable.
        sessions: most sessions at a time, as far as the system permits so many open files.
        idle: seconds without a message after which a session ends.
        out: file for finished games (JSON lines), which the same command continues; for one part,
            depth and number of distractors.
    """
    whole("sessions", sessions, 1, _MOST_SESSIONS)
    number_in("idle", idle, 1, _LONGEST_IDLE, f"seconds, 1 to {_LONGEST_IDLE:,.0f}")
    parts = list(dict.fromkeys(split_labels(part or ["train"])))
    for name in parts:
        one_of("part", name, get_args(Parts))
    depths = whole_numbers("depth", depth or ["1"])
    for task_depth in depths:
        whole("depth", task_depth, 1, MAX_DEPTH)
    numbers = whole_numbers("distractors", distractors or ["8"])
    game_options = (graph, part, depth, distractors, attempts, difficulty, reward, look_ups)
    if track is not None and game_options != (
        "everyday",
        None,
        None,
        None,
        None,
        None,
        "sparse",
        LOOK_UPS,
    ):
        raise ConfigError(
            "--track has its own games; omit the graph and the options of games but --knowledge."
        )
    if out is not None and len(parts) * len(depths) * len(numbers) > 1:
        raise ConfigError(
            "`out`: a file of games has one part, depth and number of distractors; give one of "
            "each, or leave --out out."
        )
    check_extra("openenv")
    from wordcraft_kg.apps.text_agents.difficulty import read_range
    from wordcraft_kg.apps.text_agents.game_records import GamesHeader
    from wordcraft_kg.apps.text_agents.hosted_games import GameList, games_writer, open_play
    from wordcraft_kg.apps.text_agents.openenv_server import make_openenv_app
    from wordcraft_kg.apps.web.serving import listen, most_web_sockets, serve

    # A quarter of the web sockets is for clients who are told that all sessions are taken.
    max_sessions = most_web_sockets() * 3 // 4
    if sessions > max_sessions:
        logging.getLogger(__name__).warning(
            "%d sessions in place of %d: this process may open few files (see ulimit -n).",
            max_sessions,
            sessions,
        )
        sessions = max_sessions
    with ExitStack() as stack:
        # The port first: if it is taken, nobody waits for the tasks.
        listening = stack.enter_context(listen(host, port))
        plays: dict[str, list[Play]] = {}
        if track is not None:
            plays["test"] = [_of_track(track, knowledge)]
        else:
            for name in parts:
                plays[name] = [
                    open_play(
                        graph, name, task_depth, number, attempts, reward, knowledge, look_ups
                    )
                    for task_depth, number in product(depths, numbers)
                ]
        games = GameList(plays, read_range(difficulty))
        keep = None
        if out is not None:
            ((play,),) = plays.values()
            header = GamesHeader(player="OpenEnv clients", settings=play.settings)
            keep = stack.enter_context(games_writer(out, header))
        app = make_openenv_app(
            games, keep=keep, sessions=sessions, idle=idle, host=host, more_hosts=allow_host or ()
        )

        def started(address: str) -> None:
            counts = {name: games.count(name) for name in plays}
            offered = ", ".join(f"{count:,} {name} tasks" for name, count in counts.items())
            view = {"address": address, "tasks": counts, "sessions": sessions}
            output.result(view, [f"{address}   {offered}   Ctrl-C stops the server"])
            # A script may wait for the address on a pipe.
            sys.stdout.flush()

        serve(app, listening, started, has_web_sockets=True)


def _of_track(name: str, knowledge: LookUps) -> "Play":
    from wordcraft_kg.apps.text_agents.benchmark import open_track

    benchmark_track = open_track(name)
    if benchmark_track.is_open_ended:
        raise ConfigError(f"track {name} is open-ended and has no reward; choose another track.")
    return benchmark_track.play(knowledge)
