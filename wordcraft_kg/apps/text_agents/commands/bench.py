"""``wordcraft-kg bench list``, ``bench run`` and ``bench verify``."""

import hashlib
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import TIMEOUT, LookUps
from wordcraft_kg.base import (
    ConfigError,
    OutputExistsError,
    WordCraftKGError,
    check_output,
    counted,
    read_small_file,
    what_is,
)
from wordcraft_kg.base.artefacts import has_only_temporary
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import Force

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.benchmark_players import Entrant
    from wordcraft_kg.apps.text_agents.submission import Submission

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
    from wordcraft_kg.apps.text_agents.benchmark import read_manifest
    from wordcraft_kg.apps.text_agents.benchmark_players import KINDS

    manifest, manifest_hash = read_manifest()
    tracks = {
        name: {"about": track.about, "games": counted(len(track.tasks or track.orders), "game")}
        for name, track in manifest.tracks.items()
    }
    kinds = {kind.usage(name): kind.about for name, kind in KINDS.items()}

    def text() -> Iterator[str]:
        yield f"{manifest.name} of {manifest.date}, {manifest.licence}, {manifest_hash[:12]}"
        yield from aligned(
            [(f"  {name}", track["games"], track["about"]) for name, track in tracks.items()]
        )
        yield "add -lite for 100 tasks, or 100 attempts, and -made-up for made-up words"
        yield "players"
        yield from aligned([(f"  {name}", about) for name, about in kinds.items()])

    # Text names the endings once; programs get each full name.
    view = {
        "benchmark": manifest.name,
        "hash": manifest_hash,
        "date": manifest.date,
        "tracks": tracks,
    }
    output.result({**view, "names": manifest.names, "players": kinds}, text())


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
    from wordcraft_kg.apps.text_agents.benchmark import open_track, rank_text
    from wordcraft_kg.apps.text_agents.benchmark_players import RunSettings, enter
    from wordcraft_kg.apps.text_agents.records import GAMES_FILE
    from wordcraft_kg.apps.text_agents.results import continuable
    from wordcraft_kg.apps.text_agents.submission import MESSAGES, write_submission
    from wordcraft_kg.runs.run_folder import locked_folder

    # Everything that the user can mistype is checked before the games, which may take hours.
    messages = out / MESSAGES
    is_program = player.startswith(("program:", "openai:"))
    check_folder = partial(
        _check_folder, out, messages / GAMES_FILE, is_program=is_program, force=force
    )
    check_folder()
    declared = _Declared(name, training_data, licence, tokens, price)
    declared.check(weights)
    prompts_hash = None
    if prompts is not None:
        prompts_hash = hashlib.sha256(read_small_file(prompts)).hexdigest()
    benchmark_track = open_track(track)
    begin = time.perf_counter()
    with locked_folder(out, "written"):
        # Once more under the lock: another process may have played meanwhile.
        is_replacing = check_folder()
        with continuable(messages):
            settings = RunSettings(
                messages, look_ups, timeout, weights, is_replacing, base_url, parallel
            )
            kind, entrant = enter(benchmark_track, player, settings)
        if declared.tokens and entrant.tokens is not None:
            raise ConfigError(
                f"`tokens`: the log of '{player[:100]}' has its own numbers. Leave the option out."
            )
        seconds = round(time.perf_counter() - begin, 1)
        about = {
            "kind": kind,
            **declared.facts(entrant),
            **_prompts(entrant, prompts_hash),
            "seconds": seconds if measured else None,
            "date": time.strftime("%Y-%m-%d", time.gmtime()) if measured else None,
        }
        submission = write_submission(out, benchmark_track, entrant.games, look_ups, about)
        if not is_program:
            # A program's prompts and answers belong to the submission. Other players have none, so
            # a folder here is from the player of a submission that was replaced.
            shutil.rmtree(messages, ignore_errors=True)
    rank = rank_text(benchmark_track.name, submission.figures.mean)
    view = {"out": str(out), "submission": submission, "rank": rank}
    lines = [*_shown(submission), *filter(None, [rank])]
    output.result(view, [*lines, f"wrote {out}/   next: wordcraft-kg bench verify {out}"])


def _check_folder(out: Path, games: Path, *, is_program: bool, force: bool) -> bool:
    """Check that a submission may be written, or continued, in a folder.

    Args:
        out: folder of the submission.
        games: file with a program's games, perhaps of an interrupted run.
        is_program: whether a program plays: only a program's games can be continued.
        force: whether the user allows that an earlier submission is replaced.

    Returns:
        Whether earlier games are replaced at the end.

    Raises:
        OutputExistsError: if the folder has other files, or a submission without ``force``.
    """
    from wordcraft_kg.apps.text_agents.submission import SUBMISSION_FILE

    is_finished = (out / SUBMISSION_FILE).exists()
    has_games = games.is_file()
    is_continued = is_program and has_games and not is_finished
    is_free = out.is_dir() and has_only_temporary(out)
    if not is_continued and not is_free:
        check_output(out, force=force)
        # Even --force replaces submissions only, never a folder that happens to have this name.
        if out.is_dir() and not is_finished and any(out.iterdir()):
            raise OutputExistsError(
                f"'{out}' {what_is(out)}, not a submission. Choose another `out`."
            )
    return force and (is_finished or has_games)


