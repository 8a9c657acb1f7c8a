"""A study as a web application: consent, tasks, answers.

The stored answers alone determine a person's progress: there is no session state in the server.
A repeated, late or resent form leads to the next page and never to a second answer. The server uses
only the code and the selected items of a request, and sets no cookie.
"""

import hashlib
import re
import secrets
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Mapping
from typing import Any
from urllib.parse import parse_qsl

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp

from wordcraft_kg.apps.people.answers_database import AnswersDatabase, Participant
from wordcraft_kg.apps.people.protocol import HUMAN_PARTS, PosedTask
from wordcraft_kg.apps.people.study import HumanStudy
from wordcraft_kg.apps.web.guard import Guard, file_endpoint
from wordcraft_kg.reports.pages import make_environment

PRIVATE = {"Cache-Control": "no-store"}
"""Headers of every page: the next person at the same machine must not see an earlier page."""
ALPHABET = "23456789abcdefghjkmnpqrstuvwxyz"
"""Letters of codes, without the similar characters 0 and o, 1, l and i."""
LENGTH = 12
"""Characters per code: about 59 bits, so that codes cannot be guessed over a network."""
GROUP = 4
"""Characters between two hyphens of a code, which are easier to copy by hand."""
NO_SESSION = (
    "There is no session with this code. Please check the code and enter it on the start page. "
    "After a withdrawal, all answers are removed and the code is no longer valid."
)
"""Shown for withdrawn sessions, too: their codes are not stored, so the server cannot tell."""
FAREWELLS: dict[str, dict[str, Any]] = {
    "declined": {
        "title": "Thank you",
        "heading": "Thank you for your time",
        "text": "You declined to participate, and no data were stored.",
    },
    "withdrawn": {
        "title": "Withdrawal complete",
        "heading": "You have withdrawn from the study",
        "text": "All your answers have been removed, and your code is no longer valid.",
    },
}
"""Pages for people who leave, by the end of their address."""
NO_CODE = (
    "There is no session with this code. A code consists of 12 letters and digits, such as "
    "k7qm-2xwd-9hrt."
)
Form = Mapping[str, str]
Reply = Callable[[Request, Form, str, Participant], Response]


def make_study_app(
    study: HumanStudy,
    answers: AnswersDatabase,
    host: str = "127.0.0.1",
    more_hosts: Collection[str] = (),
    *,
    clock: Callable[[], float] | None = None,
) -> ASGIApp:
    """Return the web application of a study.

    Args:
        study: tasks and texts.
        answers: database of the study's answers.
        host: host that the server listens on.
        more_hosts: further host names by which browsers may ask, as behind a proxy.
        clock: returns seconds that grow even across restarts; None for :func:`steady_clock`.
    """
    server = _Server(study, answers, clock or steady_clock())
    routes = [
        Route("/", server.first),
        Route("/begin", server.begin, methods=["POST"]),
        Route("/return", server.come_back, methods=["POST"]),
        Route("/declined", server.farewell("declined")),
        Route("/files/{name}", server.files),
        Route("/s/{code}", server.of_person(server.introduction)),
        Route("/s/{code}/task", server.of_person(server.task)),
        Route("/s/{code}/answer", server.of_person(server.answer), methods=["POST"]),
        Route("/s/{code}/feedback/{number}", server.of_person(server.feedback)),
        Route("/s/{code}/end", server.of_person(server.end)),
        Route("/s/{code}/withdraw", server.of_person(server.withdraw), methods=["POST"]),
        Route("/withdrawn", server.farewell("withdrawn")),
    ]
    # Sessions, answers and withdrawals need POST: a link or a preview cannot make one.
    return Guard(
        Router(routes, redirect_slashes=False, default=server.missing()),
        host,
        more_hosts,
        server.error,
        methods=("GET", "HEAD", "POST"),
    )


def steady_clock() -> Callable[[], float]:
    """Return a clock in seconds since 1970 that ignores later changes of the machine's time."""
    # Wall time only once: it makes times comparable after a restart, but may jump while running.
    began = time.time() - time.monotonic()
    return lambda: began + time.monotonic()


def new_code() -> str:
    """Return a random code to resume a session, such as ``k7qm-2xwd-9hrt``.

    Codes are never stored, only their hashes: who reads the database cannot continue a session.
    """
    return _grouped("".join(secrets.choice(ALPHABET) for _ in range(LENGTH)))


