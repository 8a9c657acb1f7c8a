"""`explore`: a server that begins, answers and ends, or a folder of pages."""

import json
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest

from tests.apps.people.stored import refused


@contextmanager
def serving(*arguments):
    """Start a server on a free port; yields it and its address."""
    command = [sys.executable, "-m", "wordcraft_kg", *arguments, "--port", "0", "--json"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": {**os.environ, "OMP_NUM_THREADS": "1"}}
    with subprocess.Popen(command, text=True, **pipes) as server:
        try:
            yield server, json.loads(server.stdout.readline())["address"]
        finally:
            server.kill()


def send(address, *lines):
    """Send lines over a connection of their own, and return the answer."""
    host, port = address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=20) as connection:
        connection.sendall("".join(f"{line}\r\n" for line in lines).encode())
        return connection.recv(100)


@pytest.mark.parametrize("termination", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_the_server_answers_until_it_is_ended_and_says_nothing_of_who_asked(termination):
    with serving("explore", "kitchen", "--no-browser") as (server, address):
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(f"{address}/entity/bread") as answer:
            assert b"<h1>bread" in answer.read()
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{address}/entity/brea")
        for method in ("POST", "GET"):
            assert b"400" in send(
                address, f"{method} / HTTP/1.1", "Host: localhost", "Transfer-Encoding: chunked", "", "zz"
            )
        server.send_signal(termination)
        out, err = server.communicate(timeout=20)
        assert (server.returncode, out) == (0, "")
        assert "GET" not in err
        assert ("Traceback" in err, err.count("Invalid HTTP request")) == (False, 1)


@pytest.mark.parametrize(
    ("arguments", "message", "kind"),
    [
        ("--port 70000", "70000", "ConfigError"),
        ("--host no.such.host.invalid", "unknown host", "ConfigError"),
        ("--host 203.0.113.7", "not an address of this machine", "ConfigError"),
        ("--force", "--export", "ConfigError"),
        ("--model nowhere", "nowhere", "ArtefactError"),
        ("--run nowhere", "nowhere", "ArtefactError"),
    ],
)
def test_what_cannot_be_served_is_a_clear_error(run, arguments, message, kind):
    assert message in refused(run("explore", "kitchen", "--no-browser", *arguments.split()), kind)


def test_the_site_as_files(run, tmp_path):
    command = ("explore", "kitchen", "--export", tmp_path / "site")
    record = json.loads(run(*command, "--json").out)
    assert record == json.loads((tmp_path / "site" / "site.json").read_text())
    assert record["graph"] == "kitchen"
    refused(run(*command), "OutputExistsError")
    assert run(*command, "--force").code == 0


def test_without_the_extra_the_command_says_what_to_install(run, monkeypatch):
    monkeypatch.setattr("wordcraft_kg.base.extras.find_spec", lambda name: None)
    assert "pip install 'starlette<2" in refused(run("explore", "kitchen"), "MissingExtraError")
