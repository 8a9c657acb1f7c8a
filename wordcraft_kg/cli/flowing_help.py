"""Help texts as paragraphs, wrapped to the width of the terminal."""

from typing import Any

from cyclopts.help import DefaultFormatter, InlineText


class FlowingHelp(DefaultFormatter):
    """Help formatter that joins the lines of docstrings; blank lines and command lines stay."""

    def __call__(self, console: Any, options: Any, panel: Any) -> None:
        """Show a panel with commands or options; positional arguments are shown without an option name."""
        for entry in panel.entries:
            _flow(entry.description)
        entries = [entry.copy(positive_names=()) if entry.positional_label else entry for entry in panel.entries]
        super().__call__(console, options, panel.copy(entries=entries))

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Print a command's description."""
        _flow(description)
        super().render_description(console, options, description)


def _flow(shown: Any) -> None:
    from rich.text import Text

    if isinstance(shown, InlineText) and isinstance(shown.primary_renderable, Text):
        text = "\n\n".join(map(_paragraph, shown.primary_renderable.plain.split("\n\n")))
        shown.primary_renderable = Text(text, end=shown.primary_renderable.end)


def _paragraph(text: str) -> str:
    lines = [line.strip() for line in text.splitlines()]
    if all(line.startswith("wordcraft-kg ") for line in lines):
        return "\n".join(f"  {line}" for line in lines)
    return " ".join(" ".join(lines).split())
