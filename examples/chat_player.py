r"""A player for `wordcraft-kg bench run` and `evaluate-agent`.

A language model behind an address on this machine, without an account.

    wordcraft-kg evaluate-agent everyday --limit 100 \
        --player "program:python examples/chat_player.py gemma3:1b"

The default address is Ollama's; give another address after the model's name. Any server with
OpenAI's API works, such as llama.cpp, Ollama and vLLM. Each request sends the whole conversation,
and each game begins a new conversation. Addresses of this machine and its private network are
reached directly, all others by the proxy of the environment.
"""

import json
import sys
from http.client import HTTPException
from ipaddress import ip_address
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import OpenerDirector, ProxyHandler, Request, build_opener

MODEL = sys.argv[1]
ADDRESS = sys.argv[2] if len(sys.argv) > 2 else "http://127.0.0.1:11434/v1"


def is_local(host: str) -> bool:
    """Return whether a host name or number is this machine, or in its private network."""
    name = host.rstrip(".").lower()
    try:
        address = ip_address(name)
    except ValueError:  # a name; those without a point are never public
        return "." not in name or name.endswith((".localhost", ".local"))
    return address.is_loopback or address.is_private or address.is_link_local


def make_opener(address: str) -> OpenerDirector:
    """Return what opens an address: a proxy knows nothing of servers on this machine."""
    is_direct = is_local(urlsplit(address).hostname or "")
    return build_opener(ProxyHandler({}) if is_direct else ProxyHandler())


OPENER = make_opener(ADDRESS)


def answer(messages: list[dict[str, str]]) -> str:
    """Return the model's next answer."""
    body = {"model": MODEL, "messages": messages, "temperature": 0, "max_tokens": 300}
    try:
        request = Request(
            f"{ADDRESS}/chat/completions",
            json.dumps(body).encode(),
            {"Content-Type": "application/json"},
        )
        with OPENER.open(request, timeout=55) as response:
            reply: dict[str, Any] = json.load(response)
        return str(reply["choices"][0]["message"]["content"])
    except HTTPError as error:
        sys.exit(f"{ADDRESS} answers with {error}; expected a chat server with the model {MODEL}.")
    except (OSError, HTTPException) as error:
        reason = getattr(error, "reason", error)
        sys.exit(f"no server at {ADDRESS} ({reason}). Start it, or give another address.")
    except (LookupError, TypeError, ValueError) as error:
        sys.exit(f"{ADDRESS} gives no answer of a chat server ({error!r}); expected OpenAI's API.")


messages: list[dict[str, str]] = []
for line in sys.stdin:
    message = json.loads(line)
    if message["new"]:
        messages = []
    messages.append({"role": "user", "content": message["text"]})
    reply_text = answer(messages)
    messages.append({"role": "assistant", "content": reply_text})
    # A JSON string holds the whole answer in one line.
    print(json.dumps(reply_text), flush=True)
