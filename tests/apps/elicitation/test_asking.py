"""Asking an endpoint: retries, refusals, what is kept, what is asked again, and that a key is never said."""

import json
import signal
import threading
import time
from pathlib import Path

import pytest
from stand_in import StandIn

from wordcraft_kg.apps.elicitation.answers import Answers
from wordcraft_kg.apps.elicitation.asking import ask_all, plan_asking
from wordcraft_kg.apps.elicitation.config import AskingConfig, OpinionsConfig, checked_endpoint
from wordcraft_kg.apps.elicitation.endpoint import Endpoint
from wordcraft_kg.apps.elicitation.prompts import LISTED, make_prompts
from wordcraft_kg.base.cache import cache_folder
from wordcraft_kg.base.errors import ConfigError, EndpointError

KEY = "sk-not-to-be-said-0123456789"


def config_of(stand_in: StandIn, **settings: object) -> OpinionsConfig:
    return OpinionsConfig("kitchen", stand_in.address, "oracle", AskingConfig(**settings))  # type: ignore[arg-type]


def asked_by(config: OpinionsConfig, folder: Path) -> list[str]:
    from wordcraft_kg.graphs.folder import open_graph

    answers = Answers(folder)
    plan = plan_asking(config, open_graph("kitchen").graph.entities, answers)
    return [answer.text for answer in ask_all(plan, lambda: Endpoint(config), answers)]


@pytest.mark.parametrize("failure", [429, 408, 500, 502, 503, "half", "closed", "slow"])
def test_what_may_pass_is_asked_again(stand_in, home, failure):
    stand_in.failures = [failure, failure]
    texts = asked_by(config_of(stand_in, goals_per_prompt=40, at_once=1, timeout=0.3), home / "answers")
    assert len(stand_in.asked) == 2 + 2
    assert stand_in.asked[0] == stand_in.asked[1] == stand_in.asked[2]
    assert len(texts) == 2
    assert all(": " in text for text in texts)


def test_the_wait_that_an_endpoint_asks_for_is_kept(stand_in, home):
    stand_in.failures, stand_in.retry_after = [429], "0.4"
    asked_by(config_of(stand_in, goals_per_prompt=100), home / "answers")
    first, second = stand_in.times
    assert second - first > 0.4


def test_after_all_retries_what_is_answered_is_kept_and_the_same_command_goes_on(stand_in, home):
    config = config_of(stand_in, at_once=1, retries=2)
    stand_in.failures = ["", "", "", 500, 500, 500]
    with pytest.raises(EndpointError, match=r"status 500.*3 times.* 3 of 8 prompts are answered and kept"):
        asked_by(config, home / "answers")
    assert len(stand_in.asked) == 6
    assert len(asked_by(config, home / "answers")) == 8
    assert len(stand_in.asked) == 6 + 5


NO_CREDITS = {"error": {"message": "you have no credits", "code": "insufficient_quota"}}


@pytest.mark.parametrize(
    ("failure", "set_up", "told"),
    [
        (401, {}, "it needs a key"),
        (403, {}, "it needs a key"),
        (404, {}, "end in /v1"),
        (400, {}, "`sampling` default"),
        (418, {}, "418"),
        (307, {}, "307"),
        ("invalid", {}, "no answer of a chat"),
        ("schema", {}, "no answer of a chat"),
        (403, {"said": NO_CREDITS}, "no money left"),
        (429, {"retry_after": "86400"}, "is busy"),
    ],
)
def test_what_will_not_pass_is_asked_once(stand_in, home, failure, set_up, told):
    stand_in.failures = [failure] * 20
    vars(stand_in).update(set_up)
    with pytest.raises(EndpointError, match=told):
        asked_by(config_of(stand_in, at_once=1), home / "answers")
    assert len(stand_in.asked) == 1


def test_an_address_at_which_nothing_listens_is_said(home):
    config = OpinionsConfig("kitchen", "http://127.0.0.1:9/v1", "oracle")
    with pytest.raises(EndpointError, match="nothing answers there"):
        asked_by(config, home / "answers")


