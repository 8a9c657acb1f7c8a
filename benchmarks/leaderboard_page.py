"""The leaderboard: verify all submissions in a folder, and write a page with a table for each track.

    python benchmarks/leaderboard_page.py leaderboard/everyday-v3 --out docs/leaderboard.md [--check]

The folder has folders of `bench run`, or ZIP archives of their files, at any depth. With --check
nothing is written, and the script fails if the page would change.
"""

import argparse
import json
import re
import sys
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

from wordcraft_kg.apps.text_agents.benchmark import BOARD, read_manifest
from wordcraft_kg.apps.text_agents.benchmark_players import KINDS, reproduce
from wordcraft_kg.apps.text_agents.submission import (
    SUBMISSION_FILE,
    Submission,
    answers_text,
    metrics_text,
    read_submission_file,
    submissions_at,
    verify,
)
from wordcraft_kg.base.artefacts import output_target, write_atomically
from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.wording import counted, for_terminal

REFERENCES = {"oracle": "oracle", "random": "chance"}
"""Kinds of players that are lines of reference, without a rank, and their names above a table."""
_SMALL = "-lite"
"""Begins the ending of a track that is a smaller version of another."""
SENSIBLE = 0.98
"""Share of sensible recipes in the book `everyday`: 392 of 400, by the stricter of two readers
(data/everyday).
"""
# Declared names may not hold this sign, so no player can mark itself or another one.
_TWIN = "‡"
_HASH = 8
"""Shown characters of a hash."""
# All characters that begin a construct of Markdown inside a line or a table. The pipe ends a cell,
# even inside code. Some dialects turn bare addresses into links, so the colon of `http://` and the
# point of `example.org` are among them.
_MARKDOWN = re.compile(r"[\\`*_{}\[\]<>#|&~!$^@=]|(?<=[A-Za-z]):(?=//)|(?<=\w)\.(?=[^\W\d])")
# At the beginning of a line, these make a list, a rule, a heading or a definition.
_MARKDOWN_START = re.compile(r"^(\s*)([-+:]|\d+[.)])")


# Letters of other scripts, and digits, that look like a Latin letter in common fonts: the frequent
# part of the confusables of Unicode Technical Standard 39, after case folding. The scripts are
# Cyrillic, Greek, Armenian, Lisu (\ua4d0 and on) and Cherokee (\u13a0 and on).
_LOOKS_LIKE = {
    "a": "\u0430\u03b1\u0251\ua4ee\u13aa",
    "b": "\u0432\u044c\u03b2\ua4d0\u13cf\u13f4",
    "c": "\u0441\u03f2\ua4da\u13df",
    "d": "\u0501\ua4d3\u13a0\u13e7",
    "e": "\u0435\u0454\u03b5\ua4f0\u13ac",
    "f": "\ua4dd",
    "g": "\u0261\u0581\ua4d6\u13c0",
    "h": "\u043d\u04bb\u0570\ua4e7\u13bb\u13c2",
    "j": "\u0458\u03f3\ua4d9\u13ab",
    "k": "\u043a\u03ba\ua4d7\u13e6",
    "l": "1i|\u0456\u03b9\u0131\u04cf\u0269\u05d5\ua4f2\u13a5\ua4e1\u13de",
    "m": "\u043c\ua4df\u13b7",
    "n": "\u0578\u03b7\ua4e0",
    "o": "0\u043e\u03bf\u0585\u03c3\u0665\u06f5\ua4f3",
    "p": "\u0440\u03c1\ua4d1\u13e2",
    "q": "\u051b",
    "r": "\u0433\ua4e3\u13a1\u13d2",
    "s": "\u0455\ua4e2\u13d5\u13da",
    "t": "\u0442\u03c4\ua4d4\u13a2",
    "u": "\u057d\u03c5\u028b\ua4f4",
    "v": "\u03bd\u0475\ua4e6\u13d9",
    "w": "\u0461\u051d\ua4ea\u13b3\u13d4",
    "x": "\u0445\u03c7\ua4eb",
    "y": "\u0443\u03b3\u04af\ua4ec\u13a9\u13bd",
    "z": "\u03b6\ua4dc\u13c3",
}
_LATIN = {ord(char): letter for letter, chars in _LOOKS_LIKE.items() for char in chars}
# Greek capitals like a Latin capital whose small letters look like another letter, or like none.
_CAPITALS = str.maketrans("\u0397\u039c\u039d\u03a5", "HMNY")
# Letters with a hook or stroke, and Latin capitals in the size of small letters, in boxes or as the
# letters of flags.
_VARIANT = re.compile(
    "(?:LATIN (?:SMALL LETTER|LETTER SMALL CAPITAL)|NEGATIVE (?:CIRCLED|SQUARED) LATIN CAPITAL "
    "LETTER|REGIONAL INDICATOR SYMBOL LETTER) ([A-Z])(?: WITH .*)?"
)


