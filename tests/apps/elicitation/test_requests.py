"""Requests to an endpoint: retries, refusals, stored answers, repetitions, and a key that is never shown."""

import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from wordcraft_kg.apps.elicitation.answers import Answers
from wordcraft_kg.apps.elicitation.config import ElicitationConfig, RequestConfig, checked_endpoint
from wordcraft_kg.apps.elicitation.endpoint import Endpoint
from wordcraft_kg.apps.elicitation.prompts import LISTED, make_prompts
from wordcraft_kg.apps.elicitation.requests import plan_requests, request_all
from wordcraft_kg.base.cache import cache_folder
from wordcraft_kg.base.errors import ConfigError, EndpointError
from wordcraft_kg.graphs.folder import open_graph

KEY = "sk-not-to-be-shown-0123456789"
NO_CREDITS = {"error": {"message": "you have no credits", "code": "insufficient_quota"}}


@pytest.fixture
def config(stand_in) -> Callable[..., ElicitationConfig]:
    return lambda **settings: ElicitationConfig("kitchen", stand_in.address, "oracle", RequestConfig(**settings))


def texts_of(config: ElicitationConfig, folder: str = "answers") -> list[str]:
    """Return the answers to all prompts, stored in a folder."""
    answers = Answers(Path(folder))
    plan = plan_requests(config, open_graph("kitchen").graph.entities, answers)
    return [answer.text for answer in request_all(plan, lambda: Endpoint(config), answers)]


@pytest.mark.parametrize("failure", [429, 408, 500, 502, 503, "half", "closed", "slow", "drip"])
def test_a_request_is_repeated_after_a_passing_failure(stand_in, config, failure):
    stand_in.failures = [failure, failure]
    texts = texts_of(config(goals_per_prompt=40, at_once=1, timeout=0.5))
    assert len(stand_in.bodies) == 2 + 2
    assert stand_in.bodies[0] == stand_in.bodies[1] == stand_in.bodies[2]
    assert len(texts) == 2
    assert all(": " in text for text in texts)


def test_the_wait_that_an_endpoint_asks_for_is_kept(stand_in, config):
    stand_in.failures, stand_in.retry_after = [429], "0.4"
    texts_of(config(goals_per_prompt=100))
    first, second = stand_in.times
    assert second - first > 0.4


def test_after_all_retries_answers_are_kept_and_the_same_command_goes_on(stand_in, config):
    settings = config(at_once=1, retries=2)
    stand_in.failures = ["", "", "", 500, 500, 500]
    with pytest.raises(EndpointError, match=r"status 500.*3 times.* 3 of 8 answers are stored"):
        texts_of(settings)
    assert len(stand_in.bodies) == 6
    assert len(texts_of(settings)) == 8
    assert len(stand_in.bodies) == 6 + 5


@pytest.mark.parametrize(
    ("failure", "set_up", "fragment"),
    [
        (401, {}, "a key is required"),
        (403, {}, "a key is required"),
        (404, {}, "end in /v1"),
        (400, {}, "`sampling` default"),
        (418, {}, "418"),
        *((status, {}, str(status)) for status in (301, 302, 307, 308)),
        ("large", {}, "more than 4,000,000 bytes"),
        ("bomb", {}, "malformed chat completion"),
        ("invalid", {}, "malformed chat completion"),
        ("schema", {}, "malformed chat completion"),
        (403, {"message": NO_CREDITS}, "no credit"),
        (429, {"retry_after": "86400"}, "is busy"),
    ],
)
def test_a_request_is_not_repeated_after_a_lasting_failure(stand_in, config, failure, set_up, fragment):
    stand_in.failures = [failure] * 20
    vars(stand_in).update(set_up)
    with pytest.raises(EndpointError, match=fragment):
        texts_of(config(at_once=1))
    assert len(stand_in.bodies) == 1


def test_an_address_without_a_server_is_an_error():
    with pytest.raises(EndpointError, match="is unreachable"):
        texts_of(ElicitationConfig("kitchen", "http://127.0.0.1:9/v1", "oracle"))


