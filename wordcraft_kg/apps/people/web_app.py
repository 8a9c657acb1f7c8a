"""A study as a web application: consent, tasks, answers. The answers alone determine a person's progress.

A repeated, late or resent form leads to the next page and never to a second answer. The server uses only the code and
the selected items of a request, and sets no cookie.
"""

import hashlib
import re
import secrets
import time
from collections.abc import Awaitable, Callable, Collection, Mapping
from typing import Any
from urllib.parse import parse_qsl

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route, Router
from starlette.types import ASGIApp, Receive, Scope, Send

from wordcraft_kg.apps.people.answers_database import AnswersDatabase, Participant
from wordcraft_kg.apps.people.protocol import HUMAN_PARTS, PosedTask
from wordcraft_kg.apps.people.study import Study
from wordcraft_kg.apps.web.files import file_endpoint
from wordcraft_kg.apps.web.guard import Guard
from wordcraft_kg.reports.pages import make_environment

PRIVATE = {"Cache-Control": "no-store"}
"""Headers of every page: the next person at the same machine must not see an earlier page."""
ALPHABET = "23456789abcdefghjkmnpqrstuvwxyz"
"""Letters of codes, without the similar characters 0 and o, 1, l and i."""
LENGTH, GROUP = 12, 4
"""Characters per code (about 59 bits), and per group."""
NO_SESSION = (
    "There is no session with this code. Please check the code and enter it on the start page. "
    "After a withdrawal, all answers are removed and the code is no longer valid."
)
"""Shown at the address of a withdrawn session, too: its code is not stored, so the server cannot tell."""
NOT_A_CODE = "A code consists of 12 letters and digits, such as k7qm-2xwd-9hrt."
Form = Mapping[str, str]
Endpoint = Callable[[Request], Awaitable[Response]]
Reply = Callable[[Request, Form, str, Participant], Response]


def make_study_app(
    study: Study,
    answers: AnswersDatabase,
    host: str = "127.0.0.1",
    more_hosts: Collection[str] = (),
    *,
    clock: Callable[[], float] | None = None,
) -> ASGIApp:
    """Return the application for a host and further host names; the clock counts seconds, even across restarts."""
    server = _Server(study, answers, clock or steady_clock())
    routes = [
        Route("/", server.first),
        Route("/begin", server.begin, methods=["POST"]),
        Route("/return", server.come_back, methods=["POST"]),
        Route("/declined", server.text("declined")),
        Route("/files/{name}", server.files),
        Route("/s/{code}", server.of_person(server.introduction)),
        Route("/s/{code}/task", server.of_person(server.task)),
        Route("/s/{code}/answer", server.of_person(server.answer), methods=["POST"]),
        Route("/s/{code}/feedback/{number}", server.of_person(server.feedback)),
        Route("/s/{code}/end", server.of_person(server.end)),
        Route("/s/{code}/withdraw", server.of_person(server.withdraw), methods=["POST"]),
        Route("/withdrawn", server.text("withdrawn")),
    ]
    router = Router(routes, redirect_slashes=False, default=server.not_found)
    return Guard(router, host, more_hosts, server.error, methods=("GET", "HEAD", "POST"))


def steady_clock() -> Callable[[], float]:
    """Return a clock in seconds since 1970 that ignores later changes of the machine's time."""
    began = time.time() - time.monotonic()
    return lambda: began + time.monotonic()


def new_code() -> str:
    """Return a random code to resume a session, such as ``k7qm-2xwd-9hrt``; codes are never stored."""
    return _grouped("".join(secrets.choice(ALPHABET) for _ in range(LENGTH)))


def read_code(typed: str) -> str | None:
    """Return a session's code, typed with any capitals, blanks and dashes; None if the text is not a code."""
    letters = re.sub(r"[\s\-–—._]", "", typed[:100]).lower()
    is_code = len(letters) == LENGTH and set(letters) <= set(ALPHABET)
    return _grouped(letters) if is_code else None


def code_hash(code: str) -> str:
    """Return the hash that is stored in place of a session's code."""
    return hashlib.sha256(code.encode()).hexdigest()


def _grouped(letters: str) -> str:
    return "-".join(letters[start : start + GROUP] for start in range(0, LENGTH, GROUP))


