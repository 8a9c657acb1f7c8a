"""A player for `wordcraft-kg evaluate-text`.

A language model behind an address on this machine, without an account.

    wordcraft-kg evaluate-text everyday --tasks 100 --player "python examples/chat_player.py
    gemma3:1b"

The default address is Ollama's; give another address after the model's name. Any server with
OpenAI's API works, such as llama.cpp, Ollama and vLLM. Each request sends the whole conversation,
and each game begins a new conversation.
"""

import json
import sys
from typing import Any
from urllib.request import Request, urlopen

MODEL = sys.argv[1]
ADDRESS = sys.argv[2] if len(sys.argv) > 2 else "http://127.0.0.1:11434/v1"


def answer(messages: list[dict[str, str]]) -> str:
    """Return the model's next answer."""
    body = {"model": MODEL, "messages": messages, "temperature": 0, "max_tokens": 300}
    request = Request(
        f"{ADDRESS}/chat/completions",
        json.dumps(body).encode(),
        {"Content-Type": "application/json"},
    )
    with urlopen(request, timeout=55) as response:
        reply: dict[str, Any] = json.load(response)
    return str(reply["choices"][0]["message"]["content"])


messages: list[dict[str, str]] = []
for line in sys.stdin:
    message = json.loads(line)
    if message["new"]:
        messages = []
    messages.append({"role": "user", "content": message["text"]})
    reply_text = answer(messages)
    messages.append({"role": "assistant", "content": reply_text})
    # Only the last line counts, and an answer is one line.
    print(reply_text.strip().splitlines()[-1] if reply_text.strip() else "", flush=True)