def test_counts_of_tokens_that_are_none_are_left_out(stand_in, home):
    stand_in.tokens = 10**400
    answers = Answers(home / "answers")
    config = config_of(stand_in, goals_per_prompt=100)
    asked_by(config, answers.folder)
    (kept,) = (json.loads(path.read_bytes())["answer"] for path in answers.folder.iterdir())
    assert (kept["tokens_in"], kept["tokens_out"]) == (None, 5)


def test_several_prompts_are_under_way_at_once_and_no_more_than_asked_for(stand_in, home):
    stand_in.delay = 0.1
    asked_by(config_of(stand_in, at_once=3), home / "answers")
    assert stand_in.most_at_once == 3


def test_prompts_hold_labels_and_no_recipe_and_are_the_same_for_any_split(opened, stand_in):
    config = config_of(stand_in)
    prompts = make_prompts(config, opened.graph.entities)
    assert [goal for prompt in prompts for goal in prompt.goals] == list(opened.graph.entities)
    system = {prompt.request.messages[0].content for prompt in prompts}
    assert len(system) == 1  # what servers may keep
    words = "\n".join([*system, *(prompt.request.messages[1].content for prompt in prompts)]).split("\n")
    assert [line for line in words if "+" in line] == ["thing: first + second"]
    free = make_prompts(config, [f"thing {number}" for number in range(LISTED + 1)])
    assert "thing 17" not in free[0].request.messages[0].content


def test_greedy_sampling_is_asked_for_and_none_if_the_endpoint_is_to_decide(stand_in, home):
    asked_by(config_of(stand_in, goals_per_prompt=100, seed=4), home / "a")
    asked_by(config_of(stand_in, goals_per_prompt=100, sampling="default"), home / "a")
    greedy, default = stand_in.asked
    assert (greedy["temperature"], greedy["seed"], greedy["path"]) == (0.0, 4, "/v1/chat/completions")
    assert not {"temperature", "seed"} & {*default}


