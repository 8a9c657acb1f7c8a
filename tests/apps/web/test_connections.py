"""Deadlines and the bounded number of connections, with real sockets and a server in a process of
its own."""

import asyncio
import contextlib
import select
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections import namedtuple

import pytest
from starlette.routing import Route, Router

from wordcraft_kg.apps.web.guard import Guard

resource = pytest.importorskip("resource")  # limits of open files, not on Windows

SERVER = """
import asyncio, sys
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route, Router
from wordcraft_kg.apps.web import serving as connections
from wordcraft_kg.apps.web.guard import Guard
from wordcraft_kg.apps.web.serving import listen, serve

for setting in sys.argv[1:]:
    name, _, value = setting.partition("=")
    setattr(connections, name, float(value))

async def page(request):
    return Response("page")

async def large(request):
    return Response(b"x" * 50_000_000)

async def form(request):
    try:
        return Response(f"{len(await request.body())} bytes")
    except ClientDisconnect:
        print("the form was not sent", flush=True)
        return Response("nobody reads this")

async def slow(request):
    print("computing", flush=True)
    await asyncio.sleep(float(request.query_params["seconds"]))
    return Response("slow page")

routes = [Route("/", page), Route("/large", large), Route("/slow", slow)]
routes.append(Route("/form", form, methods=["POST"]))
router = Router(routes)
app = Guard(router, "127.0.0.1", (), lambda status, message: message, methods=("GET", "POST"))
serve(app, listen("127.0.0.1", 0), lambda address: print(address, flush=True))
"""

HALF = b"GET / HTTP/1.1\r\nHost: localhost\r\n"

FORM = b"POST /form HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n"

Served = namedtuple("Served", "process address port")


@pytest.fixture(scope="module")
def starting():
    """Start servers; arguments set constants, such as CLIENT_WAIT=1, and ``files`` limits the open
    files."""
    with contextlib.ExitStack() as stack:

        def start(*settings, files=None):
            def limit():
                if files is not None:
                    resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))

            process = stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", SERVER, *settings],
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                    preexec_fn=limit,
                )
            )
            stack.callback(process.kill)
            address = process.stdout.readline().strip()
            return Served(process, address, int(address.rpartition(":")[2]))

        yield start


@pytest.fixture(scope="module")
def impatient(starting):
    """A server with short deadlines, in seconds; tests read all that it prints about them."""
    return starting("CLIENT_WAIT=1")


def connect(served, data=b"", count=1):
    """Open connections that send some bytes each."""
    connections = []
    for _ in range(count):
        connection = socket.create_connection(("127.0.0.1", served.port), timeout=20)
        connection.sendall(data)
        connections.append(connection)
    return connections


def open_of(connections):
    """Return the number of connections that the server has not closed."""
    poll = select.poll()
    for connection in connections:
        poll.register(connection, select.POLLIN | select.POLLHUP)
    return len(connections) - len(poll.poll(0))


def seconds_until_closed(connections, longest=20):
    began = time.monotonic()
    while open_of(connections):
        assert time.monotonic() - began < longest, f"{open_of(connections)} connections are open"
        time.sleep(0.05)
    return time.monotonic() - began


def seconds_of_dripping(connection, drop):
    """Send drops until the server has closed the connection."""
    began = time.monotonic()
    with contextlib.suppress(OSError):  # reset, or broken pipe
        while time.monotonic() - began < 15:
            connection.sendall(drop)
            time.sleep(0.1)
    return time.monotonic() - began


def visit(served, path="/"):
    with urllib.request.urlopen(served.address + path, timeout=20) as answer:
        return answer.read().decode()


@pytest.mark.parametrize("data", [b"", HALF], ids=["silent", "half a header"])
def test_a_connection_without_a_whole_header_ends(impatient, data):
    connections = connect(impatient, data, 200)
    assert open_of(connections[-1:]) == 1
    assert visit(impatient) == "page"
    assert seconds_until_closed(connections) < 10


def test_drops_of_a_header_do_not_prolong_its_time(impatient):
    (connection,) = connect(impatient, HALF)
    assert 0.2 < seconds_of_dripping(connection, b"X-a: b\r\n") < 10


def test_half_a_header_after_an_answer_ends_as_well(impatient):
    (connection,) = connect(impatient, HALF + b"\r\n")
    assert b"200 OK" in connection.recv(1000)
    connection.sendall(HALF)
    assert seconds_until_closed([connection]) < 10


def test_a_body_in_drops_ends_and_a_slow_one_is_read(impatient):
    late, slow = connect(impatient, FORM, 2)
    for _ in range(4):
        slow.sendall(b"x" * 25)
        time.sleep(0.1)
    assert b"100 bytes" in slow.recv(1000)
    assert seconds_of_dripping(late, b"x") < 10
    assert impatient.process.stdout.readline() == "the form was not sent\n"


def test_who_does_not_read_a_page_is_left_and_who_reads_slowly_gets_it(impatient):
    request = b"GET /large HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    lazy, slow = connect(impatient, request, 2)
    received, began = 0, time.monotonic()
    while part := slow.recv(1_000_000):
        received += len(part)
        if time.monotonic() - began < 4:  # longer than any deadline
            time.sleep(0.1)
    assert received > 50_000_000
    buffered = sum(iter(lambda: len(lazy.recv(1_000_000)), 0))
    assert buffered < 40_000_000  # only what the system had taken before the server left


def test_a_page_that_takes_long_to_compute_has_no_deadline(impatient):
    assert visit(impatient, "/slow?seconds=2") == "slow page"  # longer than any deadline
    assert impatient.process.stdout.readline() == "computing\n"


@pytest.mark.parametrize(
    "data",
    [b"", pytest.param(HALF, marks=pytest.mark.slow), pytest.param(FORM, marks=pytest.mark.slow)],
    ids=["silent", "half a header", "half a form"],
)
def test_a_visitor_is_served_while_others_hold_more_connections_than_files(starting, data):
    files = 128
    served = starting(files=files)
    connections = connect(served, data, 2 * files)
    began = time.monotonic()
    assert [visit(served) for _ in range(3)] == ["page"] * 3
    assert time.monotonic() - began < 10
    assert 0 < open_of(connections) < files
    served.process.send_signal(signal.SIGINT)
    _, log = served.process.communicate(timeout=20)
    assert (served.process.returncode, "out of system resource" in log) == (0, False)


def test_a_computing_page_does_not_give_way(starting):
    served = starting(files=96)
    (waiting,) = connect(served, HALF.replace(b"GET /", b"GET /slow?seconds=1") + b"\r\n")
    assert served.process.stdout.readline() == "computing\n"
    connect(served, HALF, 100)
    assert b"200 OK" in waiting.recv(1000)


def test_ctrl_c_does_not_wait_for_clients(starting):
    served = starting()
    connections = connect(served, HALF, 20) + connect(served, FORM, 20)
    assert visit(served) == "page"
    began = time.monotonic()
    served.process.send_signal(signal.SIGINT)
    served.process.communicate(timeout=20)
    assert (served.process.returncode, time.monotonic() - began < 3) == (0, True)
    assert open_of(connections) == 0


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
