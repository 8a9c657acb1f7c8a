"""Submissions to the benchmark: a folder with ``submission.json`` and all games.

Anyone may send one, so nothing in it is trusted: verification plays all games again by the rules,
computes all results again, and compares bytes. Both files are canonical: the same games give the
same bytes. What a player declares about itself cannot be verified; it may only be a harmless line.

The files lie in a folder, or in a ZIP archive with the two files of one submission or a folder for
each of several. A submission in an archive has the path of the archive and of its folder there,
such as ``craft-8.zip/votes``; other members have no effect.
"""

import hashlib
import json
import os
import re
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from wordcraft_kg.apps.text_agents.benchmark import Track, open_track, read_manifest
from wordcraft_kg.apps.text_agents.games import Picks, TaskGame
from wordcraft_kg.apps.text_agents.plays import Play
from wordcraft_kg.apps.text_agents.results import GAMES_FILE, GameRecord, mean_known
from wordcraft_kg.apps.text_agents.settings import LookUps
from wordcraft_kg.base import (
    TEMPORARY,
    ArtefactError,
    ConfigError,
    Count,
    EpisodeError,
    Hash,
    OutputExistsError,
    Record,
    Share,
    as_lines,
    as_values,
    check_output,
    counted,
    dump_json,
    made_folder,
    parse_record,
    read_small_file,
    refuse,
    what_is,
    write_atomically,
)
from wordcraft_kg.base.artefacts import SMALL_FILE, ZipArchive, has_only_temporary
from wordcraft_kg.base.settings import one_line
from wordcraft_kg.base.statistics import student_interval, task_bootstrap

MESSAGES = "messages"
"""Folder in a submission with a text player's prompts and answers, which verification ignores."""
_MOST_SHOWN = 300
"""Characters of a wrong value in an error."""
SCHEMA = Path(__file__).parent / "data" / "submission.schema.json"
# Processors may differ in the last bits of a mean, and verification compares bytes.
_DIGITS = 6
# Declared numbers are shown in tables: the limits keep nonsense out, and columns narrow.
MOST_DOLLARS = 1_000_000
MOST_TOKENS = 10**12
MOST_INVALID = 1_000_000
"""Invalid answers in a game.

They cost nothing on an MCP server, so no rule of the game limits them.
"""
_Amount = Annotated[float, msgspec.Meta(ge=0, le=1e9)]
_Dollars = Annotated[float, msgspec.Meta(ge=0, le=MOST_DOLLARS)]
_Tokens = Annotated[int, msgspec.Meta(ge=0, le=MOST_TOKENS)]
LONGEST_NAME = 100
LONGEST_TEXT = 500
LONGEST_FILE_NAME = 255
# Declared texts are letters and digits of any script, with common punctuation. Refused are
# characters that mark up text or columns (angle brackets, bars, backquotes, backslashes), addresses
# of mail, control and invisible characters, and the page's own daggers.
_REFUSED = (
    "\\u0000-\\u001f\\u007f-\\u00a0\\u00ad\\u034f\\u061c\\u115f\\u1160\\u1680\\u17b4\\u17b5"
    "\\u180e\\u2000-\\u200f\\u2020\\u2021\\u2028-\\u202f\\u205f-\\u206f\\u2800\\u3000\\u3164"
    "\\ufe00-\\ufe0f\\ufeff\\uffa0\\ufff9-\\uffff<>|`\\\\@"
)
_PATTERN = f"^[^{_REFUSED}]+$"
# The pattern is for other programs: here, `check_declared` refuses the same texts in words.
_SHOWN: Any = {"pattern": _PATTERN}
_Name = Annotated[
    str, msgspec.Meta(min_length=1, max_length=LONGEST_NAME, extra_json_schema=_SHOWN)
]
_Text = Annotated[
    str, msgspec.Meta(min_length=1, max_length=LONGEST_TEXT, extra_json_schema=_SHOWN)
]
_FileName = Annotated[
    str, msgspec.Meta(min_length=1, max_length=LONGEST_FILE_NAME, extra_json_schema=_SHOWN)
]
_Date = Annotated[
    str,
    msgspec.Meta(pattern="^[0-9]{4}-[0-9]{2}-[0-9]{2}$", max_length=10, description="ISO 8601"),
]
# A page or a viewer may turn an address into a link, and a link may run code or open a program.
_SCHEME = re.compile(r"([a-z][a-z0-9+.-]*)\s*:\s*//", re.IGNORECASE)
_CODE = re.compile(r"\b(?:javascript|vbscript)\s*:|\bdata\s*:\s*\w+/", re.IGNORECASE)
_VARIATION = re.compile("[\u180b-\u180d\u180f\U000e0100-\U000e01ef]")
"""Selectors of variants, which show nothing; the pattern of the schema has the others."""
_STACKED = re.compile(r"[\u0300-\u036f\u0483-\u0489\u1ab0-\u1aff\u1dc0-\u1dff\u20d0-\u20ff]{3}")
"""Three accents in a row: they cover the lines above and below."""


