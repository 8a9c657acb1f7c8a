import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from wordcraft_kg import WordCraftConfig, World, open_graph
from wordcraft_kg.apps.text_agents.games import TaskGames


class _Chat(BaseHTTPRequestHandler):
    """Answers every prompt with the first two things, after a thought."""

    wbufsize = -1  # head and body in one packet: a body alone waits 40 ms for the head's receipt

    def do_POST(self):
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        assert body["messages"][-1]["role"] == "user"
        message = {"role": "assistant", "content": "Let me think.\n\n1 + 2\n"}
        body = json.dumps(
            {"choices": [{"index": 0, "message": message, "finish_reason": "stop"}]}
        ).encode()
        self.send_response(200 if self.path == "/v1/chat/completions" else 404)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def chat_server():
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Chat)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/v1"
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="session")
def kitchen():
    return open_graph("kitchen")


@pytest.fixture(scope="session")
def games(kitchen):
    return TaskGames(World(kitchen, WordCraftConfig(part="test", num_distractors=3)))
