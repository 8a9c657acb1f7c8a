"""A stand-in for an endpoint of a language model: it answers from a table, and fails on request."""

import gzip
import json
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from wordcraft_kg.graphs.recipe_graph import RecipeGraph

Answerer = Callable[[list[str]], str]
"""Returns the text of an answer about a prompt's goals."""


def table_of(graph: RecipeGraph) -> dict[str, list[tuple[str, str]]]:
    table: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for a, b, result in graph.recipe_labels():
        table[result].append((a, b))
    return table


def answers_from(table: dict[str, list[tuple[str, str]]]) -> Answerer:
    return lambda goals: "\n".join(f"{goal}: {a} + {b}" for goal in goals for a, b in table.get(goal, ()))


@dataclass
class StandIn:
    """A server on the loopback; `failures` are the next responses instead of an answer, "" for an answer."""

    answer: Answerer
    failures: list[int | str] = field(default_factory=list)  # see :meth:`_respond`
    retry_after: str | None = None  # the header of a 429
    message: object = field(default_factory=lambda: {"error": {"message": "failure on request", "code": "requested"}})
    delay: float = 0.0  # seconds until an answer
    bodies: list[dict[str, Any]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)  # by name in lower case
    times: list[float] = field(default_factory=list)
    most_at_once: int = 0
    address: str = ""
    _at_once: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def handle(self, handler: BaseHTTPRequestHandler) -> None:
        body = json.loads(handler.rfile.read(int(handler.headers["Content-Length"])))
        with self._lock:
            self.bodies.append({"path": handler.path, **body})
            self.headers.append({name.lower(): value for name, value in handler.headers.items()})
            self.times.append(time.monotonic())
            failure = self.failures.pop(0) if self.failures else ""
            self._at_once += 1
            self.most_at_once = max(self.most_at_once, self._at_once)
        try:
            time.sleep(self.delay)
            self._respond(handler, body, failure)
        finally:
            with self._lock:
                self._at_once -= 1

    def _respond(self, handler: BaseHTTPRequestHandler, body: dict[str, Any], failure: int | str) -> None:
        goals = body["messages"][-1]["content"].split("\n")[1:]
        choice = {"finish_reason": "stop", "message": {"role": "assistant", "content": self.answer(goals)}}
        whole = json.dumps({"model": f"{body['model']}-as-answered", "choices": [choice]}).encode()
        half = whole[: len(whole) // 2]
        if failure == "closed":
            handler.connection.shutdown(socket.SHUT_RDWR)
            return
        if failure == "slow":
            time.sleep(1.0)
        content = {"invalid": half, "half": half, "schema": b'{"choices": [{"text": "mud"}]}'}.get(failure, whole)
        if failure in ("large", "bomb"):
            content = whole.rjust(5_000_000)
        if failure == "bomb":
            content = gzip.compress(gzip.compress(content))
        status = 200
        if isinstance(failure, int):
            status, content = failure, json.dumps(self.message).encode()
        handler.send_response(status)
        handler.send_header("Content-Type", "application/json")
        handler.send_header("Content-Length", str(len(whole if failure == "half" else content)))
        if status == 429 and self.retry_after is not None:
            handler.send_header("Retry-After", self.retry_after)
        if 300 <= status < 400:
            handler.send_header("Location", f"{self.address.replace('127.0.0.1', 'localhost')}/elsewhere")
        if failure == "bomb":
            handler.send_header("Content-Encoding", "gzip, gzip")
        handler.end_headers()
        for start in range(0, len(content), step := 100 if failure == "drip" else len(content)):
            handler.wfile.write(content[start : start + step])
            time.sleep(0.05 if failure == "drip" else 0)
        handler.close_connection = True


@contextmanager
def standing_in(answer: Answerer) -> Iterator[StandIn]:
    stand_in = StandIn(answer)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            with suppress(BrokenPipeError, ConnectionResetError):
                stand_in.handle(self)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    stand_in.address = f"http://127.0.0.1:{server.server_address[1]}/v1"
    try:
        yield stand_in
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