@dataclass(frozen=True)
class _Declared:
    """What the user declares about a player; None where nothing is declared.

    Attributes:
        name: name in tables.
        training_data: data on which the player was trained.
        licence: licence of the player or its weights.
        tokens: numbers of input and output tokens.
        price: price of the evaluation in US dollars.
    """

    name: str | None
    training_data: str | None
    licence: str | None
    tokens: tuple[int, int] | None
    price: float | None

    def check(self, weights: Path | None) -> None:
        """Raise a ConfigError for a text or a number that a submission may not hold.

        ``weights`` is the file with the player's weights, whose name becomes part of the
        submission.
        """
        from wordcraft_kg.apps.text_agents.submission import (
            LONGEST_NAME,
            LONGEST_TEXT,
            MOST_DOLLARS,
            MOST_TOKENS,
            check_declared,
        )
        from wordcraft_kg.base.settings import number_in

        for option, text, limit in (
            ("name", self.name, LONGEST_NAME),
            ("training_data", self.training_data, LONGEST_TEXT),
            ("licence", self.licence, LONGEST_NAME),
            ("weights", None if weights is None else weights.name, LONGEST_TEXT),
        ):
            if text is not None:
                check_declared(option, text, limit)
        numbers = f"two numbers of tokens, 0 to {MOST_TOKENS:,}"
        for number in self.tokens or ():
            number_in("tokens", number, 0, MOST_TOKENS, numbers)
        if self.price is not None:
            number_in("price", self.price, 0, MOST_DOLLARS, f"US dollars, 0 to {MOST_DOLLARS:,}")

    def facts(self, entrant: "Entrant") -> dict[str, Any]:
        """Return fields of the submission: as declared, else as the player's folder says."""
        from wordcraft_kg.apps.text_agents.submission import LONGEST_NAME, acceptable

        tokens = entrant.tokens
        if tokens is None and self.tokens is not None:
            tokens = dict(zip(("input", "output"), self.tokens, strict=True))
        return {
            "player": self.name or acceptable(entrant.name, LONGEST_NAME),
            "weights": dict(entrant.weights),
            "training_data": self.training_data or acceptable(entrant.training_data),
            "tokens": None if tokens is None else dict(tokens),
            "price": self.price,
            "licence": self.licence or acceptable(entrant.licence, LONGEST_NAME),
        }


def _prompts(entrant: "Entrant", declared_hash: str | None) -> dict[str, Any]:
    """Return the submission's fields about prompts.

    Args:
        entrant: the player.
        declared_hash: hash of the user's own prompts; None without any.
    """
    from wordcraft_kg.apps.text_agents.benchmark import read_manifest

    prompt_hash = entrant.prompt_hash
    standard = read_manifest()[0].prompts.values()
    if declared_hash is not None or (prompt_hash is not None and prompt_hash not in standard):
        kind = "custom"
    elif prompt_hash is None:
        kind = "none"
    else:
        kind = "standard"
    return {"prompts": kind, "prompt_hash": declared_hash or prompt_hash}


def _shown(submission: "Submission") -> list[str]:
    """Return the result as lines of text."""
    from wordcraft_kg.apps.text_agents.submission import answers_text, metrics_text

    games = counted(submission.figures.games, "game")
    result = (
        f"{submission.track}  {submission.player}  {metrics_text(submission.figures)} over {games}"
    )
    if submission.prompts == "none":
        return [result]
    lost = counted(submission.lost_attempts, "attempt")
    return [result, f"answers read  {answers_text(submission)}, {lost} lost"]


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
    from wordcraft_kg.apps.text_agents.submission import metrics_text, submissions_at, verify

    if not folders:
        raise ConfigError("expected at least one folder of `wordcraft-kg bench run`.")
    marks: list[dict[str, Any]] = []
    lines = []
    for folder in chain.from_iterable(map(submissions_at, folders)):
        # A refused submission does not end the command: the others are still checked.
        try:
            checked = verify(folder)
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
        games = counted(checked.figures.games, "game")
        result = f"{metrics_text(checked.figures)} over {games}"
        lines.append(f"{mark}  {checked.track}  {checked.player}  {result}   {folder}")
    output.result({"submissions": marks}, lines)
    return 1 if any(entry["mark"] == "refused" for entry in marks) else 0
