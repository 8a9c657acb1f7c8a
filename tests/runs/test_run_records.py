"""Run records: what they hold, what they keep quiet about, and what is verified with them."""

import getpass
import socket
import sys

import pytest

from wordcraft_kg.base.artefacts import locked, read_large_file, sha256_of
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.runs.checkpoints import Checkpoints
from wordcraft_kg.runs.record import (
    RunFiles,
    check_done,
    end_run,
    read_finished_run,
    read_run,
    run_name,
    start_run,
)


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "run"
    path.mkdir()
    return path


def finished(folder):
    (folder / "weights").write_bytes(b"abc")
    return end_run(folder, start_run(folder, "train-complex", seed=3), "done", ("weights",))


def test_a_run_is_on_record_while_it_runs(folder):
    run = start_run(folder, "train-complex", seed=3)
    assert read_run(folder) == run
    assert (run.kind, run.status, run.seed, run.ended, run.outputs) == (
        "train-complex",
        "running",
        3,
        None,
        {},
    )


def test_a_run_that_ended_has_the_hashes_of_its_outputs(folder):
    finished(folder)
    run = read_finished_run(folder, "a model", "weights")
    assert (run.status, run.outputs) == ("done", {"weights": sha256_of(folder / "weights")})
    assert run.started <= run.ended


def test_a_run_says_with_which_versions_it_was_made(folder):
    versions = start_run(folder, "train-complex").versions
    assert versions["python"] == ".".join(str(part) for part in sys.version_info[:3])
    assert {"wordcraft-kg", "torch", "pykeen", "numpy"} <= set(versions)


def test_the_home_folder_in_arguments_becomes_a_tilde(folder, monkeypatch):
    monkeypatch.setenv("HOME", "/homes/somebody")
    arguments = [
        "/homes/somebody/bin/wordcraft-kg",
        "build",
        "/homes/somebody/graphs",
        "--out=/homes/somebody/m",
    ]
    monkeypatch.setattr(sys, "argv", arguments)
    assert start_run(folder, "train-complex").argv == (
        "wordcraft-kg",
        "build",
        "~/graphs",
        "--out=~/m",
    )


def test_no_host_or_user_name_goes_into_a_record(folder, monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "some-host-name")
    monkeypatch.setenv("HOSTNAME", "some-host-name")
    monkeypatch.setenv("USER", "some-user-name")
    monkeypatch.setenv("LOGNAME", "some-user-name")
    assert getpass.getuser() == "some-user-name"
    start_run(folder, "train-complex")
    text = (folder / "run.json").read_text()
    assert "some-host-name" not in text
    assert "some-user-name" not in text


@pytest.mark.parametrize("status", ["interrupted", "failed"])
def test_a_run_that_is_not_done_is_refused_with_its_status(folder, status):
    end_run(folder, start_run(folder, "train-complex"), status)
    with pytest.raises(ArtefactError, match=rf"{status}, not done.*Repeat the training command"):
        read_finished_run(folder, "a model", "model.bin")


def test_a_run_is_still_running_while_its_folder_is_locked_and_else_was_stopped(folder):
    def refused(says, read):
        with pytest.raises(ArtefactError, match=says):
            read()

    def finished():
        read_finished_run(folder, "a model", "model.bin")

    def weights():
        read_large_file(folder / "model.bin")

    with locked(folder):
        refused("still running, and has written nothing.*Wait", finished)
        run = start_run(folder, "train-complex")
        refused("still running .train-complex, since .*not done. Wait", finished)
        refused("still being written", weights)
        refused("still running, and has no checkpoint", Checkpoints(folder, "epoch", dict).load)
    refused("stopped, by a kill or a crash, not done. Repeat the training", finished)
    refused("model.bin is missing; the folder is incomplete", weights)
    end_run(folder, run, "done", [])
    check_done(folder, read_run(folder))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[]",
        b"{}",
        b'{"format": "something else 1"}',
        b"3",
        b"null",
        b'{"format": "\xff"}',
    ],
)
def test_something_else_than_a_run_record_is_refused(folder, text):
    (folder / "run.json").write_bytes(text)
    with pytest.raises(ArtefactError, match=r"run\.json"):
        read_run(folder)


@pytest.mark.parametrize(
    ("name", "data"),
    [*(("weights", data) for data in (b"", b"ab", b"abd", b"abcd")), ("other", b"abc")],
)
def test_bytes_that_differ_or_that_the_record_does_not_know_are_refused(folder, name, data):
    files = RunFiles(folder, finished(folder))
    assert files.bytes("weights") == b"abc"
    (folder / name).write_bytes(data)
    with pytest.raises(ArtefactError, match=f"{name} is damaged"):
        files.bytes(name)


@pytest.mark.parametrize(
    ("written", "checked_out", "is_read"),
    [
        (b'{\n"a": 1\n}\n', b'{\r\n"a": 1\r\n}\r\n', True),
        (b"a\r\nb\n", b"a\r\nb\n", True),  # unchanged, so it is as it was written
        (b"a\nb\n", b"a\r\nB\r\n", False),
        (b"a\nb\n", b"a\r\nb\r\n\r\n", False),
        (b"a\nb\n", b"a\rb\r", False),
    ],
)
def test_a_text_with_the_line_ends_of_windows_is_read_as_it_was_written(
    folder, written, checked_out, is_read
):
    (folder / "weights").write_bytes(written)
    run = end_run(folder, start_run(folder, "train-complex", seed=3), "done", ("weights",))
    (folder / "weights").write_bytes(checked_out)
    files = RunFiles(folder, run)
    if is_read:
        assert files.bytes("weights") == written
    else:
        with pytest.raises(ArtefactError, match="weights is damaged"):
            files.bytes("weights")


def test_a_loop_of_links_has_a_name_too(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    assert run_name(tmp_path / "loop") == "loop"
