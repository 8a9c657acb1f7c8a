"""A study's pages as a browser gets them: consent, tasks, answers once, and nothing about the
person."""

import re
from contextlib import contextmanager
from html import unescape

import pytest
from starlette.testclient import TestClient

from tests.apps.people.stored import lines_of
from wordcraft_kg.apps.people.study import HumanStudy, kept_answers, read_study
from wordcraft_kg.apps.people.study_config import StudyConfig
from wordcraft_kg.apps.people.web_app import code_hash, make_study_app
from wordcraft_kg.apps.web.guard import HEADERS, LONGEST_BODY

CODE = "k7qm-2xwd-9hrt"
CONSENT = "Do you <b>agree</b>?\n\nSecond & last\nline."


class Browser:
    """A person's browser, and a clock that the server reads."""

    def __init__(self, study, answers, folder):
        self.study, self.answers, self.folder, self.now = study, answers, folder, 1_000.0
        self.app = make_study_app(study, answers, clock=lambda: self.now)
        self.client = TestClient(self.app, base_url="http://localhost:8766")
        self.place = self.page = ""
        self.status = 0

    def get(self, path):
        """Load a page, and follow where it leads."""
        return self._follow(self.client.get(path))

    def post(self, path, form, **headers):
        return self._follow(self.client.post(path, data=form, headers=headers))

    def see(self, pattern, path):
        match = re.search(pattern, self.get(path))
        assert match is not None, self.page
        return match[1]

    def _follow(self, answer):
        self.place, self.status, self.page = answer.url.path, answer.status_code, answer.text
        return self.page

    def new_code(self):
        return self.see(r'name="code" value="([^"]+)"', "/")

    def begin(self):
        """Agree; return the code."""
        code = self.new_code()
        self.post("/begin", {"consent": "yes", "code": code})
        assert self.place == f"/s/{code}"
        return code

    def answer(self, code, first, second, place=None):
        """Answer the task that the page shows, or another."""
        number = self.given(code) if place is None else place
        return self.post(
            f"/s/{code}/answer", {"task": str(number), "first": str(first), "second": str(second)}
        )

    def take(self, code, first, second):
        """Load the next task, and answer it."""
        self.get(f"/s/{code}/task")
        return self.answer(code, first, second)

    def given(self, code):
        return len(self.answers.answers_of(self.person(code)))

    def person(self, code):
        return self.answers.find(code_hash(code))

    def people(self):
        return len(read_study(self.folder))

    def lines(self):
        return lines_of(self.folder)


@contextmanager
def browsing(study, folder):
    with kept_answers(folder, study) as answers:
        yield Browser(study, answers, folder)


@pytest.fixture(scope="module")
def study(kitchen):
    return HumanStudy(kitchen, StudyConfig(tasks=2, distractors=(8,), forms=2, consent=CONSENT))


@pytest.fixture
def browser(study, tmp_path):
    with browsing(study, tmp_path / "study") as browser:
        yield browser


@pytest.fixture
def code(browser):
    """The code of somebody who has begun."""
    return browser.begin()


def test_the_consent_text_is_shown_as_text_in_its_paragraphs(browser):
    shown = re.findall(r"<p>(.*?)</p>", browser.get("/"), re.DOTALL)
    assert shown[:2] == ["Do you &lt;b&gt;agree&lt;/b&gt;?", "Second &amp; last\nline."]


@pytest.mark.parametrize(
    ("consent", "code", "place"),
    [
        ("", "", "/"),
        ("yes", "", "/"),
        ("maybe", CODE, "/"),
        ("yes", "mine", "/"),
        ("no", CODE, "/declined"),
    ],
)
def test_only_an_explicit_yes_begins_a_session(browser, consent, code, place):
    page = browser.post("/begin", {"consent": consent, "code": code})
    assert browser.place == place
    assert ("no data were stored" in page) == (consent == "no")
    assert browser.people() == 0


def test_the_code_is_shown_at_the_start_and_at_the_end_and_leads_back(browser, code):
    assert f">{code}<" in browser.page
    assert "The second selection is final" in browser.page
    browser.take(code, 1, 2)
    page = browser.post("/return", {"code": code.upper().replace("-", " ")})
    assert browser.place == f"/s/{code}"
    assert "Welcome back" in page
    assert "1 of 4 tasks completed" in page
    for _ in range(3):
        browser.take(code, 1, 2)
    assert browser.place == f"/s/{code}/end"
    assert f">{code}<" in browser.page
    assert "Thank you for participating" in browser.post("/return", {"code": code})