def look_alike_key(name: str) -> str:
    r"""Return a key that names share if readers can hardly tell them apart.

    Compatibility forms, case, accents, blanks, kinds of dashes, small capitals, and letters of
    other scripts or digits in the place of Latin letters make no difference.

    Example:
        >>> look_alike_key("r\u0430nd0m") == look_alike_key("Random")
        True
    """
    # Decomposed twice: case folding may compose anew, and compatibility forms may hold capitals.
    latin = unicodedata.normalize("NFKD", name).translate(_CAPITALS)
    plain = unicodedata.normalize("NFKD", latin.casefold())
    letters = "".join(_letter(char) for char in plain).translate(_LATIN)
    # Two letters that look like one in most fonts.
    return letters.replace("rn", "m").replace("vv", "w")


def _letter(char: str) -> str:
    category = unicodedata.category(char)
    if category == "Pd" or char == "\u2212":  # dashes, and the minus sign
        return "-"
    if category.startswith(("M", "Z", "C")):  # accents, blanks, invisible characters
        return ""
    variant = _VARIANT.fullmatch(unicodedata.name(char, ""))
    return variant[1].lower() if variant else char


def for_markdown(text: str) -> str:
    """Return a text for a cell or a line of Markdown.

    No link, image, heading, code or further cell comes from it.

    Character references are used in place of backslashes, because all dialects show them as plain
    text, even in tables.

    Example:
        >>> for_markdown("[x](javascript:0) | a_b")
        '&#91;x&#93;(javascript:0) &#124; a&#95;b'
    """
    inline = _MARKDOWN.sub(_as_references, for_terminal(text))
    return _MARKDOWN_START.sub(lambda match: match[1] + _as_references(match[2]), inline)


def _as_references(match: re.Match[str] | str) -> str:
    marks = match if isinstance(match, str) else match[0]
    return "".join(mark if mark.isdigit() else f"&#{ord(mark)};" for mark in marks)


@dataclass(frozen=True)
class _Row:
    """A verified submission.

    Attributes:
        submission: the submission.
        mark: replayed or reproduced.
    """

    submission: Submission
    mark: str

    @property
    def answers_read(self) -> str:
        """Share of the answers that the grammar reads; empty for players without text."""
        return "" if self.submission.prompts == "none" else answers_text(self.submission)


def leaderboard_page(folder: Path) -> str:
    """Verify all submissions below a folder, and return the page with a table for each track.

    Submissions by players of this package are also reproduced.

    Raises:
        ArtefactError: if there is no submission, or one is refused.
        ConfigError: if a submission is of an unknown track, or declares a text with refused
            characters.
    """
    paths = submissions_at(folder)
    marked = [_marked(path) for path in steps("verifying submissions", paths)]
    return "\n".join(_lines(marked)) + "\n"


def _marked(path: Path) -> _Row:
    submission = verify(path)
    # A kind with an argument needs a model or a program, and to start a foreign program is no part
    # of making a page.
    if submission.kind not in KINDS or KINDS[submission.kind].argument:
        return _Row(submission, "replayed")
    reproduce(path, submission, submission.kind)
    return _Row(submission, "reproduced")


def _twins(marked: Sequence[_Row]) -> set[str]:
    """Return the names that readers could take for the name of another player on the page.

    A name is a twin if another spelling looks the same, if players of different kinds, or of one
    track with different weights, have this name, or if it stands twice in a track with the same
    offer of look-ups: with the same games, or with other games by the same prompts.
    """
    spellings = defaultdict[str, set[str]](set)
    kinds = defaultdict[str, set[str]](set)
    weights = defaultdict[tuple[str, str], set[str]](set)
    entries = Counter[tuple[str, ...]]()
    for row in marked:
        submission = row.submission
        key = look_alike_key(submission.player)
        spellings[key].add(submission.player)
        kinds[key].add(submission.kind)
        weights[key, submission.track].add(json.dumps(submission.weights, sort_keys=True))
        # Rows with and without look-ups are told apart.
        entries[key, submission.track, submission.knowledge, submission.games_hash] += 1
        entries[key, submission.track, submission.knowledge, submission.prompt_hash or ""] += 1
    # Equal weights on different tracks are one player; so weights are compared within a track.
    several = {key for key, different in (*spellings.items(), *kinds.items()) if len(different) > 1}
    several |= {key for (key, _), different in weights.items() if len(different) > 1}
    several |= {key for (key, *_), number in entries.items() if number > 1}
    names: set[str] = set()
    for key in several:
        names |= spellings[key]
    return names


