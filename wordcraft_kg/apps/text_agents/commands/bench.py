"""``wordcraft-kg bench list``, ``bench run`` and ``bench verify``."""

import hashlib
import shutil
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import TIMEOUT, LookUps
from wordcraft_kg.base import (
    ConfigError,
    WordCraftKGError,
    counted,
    read_small_file,
)
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import Force

GROUP = "Text agents"
FILE_ONLY = {"bench run": ("--price",)}
SUBJECT = "Play a benchmark's frozen tasks, and verify results by playing all games again."
EXAMPLES = {
    "bench list": ("wordcraft-kg bench list", "wordcraft-kg bench list --json"),
    "bench run": (
        "wordcraft-kg bench run craft-8-lite --player votes --out submission",
        'wordcraft-kg bench run craft-8-lite --player "program:python examples/line_player.py" '
        "--out submission",
        "wordcraft-kg bench run depth-2 --player planner:models/recipes --out submission",
    ),
    "bench verify": (
        "wordcraft-kg bench verify submission",
        "wordcraft-kg bench verify submission --player scorer:models/mine",
    ),
}


def bench_list(*, output: Output = Output()) -> None:
    """List the benchmark's tracks, and the kinds of players for `bench run`."""
    from wordcraft_kg.apps.text_agents import benchmark, benchmark_players

    manifest, manifest_hash = benchmark.read_manifest()
    tracks = {
        name: {"about": track.about, "games": counted(len(track.tasks or track.orders), "game")}
        for name, track in manifest.tracks.items()
    }
    kinds = {kind.usage(name): kind.about for name, kind in benchmark_players.KINDS.items()}

    def text() -> Iterator[str]:
        yield f"{manifest.name} of {manifest.date}, {manifest.licence}, {manifest_hash[:12]}"
        yield from aligned(
            [(f"  {name}", track["games"], track["about"]) for name, track in tracks.items()]
        )
        yield "add -lite for 100 tasks, or 100 attempts, and -made-up for made-up words"
        yield "players"
        yield from aligned([(f"  {name}", about) for name, about in kinds.items()])

    view = {
        "benchmark": manifest.name,
        "hash": manifest_hash,
        "date": manifest.date,
        "tracks": tracks,
        # Text names the endings once; programs get each full name.
        "names": manifest.names,
        "players": kinds,
    }
    output.result(view, text())


