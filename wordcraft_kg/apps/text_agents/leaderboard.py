"""The leaderboard: verified submissions by track, as a page in Markdown."""

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.apps.text_agents.benchmark import read_manifest
from wordcraft_kg.apps.text_agents.benchmark_players import KINDS, reproduce
from wordcraft_kg.apps.text_agents.submission import (
    Submission,
    answers_text,
    metrics_text,
    verified_games,
)
from wordcraft_kg.apps.text_agents.submission_files import submissions_below
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.escaping import for_markdown, look_alike_key
from wordcraft_kg.base.progress import steps
from wordcraft_kg.evaluation.reference import literature

_TITLES = ("rank", "player", "result", "by plan", "invalid", "words or weights", "mark")
_DETAILS = (
    "player",
    "prompts",
    "look-ups",
    "answers",
    "training data",
    "weights",
    "cost",
    "licence",
    "mark",
    "date",
)
REFERENCES = {"oracle", "random", "people"}
"""Kinds of players that are lines of reference in a table, without a rank."""
SENSIBLE = 0.98
"""Share of sensible recipes in the book `everyday`: 392 of 400, by the stricter of two readers
(data/everyday).
"""
# Declared names may not hold this sign, so no player can mark itself or another one.
_TWIN = "‡"


@dataclass(frozen=True)
class _Row:
    """A verified submission.

    Attributes:
        submission: the submission.
        mark: replayed or reproduced.
        answers: number and share of invalid answers as text; empty for players without text.
    """

    submission: Submission
    mark: str
    answers: str


def leaderboard_page(folder: Path) -> str:
    """Verify all submissions below a folder, and return the page with a table for each track.

    Submissions by players of this package are also reproduced.

    Raises:
        ArtefactError: if there is no submission, or one is refused.
    """
    paths = submissions_below(folder)
    if not paths:
        raise ArtefactError(
            f"'{folder}' has no submission; expected folders of `wordcraft-kg bench run`, or "
            "archives of them."
        )
    marked = [_marked(path) for path in steps("verifying submissions", paths)]
    return "\n".join(_lines(marked)) + "\n"


def _marked(path: Path) -> _Row:
    submission, lines = verified_games(path)
    answers = "" if submission.prompts == "none" else answers_text(lines)
    # A kind with an argument needs a model or a program, and to start a foreign program is no part
    # of making a page.
    if submission.kind not in KINDS or KINDS[submission.kind].argument:
        return _Row(submission, "replayed", answers)
    reproduce(path, submission, submission.kind)
    return _Row(submission, "reproduced", answers)


def _twins(marked: Sequence[_Row]) -> set[str]:
    """Return the names that readers could take for the name of another player on the page.

    A name is a twin if another spelling looks the same, or if players of different kinds, or of one
    track with different weights, have this name.
    """
    spellings = defaultdict[str, set[str]](set)
    kinds = defaultdict[str, set[str]](set)
    weights = defaultdict[tuple[str, str], set[str]](set)
    for row in marked:
        one = row.submission
        key = look_alike_key(one.player)
        spellings[key].add(one.player)
        kinds[key].add(one.kind)
        weights[key, one.track].add(json.dumps(one.weights, sort_keys=True))
    # Equal weights on different tracks are one player; so weights are compared within a track.
    several = {key for key, different in (*spellings.items(), *kinds.items()) if len(different) > 1}
    several |= {key for (key, _), different in weights.items() if len(different) > 1}
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
        f"Made by `bench leaderboard` from verified submissions to {manifest.name}",
    )
    yield (
        f"({manifest_hash[:12]}); see [Benchmark](benchmark.md). "
        "Results: success, or known items if open-ended,"
    )
    yield (
        f"with 95 % intervals. † marks a success above {SENSIBLE:.0%}, "
        "the share of sensible recipes in the book:"
    )
    yield "such a player knows the book, not only common sense."
    twins = _twins(marked)
    if twins:
        yield (
            f"{_TWIN} marks a name that another player on this page has too, "
            "or one that looks the same:"
        )
        yield "judge such rows by their other columns."
    for track in manifest.names:
        on_track = [one for one in marked if one.submission.track == track]
        rows = sorted(on_track, key=lambda one: -one.submission.figures.mean)
        if rows:
            yield from ("", f"## {track}", "")
            yield from _table(rows, twins)
            yield from ("", "<details markdown>", f"<summary>Details of {track}</summary>", "")
            yield from (_row(_DETAILS), _row(["---"] * len(_DETAILS)))
            yield from (_row(_details(one, twins)) for one in rows)
            yield from ("", "</details>")
    if not any(one.submission.kind == "people" for one in marked):
        yield from ("", "People: no games were submitted yet.")
    yield from ("", "## From the literature: other tasks, not comparable", "")
    yield from (
        f"- {row.player}: {row.in_words}. {row.reference}" for row in literature(["success"])
    )


def _table(rows: Sequence[_Row], twins: set[str]) -> Iterator[str]:
    """Yield the lines of a track's table, best first.

    The oracle, chance and people are lines of reference, without a rank. Equal results share one.
    """
    yield from (_row(_TITLES), _row(["---"] * len(_TITLES)))
    most = max(1.0, *(one.submission.figures.ci_high for one in rows))
    ranked = [one for one in rows if one.submission.kind not in REFERENCES]
    for one in rows:
        mean = one.submission.figures.mean
        better = sum(other.submission.figures.mean > mean for other in ranked)
        yield _row(_cells(one, twins, str(better + 1) if one in ranked else "–", most))


def _cells(row: _Row, twins: set[str], rank: str, most: float) -> Iterator[str]:
    """Yield the cells of a row; ``most`` is the right end of the bars.

    Texts from the submission are escaped, because anyone may declare.
    """
    submission = row.submission
    figures = submission.figures
    yield rank
    player = _player(submission, twins)
    if submission.knowledge != "none":
        player += ", look-ups"
    yield player if rank != "–" else f"*{player}*"
    ends = (f"{100 * end / most:.1f}" for end in (figures.ci_low, figures.mean, figures.ci_high))
    low, at, high = ends
    bar = f'<span class="bar" style="--low: {low}; --at: {at}; --high: {high}"></span>'
    yield f"{metrics_text(figures)} {bar}"
    yield "" if figures.by_plan is None else f"{figures.by_plan:.3f}"
    yield row.answers.partition("(")[2].removesuffix(")")
    words = re.search(r"(\w+) words$", submission.training_data)
    yield for_markdown(words[1] if words else ", ".join(submission.weights))
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
    """Yield the cells of a row with the declared facts."""
    submission = row.submission
    yield _player(submission, twins)
    yield submission.prompts
    if submission.knowledge == "none":
        yield ""
    else:
        yield f"{submission.look_ups:,} ({submission.knowledge})"
    yield row.answers
    yield for_markdown(submission.training_data)
    yield for_markdown(", ".join(submission.weights))
    tokens = "" if submission.tokens is None else f"{sum(submission.tokens.values()):,} tokens"
    price = "" if submission.price is None else f"${submission.price:,.2f}"
    yield ", ".join(part for part in (tokens, price) if part)
    yield for_markdown(submission.licence)
    yield row.mark
    yield submission.date or ""


def _row(cells: Iterator[str] | Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
