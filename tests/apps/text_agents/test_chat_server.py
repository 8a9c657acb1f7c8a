"""A model behind a chat completions API, played by a fake server in this process."""

import json
import re

import pytest

from wordcraft_kg.apps.text_agents.text_players import ChatServer
from wordcraft_kg.base.errors import ConfigError, PlayerError

KEY = "sk-a-secret-of-mine"


def said(text, **more):
    return {"choices": [{"message": {"content": text}}], **more}


def first_two(number, body):
    # Some servers do not count tokens.
    return 200, said("1 + 2", usage={"prompt_tokens": None, "completion_tokens": None})


def test_parallel_games_are_those_of_one_at_a_time_and_become_a_submission(run, tmp_path, serve):
    url = serve(first_two)
    files = []
    for parallel in (1, 8):
        out = tmp_path / str(parallel)
        options = ["--player", "openai:tiny", "--base-url", url, "--parallel", parallel]
        outcome = run("bench", "run", "craft-1-lite", *options, "--out", out)
        assert outcome.code == 0, outcome.err
        files.append((out / "games.jsonl").read_bytes())
    assert files[0] == files[1]
    submission = json.loads((out / "submission.json").read_text())
    assert (submission["kind"], submission["player"]) == ("openai", "tiny")
    assert run("bench", "verify", out).code == 0


def test_the_key_is_sent_but_never_shown(serve, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    seen = []
    url = serve(lambda number, body: (401, {"error": f"bad key {KEY}:\nask for another"}), seen)
    with pytest.raises(PlayerError, match=r"answers with 401: .*ask for another") as caught:
        ChatServer("tiny", url, 5.0).ask([{"role": "user", "content": "hello"}])
    assert seen[0][0]["Authorization"] == f"Bearer {KEY}"
    assert KEY not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_busy_server_is_asked_again_and_a_broken_one_given_up(serve):
    url = serve(lambda number, body: first_two(number, body) if number > 2 else (429, b"later"))
    server = ChatServer("tiny", url, 5.0, pause=0.0)
    assert server.ask([]) == "1 + 2"
    seen = []
    url = serve(lambda number, body: (503, b"out of order"), seen)
    with pytest.raises(PlayerError, match="answers with 503: out of order"):
        ChatServer("tiny", url, 5.0, pause=0.0).ask([])
    assert len(seen) == 5


@pytest.mark.parametrize(
    "reply",
    [b"<html>", {"choices": []}, [1], {"choices": [{"message": None}]}, said(5), said([5])],
    ids=["html", "empty", "list", "no message", "number", "numbers"],
)
def test_another_reply_is_shown_and_refused(serve, reply):
    url = serve(lambda number, body: (200, reply))
    with pytest.raises(PlayerError, match="expected a reply of a chat completions API"):
        ChatServer("tiny", url, 5.0).ask([])


def test_a_redirection_does_not_carry_the_key(serve, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    seen = []
    other = serve(first_two, seen)
    url = serve(lambda number, body: (307, b"", ("Location", f"{other}/chat/completions")))
    with pytest.raises(PlayerError, match="answers with 307"):
        ChatServer("tiny", url, 5.0).ask([])
    assert not seen


def test_an_answer_in_parts_is_their_text(serve):
    parts = [{"type": "thinking"}, {"type": "text", "text": "1 "}, {"type": "text", "text": "+ 2"}]
    assert (
        ChatServer("tiny", serve(lambda number, body: (200, said(parts))), 5.0).ask([]) == "1 + 2"
    )


def test_a_key_that_cannot_be_sent_is_refused_unseen(serve, monkeypatch):
    """A line break behind a key is cut; elsewhere, and letters beyond ASCII, are errors."""
    seen = []
    url = serve(first_two, seen)
    monkeypatch.setenv("OPENAI_API_KEY", f"{KEY}\n")
    ChatServer("tiny", url, 5.0).ask([])
    assert seen[0][0]["Authorization"] == f"Bearer {KEY}"
    for key in (f"{KEY}\nmore", f"{KEY}\u2192"):
        monkeypatch.setenv("OPENAI_API_KEY", key)
        with pytest.raises(ConfigError, match="OPENAI_API_KEY") as caught:
            ChatServer("tiny", url, 5.0)
        assert KEY not in str(caught.value)


@pytest.mark.parametrize(
    "url",
    ["file:///etc/passwd", "127.0.0.1:8000", "", "http://", "http://[::1/v1", "http://localhost:x"],
)
def test_an_address_that_is_none_of_http_is_refused(url):
    with pytest.raises(ConfigError, match="chat completions API"):
        ChatServer("tiny", url, 5.0)


@pytest.mark.parametrize(
    ("player", "address", "says"),
    [
        (
            "openai:tiny",
            ("--base-url", "http://127.0.0.1:9/v1"),
            "does not answer.*Start the server",
        ),
        (
            "votes",
            ("--base-url", "http://127.0.0.1:9/v1"),
            "--base-url is for --player openai:MODEL, not 'votes'",
        ),
        ("openai:tiny", (), "base-url"),
    ],
    ids=["down", "not asked", "missing"],
)
def test_a_server_that_cannot_be_asked_is_an_error_in_a_sentence(
    refused, tmp_path, player, address, says
):
    command = ("bench", "run", "craft-1-lite", "--player", player, *address)
    error = refused(*command, "--out", tmp_path / "out")
    assert re.search(says, error)
    # The folder keeps what a run that began needs to go on.
    assert (tmp_path / "out").exists() == ("Start the server" in error)