def bench_run(  # noqa: PLR0913 - parameters are the command's options
    track: str,
    *,
    player: str,
    out: Path,
    name: str | None = None,
    look_ups: LookUps = "none",
    weights: Path | None = None,
    prompts: Path | None = None,
    training_data: str | None = None,
    licence: str | None = None,
    tokens: Annotated[tuple[int, int] | None, Parameter(negative=())] = None,
    price: float | None = None,
    measured: Flag = False,
    timeout: float = TIMEOUT,
    base_url: str | None = None,
    parallel: int = 1,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Let a player play a track of the benchmark; write a submission with all games.

    The same player writes the same bytes. Repeat the command to continue an interrupted program. An
    earlier submission stays until the new one is complete.

    Args:
        track: name from `bench list`, such as craft-8-lite.
        player: KIND or KIND:ARGUMENT, see `bench list`, such as random or scorer:models/mine.
        out: folder for submission.json, games.jsonl, and a program's prompts and answers
            (messages).
        name: player's name in tables.
        look_ups: look-up source for players by text: none, or partial (train recipes).
        weights: file with a text player's weights; the submission holds the hash.
        prompts: file with the prompts, if they differ from the standard prompts; the submission
            holds the hash.
        training_data: data on which the player was trained, in words.
        licence: licence of the player or its weights.
        tokens: numbers of input and output tokens, if the player has counted them; an Inspect log
            holds them.
        price: price of the evaluation in US dollars.
        measured: add the date and the duration, which differ between runs.
        timeout: seconds for an answer of a program or server.
        base_url: address of a chat completions API, for openai:MODEL; a key is read from
            OPENAI_API_KEY.
        parallel: games at a time, for openai:MODEL.
    """
    from wordcraft_kg.apps.text_agents import benchmark, benchmark_players, results, submission
    from wordcraft_kg.runs.run_folder import locked_folder

    # Everything that the user can mistype is checked before the games, which may take hours.
    messages = out / submission.MESSAGES
    is_program = player.startswith(("program:", "openai:"))
    if base_url is not None and not player.startswith("openai:"):
        raise ConfigError(f"`base_url` is for --player openai:MODEL, not '{player[:100]}'.")
    games = messages / results.GAMES_FILE
    submission.check_folder(out, games, is_program=is_program, force=force)
    declared = benchmark_players.declarations(name, training_data, licence, tokens, price, weights)
    if prompts is not None:
        prompt_hash = hashlib.sha256(read_small_file(prompts)).hexdigest()
        declared |= {"prompts": "custom", "prompt_hash": prompt_hash}
    benchmark_track = benchmark.open_track(track)
    begin = time.perf_counter()
    with locked_folder(out, "written"):
        # Once more under the lock: another process may have played meanwhile.
        is_replacing = submission.check_folder(out, games, is_program=is_program, force=force)
        with results.continuable(messages):
            settings = benchmark_players.RunSettings(
                messages, look_ups, timeout, is_replacing, base_url, parallel
            )
            kind, entrant = benchmark_players.enter(benchmark_track, player, settings, weights)
        if tokens and entrant.tokens is not None:
            raise ConfigError(
                f"`tokens`: the log of '{player[:100]}' has its own numbers. Leave the option out."
            )
        seconds = round(time.perf_counter() - begin, 1)
        about = {
            "kind": kind,
            **entrant.facts(),
            **declared,
            "seconds": seconds if measured else None,
            "date": time.strftime("%Y-%m-%d", time.gmtime()) if measured else None,
        }
        entry = submission.write_submission(out, benchmark_track, entrant.games, look_ups, about)
        if not is_program:
            # A program's prompts and answers belong to the submission. Other players have none, so
            # a folder here is from the player of a submission that was replaced.
            shutil.rmtree(messages, ignore_errors=True)
    rank = benchmark.rank_text(benchmark_track.name, entry.figures.mean)
    lines = [*submission.result_lines(entry), *filter(None, [rank])]
    view = {"out": str(out), "submission": entry, "rank": rank}
    output.result(view, [*lines, f"wrote {out}/   next: wordcraft-kg bench verify {out}"])


def bench_verify(
    *folders: Path,
    player: str | None = None,
    weights: Path | None = None,
    timeout: float = TIMEOUT,
    output: Output = Output(),
) -> int:
    """Verify submissions: play all games again, and compute results and intervals again.

    Each folder is marked as replayed, or refused with the reason. With --player, the player plays
    the track again: if weights and games are the same, the submission is also marked as reproduced.
    The exit code is 1 if any is refused.

    Args:
        folders: folders of `bench run`, ZIP archives of their two files, or folders and archives of
            such folders.
        player: the player of the submissions, as for `bench run`.
        weights: file with a text player's weights.
        timeout: seconds for an answer of a program.
    """
    from wordcraft_kg.apps.text_agents import submission

    if not folders:
        raise ConfigError("expected at least one folder of `wordcraft-kg bench run`.")
    marks: list[dict[str, Any]] = []
    lines: list[str] = []
    for folder in chain.from_iterable(map(submission.submissions_at, folders)):
        # A refused submission does not end the command: the others are still checked.
        try:
            checked = submission.verify(folder)
            mark = "replayed"
            if player is not None:
                from wordcraft_kg.apps.text_agents.benchmark_players import reproduce

                reproduce(folder, checked, player, timeout, weights)
                mark = "reproduced"
        except WordCraftKGError as error:
            marks.append({"folder": str(folder), "mark": "refused", "reason": str(error)})
            lines.append(f"refused  {error}")
            continue
        marks.append({"folder": str(folder), "mark": mark, "submission": checked})
        lines.append(f"{mark}  {submission.result_lines(checked)[0]}   {folder}")
    output.result({"submissions": marks}, lines)
    return 1 if any(entry["mark"] == "refused" for entry in marks) else 0