def read_code(typed: str) -> str:
    """Return a code that was typed with any capitals, blanks and dashes; "" if it is no code."""
    # Cut before anything else, so that a long text costs nothing.
    letters = re.sub(r"[\s\-–—._]", "", typed[:100]).lower()
    is_code = len(letters) == LENGTH and set(letters) <= set(ALPHABET)
    return _grouped(letters) if is_code else ""


def code_hash(code: str) -> str:
    """Return the hash that is stored in place of a session's code."""
    return hashlib.sha256(code.encode()).hexdigest()


def _grouped(letters: str) -> str:
    return "-".join(letters[start : start + GROUP] for start in range(0, LENGTH, GROUP))


class _Server:
    """The endpoints. Each of them may be asked at any time: in a second tab, late, or again."""

    def __init__(
        self, study: HumanStudy, answers: AnswersDatabase, clock: Callable[[], float]
    ) -> None:
        self.study = study
        self.answers = answers
        self.clock = clock
        self.environment = make_environment("wordcraft_kg.apps.people")
        self.environment.globals.update(
            study=study.record, paragraphs=study.record.consent.split("\n\n")
        )
        self.files = file_endpoint(
            "wordcraft_kg.apps.people", ("study.css", "study.js"), self.missing
        )

    async def first(self, _: Request) -> Response:
        return self._page("first", code=new_code(), problem="", typed="")

    def farewell(self, name: str) -> Callable[[Request], Response]:
        return lambda _: self._page("farewell", **FAREWELLS[name])

    async def begin(self, request: Request) -> Response:
        # The form contains the code, so a repeated form begins one session.
        form = await _form(request)
        if form.get("consent") == "no":
            return _to("/declined")
        code = read_code(form.get("code", ""))
        # Nothing but an explicit yes begins a session.
        if form.get("consent") != "yes" or not code:
            return _to("/")
        await run_in_threadpool(self.answers.begin, code_hash(code), self.study.cells)
        return _to(f"/s/{code}")

    async def come_back(self, request: Request) -> Response:
        typed = (await _form(request)).get("code", "").strip()[:100]
        code = read_code(typed)
        # No session has the hash of an empty code.
        if await run_in_threadpool(self.answers.find, code_hash(code)) is None:
            return self._page("first", 404, code=new_code(), problem=NO_CODE, typed=typed)
        return _to(f"/s/{code}")

    def of_person(self, reply: Reply) -> Callable[[Request], Awaitable[Response]]:
        """Return the endpoint that finds the person of a code, and lets ``reply`` answer."""

        async def endpoint(request: Request) -> Response:
            form = await _form(request) if request.method == "POST" else {}

            def replied() -> Response:
                code = read_code(request.path_params["code"])
                person = self.answers.find(code_hash(code))
                if person is None:
                    return self.missing(NO_SESSION)
                return reply(request, form, code, person)

            # In a thread: a reply waits for the disk; other people's pages must not wait with it.
            return await run_in_threadpool(replied)

        return endpoint

    def introduction(self, _: Request, __: Form, code: str, person: Participant) -> Response:
        answers = self.answers.answers_of(person)
        tasks = self.study.tasks(person.cell)
        if len(answers) == len(tasks):
            return _to(f"/s/{code}/end")
        return self._page(
            "introduction",
            code=code,
            given=len(answers),
            tasks=tasks,
            most=self.study.protocol(person.cell).most_picks,
        )

    def task(self, request: Request, _: Form, code: str, person: Participant) -> Response:
        tasks = self.study.tasks(person.cell)
        place = len(self.answers.answers_of(person))
        if place == len(tasks):
            return _to(f"/s/{code}/end")
        task = tasks[place]
        query = request.query_params
        if "first" in query:
            was_shown = self.answers.shown(person, task.part, task.number) is not None
            if query.get("task") != str(place) or not was_shown:
                # The item was selected at another task, as in a second tab or after going back.
                return _to(f"/s/{code}/task")
        elif request.method == "GET":
            # A reload after a first selection or an undo does not count as a page load.
            self.answers.show(person, task.part, task.number, self.clock())
        most_picks = self.study.protocol(person.cell).most_picks
        # Of a set, the numbers of all items so far.
        return self._page(
            "task",
            code=code,
            task=task,
            selection=_slots(query.get("first", ""), task, max(most_picks, 1)),
            most=most_picks,
            place=place,
            all=len(tasks),
        )

    def answer(self, _: Request, form: Form, code: str, person: Participant) -> Response:
        # Before anything else: waiting for the database is not the person's time.
        time = self.clock()
        tasks = self.study.tasks(person.cell)
        place = len(self.answers.answers_of(person))
        number = _number(form.get("task", ""))
        present_task = _to(f"/s/{code}/task")
        # A repeated form, as after a lost answer of the server: the first answer stays.
        if number is not None and number < place:
            return _after(code, tasks[number])
        if number != place or place == len(tasks):
            return present_task
        # Only a task that was shown has a time, and only the present one can be answered.
        task = tasks[place]
        shown = self.answers.shown(person, task.part, task.number)
        if shown is None:
            return present_task
        protocol = self.study.protocol(person.cell)
        picks = form.get("first", "")
        if not protocol.most_picks:
            picks += f",{form.get('second', '')}"
        slots = _slots(picks, task, protocol.most_picks or 2)
        if not slots:
            return present_task
        # After a restart, the clock may begin before the time of showing.
        self.answers.add(person, protocol.answer(task, slots, max(time - shown, 0.0)))
        return _after(code, task)

    def feedback(self, request: Request, _: Form, code: str, person: Participant) -> Response:
        tasks = self.study.tasks(person.cell)
        answers = self.answers.answers_of(person)
        # Train tasks come first, so their numbers are places. Only answered ones have a solution.
        number = _number(request.path_params["number"])
        place = -1 if number is None else number - 1
        if not 0 <= place < min(len(answers), self.study.record.tasks):
            return _to(f"/s/{code}/task")
        return self._page(
            "feedback",
            code=code,
            task=tasks[place],
            answer=answers[place],
            place=place + 1,
            all=len(tasks),
        )

    def withdraw(self, _: Request, __: Form, ___: str, person: Participant) -> Response:
        self.answers.withdraw(person)
        return _to("/withdrawn")

    def end(self, _: Request, __: Form, code: str, person: Participant) -> Response:
        answers = self.answers.answers_of(person)
        if len(answers) < len(self.study.tasks(person.cell)):
            return _to(f"/s/{code}/task")
        correct = Counter(answer.part for answer in answers if answer.success)
        tasks = self.study.record.tasks
        return self._page(
            "end", code=code, correct={part: (correct[part], tasks) for part in HUMAN_PARTS}
        )

    def _page(self, name: str, status: int = 200, **values: Any) -> Response:
        return Response(
            self._render(name, **values), status, media_type="text/html", headers=PRIVATE
        )

    def _render(self, name: str, **values: Any) -> str:
        return self.environment.get_template(f"{name}.html.j2").render(**values)

    def error(self, status: int, message: str) -> str:
        return self._render("error", status=status, message=message)

    def missing(self, message: str = "This page does not exist.") -> Response:
        return Response(self.error(404, message), 404, media_type="text/html", headers=PRIVATE)


