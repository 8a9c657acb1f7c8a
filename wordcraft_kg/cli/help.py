"""Help as paragraphs: a docstring is wrapped for its file, its help for the terminal."""

from typing import Any

from cyclopts.help import DefaultFormatter, InlineText


class FlowingHelp(DefaultFormatter):
    """Shows descriptions without the line ends of their docstrings; blank lines still separate paragraphs."""

    def __call__(self, console: Any, options: Any, panel: Any) -> None:
        """Show a panel of commands or options."""
        for entry in panel.entries:
            _flow(entry.description)
        super().__call__(console, options, panel)

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Show what a command does."""
        _flow(description)
        super().render_description(console, options, description)


def _flow(shown: Any) -> None:
    from rich.text import Text

    if isinstance(shown, InlineText) and isinstance(shown.primary_renderable, Text):
        paragraphs = shown.primary_renderable.plain.split("\n\n")
        text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
        shown.primary_renderable = Text(text, end=shown.primary_renderable.end)
