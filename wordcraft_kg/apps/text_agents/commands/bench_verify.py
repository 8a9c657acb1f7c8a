"""``wordcraft-kg bench verify``."""

from itertools import chain
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.text_agents.settings import TIMEOUT
from wordcraft_kg.base.errors import ConfigError, WordCraftKGError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output

GROUP = "Text agents"
EXAMPLES = (
    "wordcraft-kg bench verify submission",
    "wordcraft-kg bench verify submission --player scorer:models/mine",
)


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