def test_who_withdraws_leaves_nothing_behind_and_nobody_gets_their_place(browser):
    stays, leaves = browser.begin(), browser.begin()
    for code in (stays, leaves):
        browser.take(code, 1, 2)
    number = browser.person(leaves).number
    assert [line.session for line in browser.lines()].count(number) == 1
    assert f'action="/s/{leaves}/withdraw"' in browser.get(f"/s/{leaves}")
    assert "You have withdrawn" in browser.post(f"/s/{leaves}/withdraw", {})
    assert [line.session for line in browser.lines()] == [browser.person(stays).number]
    assert browser.people() == 1
    answer = {"task": "0", "first": "1", "second": "2"}
    for page in (browser.get(f"/s/{leaves}/task"), browser.post(f"/s/{leaves}/answer", answer)):
        assert browser.status == 404
        assert "After a withdrawal, all answers are removed" in page
        assert not re.search("safe|stored|kept", page)
    assert browser.person(browser.begin()).number > number
    browser.answers.close()
    content = b"".join(path.read_bytes() for path in browser.folder.iterdir())
    assert code_hash(stays).encode() in content
    assert code_hash(leaves).encode() not in content, "it is overwritten, not only unlinked"


@pytest.mark.parametrize(
    ("typed", "status", "said"),
    [
        (CODE, 404, "There is no session with this code"),
        ("<b>", 404, "12 letters"),
        ("", 404, "12 letters"),
    ],
)
def test_a_code_that_leads_nowhere_is_answered_on_the_first_page(browser, typed, status, said):
    page = browser.post("/return", {"code": typed})
    assert (browser.status, browser.place) == (status, "/return")
    assert said in page
    assert "<b>" not in page.replace(CONSENT, "")
    assert "Yes, I agree" in page


@pytest.mark.parametrize("path", ["", "/task", "/feedback/1", "/end"])
def test_a_session_that_is_not_there_is_not_found(browser, path):
    for code in ("k7qm-2xwd-9hrt", "nonsense", "..%2f..", "%00"):
        assert "Traceback" not in browser.get(f"/s/{code}{path}")
        assert browser.status == 404


def test_a_person_gets_the_tasks_with_answers_in_practice_only(browser, study, code):
    right = {"train": 0, "test": 0}
    for place, task in enumerate(study.tasks(browser.person(code).cell)):
        assert unescape(browser.see(r'class="goal">([^<]*)<', f"/s/{code}/task")) == task.goal
        page = browser.page
        labels = [unescape(label) for label in re.findall(r'class="label">([^<]*)<', page)]
        assert labels == list(task.table)
        assert f"{'Practice' if task.part == 'train' else 'Test'} task {task.number} of 2" in page
        assert f'value="{place}" max="4"' in page
        one, other = (labels.index(label) + 1 for label in task.plans[0][:2])
        held = browser.get(f"/s/{code}/task?task={place}&first={one}")
        assert f"<strong>{labels[one - 1]}</strong>" in held
        is_right = place % 2 == 0
        shown = browser.answer(
            code, one, other if is_right else next(i for i in range(1, 9) if i not in (one, other))
        )
        if task.part == "train":
            assert browser.place == f"/s/{code}/feedback/{task.number}"
            assert ("Correct: " in shown, "Incorrect: " in shown) == (is_right, not is_right)
            assert ("solution: " in shown.lower()) == (not is_right)
        else:
            assert browser.place == f"/s/{code}/{'task' if place < 3 else 'end'}"
            assert "ight: " not in shown
        right[task.part] += browser.lines()[-1].success
    assert right == {"train": 1, "test": 1}
    assert browser.page.count("1 of 2 correct") == 2


def test_how_many_are_right_is_said_at_the_end_only(browser, code):
    for _ in range(3):
        browser.take(code, 1, 1)
        for path in ("", "/task", "/end", "/feedback/1", "/feedback/2", "/feedback/3"):
            assert not re.search(r"\d of \d correct", browser.get(f"/s/{code}{path}"))
            assert not browser.place.endswith(("/end", "/feedback/3"))
    browser.take(code, 1, 1)
    assert re.search(r"\d of 2 correct", browser.get(f"/s/{code}/task"))
    assert browser.place == f"/s/{code}/end"


