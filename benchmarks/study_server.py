"""Let simulated people take a study at once, kill its server now and then, and compare what they did with what is kept.

python benchmarks/study_server.py --people 50 --seconds 120 --kills 2

The server is a process of its own on this machine, killed with SIGKILL and started again by the same command. Each
person keeps a record of every answer that was sent and of every answer that was acknowledged, and now and then sends an
answer twice, with another pick the second time, or reloads instead. Exit code 1 if an acknowledged answer is lost or is
another, an answer is there twice, or one is there that nobody gave.
"""

import argparse
import hashlib
import http.client
import json
import os
import random
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from html import unescape
from pathlib import Path
from urllib.parse import urlencode

LOST = (OSError, http.client.HTTPException)
"""What a request ends with whose server is killed."""
AGAIN = 0.1
"""Seconds until somebody tries again."""


@dataclass
class Person:
    """Somebody's own record, by number of the task: the goal and the picks of each answer sent, and the one that
    was acknowledged first.
    """

    code: str
    sent: dict[int, list[tuple[str, str, str]]] = field(default_factory=dict)
    acknowledged: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    is_finished: bool = False


class Client(threading.Thread):
    """One chair: a person after another takes the study until the time is up."""

    def __init__(self, port: int, seed: int, until: float, pause: float):
        super().__init__(daemon=True)
        self.port, self.rng, self.until, self.pause = port, random.Random(seed), until, pause
        self.connection: http.client.HTTPConnection | None = None
        self.people: list[Person] = []
        self.seconds: list[float] = []
        self.interruptions = 0
        self.problem = ""

    def run(self) -> None:
        try:
            while time.monotonic() < self.until:
                self.take_part()
        except Exception as error:
            self.problem = repr(error)

    # --- requests ----------------------------------------------------------------------------------------------------

    def once(self, path: str, form: dict[str, str] | None = None) -> tuple[int, str, str]:
        """Send one request; return status, where it leads, and the page."""
        if self.connection is None:
            self.connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        headers = {"Content-Type": "application/x-www-form-urlencoded"} if form is not None else {}
        body = urlencode(form) if form is not None else None
        began = time.perf_counter()
        try:
            self.connection.request("GET" if form is None else "POST", path, body, headers)
            answer = self.connection.getresponse()
            page = answer.read().decode()
        except LOST:
            self.connection.close()
            self.connection = None
            self.interruptions += 1
            raise
        self.seconds.append(time.perf_counter() - began)
        if answer.status >= 400:
            raise RuntimeError(f"{path}: {answer.status} {page[-500:]}")
        return answer.status, answer.headers.get("Location", ""), page

    def get(self, path: str) -> str:
        """Load a page, again and again until the server is there, and wherever it leads."""
        while True:
            try:
                status, place, page = self.once(path)
            except LOST:
                time.sleep(AGAIN)
                continue
            if status != 303:
                return page
            path = place

    # --- taking part -------------------------------------------------------------------------------------------------

    def take_part(self) -> None:
        code = found(r'name="code" value="([^"]+)"', self.get("/"))
        person = Person(code)
        self.people.append(person)
        while True:
            try:
                self.once("/begin", {"consent": "yes", "code": code})
                break
            except LOST:
                time.sleep(AGAIN)
        self.get(f"/s/{code}")
        while time.monotonic() < self.until:
            page = self.get(f"/s/{code}/task")
            if "Thank you for taking part" in page:
                person.is_finished = True
                return
            time.sleep(self.rng.expovariate(1 / self.pause))
            self.answer(person, page)

    def answer(self, person: Person, page: str) -> None:
        goal = found(r'class="goal">([^<]*)<', page)
        table = [unescape(label) for label in re.findall(r'class="label">([^<]*)<', page)]
        first = self.rng.randrange(len(table))
        held = self.get(f"/s/{person.code}/task?held={first + 1}")
        if found(r'class="goal">([^<]*)<', held) != goal:
            raise RuntimeError("another task, though nothing was answered")
        number = int(found(r'name="task" value="(\d+)"', held))
        times = 2 if self.rng.random() < 0.2 else 1
        while times:
            second = self.rng.randrange(len(table))
            given = (unescape(goal), table[first], table[second])
            person.sent.setdefault(number, []).append(given)
            form = {"task": str(number), "first": str(first + 1), "second": str(second + 1)}
            try:
                status, place, _ = self.once(f"/s/{person.code}/answer", form)
            except LOST:
                if self.rng.random() < 0.5:
                    return  # loads the task again
                time.sleep(AGAIN)
                continue
            if status != 303 or place.endswith("/task?held="):
                raise RuntimeError(f"an answer led to {status} {place}")
            # A copy may be acknowledged whose original was stored without a word: then that one counts.
            is_certain = len(person.sent[number]) == 1
            if number not in person.acknowledged:
                person.acknowledged[number] = given if is_certain else ("", "", "")
            times -= 1
        if "feedback" in place:
            self.get(place)


def found(pattern: str, page: str) -> str:
    """Return what a page says."""
    match = re.search(pattern, page)
    if match is None:
        raise RuntimeError(f"no {pattern} in {page[-1500:]}")
    return match[1]