def _lines(marked: Sequence[_Row]) -> Iterator[str]:
    # No time and no version of the package: the page depends on the submissions alone.
    manifest, manifest_hash = read_manifest()
    yield from (
        "# Leaderboard",
        "",
        f"Made by `benchmarks/leaderboard_page.py` from verified submissions to {manifest.name}",
    )
    yield (
        f"({manifest_hash[:12]}); see [Benchmark](benchmark.md). "
        "A bar shows the 95 % interval, a thin line chance; *answers read* is the share of a "
        "text player's answers that the grammar reads."
    )
    yield (
        f"† marks a success above {SENSIBLE:.0%}, the share of sensible recipes in the book: "
        "such a player knows the book, not only common sense."
    )
    yield "Click on a heading to sort."
    twins = _twins(marked)
    if twins:
        yield (
            f"{_TWIN} marks a name that another player on this page has too, one that looks the "
            "same, or one that stands twice in a track:"
        )
        yield "judge such rows by their other columns."
    heading = ""
    for track in manifest.names:
        on_track = [row for row in marked if row.submission.track == track]
        rows = sorted(on_track, key=lambda row: -row.submission.figures.mean)
        if not rows:
            continue
        full_track, is_small, _ = track.partition(_SMALL)
        if full_track != heading:
            yield from ("", f"## {full_track}")
            heading = full_track
        table = [*_references(rows, twins), *_table(rows, twins)]
        # A list, since a table of so many columns would scroll sideways on a phone.
        details = [line for row in rows for line in _details(row, twins)]
        if is_small:
            # One fold for all: a small track takes one line of the page.
            yield from ("", *_folded(_summary(track, rows), [*table, "", *details]))
        else:
            yield from ("", *table, "", *_folded(f"Details of {track}", details))
    yield from (
        "",
        "A submission cannot show that a person has played: see [Let people play](people.md).",
    )


def _folded(summary: str, lines: Sequence[str]) -> Iterator[str]:
    yield from ("<details markdown>", f"<summary>{summary}</summary>", "", *lines, "", "</details>")


def _summary(track: str, rows: Sequence[_Row]) -> str:
    """Return the title of a folded track, with its number of players and its best result."""
    ranked = [row for row in rows if row.submission.kind not in REFERENCES]
    if not ranked:
        return track
    return f"{track}: {counted(len(ranked), 'player')}, best {_value(ranked[0])}"


def _value(row: _Row) -> str:
    return metrics_text(row.submission.figures).partition(" [")[0]


def _references(rows: Sequence[_Row], twins: set[str]) -> Iterator[str]:
    """Yield the line above a table with the oracle and chance."""
    texts = [
        f"{about} {_value(row)} ({_player(row.submission, twins)}, {row.mark})"
        for kind, about in REFERENCES.items()
        for row in rows
        if row.submission.kind == kind
    ]
    if texts:
        yield from (f"Lines of reference: {'; '.join(texts)}.", "")


def _table(rows: Sequence[_Row], twins: set[str]) -> Iterator[str]:
    """Yield the lines of a track's table, best first; nothing without a ranked player.

    Equal results share a rank. Each bar also shows chance, as a thin line.
    """
    ranked = [row for row in rows if row.submission.kind not in REFERENCES]
    if not ranked:
        return
    is_open_ended = ranked[0].submission.figures.by_plan is None
    result = "known items" if is_open_ended else "success"
    titles = ["rank", "player", result, "by plan", "answers read", "mark"]
    ends = [row.submission.figures.ci_high for row in rows]
    scale_end = max(1.0, *ends)
    lines = []
    for row in rows:
        if row.submission.kind == "random":
            mean = row.submission.figures.mean
            lines.append(100 * mean / scale_end)
    means = [row.submission.figures.mean for row in ranked]
    table = []
    for row, mean in zip(ranked, means, strict=True):
        num_better = sum(value > mean for value in means)
        table.append([*_cells(row, twins, num_better + 1, scale_end, lines)])
    # A column without a single entry takes room and says nothing.
    is_shown = [any(column) for column in zip(*table, strict=True)]
    yield _row([*compress(titles, is_shown)])
    yield _row(["---"] * sum(is_shown))
    for cells in table:
        yield _row([*compress(cells, is_shown)])


