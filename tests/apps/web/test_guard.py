"""The guard's log, which people with a terminal keep."""

import asyncio

from starlette.routing import Route, Router

from wordcraft_kg.apps.web.guard import Guard


async def _broken(request):
    raise ZeroDivisionError


def test_a_session_code_never_reaches_the_log(caplog):
    """Whoever has the code of a session can answer as that person, or withdraw the answers."""
    app = Guard(
        Router([Route("/s/{code}/task", _broken)]), "localhost", (), lambda *what: str(what)
    )
    sent = []

    async def receive():
        return {"type": "http.request", "body": b""}

    async def send(message):
        sent.append(message)

    path = "/s/secret-code/task"
    scope = {
        **{"type": "http", "method": "GET", "query_string": b"", "raw_path": path.encode()},
        **{"path": path, "headers": [(b"host", b"localhost")]},
    }
    asyncio.run(app(scope, receive, send))
    assert sent[0]["status"] == 500
    assert "ZeroDivisionError" in caplog.text
    assert "error in a request for /s" in caplog.text
    assert "secret-code" not in caplog.text