def test_the_answer_of_a_task_is_not_shown_before_it_was_answered(browser, code):
    for number in (0, 1, 2, 99, 10**30, "9" * 5_000, "x", "²"):
        browser.get(f"/s/{code}/feedback/{number}")
        assert (browser.status, browser.place) == (200, f"/s/{code}/task")
    browser.answer(code, 1, 2)
    for number, place in ((1, "feedback/1"), (2, "task")):
        browser.get(f"/s/{code}/feedback/{number}")
        assert browser.place == f"/s/{code}/{place}"


# A second tab, or the browser after going back, still shows another task.
STALE = ("task=0&first=3", "first=3", "task=2&first=3", "task=x&first=3")
NO_SLOT = ("", "0", "11", "-1", "1.0", "x", "²", "٣", "9" * 5_000)


def test_a_first_pick_that_is_none_or_at_another_table_is_no_pick(browser, code):
    browser.take(code, 1, 1)
    assert ">Undo<" not in browser.get(f"/s/{code}/task")
    assert ">Undo<" in browser.get(f"/s/{code}/task?task=1&first=3")
    no_slots = [f"task=1&first={held}" for held in NO_SLOT]
    for query in (*STALE, *no_slots, "task=1&first=1&first=2"):
        page = browser.get(f"/s/{code}/task?{query}")
        assert (browser.status, browser.place) == (200, f"/s/{code}/task"), query
        assert ("Select the first item" in page) == ("first=1&" not in query), query


def test_a_table_is_not_seen_before_its_time_begins(browser, code):
    browser.get(f"/s/{code}/task?task=0&first=1")
    browser.now += 7
    browser.answer(code, 1, 1)
    assert [line.seconds for line in browser.lines()] == [7.0]


def test_time_goes_from_showing_to_second_pick(browser, code):
    """Time goes from the first showing to the second pick and loads are counted."""
    browser.get(f"/s/{code}/task")
    browser.now += 10
    browser.get(f"/s/{code}/task")  # a reload
    browser.client.head(f"/s/{code}/task")
    browser.now += 2.25
    for held in ("1", "", "2"):
        browser.get(f"/s/{code}/task?task=0&first={held}")
    browser.now += 1
    browser.answer(code, 2, 1)
    browser.now += 50  # looks at the answer
    browser.get(f"/s/{code}/task")
    browser.now -= 5  # the machine's clock was put right
    browser.answer(code, 1, 1)
    assert [(line.seconds, line.loads) for line in browser.lines()] == [(13.25, 2), (0.0, 1)]


def test_a_double_click_and_a_form_sent_again_are_one_answer(browser, code):
    browser.take(code, 1, 2)
    first = browser.lines()
    for second in (2, 5):
        page = browser.answer(code, 1, second, place=0)
        assert browser.place == f"/s/{code}/feedback/1"
        assert f"{first[0].actions[0]} + {first[0].actions[1]} makes" in unescape(page)
    assert browser.lines() == first


NO_ANSWERS = (
    ("", "", ""),
    ("0", "", ""),
    ("0", "1", ""),
    ("0", "0", "1"),
    ("0", "1", "11"),
    ("1", "1", "2"),
    *((task, "1", "2") for task in ("99999999", "-1", "x", "²", "9" * 5_000)),
)
"""Task, first and second item as a form sends them."""


def test_a_form_that_is_no_answer_to_this_task_leads_back_to_it(browser, code):
    browser.answer(code, 1, 2)  # a task that was not shown
    assert (browser.place, browser.lines()) == (f"/s/{code}/task", [])
    for answer in NO_ANSWERS:
        form = dict(zip(("task", "first", "second"), answer, strict=True))
        browser.post(f"/s/{code}/answer", {name: value for name, value in form.items() if value})
        shown = (browser.status, browser.place, browser.lines())
        assert shown == (200, f"/s/{code}/task", []), answer


def test_nothing_of_a_request_is_stored_and_no_cookie_is_set(browser):
    browser.client.headers.update(
        {"User-Agent": "Mozilla-of-Ada", "X-Forwarded-For": "203.0.113.77", "Cookie": "a=b"}
    )
    code = browser.begin()
    answer = browser.client.get(f"/s/{code}/task")
    browser.answer(code, 1, 2)
    assert "set-cookie" not in answer.headers
    data = b"".join(path.read_bytes() for path in browser.folder.iterdir())
    for private in (b"Mozilla-of-Ada", b"203.0.113.77", b"testclient", code.encode()):
        assert private not in data