def test_several_prompts_are_under_way_at_once_and_no_more_than_configured(stand_in, config):
    stand_in.delay = 0.1
    texts_of(config(at_once=3))
    assert stand_in.most_at_once == 3


def test_prompts_contain_labels_and_no_recipe(opened, config):
    prompts = make_prompts(config(), opened.graph.entities)
    assert [goal for prompt in prompts for goal in prompt.goals] == list(opened.graph.entities)
    (system,) = {prompt.request.messages[0].content for prompt in prompts}  # one prefix, which servers cache
    words = "\n".join([system, *(prompt.request.messages[1].content for prompt in prompts)]).split("\n")
    assert [line for line in words if "+" in line] == ["item: first + second"]
    free = make_prompts(config(), [f"thing {number}" for number in range(LISTED + 1)])
    assert "thing 17" not in free[0].request.messages[0].content


def test_temperature_and_seed_are_sent_with_greedy_sampling_only(stand_in, config):
    texts_of(config(goals_per_prompt=100, seed=4))
    texts_of(config(goals_per_prompt=100, sampling="default"))
    greedy, default = stand_in.bodies
    assert (greedy["temperature"], greedy["seed"], greedy["path"]) == (0.0, 4, "/v1/chat/completions")
    assert not {"temperature", "seed"} & {*default}


