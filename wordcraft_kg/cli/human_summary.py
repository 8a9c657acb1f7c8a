"""``wordcraft-kg human-summary``."""

from pathlib import Path
from typing import Any

from wordcraft_kg.cli.console import Output, aligned

EXAMPLES = ("wordcraft-kg human-summary human.jsonl", "wordcraft-kg human-summary one.jsonl two.jsonl --json")


def human_summary(*sessions: Path, output: Output = Output()) -> None:
    """Show how often people made the goal in the paper's protocol, with a 95% Wilson interval.

    Args:
        sessions: files written by `play --protocol paper`, with equal graph, split and settings.
    """
    from wordcraft_kg.agents.human import summarise

    values = summarise(sessions)
    output.result(values, _text(values))


def _text(values: dict[str, Any]) -> list[str]:
    def figures(row: dict[str, Any]) -> str:
        if not row["answered"]:
            return "no answers"
        low, high = row["interval"]
        return f"{row['successes']} of {row['answered']} right, rate {row['rate']:.3f} [{low:.3f}, {high:.3f}]"

    distractors = values["settings"].get("num_distractors")
    first = (
        f"{values['graph']}, {distractors} distractors; sessions: {values['sessions']}, finished: {values['finished']}"
    )
    return [first, *aligned((part, figures(row)) for part, row in values["parts"].items())]
