"""A player for `wordcraft-kg evaluate-text`: a language model behind an address on this machine, without an account.

    wordcraft-kg evaluate-text everyday --tasks 100 --player "python examples/chat_player.py gemma3:1b"

The address is that of a server that speaks as OpenAI's does, such as those of llama.cpp, Ollama and vLLM; give another
one after the model's name. The conversation of a game is sent whole each time, and each game begins a new one.
"""

import json
import sys
from typing import Any
from urllib.request import Request, urlopen

MODEL = sys.argv[1]
ADDRESS = sys.argv[2] if len(sys.argv) > 2 else "http://127.0.0.1:11434/v1"


def answer(messages: list[dict[str, str]]) -> str:
    """Return what the model says next."""
    asked = {"model": MODEL, "messages": messages, "temperature": 0, "max_tokens": 300}
    request = Request(f"{ADDRESS}/chat/completions", json.dumps(asked).encode(), {"Content-Type": "application/json"})
    with urlopen(request, timeout=55) as response:
        found: dict[str, Any] = json.load(response)
    return str(found["choices"][0]["message"]["content"])


messages: list[dict[str, str]] = []
for line in sys.stdin:
    told = json.loads(line)
    if told["new"]:
        messages = []
    messages.append({"role": "user", "content": told["text"]})
    said = answer(messages)
    messages.append({"role": "assistant", "content": said})
    # Only the last line counts, and an answer is one line.
    print(said.strip().splitlines()[-1] if said.strip() else "", flush=True)
