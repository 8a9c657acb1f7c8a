"""The leaderboard: verified submissions by track, as a page in Markdown."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from wordcraft_kg.apps.text_agents.benchmark import read_manifest
from wordcraft_kg.apps.text_agents.benchmark_players import KINDS, reproduce
from wordcraft_kg.apps.text_agents.submission import (
    SUBMISSION_FILE,
    Submission,
    figures_text,
    verify,
)
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.evaluation.reference import literature

_TITLES = (
    "player",
    "figure",
    "by plan",
    "prompts",
    "look-ups",
    "training data",
    "cost",
    "licence",
    "mark",
    "date",
)
SENSIBLE = 0.98
"""Share of sensible recipes in the book `everyday`: 392 of 400, by the stricter of two readers (data/everyday)."""
_Marked = tuple[Submission, str]


def leaderboard_page(folder: Path) -> str:
    """Verify all submissions below a folder (else ArtefactError), reproduce some, and return the page."""
    paths = sorted(path.parent for path in folder.rglob(SUBMISSION_FILE))
    if not paths:
        raise ArtefactError(
            f"'{folder}' has no submission; expected folders of `wordcraft-kg bench run`."
        )
    marked = [_marked(path) for path in steps("verifying submissions", paths)]
    return "\n".join(_lines(marked)) + "\n"


def _marked(path: Path) -> _Marked:
    submission = verify(path)
    if submission.kind not in KINDS or KINDS[submission.kind].argument:
        return submission, "replayed"
    reproduce(path, submission, submission.kind)
    return submission, "reproduced"


def _lines(marked: Sequence[_Marked]) -> Iterator[str]:
    manifest, manifest_hash = read_manifest()
    yield from (
        "# Leaderboard",
        "",
        f"Made by `bench leaderboard` from verified submissions to {manifest.name}",
    )
    yield f"({manifest_hash[:12]}); see [Benchmark](benchmark.md). Figures: success, or known items if open-ended,"
    yield f"with 95 % intervals. † marks a success above {SENSIBLE:.0%}, the share of sensible recipes in the book:"
    yield "such a player knows the book, not only common sense."
    for track in manifest.names:
        rows = sorted(
            (one for one in marked if one[0].track == track), key=lambda one: -one[0].figures.mean
        )
        if rows:
            yield from ("", f"## {track}", "", _row(_TITLES), _row(["---"] * len(_TITLES)))
            yield from (_row(_cells(*one)) for one in rows)
    yield from ("", "## From the literature: other tasks, not comparable", "")
    yield from (
        f"- {row.player}: {row.in_words}. {row.reference}" for row in literature(["success"])
    )


def _cells(submission: Submission, mark: str) -> Iterator[str]:
    figures = submission.figures
    yield submission.player + " †" * (figures.by_plan is not None and figures.mean > SENSIBLE)
    yield figures_text(submission)
    yield "" if figures.by_plan is None else f"{figures.by_plan:.3f}"
    yield submission.prompts
    yield (
        ""
        if submission.knowledge == "none"
        else f"{submission.look_ups:,} ({submission.knowledge})"
    )
    yield submission.training_data
    tokens = "" if submission.tokens is None else f"{sum(submission.tokens.values()):,} tokens"
    price = "" if submission.price is None else f"${submission.price:,.2f}"
    yield ", ".join(part for part in (tokens, price) if part)
    yield submission.licence
    yield mark
    yield submission.date or ""


def _row(cells: Iterator[str] | Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/').replace('<', '&lt;') for cell in cells)} |"