class _Server:
    def __init__(self, study: Study, answers: AnswersDatabase, clock: Callable[[], float]) -> None:
        self.study, self.answers, self.clock = study, answers, clock
        self.environment = make_environment("wordcraft_kg.apps.people")
        self.environment.globals.update(
            study=study.record, paragraphs=study.record.consent.split("\n\n")
        )
        self.files = file_endpoint(
            "wordcraft_kg.apps.people", ("study.css", "study.js"), self._missing
        )

    async def first(self, _: Request) -> Response:
        return self._page("first", code=new_code(), problem="", typed="")

    def text(self, name: str) -> Callable[[Request], Response]:
        return lambda _: self._page(name)

    async def begin(self, request: Request) -> Response:
        # The form contains the code, so a repeated form begins one session.
        form = await _form(request)
        if form.get("consent") == "no":
            return _to("/declined")
        code = read_code(form.get("code", ""))
        if form.get("consent") != "yes" or code is None:
            return _to("/")
        await run_in_threadpool(self.answers.begin, code_hash(code), self.study.cells)
        return _to(f"/s/{code}")

    async def come_back(self, request: Request) -> Response:
        typed = (await _form(request)).get("code", "").strip()[:100]
        code = read_code(typed)
        if (
            code is not None
            and await run_in_threadpool(self.answers.find, code_hash(code)) is not None
        ):
            return _to(f"/s/{code}")
        problem = "There is no session with this code." if code else NOT_A_CODE
        return self._page(
            "first", 404 if code else 400, code=new_code(), problem=problem, typed=typed
        )

    def of_person(self, reply: Reply) -> Endpoint:
        async def endpoint(request: Request) -> Response:
            form = await _form(request) if request.method == "POST" else {}

            def replied() -> Response:
                code = read_code(request.path_params["code"])
                person = None if code is None else self.answers.find(code_hash(code))
                if code is None or person is None:
                    return self._missing(NO_SESSION)
                return reply(request, form, code, person)

            return await run_in_threadpool(replied)  # waits for the database

        return endpoint

    def introduction(self, _: Request, __: Form, code: str, person: Participant) -> Response:
        given, tasks = self.answers.answers_of(person), self.study.tasks(person.cell)
        if len(given) == len(tasks):
            return _to(f"/s/{code}/end")
        return self._page("introduction", code=code, given=len(given), tasks=tasks)

    def task(self, request: Request, _: Form, code: str, person: Participant) -> Response:
        tasks, place = self.study.tasks(person.cell), len(self.answers.answers_of(person))
        if place == len(tasks):
            return _to(f"/s/{code}/end")
        task, query = tasks[place], request.query_params
        if "first" in query and (
            query.get("task") != str(place)
            or self.answers.shown(person, task.part, task.number) is None
        ):
            # The item was selected at another task, as in a second tab or after going back.
            return _to(f"/s/{code}/task")
        selection = _slot(query.get("first", ""), task)
        # A reload after a first selection or an undo does not count as a page load.
        if "first" not in query and request.method == "GET":
            self.answers.show(person, task.part, task.number, self.clock())
        return self._page(
            "task", code=code, task=task, selection=selection, place=place, all=len(tasks)
        )

    def answer(self, _: Request, form: Form, code: str, person: Participant) -> Response:
        now = self.clock()
        tasks, place = self.study.tasks(person.cell), len(self.answers.answers_of(person))
        number = _number(form.get("task", ""))
        if number is None:
            number = -1
        if number < place:  # a repeated form
            return self._after(code, tasks, number) if number >= 0 else _to(f"/s/{code}/task")
        task = tasks[number] if number == place < len(tasks) else None
        shown = None if task is None else self.answers.shown(person, task.part, task.number)
        if task is None or shown is None:
            return _to(f"/s/{code}/task")
        first, second = (_slot(form.get(name, ""), task) for name in ("first", "second"))
        if first is None or second is None:
            return _to(f"/s/{code}/task")
        answer = self.study.protocol(person.cell).answer(
            task, (first, second), max(now - shown, 0.0)
        )
        self.answers.add(person, answer)
        return self._after(code, tasks, number)

    def _after(self, code: str, tasks: tuple[PosedTask, ...], place: int) -> Response:
        task = tasks[place]
        if task.part == "train":
            return _to(f"/s/{code}/feedback/{task.number}")
        return _to(f"/s/{code}/{'task' if place + 1 < len(tasks) else 'end'}")

    def feedback(self, request: Request, _: Form, code: str, person: Participant) -> Response:
        tasks, given = self.study.tasks(person.cell), self.answers.answers_of(person)
        number = _number(request.path_params["number"])
        if number is None or not 1 <= number <= min(len(given), self.study.record.tasks):
            return _to(f"/s/{code}/task")
        task, answer = tasks[number - 1], given[number - 1]
        return self._page(
            "feedback", code=code, task=task, answer=answer, place=number, all=len(tasks)
        )

    def withdraw(self, _: Request, __: Form, ___: str, person: Participant) -> Response:
        self.answers.withdraw(person)
        return _to("/withdrawn")

    def end(self, _: Request, __: Form, code: str, person: Participant) -> Response:
        given = self.answers.answers_of(person)
        if len(given) < len(self.study.tasks(person.cell)):
            return _to(f"/s/{code}/task")
        correct = {
            part: [answer.success for answer in given if answer.part == part]
            for part in HUMAN_PARTS
        }
        return self._page(
            "end",
            code=code,
            correct={part: (sum(made), len(made)) for part, made in correct.items()},
        )

    def _page(self, name: str, status: int = 200, **values: Any) -> Response:
        return Response(
            self._render(name, **values), status, media_type="text/html", headers=PRIVATE
        )

    def _render(self, name: str, **values: Any) -> str:
        return self.environment.get_template(f"{name}.html.j2").render(**values)

    def error(self, status: int, message: str) -> str:
        if status == 500:  # participants must not see the log
            message = "Something went wrong. Please reload the page."
        return self._render("error", status=status, message=message)

    def _missing(self, message: str = "This page does not exist.") -> Response:
        return Response(self.error(404, message), 404, media_type="text/html", headers=PRIVATE)

    async def not_found(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._missing()(scope, receive, send)


async def _form(request: Request) -> dict[str, str]:
    try:
        body = await request.body()
        return dict(parse_qsl(body.decode(), keep_blank_values=True, max_num_fields=20))
    except (ValueError, ClientDisconnect):
        return {}


def _slot(text: str, task: PosedTask) -> int | None:
    number = _number(text)
    return number - 1 if number is not None and 1 <= number <= len(task.table) else None


def _number(text: str) -> int | None:
    """Return a number of at most five digits; None for another text.

    Python raises a ValueError for a number of very many digits.
    """
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 6 else None


def _to(path: str) -> Response:
    # 303: the browser requests the next page, and a reload does not resend the form.
    return RedirectResponse(path, 303, PRIVATE)
