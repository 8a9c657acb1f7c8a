"""``wordcraft-kg human-summary``."""

from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output, aligned

if TYPE_CHECKING:
    from wordcraft_kg.agents.human import AnswerRate, HumanSummary

EXAMPLES = ("wordcraft-kg human-summary human.jsonl", "wordcraft-kg human-summary one.jsonl two.jsonl --json")


def human_summary(*sessions: Path, output: Output = Output()) -> None:
    """Show how often people made the goal in the paper's protocol, with a 95% Wilson interval.

    Args:
        sessions: files written by `play --protocol paper`, with the same graph, split and settings.
    """
    from wordcraft_kg.agents.human import summarise

    view = summarise(sessions)
    output.result(view, _text(view))


def _text(view: "HumanSummary") -> list[str]:
    def figures(row: "AnswerRate") -> str:
        if row.interval is None:
            return "no answers"
        low, high = row.interval
        return f"{row.successes} of {row.answered} right, rate {row.rate:.3f} [{low:.3f}, {high:.3f}]"

    distractors = view.settings.get("num_distractors")
    first = f"{view.graph}, {distractors} distractors; sessions: {view.sessions}, finished: {view.finished}"
    return [first, *aligned((part, figures(row)) for part, row in view.parts.items())]