def test_every_page_is_kept_by_no_browser_and_has_the_headers_of_the_guard(browser, code):
    for path in (
        "/",
        "/declined",
        f"/s/{code}",
        f"/s/{code}/task",
        f"/s/{code}/end",
        "/nowhere",
        "/s/nobody/task",
    ):
        answer = browser.client.get(path)
        assert answer.headers["cache-control"] == "no-store", path
        assert HEADERS.items() <= {name: answer.headers.get(name) for name in HEADERS}.items()
        for forbidden in ("style=", "<style", "onclick", "http://", "https://"):
            assert forbidden not in answer.text
        assert re.findall(r"<script[^>]*>([^<]*)</script>", answer.text) in ([""], [])


def test_forms_of_other_sites_and_other_hosts_are_refused(browser, code):
    browser.get(f"/s/{code}/task")
    form = {"task": "0", "first": "1", "second": "2"}
    consent = {"consent": "yes", "code": CODE}
    for path, values in (
        (f"/s/{code}/answer", form),
        ("/begin", consent),
        (f"/s/{code}/withdraw", {}),
    ):
        for origin in (
            "http://evil.example",
            "http://localhost:1",
            "http://localhost",
            "http://[",
            "null",
        ):
            assert (
                browser.client.post(path, data=values, headers={"Origin": origin}).status_code
                == 403
            )
        assert (
            browser.client.post(path, data=values, headers={"Host": "evil.example"}).status_code
            == 421
        )
    assert browser.lines() == []
    assert browser.people() == 1
    assert (
        browser.client.post("/begin", data={}, headers={"Origin": "http://localhost:8766"}).url.path
        == "/"
    )


def test_what_is_too_long_or_of_another_method_is_refused(browser, code):
    for content in (
        b"x" * (LONGEST_BODY + 1),
        (b"x" * 1_000 for _ in range(100)),
    ):  # its length is said or not
        assert browser.client.post(f"/s/{code}/answer", content=content).status_code == 413
    assert browser.client.put("/begin").status_code == 405
    for path in ("/begin", "/return", f"/s/{code}/answer", f"/s/{code}/withdraw"):
        assert browser.client.get(path).status_code in (404, 405)
    for content in (b"\xff\xfe", b"=&=&;", b"task=%ff&first=1", b"&" * 1_000, b"a=1&" * 1_000):
        assert (
            browser.client.post(f"/s/{code}/answer", content=content).url.path == f"/s/{code}/task"
        )


def test_an_error_within_shows_nothing_of_itself(browser, code, monkeypatch):
    def fail(*_):
        raise RuntimeError("the secret of line 42")

    monkeypatch.setattr(browser.answers, "answers_of", fail)
    page = browser.get(f"/s/{code}/task")
    assert browser.status == 500
    assert "secret" not in page
    assert "Answers that were stored before are kept" in page


def test_a_person_selects_the_items_of_a_set_and_combines_them(tmp_path):
    settings = StudyConfig(tasks=2, distractors=(1,), forms=1, consent=CONSENT)
    study = HumanStudy("examples/kitchen-sets.csv", settings)
    with browsing(study, tmp_path / "study") as browser:
        code = browser.begin()
        assert "at most 6" in browser.page
        person = browser.person(code)
        task = study.tasks(person.cell)[0]
        slots = [task.table.index(label) + 1 for label in task.plans[0].ingredients]
        browser.get(f"/s/{code}/task")
        assert "Combine" not in browser.page
        for number in range(1, len(slots) + 1):
            first = ",".join(map(str, slots[:number]))
            assert f'name="first" value="{first}"' in browser.page
            browser.get(f"/s/{code}/task?task=0&first={first}")
        # Numbers beyond the table, too many, and none are no answers.
        for wrong in ("", "0", "1,99", "1,1,1,1,1,1,1", "1,,2"):
            browser.post(f"/s/{code}/answer", {"task": "0", "first": wrong})
            assert browser.given(code) == 0
        browser.post(f"/s/{code}/answer", {"task": "0", "first": first})
        (answer,) = browser.answers.answers_of(person)
        assert answer.success
        assert sorted(answer.actions) == list(task.plans[0].ingredients)
        assert "Correct" in browser.page
