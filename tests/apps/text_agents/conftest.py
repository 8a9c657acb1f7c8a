import json
import threading
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from wordcraft_kg import WordCraftConfig, World
from wordcraft_kg.apps.text_agents.plays import TaskGames


@pytest.fixture
def serve():
    """Return a function that starts a chat server, given the status and reply of the request of a
    number."""
    servers = []

    def start(reply, seen=None):
        counts = Counter()
        lock = threading.Lock()

        class Handler(BaseHTTPRequestHandler):
            # Head and body in one packet: a body alone waits 40 ms for the head's receipt.
            wbufsize = -1

            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                with lock:
                    counts["requests"] += 1
                    number = counts["requests"]
                if seen is not None:
                    seen.append((dict(self.headers), body))
                status, content, *more = reply(number, body)
                data = content if isinstance(content, bytes) else json.dumps(content).encode()
                self.send_response(status if self.path == "/v1/chat/completions" else 404)
                for name, value in more:
                    self.send_header(name, value)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, *_):
                pass

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        servers.append(server)
        return f"http://127.0.0.1:{server.server_port}/v1"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture
def chat_server(serve):
    """A server that answers each prompt with the first two things, after a thought."""

    def first_two(number, body):
        assert body["messages"][-1]["role"] == "user"
        message = {"role": "assistant", "content": "Let me think.\n\n1 + 2\n"}
        return 200, {"choices": [{"index": 0, "message": message, "finish_reason": "stop"}]}

    return serve(first_two)


@pytest.fixture(scope="session")
def games(opened_kitchen):
    return TaskGames(World(opened_kitchen, WordCraftConfig(part="test", num_distractors=3)))