def _cells(
    row: _Row, twins: set[str], rank: int, scale_end: float, lines: Sequence[float]
) -> Iterator[str]:
    """Yield the cells of a ranked row.

    Texts from the submission are escaped, because anyone may declare.

    Args:
        row: the submission.
        twins: names that need a mark.
        rank: its rank.
        scale_end: result at the right end of the bars.
        lines: places of the lines of reference on the bar, in percent of its width.
    """
    submission = row.submission
    figures = submission.figures
    yield str(rank)
    player = _player(submission, twins)
    yield player if submission.knowledge == "none" else f"{player}, look-ups"
    # Places on the bar, in percent of its width.
    places = [100 * end / scale_end for end in (figures.ci_low, figures.mean, figures.ci_high)]
    low, at, high = (f"{place:.1f}" for place in places)
    ticks = "".join(f'<i style="--at: {line:.1f}"></i>' for line in lines)
    bar = f'<span class="bar" style="--low: {low}; --at: {at}; --high: {high}">{ticks}</span>'
    yield f"{metrics_text(figures)} {bar}"
    yield "" if figures.by_plan is None else f"{figures.by_plan:.3f}"
    yield row.answers_read
    yield row.mark


def _player(submission: Submission, twins: set[str]) -> str:
    """Return the name of a player with its marks."""
    marks = []
    # Some recipes of the book are not sensible: who makes them all the same has seen the book.
    if submission.figures.by_plan is not None and submission.figures.mean > SENSIBLE:
        marks.append("†")
    if submission.player in twins:
        marks.append(_TWIN)
    return " ".join([for_markdown(submission.player), *marks])


def _details(row: _Row, twins: set[str]) -> Iterator[str]:
    """Yield a player and its declared facts as a list in a list; facts that it lacks are left out.

    Each fact has a line of its own, or a declared text could go on as another fact.
    """
    submission = row.submission
    hashes = [f"{name} {digest[:_HASH]}" for name, digest in submission.weights.items()]
    prompt_hash = submission.prompt_hash or ""
    look_ups = ""
    if submission.knowledge != "none":
        look_ups = f"{submission.look_ups:,} ({submission.knowledge})"
    costs = []
    if submission.tokens is not None:
        tokens = sum(submission.tokens.values())
        costs.append(f"{tokens:,} tokens")
    if submission.seconds is not None:
        costs.append(f"{submission.seconds:,.0f} s")
    if submission.price is not None:
        costs.append(f"${submission.price:,.2f}")
    facts = {
        "training data": for_markdown(submission.training_data),
        "weights": for_markdown(", ".join(hashes)),
        "prompts": f"{submission.prompts} {prompt_hash[:_HASH]}".strip(),
        "look-ups": look_ups,
        "answers read": row.answers_read,
        "cost": ", ".join(costs),
        "licence": for_markdown(submission.licence),
        "date": submission.date or "",
    }
    yield f"- {_player(submission, twins)}"
    for name, value in facts.items():
        if value:
            yield f"    - {name}: {value}"


def _row(cells: Iterator[str] | Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def board_text(folder: Path) -> str:
    """Return all rows with a rank as JSON, by track, the best first: `bench run` names the rank."""
    tracks: dict[str, list[dict[str, float | str]]] = defaultdict(list)
    for path in submissions_at(folder):
        submission = json.loads(read_submission_file(path, SUBMISSION_FILE))
        if submission["kind"] not in REFERENCES:
            mean = submission["figures"]["mean"]
            tracks[submission["track"]].append({"player": submission["player"], "success": mean})
    for rows in tracks.values():
        rows.sort(key=lambda row: (-row["success"], row["player"]))
    return json.dumps(tracks, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def write_leaderboard(folder: Path, out: Path, *, check: bool = False) -> None:
    """Write the page of a folder of submissions, or compare it with the file.

    Args:
        folder: folder with submissions, at any depth.
        out: Markdown page to write.
        check: write nothing.

    Raises:
        ArtefactError: if a submission is refused, or with ``check`` if the page would change.
    """
    # The page depends on the submissions alone, so that it can be compared in full.
    page = leaderboard_page(folder)
    if not check:
        write_atomically(output_target(out), page)
    elif not out.is_file() or out.read_text(encoding="utf-8") != page:
        raise ArtefactError(f"{out} is not up to date; omit --check.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    try:
        write_leaderboard(arguments.folder, arguments.out, check=arguments.check)
        if not arguments.check:
            write_atomically(BOARD, board_text(arguments.folder))
    except WordCraftKGError as error:
        sys.exit(str(error))