def test_misplaced_and_damaged_answers_are_requested_again_with_a_warning(stand_in, config, caplog):
    texts = texts_of(config())
    files = sorted(Path("answers").iterdir())
    before = [path.read_bytes() for path in files]
    files[0].write_bytes(before[1])  # the answer to another prompt
    files[2].write_bytes(before[2][: len(before[2]) // 2])
    changes = ("text", "bread: water + salt"), ("model", "gpt"), ("finish", "length")
    for number, (field, value) in enumerate(changes, 3):
        edited = json.loads(before[number])
        edited["answer"][field] = value
        files[number].write_text(json.dumps(edited))
    files[6].write_bytes(before[6].replace(b"answer 2", b"answer 1"))
    stand_in.bodies.clear()
    assert texts_of(config()) == texts
    assert len(stand_in.bodies) == 6
    assert [path.read_bytes() for path in files] == before
    for fragment in ("answers another prompt", "is damaged", "was edited"):
        assert fragment in caplog.text


def test_an_answer_belongs_to_its_model_its_address_and_its_sampling(stand_in, config):
    first = config(goals_per_prompt=100)
    texts, elsewhere = texts_of(first), stand_in.address.replace("127.0.0.1", "localhost")
    others = (replace(first, model="another"), config(goals_per_prompt=100, seed=1), replace(first, endpoint=elsewhere))
    for number, other in enumerate(others, 2):
        assert texts_of(other) == texts
        assert len(stand_in.bodies) == number == len(list(Path("answers").iterdir()))


@contextmanager
def interrupted(stand_in, after: int, times: int = 1) -> Iterator[None]:
    """Send Ctrl-C once or several times after a number of requests."""

    def interrupt() -> None:
        while len(stand_in.bodies) < after:
            time.sleep(0.01)
        for _ in range(times):
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.4)

    thread = threading.Thread(target=interrupt)
    thread.start()
    yield
    thread.join()


def test_ctrl_c_keeps_every_answer_that_is_under_way(stand_in, ask):
    stand_in.delay = 0.15
    with interrupted(stand_in, after=4):
        outcome = ask("--yes", "--at-once", "2", "--goals-per-prompt", "5")
    kept = len(list(cache_folder("elicited").iterdir()))
    assert outcome.code == 130
    assert kept == len(stand_in.bodies) < 16
    assert f"interrupted; {kept} of 16 answers are stored" in outcome.err
    assert not Path("models").exists()
    stand_in.delay = 0.0
    assert ask("--yes", "--goals-per-prompt", "5").code == 0
    assert len(stand_in.bodies) == 16


def test_a_second_ctrl_c_waits_for_nothing(stand_in, ask):
    stand_in.delay = 3.0
    with interrupted(stand_in, after=1, times=2):
        outcome = ask("--yes", "--verbose")
        ended = time.monotonic()
    assert outcome.code == 130
    assert "interrupted; 0 of 8 answers are stored" in outcome.err
    assert ended - stand_in.times[0] < 2.5


@pytest.mark.parametrize("failures", [[], [401], [400], [429, 500, 418], ["schema"]])
def test_a_key_is_sent_and_never_written_or_shown(stand_in, home, monkeypatch, ask, failures):
    monkeypatch.setenv("OUR_KEY", KEY)
    stand_in.failures = list(failures)
    stand_in.message = {"error": {"message": f"you sent Bearer {KEY} to us", "code": KEY}}
    answer = stand_in.answer
    stand_in.answer = lambda goals: f"{answer(goals)}\nyour key is {KEY}"
    outcome = ask("--yes", "--verbose", "--key-variable", "OUR_KEY", "--at-once", 1, "--goals-per-prompt", 100)
    assert outcome.code == (1 if failures else 0)
    assert stand_in.headers[0]["authorization"] == f"Bearer {KEY}"
    assert KEY not in outcome.out + outcome.err
    written = [path for path in home.rglob("*") if path.is_file()]
    assert bool(written) == (not failures)
    assert not [path for path in written if KEY.encode() in path.read_bytes()]


def test_nothing_of_the_environment_is_sent_and_no_proxy_sees_a_request_over_http(stand_in, config, monkeypatch):
    for name in ("OPENAI_ORG_ID", "OPENAI_PROJECT_ID", "OPENAI_ADMIN_KEY"):
        monkeypatch.setenv(name, KEY)
    monkeypatch.setenv("OPENAI_CUSTOM_HEADERS", f"X-Other: {KEY}")
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    texts_of(config(goals_per_prompt=100))
    (headers,) = stand_in.headers
    assert KEY not in str(headers)
    assert not [name for name in headers if name.startswith(("openai", "x-"))]


def test_openais_key_goes_to_no_address_without_encryption_unless_it_is_named(stand_in, config, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    texts_of(config(goals_per_prompt=100), "a")
    assert KEY not in str(stand_in.headers)
    texts_of(config(goals_per_prompt=100, key_variable="OPENAI_API_KEY"), "b")
    assert stand_in.headers[1]["authorization"] == f"Bearer {KEY}"


@pytest.mark.parametrize("address", ["http://me:secret@host/v1", "http://host/v1?key=secret", "https://host/#secret"])
def test_an_address_that_may_contain_a_secret_is_refused_without_repeating_it(run, address):
    outcome = run("elicit", "kitchen", "--endpoint", address, "--model", "oracle")
    assert (outcome.code, outcome.kind, outcome.setting) == (1, "ConfigError", "endpoint")
    assert "secret" not in outcome.out + outcome.err


@pytest.mark.parametrize(
    "address", ["", "localhost:8080", "ftp://host/v1", "http://", "http://host:x/v1", "http://a b", "http://a..b"]
)
def test_a_malformed_address_is_refused(address):
    with pytest.raises(ConfigError, match="such as http://localhost:8080/v1"):
        checked_endpoint(address)


def test_a_key_in_place_of_its_variable_is_not_repeated(ask, stand_in, monkeypatch):
    monkeypatch.setenv("OUR_KEY", f"{KEY}\nX-Other: 1")
    for variable in (KEY, "abcdef0123456789", "OUR_KEY"):
        outcome = ask("--yes", "--key-variable", variable)
        assert (outcome.code, outcome.kind, outcome.setting) == (1, "ConfigError", "key_variable")
        assert not [secret for secret in (KEY, "abcdef0123456789") if secret in outcome.out + outcome.err]
    assert not stand_in.bodies