async def _form(request: Request) -> dict[str, str]:
    """Return the fields of a form; empty for a damaged form, which then leads to the next page."""
    try:
        body = await request.body()
        # The limit of fields bounds the work that a hostile form causes.
        return dict(parse_qsl(body.decode(), keep_blank_values=True, max_num_fields=20))
    except (ValueError, ClientDisconnect):
        return {}


def _after(code: str, task: PosedTask) -> Response:
    """Lead to the page after an answer: the solution for a train task, else the next task."""
    if task.part == "train":
        return _to(f"/s/{code}/feedback/{task.number}")
    # After the last task, this page leads to the end.
    return _to(f"/s/{code}/task")


def _slots(text: str, task: PosedTask, most: int) -> tuple[int, ...]:
    """Return the slots for numbers from 1 in a form, with commas; none for other texts."""
    numbers = [_number(part) for part in text.split(",")] if text.isascii() else []
    if not 0 < len(numbers) <= most:
        return ()
    slots = [number - 1 for number in numbers if number and number <= len(task.table)]
    return tuple(slots) if len(slots) == len(numbers) else ()


def _number(text: str) -> int | None:
    # Python refuses to read very long numbers, and reading long ones takes long.
    return int(text) if text.isdecimal() and len(text) < 6 else None


def _to(path: str) -> Response:
    # 303: the browser requests the next page, and a reload does not resend the form.
    return RedirectResponse(path, 303, PRIVATE)