# --- the server ------------------------------------------------------------------------------------------------------


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start(command: list[str]) -> subprocess.Popen[str]:
    """Start the server, and wait until it answers."""
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert server.stdout is not None
    assert server.stderr is not None
    if not server.stdout.readline():
        raise SystemExit(f"the server did not start: {server.stderr.read()}")
    return server


# --- what is kept ----------------------------------------------------------------------------------------------------


def differences(people: list[Person], database: Path, lines: list[dict[str, object]]) -> list[str]:
    """Compare what people say with what was exported; return what should not be."""
    with sqlite3.connect(database) as connection:
        numbers = dict(connection.execute("SELECT code, number FROM sessions"))
        (sound,) = connection.execute("PRAGMA integrity_check").fetchone()
    problems = [] if sound == "ok" else [f"the database is damaged: {sound}"]
    keys = Counter((line["session"], line["part"], line["number"]) for line in lines)
    problems += [f"there is more than one answer to {key}" for key, count in keys.items() if count > 1]
    by_session: dict[object, list[tuple[str, str, str]]] = {}
    for line in lines:  # in the order of the tasks
        picks = line["picks"]
        assert isinstance(picks, list)
        by_session.setdefault(line["session"], []).append((str(line["goal"]), picks[0], picks[1]))
    if len({person.code for person in people}) != len(people) or set(numbers.values()) < set(by_session):
        problems.append("codes or sessions are there twice")
    for person in people:
        session = numbers.get(hashlib.sha256(person.code.encode()).hexdigest())
        kept = by_session.pop(session, [])
        for number, given in person.acknowledged.items():
            if number >= len(kept):
                problems.append(f"person {session}: answer {number} was acknowledged and is lost")
            elif given != ("", "", "") and kept[number] != given:
                problems.append(f"person {session}: answer {number} was {given}, and {kept[number]} is kept")
        for number, one in enumerate(kept):
            if one not in person.sent.get(number, []):
                problems.append(f"person {session}: nobody gave the answer {number}, {one}")
    return problems + [f"session {session} is nobody's" for session in by_session]


def percentiles(seconds: list[float]) -> dict[str, float]:
    """Return milliseconds of requests."""
    ordered = sorted(seconds)
    return {f"p{share}": round(1000 * ordered[len(ordered) * share // 100], 2) for share in (50, 95, 99)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--graph", default="everyday")
    parser.add_argument("--people", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--kills", type=int, default=2)
    parser.add_argument("--tasks", type=int, default=20)
    parser.add_argument("--pause", type=float, default=0.5, help="seconds that somebody looks at a table, on average")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        out, port = Path(place) / "study", free_port()
        program = [sys.executable, "-m", "wordcraft_kg", "study"]
        settings = f"--tasks {arguments.tasks} --distractors 1,8 --forms 3 --port {port} --no-browser --json".split()
        command = [*program, "serve", arguments.graph, "--out", str(out), *settings]
        server = start(command)
        until = time.monotonic() + arguments.seconds
        seeds = range(arguments.seed, arguments.seed + arguments.people)
        clients = [Client(port, seed, until, arguments.pause) for seed in seeds]
        for client in clients:
            client.start()
        down = 0.0
        for _ in range(arguments.kills):
            time.sleep(arguments.seconds / (arguments.kills + 1))
            os.kill(server.pid, signal.SIGKILL)
            began = time.monotonic()
            server.communicate()
            server = start(command)
            down += time.monotonic() - began
        for client in clients:
            client.join(arguments.seconds + 60)
        server.send_signal(signal.SIGINT)
        _, said = server.communicate(timeout=30)
        subprocess.run([*program, "export", str(out), "--out", f"{place}/answers.jsonl"], check=True, stdout=2)
        lines = [json.loads(line) for line in Path(place, "answers.jsonl").read_text().splitlines()]
        people = [person for client in clients for person in client.people]
        problems = [f"a person could not go on: {client.problem}" for client in clients if client.problem]
        problems += ["a person did not end"] * sum(client.is_alive() for client in clients)
        if server.returncode != 0 or "stored in" not in said:
            problems.append(f"the server ended with {server.returncode}: {said}")
        problems += differences(people, out / "answers.sqlite", lines)
        with sqlite3.connect(out / "answers.sqlite") as connection:
            cells = connection.execute("SELECT COUNT(*) FROM sessions GROUP BY form, distractors")
            spread = [count for (count,) in cells]
        seconds = [value for client in clients for value in client.seconds]
        report = {
            "people": len(people),
            "finished": sum(person.is_finished for person in people),
            "in_a_cell": [min(spread), max(spread)],
            "answers": len(lines),
            "acknowledged": sum(len(person.acknowledged) for person in people),
            "sent": sum(len(sent) for person in people for sent in person.sent.values()),
            "interrupted_requests": sum(client.interruptions for client in clients),
            "seconds_down": round(down, 2),
            "answers_per_second": round(len(lines) / (arguments.seconds - down), 1),
            "requests_per_second": round(len(seconds) / (arguments.seconds - down), 1),
            "milliseconds": percentiles(seconds),
            "problems": problems[:20],
        }
        print(json.dumps(report, indent=2))
        return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
