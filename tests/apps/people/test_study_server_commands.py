"""``people serve`` as a process of its own, ``people summary --export``, and ``people summary`` of
a study."""

import json
import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import httpx2
import pytest

from tests.apps.people.stored import go_on, refused, unchanged
from wordcraft_kg.apps.people.study import HumanStudy, kept_answers
from wordcraft_kg.apps.people.study_config import StudyConfig

CLIENT = httpx2.Client(follow_redirects=True, timeout=30)
ROOT = Path(__file__).parents[3]
SETTINGS = {"--tasks": "2", "--distractors": "1,8", "--forms": "2"}
SMALL = ("--no-browser", *(word for option in SETTINGS.items() for word in option))
SERVE = ("people", "serve", "kitchen", "--port", "0", "--out")


@contextmanager
def served(out, *options):
    """Serve a study on a free port; yield the process and its address."""
    command = [sys.executable, "-m", "wordcraft_kg", *SERVE, str(out)]
    process = subprocess.Popen(
        [*command, *SMALL, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    try:
        line = process.stdout.readline()
        assert line, process.communicate()[1]
        yield process, json.loads(line)["address"] if "--json" in options else line.split()[0]
    finally:
        process.kill()
        process.communicate()


def page(address, path="/", **form):
    """Load a page, or send a form and load what follows."""
    answer = CLIENT.request("POST" if form else "GET", f"{address}{path}", data=form)
    return answer.raise_for_status().text


def begin(address):
    match = re.search(r'name="code" value="([^"]+)"', page(address))
    assert match
    page(address, "/begin", consent="yes", code=match[1])
    return match[1]


def answer(address, code, task):
    page(address, f"/s/{code}/task")
    return page(address, f"/s/{code}/answer", task=str(task), first="1", second="2")


@pytest.fixture
def summary(run):
    """Summarise studies, with options."""
    return lambda *arguments: run("people", "summary", *arguments)


def test_who_asks_is_private_and_a_manager_ends_it_like_ctrl_c(tmp_path):
    """Who asks is nobodys business and a service manager ends it like ctrl c."""
    with served(tmp_path / "study", "--verbose") as (process, address):
        code = begin(address)
        with pytest.raises(httpx2.HTTPStatusError):
            page(address, f"/s/{code}/nothing")
        process.send_signal(signal.SIGTERM)
        said, log = process.communicate(timeout=20)
    assert (process.returncode, "stopped; the answers are in" in log) == (0, True)
    assert sorted(path.name for path in (tmp_path / "study").iterdir()) == [
        "answers.sqlite",
        "study.json",
    ]
    assert code not in said + log
    assert "GET" not in log
    assert "127.0.0.1" not in log


def test_a_port_in_use_is_an_error_before_anything_is_written(run, tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        outcome = run(
            "people", "serve", "kitchen", "--out", tmp_path / "study", *SMALL, "--port", port
        )
    assert f"--port {port} is in use by another program" in refused(outcome)
    assert not (tmp_path / "study").exists()


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """A study whose four people have answered 4, 3, 2 and 1 of 4 tasks; every other answer is
    right."""
    folder = tmp_path_factory.mktemp("studies") / "begun"
    study = HumanStudy("kitchen", StudyConfig(tasks=2, distractors=(1, 8), forms=2))
    with kept_answers(folder, study) as answers:
        for person in [answers.begin(str(number), study.cells) for number in range(4)]:
            go_on(answers, study, person, 5 - person.number)
    return folder


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--tasks 0", "--tasks 0: expected a whole number, 1 to 1000"),
        ("--distractors x", "--distractors 'x': expected whole numbers"),
        ("--distractors 10000", "--distractors 10000"),
        ("--port 65536", "--port 65536"),
        ("--host 256.1.1.1", "--host '256.1.1.1': unknown host"),
        ("--consent nowhere.txt", "nowhere.txt is missing"),
        ("--consent latin.txt", "expected UTF-8 text"),
        ("--consent empty.txt", "--consent: the text has 0 characters"),
    ],
)
def test_options_that_cannot_be_write_nothing(run, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    Path("latin.txt").write_bytes("Einverständnis".encode("latin-1"))
    Path("empty.txt").write_text(" \n\n")
    port = () if "--port" in options else ("--port", "0")
    outcome = run(
        "people", "serve", "kitchen", "--out", "study", "--no-browser", *port, *options.split()
    )
    kind = "ArtefactError" if "nowhere" in options else "ConfigError"
    assert message in refused(outcome, kind)
    assert not Path("study").exists()


def test_the_export_has_a_line_for_each_answer_and_the_study_stays(summary, begun, tmp_path):
    out = tmp_path / "answers.jsonl"
    with unchanged(begun):
        outcome = summary(begun, "--export", out)
    assert (outcome.code, outcome.out) == (0, f"wrote {out}: answers: 10, people: 4\n")
    lines = [SimpleNamespace(**json.loads(line)) for line in out.read_text().splitlines()]
    assigned = [(line.session, line.form, line.distractors, line.seed) for line in lines[::4]]
    assert assigned == [(1, 0, 1, 0), (2, 0, 8, 0), (3, 1, 1, 1)]
    assert [line.success for line in lines[:4]] == [True, False, True, False]
    assert {(line.seconds, line.loads) for line in lines} == {(3.5, 1)}
    values = json.loads(summary(begun, "--export", out, "--force", "--json").out)
    assert values == {"out": str(out), "people": 4, "answers": 10}
    assert "exists" in refused(summary(begun, "--export", out), "OutputExistsError")
    for wrong in (
        (begun, begun, "--export", out),
        (begun, "--export", out, "--run", "agent"),
        (begun, "--force"),
    ):
        assert "--export" in refused(summary(*wrong))


def test_the_summary_of_a_study_is_by_condition_with_its_people(summary, begun):
    values = json.loads(summary(begun, "--json").out)
    assert values["graph"] == "kitchen"
    assert [one["finished"] for one in values["conditions"]] == [1, 0]
    answered = [
        [part["answered"] for part in one["parts"].values()] for one in values["conditions"]
    ]
    assert answered == [[4, 2], [3, 1]]
    text = summary(begun).out.splitlines()
    assert text[0] == "kitchen; sessions: 4, finished: 1"
    assert text[1].startswith("1 distractor, train   2 of 4 correct, rate 0.500 [")
    assert text[2] == "  over 2 people       [0.500, 0.500]"
    assert text[-3].startswith("95 % intervals: Wilson")
    assert max(map(len, text)) <= 80


def test_a_summary_refuses_what_it_cannot_sum_up(summary, begun, tmp_path):
    assert summary(begun, begun).out == summary(begun).out
    assert "expected a study" in refused(summary())
    for path in (begun / "study.json", tmp_path, tmp_path / "nowhere"):
        refused(summary(path), "ArtefactError")
