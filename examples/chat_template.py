"""The chat template of a language model, rendered with bounds of time and memory.

A template is a program of whoever made the model. transformers runs it in a sandbox, from which
it reaches nothing; but it may loop without an end, or fill the memory. So it runs in a process of
its own, which is ended if it takes too long.
"""

import json
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from weakref import finalize

from wordcraft_kg.base.errors import ArtefactError, reason
from wordcraft_kg.base.wording import for_terminal

SECONDS = 10.0
"""Longest time for a conversation; usual templates take a millisecond."""
_START = 120.0
"""Longest time until the process has imported transformers and read the template."""
_MEMORY = 2**30
"""Bytes besides the program."""
_LONGEST = 10_000_000
"""Bytes of a template, and of a rendered conversation."""
_REMEDY = "Give another model, or set the template of its tokenizer."


class ChatTemplate:
    """The template of a tokenizer in a process of its own, which ends with this object."""

    def __init__(self, tokenizer: Any):
        """Start the process, and let it read the template.

        Raises:
            ArtefactError: if the tokenizer has no template.
        """
        template = usual_template(tokenizer)
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL
        )
        # Also at the end of this process.
        finalize(self, self._process.kill)
        self._ask([template, tokenizer.special_tokens_map], _START)

    def render(self, messages: Sequence[Mapping[str, str]], *, is_asked: bool) -> str:
        """Return a conversation as text, as ``tokenizer.apply_chat_template`` does.

        Args:
            messages: role and content of each message.
            is_asked: whether the text ends with the beginning of an answer.

        Raises:
            ArtefactError: if the template fails, or takes more time or memory than it may.
        """
        return self._ask([list(messages), is_asked], SECONDS)

    def _ask(self, question: list[Any], seconds: float) -> str:
        """Send a line, and return the answer of the process."""
        sent = self._process.stdin
        received = self._process.stdout
        assert sent is not None
        assert received is not None
        timer = threading.Timer(seconds, self._process.kill)
        timer.start()
        try:
            with suppress(OSError):  # the process has ended, and there is no answer
                sent.write(json.dumps(question, default=str).encode() + b"\n")
                sent.flush()
            line = received.readline(_LONGEST)
        finally:
            timer.cancel()
        if not line.endswith(b"\n"):
            raise ArtefactError(
                f"the model's chat template took more than {seconds:g} seconds, 1 GiB of memory "
                f"or {_LONGEST:,} bytes for a conversation. {_REMEDY}"
            )
        text, error = json.loads(line)
        if error:
            shown = for_terminal(error)
            raise ArtefactError(f"the model's chat template fails: {shown}. {_REMEDY}")
        return str(text)


def usual_template(tokenizer: Any) -> str:
    """Return the template that a tokenizer has for conversations.

    Raises:
        ArtefactError: if it has none, several without a usual one, or one of an excessive size.
    """
    try:
        template = tokenizer.get_chat_template()
    except ValueError:
        template = None
    if not isinstance(template, str) or not template or len(template) > _LONGEST:
        raise ArtefactError(
            f"the tokenizer of '{tokenizer.name_or_path}' has no chat template, or one of more "
            f"than {_LONGEST:,} characters. Take an instruct model, which was trained to answer, "
            "or set the template of its tokenizer."
        )
    return template


def _serve() -> None:
    """Read a template on stdin, then conversations; write their texts to stdout."""
    from transformers.utils.chat_template_utils import render_jinja_template

    size = Path("/proc/self/statm")
    if size.exists():  # Linux
        import resource

        memory = int(size.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (memory + _MEMORY, memory + _MEMORY))
    try:
        template, tokens = json.loads(sys.stdin.readline())
    except (TypeError, ValueError):
        sys.exit("no template on stdin: expected that of transformers_player.py. Run that.")
    _answer("")
    for line in sys.stdin:
        messages, is_asked = json.loads(line)
        try:
            rendered, _ = render_jinja_template(
                [messages], chat_template=template, add_generation_prompt=is_asked, **tokens
            )
        except Exception as error:  # whatever the template does
            _answer("", reason(error))
        else:
            _answer(rendered[0])


def _answer(text: str, error: str = "") -> None:
    sys.stdout.write(json.dumps([text, error]) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _serve()