def test_an_answer_of_another_prompt_and_a_damaged_one_are_asked_again_with_a_warning(stand_in, home, caplog):
    config = config_of(stand_in)
    texts = asked_by(config, home / "answers")
    files = sorted((home / "answers").iterdir())
    before = [path.read_bytes() for path in files]
    files[0].write_bytes(before[1])  # that of another prompt
    files[2].write_bytes(before[2][: len(before[2]) // 2])
    edited = json.loads(before[3])
    edited["answer"]["text"] += "\nbread: water + salt"
    files[3].write_text(json.dumps(edited))
    stand_in.asked.clear()
    assert asked_by(config, home / "answers") == texts
    assert len(stand_in.asked) == 3
    assert [path.read_bytes() for path in files] == before
    for told in ("the answer to another prompt", "is damaged", "was edited"):
        assert told in caplog.text


def test_an_answer_belongs_to_its_model_its_address_and_its_sampling(stand_in, home):
    texts = asked_by(config_of(stand_in, goals_per_prompt=100), home / "answers")
    elsewhere, settings = stand_in.address.replace("127.0.0.1", "localhost"), AskingConfig(goals_per_prompt=100)
    others = (
        OpinionsConfig("kitchen", stand_in.address, "another", settings),
        config_of(stand_in, goals_per_prompt=100, seed=1),
        OpinionsConfig("kitchen", elsewhere, "oracle", settings),
    )
    for number, config in enumerate(others, 2):
        assert asked_by(config, home / "answers") == texts
        assert len(stand_in.asked) == number
    assert len(list((home / "answers").iterdir())) == 4


def test_ctrl_c_keeps_every_answer_that_is_under_way(stand_in, home, run):
    stand_in.delay = 0.15

    def interrupt() -> None:
        while len(stand_in.asked) < 4:
            time.sleep(0.01)
        signal.raise_signal(signal.SIGINT)

    timer = threading.Thread(target=interrupt)
    timer.start()
    arguments = ("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--yes")
    outcome = run(*arguments, "--at-once", "2", "--goals-per-prompt", "5")
    timer.join()
    kept = len(list(cache_folder("opinions").iterdir()))
    assert outcome.code == 130
    assert kept == len(stand_in.asked) < 16
    assert f"interrupted; {kept} of 16 prompts are answered and kept; the same command goes on" in outcome.err
    assert not Path("models").exists()
    stand_in.delay = 0.0
    assert run(*arguments, "--goals-per-prompt", "5").code == 0
    assert len(stand_in.asked) == 16


def test_a_second_ctrl_c_waits_for_nothing(stand_in, home, run):
    stand_in.delay = 3.0

    def interrupt() -> None:
        while not stand_in.asked:
            time.sleep(0.01)
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.4)

    thread = threading.Thread(target=interrupt)
    thread.start()
    outcome = run("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--yes", "--verbose")
    ended = time.monotonic()
    thread.join()
    assert outcome.code == 130
    assert "interrupted; 0 of 8 prompts are answered and kept" in outcome.err
    assert ended - stand_in.times[0] < 2.5


# --- keys ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("failures", [[], [401], [400], [429, 500, 418], ["schema"]])
def test_a_key_is_sent_and_never_written_or_said(stand_in, home, monkeypatch, run, failures):
    monkeypatch.setenv("OUR_KEY", KEY)
    stand_in.failures = list(failures)
    stand_in.said = {"error": {"message": f"you sent Bearer {KEY} to us", "code": KEY}}
    answer = stand_in.answer
    stand_in.answer = lambda goals: f"{answer(goals)}\nyour key is {KEY}"
    outcome = run(
        *("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--yes", "--verbose"),
        *("--key-variable", "OUR_KEY", "--at-once", "1", "--goals-per-prompt", "100"),
    )
    assert outcome.code == (1 if failures else 0)
    assert stand_in.headers[0]["authorization"] == f"Bearer {KEY}"
    assert KEY not in outcome.out + outcome.err
    written = [path for path in home.rglob("*") if path.is_file()]
    assert bool(written) == (not failures)
    assert not [path for path in written if KEY.encode() in path.read_bytes()]


def test_openais_key_goes_to_no_address_without_encryption_unless_it_is_named(stand_in, home, monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    asked_by(config_of(stand_in, goals_per_prompt=100), home / "a")
    assert KEY not in str(stand_in.headers)
    asked_by(config_of(stand_in, goals_per_prompt=100, key_variable="OPENAI_API_KEY"), home / "b")
    assert stand_in.headers[1]["authorization"] == f"Bearer {KEY}"


@pytest.mark.parametrize("address", ["http://me:secret@host/v1", "http://host/v1?key=secret", "https://host/#secret"])
def test_an_address_that_may_hold_a_secret_is_refused_without_repeating_it(run, address):
    outcome = run("ask-opinions", "kitchen", "--endpoint", address, "--model", "oracle")
    assert (outcome.code, outcome.kind) == (1, "ConfigError")
    assert "secret" not in outcome.out + outcome.err


@pytest.mark.parametrize(
    "address", ["", "localhost:8080", "ftp://host/v1", "http://", "http://host:x/v1", "http://a b", "http://a..b"]
)
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ConfigError, match="such as http://localhost:8080/v1"):
        checked_endpoint(address)


def test_a_key_in_place_of_its_variable_is_not_repeated(run, stand_in, monkeypatch):
    for wrong in (KEY, "abcdef0123456789"):
        arguments = ("ask-opinions", "kitchen", "--endpoint", stand_in.address, "--model", "oracle", "--yes")
        outcome = run(*arguments, "--key-variable", wrong)
        assert (outcome.code, outcome.kind) == (1, "ConfigError")
        assert wrong not in outcome.out + outcome.err
    monkeypatch.setenv("OUR_KEY", f"{KEY}\nX-Other: 1")
    outcome = run(*arguments, "--key-variable", "OUR_KEY")
    assert (outcome.code, outcome.kind) == (1, "ConfigError")
    assert KEY not in outcome.out + outcome.err
    assert not stand_in.asked