class GameLine(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A game: a line in ``games.jsonl``.

    Attributes:
        number: number of the game in the track, from 0.
        goal: label of the entity to make; None in open-ended games.
        pairs: labels of the combined pairs in turn; None for an attempt lost by invalid answers.
        made: for each attempt, the labels of the new entities.
        success: whether the goal was made; None in open-ended games.
        by_plan: whether a plan's last pair made the goal; None in open-ended games.
        known: number of known entities at the end of an open-ended game; None for tasks.
        look_ups: number of entities that were looked up.
        invalid_actions: number of invalid answers.
        ended: whether the game ended with attempts left and without success.
    """

    number: Count
    goal: str | None = None
    pairs: tuple[Picks | None, ...]
    made: tuple[tuple[str, ...], ...]
    success: bool | None = None
    by_plan: bool | None = None
    known: Count | None = None
    look_ups: Count = 0
    invalid_actions: Count = 0
    ended: bool = False


class TrackMetrics(Record, frozen=True, kw_only=True):
    """Results over all games, rounded to six digits.

    Attributes:
        games: number of games.
        mean: share of made goals, or mean number of known entities after the last attempt.
        ci_low: lower end of the 95 % interval: a bootstrap over the groups of tasks that the
            track's split holds out together, or Student's t over open-ended games.
        ci_high: upper end of this interval.
        by_plan: share of goals made by a plan's last pair; None in open-ended games.
        known: mean number of known entities by attempts; empty for tasks.
    """

    games: Count
    mean: _Amount
    ci_low: _Amount
    ci_high: _Amount
    by_plan: Share | None
    known: dict[Count, _Amount]


class Submission(Record, frozen=True, kw_only=True):
    """A submission (``submission.json``).

    Attributes:
        format: format of the file.
        benchmark: name and version of the benchmark.
        benchmark_hash: SHA-256 of the benchmark's manifest file.
        scoring: version of the rules of scoring.
        track: name of the track, such as ``craft-8-lite``.
        graph_hash: content hash of the book's graph.
        player: the player's name in tables.
        kind: kind of the player, such as ``program``.
        weights: SHA-256 of the weights by file or model name; empty without weights.
        prompts: standard prompts of this package, custom prompts, or none for players without text.
        prompt_hash: hash of the prompts; null for players without text.
        training_data: data on which the player was trained, as declared.
        knowledge: offered look-ups: none, or partial (the train recipes).
        tokens: number of tokens by kind; null if unknown.
        price: price of the evaluation in US dollars; null if unknown.
        seconds: duration; null unless asked for, so that the same player writes the same file.
        date: day of the evaluation, such as 2026-11-23; null unless asked for.
        licence: licence of the player or its weights, as declared.
        look_ups: number of look-ups over all games.
        invalid_actions: number of invalid answers over all games.
        answers_read: share of the answers that the grammar reads, pairs and look-ups; null without
            an answer.
        lost_attempts: number of attempts lost by invalid answers over all games.
        figures: results over all games.
        games_hash: SHA-256 of the file with the games.
    """

    format: Literal["wordcraft-kg submission 2"] = "wordcraft-kg submission 2"
    benchmark: str
    benchmark_hash: Hash
    scoring: Count
    track: str
    graph_hash: Hash
    player: _Name
    kind: _Name
    weights: Annotated[dict[_FileName, Hash], msgspec.Meta(max_length=100)]
    prompts: Literal["none", "standard", "custom"]
    prompt_hash: Hash | None
    training_data: _Text
    knowledge: LookUps
    tokens: Annotated[dict[_Name, _Tokens], msgspec.Meta(max_length=10)] | None
    price: _Dollars | None
    seconds: _Amount | None
    date: _Date | None
    licence: _Name
    look_ups: Count
    invalid_actions: Count
    answers_read: Share | None
    lost_attempts: Count
    figures: TrackMetrics
    games_hash: Hash


def replay(play: Play, number: int, played: GameRecord | GameLine) -> GameLine:
    """Play a game again by the rules.

    Args:
        play: the games of the track.
        number: number of the game in the track, from 0.
        played: a game, of which only the player's decisions count: pairs, look-ups, and the number
            of invalid answers.

    Returns:
        The game's line, with the results that the rules give.

    Raises:
        EpisodeError: for decisions against the rules.
    """
    # On tasks each game is another task with the first table; open-ended games are runs in one
    # world, told apart by the seed alone.
    task, seed = (0, number) if play.settings.is_open_ended else (number, 0)
    game = play.game(task, seed)
    new_labels: list[tuple[str, ...]] = []
    for attempt, pair in enumerate(played.pairs, 1):
        before = game.labels
        if game.is_over:
            raise EpisodeError(f"attempt {attempt} comes after the end of the game")
        if pair is None:
            game.lose_attempt()
        else:
            for label in pair:
                if label not in before:
                    raise EpisodeError(
                        f"attempt {attempt} combines '{label[:100]}', which is not on the table"
                    )
            game.combine(*map(before.index, pair))
        # New entities take the next places behind those at hand.
        new_labels.append(game.labels[len(before) :])
    _check_counts(play, played)
    outcome: dict[str, Any] = {"known": len(game.labels)}
    if isinstance(game, TaskGame):
        outcome = {"goal": game.goal, "success": game.is_made, "by_plan": game.by_plan}
    return GameLine(
        number=number,
        pairs=tuple(played.pairs),
        made=tuple(new_labels),
        look_ups=played.look_ups,
        invalid_actions=played.invalid_actions,
        ended=not game.is_over,
        **outcome,
    )


def _check_counts(play: Play, played: GameRecord | GameLine) -> None:
    """Raise an EpisodeError for counts that the decisions make impossible.

    The messages are not part of a submission, so only bounds can be checked.
    """
    max_look_ups = play.settings.look_ups
    if played.look_ups > max_look_ups:
        raise EpisodeError(
            f"the game has {counted(played.look_ups, 'look-up')}; expected at most {max_look_ups}"
        )
    lost = list(played.pairs).count(None)
    # Invalid answers that cost an attempt.
    answers_per_attempt = play.settings.max_invalid + 1
    if played.invalid_actions < lost * answers_per_attempt:
        invalid = counted(played.invalid_actions, "invalid answer")
        raise EpisodeError(
            f"{counted(lost, 'attempt')} were lost with {invalid}; expected {answers_per_attempt} "
            "or more for each"
        )
    if played.invalid_actions > MOST_INVALID:
        raise EpisodeError(
            f"the game has {counted(played.invalid_actions, 'invalid answer')}; "
            f"expected at most {MOST_INVALID:,}"
        )


def metrics_text(figures: TrackMetrics) -> str:
    """Return the mean with its interval as text, such as ``0.360 [0.270, 0.450]``."""
    digits = 3 if figures.by_plan is not None else 1
    mean, low, high = (
        f"{value:.{digits}f}" for value in (figures.mean, figures.ci_low, figures.ci_high)
    )
    return f"{mean} [{low}, {high}]"


def answers_text(submission: Submission) -> str:
    """Return the share of a player's answers that the grammar reads, such as ``75.0%``."""
    share = submission.answers_read
    return "none" if share is None else f"{share:.1%}"


def result_lines(submission: Submission) -> list[str]:
    """Return the result of a submission as lines of text."""
    games = counted(submission.figures.games, "game")
    result = (
        f"{submission.track}  {submission.player}  {metrics_text(submission.figures)} over {games}"
    )
    if submission.prompts == "none":
        return [result]
    lost = counted(submission.lost_attempts, "attempt")
    return [result, f"answers read  {answers_text(submission)}, {lost} lost"]


def metrics_of(track: Track, lines: Sequence[GameLine]) -> TrackMetrics:
    """Return the results over all games of a track.

    Args:
        track: the track of the benchmark.
        lines: all games of the track, one for each task and attempt, or run of an open-ended track.

    Returns:
        mean success rate, or mean number of known entities, with its 95 % interval.
    """
    known_by_mark: dict[int, float] = {}
    by_plan = None
    if track.is_open_ended:
        base = len(track.frozen.orders[0])
        curves = [np.cumsum([base, *map(len, line.made)]).tolist() for line in lines]
        known_by_mark = {
            mark: _rounded(mean) for mark, mean in mean_known(curves, track.frozen.attempts).items()
        }
        final = [curve[-1] for curve in curves]
        mean = float(np.mean(final))
        interval = student_interval(final, within=(0, track.opened.graph.num_entities))
    else:
        success = np.array([bool(line.success) for line in lines])
        mean = float(success.mean())
        interval = task_bootstrap(success[:, None], track.world.groups)
        by_plan = _rounded(np.mean([bool(line.by_plan) for line in lines]))
    low, high = interval or (mean, mean)
    return TrackMetrics(
        games=len(lines),
        mean=_rounded(mean),
        ci_low=_rounded(low),
        ci_high=_rounded(high),
        by_plan=by_plan,
        known=known_by_mark,
    )


def _rounded(value: float | np.floating) -> float:
    return round(float(value), _DIGITS)


def check_folder(out: Path, games: Path, *, is_program: bool, force: bool) -> bool:
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


def write_submission(
    folder: Path,
    track: Track,
    games: Sequence[GameRecord],
    knowledge: LookUps,
    about: Mapping[str, Any],
) -> Submission:
    """Write a submission with its games, and return the record of ``submission.json``.

    An earlier submission is replaced at the end.

    Args:
        folder: folder to write, perhaps with an earlier submission.
        track: the track that was played.
        games: decisions in all games, in the order of the track.
        knowledge: offered look-ups.
        about: remaining fields of the :class:`Submission` about the player.

    Raises:
        EpisodeError: for decisions against the rules; nothing is written.
        ArtefactError: for facts outside the schema; nothing is written.
        ConfigError: for a declared text with refused characters, or other look-ups; nothing is
            written.
    """
    play = track.play(knowledge)
    lines = [replay(play, number, played) for number, played in enumerate(games)]
    text = "".join(as_lines(lines)).encode()
    manifest, manifest_hash = read_manifest()
    submission = Submission(
        benchmark=manifest.name,
        benchmark_hash=manifest_hash,
        scoring=manifest.scoring,
        track=track.name,
        knowledge=knowledge,
        **_totals(track, lines, text),
        **about,
    )
    # Everything is complete and checked before an earlier submission is replaced.
    dumped = dump_json(as_values(submission))
    _check_versions(folder, parse_record(dumped.encode(), Submission, folder / SUBMISSION_FILE))
    with made_folder(folder), TemporaryDirectory(TEMPORARY, ".", folder) as staging:
        files: dict[str, str | bytes] = {GAMES_FILE: text, SUBMISSION_FILE: dumped}
        for name, content in files.items():
            write_atomically(Path(staging) / name, content)
        # Both are written before one is replaced. Between the two renames, `games_hash` of an
        # earlier submission does not fit, and verification refuses it.
        for name in files:
            os.replace(Path(staging) / name, folder / name)
    return submission


def _totals(track: Track, lines: Sequence[GameLine], games: bytes) -> dict[str, Any]:
    lost = sum(line.pairs.count(None) for line in lines)
    look_ups = sum(line.look_ups for line in lines)
    invalid = sum(line.invalid_actions for line in lines)
    answers = sum(len(line.pairs) for line in lines) - lost + look_ups
    return {
        "graph_hash": track.opened.graph.hash,
        "look_ups": look_ups,
        "invalid_actions": invalid,
        "answers_read": _rounded(answers / (answers + invalid)) if answers + invalid else None,
        "lost_attempts": lost,
        "figures": metrics_of(track, lines),
        "games_hash": hashlib.sha256(games).hexdigest(),
    }


def verify(folder: Path) -> Submission:
    """Play a submission again, compare every byte and result, and return it.

    Raises:
        ArtefactError: if a file is missing, damaged or edited, or if a result differs from what
            replaying the games gives; the message names the first difference.
        ConfigError: for an unknown track, or a declared text with refused characters.
    """
    # The path is for messages: an archive is no folder, but reads like one.
    path = folder / SUBMISSION_FILE
    data = read_submission_file(folder, SUBMISSION_FILE)
    submission = parse_record(data, Submission, path)
    _check_versions(path, submission)
    track = open_track(submission.track)
    games = read_submission_file(folder, GAMES_FILE)
    lines = _replayed(games, folder / GAMES_FILE, track, track.play(submission.knowledge))
    for name, value in _totals(track, lines, games).items():
        declared = getattr(submission, name)
        if declared != value:
            raise _refused(
                path, name, json.dumps(as_values(declared)), json.dumps(as_values(value))
            )
    # The same values in another form, such as other blanks, would have another hash.
    if dump_json(as_values(submission)).encode() != data:
        raise ArtefactError(f"{path} was edited: expected the form in which `bench run` writes it.")
    return submission


def check_declared(name: str, text: str, longest: int = LONGEST_TEXT) -> None:
    """Check that a declared text is a line of letters, digits and common punctuation.

    Submissions are shown in terminals, on pages and in tables, and anyone may send one: a text must
    not mark up a page, hide characters, overwrite neighbouring lines, or hold a link that runs
    code.

    Args:
        name: the setting, for the message.
        text: the declared text; addresses in it begin with http or https.
        longest: largest number of characters.

    Raises:
        ConfigError: for another text.
    """
    one_line(name, text, longest)
    if not re.match(_PATTERN, text) or _VARIATION.search(text):
        raise refuse(name, text, r"a text without < > | ` \ @ and invisible characters")
    # Decomposed, a letter with an accent is two characters, so that all accents count.
    if _STACKED.search(unicodedata.normalize("NFD", text)):
        raise refuse(name, text, "at most two accents on a letter")
    schemes = {match[1].casefold() for match in _SCHEME.finditer(text)}
    if _CODE.search(text) or schemes - {"http", "https"}:
        raise refuse(name, text, "addresses with http or https only")


def acceptable(text: str, longest: int = LONGEST_TEXT) -> str:
    """Return a text that passes :func:`check_declared`.

    A dash is in the place of refused characters; if this is not enough, the text is "not declared".
    A player's own name and folder give such texts, and must not stop a long evaluation at its end.
    """
    plain = re.sub(f"[{_REFUSED}]", "-", text).strip()[:longest]
    try:
        check_declared("text", plain, longest)
    except ConfigError:
        return "not declared"
    return plain


def _check_versions(path: Path, submission: Submission) -> None:
    """Check versions and declarations; raises ArtefactError or ConfigError for the first fault."""
    manifest, manifest_hash = read_manifest()
    versions = {
        "benchmark": manifest.name,
        "benchmark_hash": manifest_hash,
        "scoring": manifest.scoring,
    }
    for name, value in versions.items():
        if getattr(submission, name) != value:
            raise _refused(path, name, getattr(submission, name), value)
    # Nobody could verify who played: answers of people are in the folder of `people serve`, which
    # checks them, and in `people summary`.
    # No letters of other scripts, digits or signs may write "people" either.
    plain = submission.kind.casefold().translate(str.maketrans("01i|", "olll"))
    if not plain.isascii() or "people" in re.sub("[^a-z]", "", plain):
        expected = (
            "the kind of a program or model in ASCII, since a submission cannot show who played"
        )
        raise _refused(path, "kind", submission.kind, expected, "give the folder of `people serve`")
    for name in ("player", "kind", "training_data", "licence"):
        check_declared(f"{path}: {name}", getattr(submission, name))
    for key in (*submission.weights, *(submission.tokens or ())):
        check_declared(f"{path}: a name in weights or tokens", key)
    standard = manifest.prompts.values()
    prompt_hash = submission.prompt_hash
    if submission.prompts == "standard" and prompt_hash not in standard:
        raise _refused(
            path, "prompt_hash", prompt_hash, " or ".join(standard), "declare custom prompts"
        )
    if (submission.prompts == "none") != (prompt_hash is None):
        expected = "none without a 'prompt_hash', else standard or custom"
        raise _refused(path, "prompts", submission.prompts, expected)


def _refused(
    path: Path, name: str, value: object, expected: object, remedy: str = "play the track again"
) -> Exception:
    # A file from outside may hold values of any length.
    shown = str(value)[:_MOST_SHOWN]
    return ArtefactError(f"{path}: '{name}' is {shown}; expected {expected}. Please {remedy}.")


def _replayed(data: bytes, path: Path, track: Track, play: Play) -> list[GameLine]:
    """Replay the games of a track.

    Args:
        data: content of the file with the games.
        path: its path, for errors.
        track: the track.
        play: the games of the track, with the look-ups that were offered.

    Returns:
        a line for each game, in the order of the track.

    Raises:
        ArtefactError: for a damaged file, a missing or needless game, or a line that differs from
            the replay; the message names the first such line.
    """
    # Counted before they are split: a file of line breaks would take eight times its size.
    num_lines = data.count(b"\n")
    if num_lines != len(track) or not data.endswith(b"\n"):
        raise ArtefactError(
            f"{path}: {num_lines:,} games, a line each; expected {len(track)}. Play all games of "
            f"{track.name}."
        )
    lines = []
    for number, text in enumerate(data.split(b"\n")[:-1]):
        place = f"{path}, line {number + 1}"
        line = parse_record(text, GameLine, f"{place},")
        if line.number != number:
            raise ArtefactError(
                f"{place}: game {line.number}; expected game {number}. Play the track again."
            )
        try:
            expected = replay(play, number, line)
        except EpisodeError as error:
            raise ArtefactError(f"{place}: {error}. Play the track again.") from None
        expected_line = as_lines([expected])[0]
        if expected_line.encode() != text + b"\n":
            raise ArtefactError(
                f"{place}: the replay gives {expected_line.strip()[:200]}. Play the track again."
            )
        lines.append(line)
    return lines


SUBMISSION_FILE = "submission.json"
ARCHIVE = ".zip"
"""Ending of an archive; ``python -m zipfile -c ARCHIVE FILES`` makes one."""


def submissions_at(path: Path) -> list[Path]:
    """Return the submissions at a path, in folders and archives at any depth, in order.

    Args:
        path: a folder or an archive; a folder without a submission and a damaged archive are
            returned as they are, so that reading them says what is wrong.
    """
    folders = [file.parent for file in path.rglob(SUBMISSION_FILE)]
    for archive in (path, *path.rglob(f"*{ARCHIVE}")):
        if archive.suffix == ARCHIVE and archive.is_file():
            folders += _in_archive(archive)
    return sorted(folders) or [path]


def read_submission_file(submission: Path, name: str) -> bytes:
    """Return the bytes of a file of a submission.

    Args:
        submission: a folder, an archive, or a folder in an archive.
        name: :data:`SUBMISSION_FILE` or
            :data:`~wordcraft_kg.apps.text_agents.results.GAMES_FILE`.

    Raises:
        ArtefactError: if the file is missing, too large or damaged.
    """
    paths = (submission, *submission.parents)
    # The archive that the path names or goes into; None outside of archives.
    path = next((path for path in paths if path.suffix == ARCHIVE and path.is_file()), None)
    if path is None:
        return read_small_file(submission / name)
    archive = ZipArchive(path, read_small_file(path))
    member = (submission.relative_to(path) / name).as_posix()
    if member not in archive.members:
        raise ArtefactError(
            f"{submission} has no {name}; expected the files {SUBMISSION_FILE} and {GAMES_FILE} of "
            f"`wordcraft-kg bench run`, or one of several folders with them, as in "
            f"{path.name}/NAME."
        )
    return archive.read(member, SMALL_FILE)


def _in_archive(archive: Path) -> list[Path]:
    """Return the paths of an archive's submissions; the archive itself if it has or shows none."""
    try:
        members = map(PurePosixPath, ZipArchive(archive, read_small_file(archive)).members)
    except ArtefactError:
        return [archive]
    folders = [archive / member.parent for member in members if member.name == SUBMISSION_FILE]
    return folders or [archive]
