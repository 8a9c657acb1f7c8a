"""Tasks of Inspect AI: figures of an evaluation to the last digit, limits, invalid answers, and
logs read back."""

import importlib
import logging
import sys
import tomllib
from pathlib import Path

import pytest

import wordcraft_kg
from wordcraft_kg import WordCraftConfig, World
from wordcraft_kg.apps.text_agents.commands.bench import bench_run
from wordcraft_kg.apps.text_agents.inspect_tasks import read_inspect_log
from wordcraft_kg.apps.text_agents.submission import verify
from wordcraft_kg.base.errors import ArtefactError, ConfigError, MissingExtraError

pytestmark = pytest.mark.filterwarnings(
    "ignore:The 'initial' parameter is deprecated:DeprecationWarning"
)


def inspect_ai():
    """Inspect, imported by the process that plays its tasks: the import takes seconds, and each
    process collects this file."""
    return importlib.import_module("inspect_ai")


def our_tasks():
    return importlib.import_module("wordcraft_kg.apps.text_agents.inspect_tasks")


def crafting(*graph, **parameters):
    return our_tasks().crafting(*graph, **parameters)


def discovery(*graph, **parameters):
    return our_tasks().discovery(*graph, **parameters)


@pytest.fixture(autouse=True)
def untouched(tmp_path, monkeypatch):
    """Take back what Inspect does to the root logger, which other tests listen to; it writes
    nothing at home."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    root = logging.getLogger()
    level, handlers = root.level, [*root.handlers]
    yield
    root.setLevel(level)
    for handler in {*root.handlers} - {*handlers}:
        root.removeHandler(handler)


@pytest.fixture
def play(tmp_path):
    """Let a model, which is a function of the messages, play a task; nothing is shown."""

    def play(task, answer, **options):
        def output(messages, *_):
            content = inspect_ai().model.ModelOutput.from_content("mockllm", answer(messages))
            # Without a usage the mock counts tokens with tables from the network.
            content.usage = inspect_ai().model.ModelUsage(
                input_tokens=100, output_tokens=10, total_tokens=110
            )
            return content

        model = inspect_ai().model.get_model("mockllm/model", custom_outputs=output, memoize=False)
        settings = {"display": "none", "log_dir": str(tmp_path), "log_realtime": False} | options
        (log,) = inspect_ai().eval(task, model=model, **settings)
        return log

    return play


def turn(messages):
    """Return the number of the model's messages."""
    return sum(message.role == "assistant" for message in messages)


def scripted(task, actions):
    """Return a model that picks the slots of a scripted player; it recognises a game by the first
    state."""
    keys = {
        sample.input[1].text: (sample.metadata["task"], sample.metadata["distractor_seed"])
        for sample in task.dataset
    }
    assert len(keys) == len(task.dataset)

    def answer(messages):
        one, other = actions[keys[messages[1].text]][2 * turn(messages) :][:2]
        return f"I wonder.\n{one + 1} + {other + 1}"

    return answer


def metrics_of(log):
    assert log.status == "success", log.error
    return {name: one.value for name, one in log.results.scores[0].metrics.items()}


def total(games, name):
    """Return a count over all games in a log."""
    return sum(getattr(game, name) for game in games)


@pytest.mark.slow
def test_the_first_prompt_opens_and_the_target_stays_in_the_log(
    opened_kitchen,
):
    """The first prompt is the opening of the conversation and the target stays in the log."""
    sample = crafting("kitchen", tasks=3, distractor_seeds=2).dataset[1]
    assert (sample.id, sample.target) == (
        "test-21-0",
        World(opened_kitchen, WordCraftConfig(part="test")).tasks[21].goal,
    )
    system, user = sample.input
    assert (system.role, user.role) == ("system", "user")
    assert system.text.startswith("This is a crafting game.")
    assert user.text.startswith(f"Goal: {sample.target}\nTable: 1 ")


@pytest.mark.slow
def test_nonsense_silence_and_limits_are_failures_and_no_game_is_missing(play):
    task = crafting("kitchen", tasks=4, depth=2, max_invalid=1)
    # No log can hold half a character: it must not fail, or the game would be played again.
    answers = ("", "unicorn + [dragon]\ud800", "1 + 2 or 3\nthat is all", "1 + 1")
    answer_to = dict(zip((sample.input[1].text for sample in task.dataset), answers, strict=True))
    log = play(task, lambda messages: answer_to[messages[1].text], message_limit=7)
    # A log sorts its samples by their names as texts.
    scores = [sample.scores["game_score"] for sample in log.samples]
    *invalid, valid = sorted(scores, key=lambda score: score.metadata["task"])
    # Two attempts, each lost with the second refusal: 8 messages without the rules, of which the
    # limit leaves 6.
    for score in invalid:
        assert (score.value, score.metadata["unfinished"]) == (0, True)
        assert (score.metadata["invalid_actions"], score.metadata["lost_attempts"]) == (3, 1)
    assert valid.metadata["unfinished"] is False
    metrics = metrics_of(log)
    counts = [
        metrics[f"{name}_in_run"] for name in ("unfinished", "invalid_actions", "lost_attempts")
    ]
    assert (metrics["success"], counts) == (0, [3, 9, 3])
    _, games, _ = read_inspect_log(log.location)
    assert len(games) == 4
    assert [total(games, name) for name in ("invalid_actions", "lost_attempts")] == [9, 3]
    prompts = [message.text for message in log.samples[0].messages if message.role == "user"]
    assert prompts[1].startswith("Invalid answer: no answer")


@pytest.mark.slow
def test_a_log_of_repeated_games_is_refused(play):
    log = play(crafting("kitchen", tasks=3), lambda messages: "1 + 1", epochs=2)
    with pytest.raises(ArtefactError, match=r"6 of 3 games.* instead of --epochs"):
        read_inspect_log(log.location)


@pytest.mark.slow
@pytest.mark.parametrize(
    "track", [pytest.param("depth-2-lite", marks=pytest.mark.slow), "discover-500-lite"]
)
def test_a_log_of_a_benchmark_track_becomes_a_submission_that_verifies(play, tmp_path, track):
    log = play(
        crafting(track=track),
        lambda messages: "1 + 2" if turn(messages) % 2 else "nonsense",
        message_limit=12,
    )
    bench_run(track, player=f"inspect:{log.location}", out=tmp_path / "out")
    submission = verify(tmp_path / "out")
    assert (submission.player, submission.prompts) == ("mockllm/model", "standard")
    assert submission.invalid_actions >= submission.figures.games == len(log.samples)
    assert submission.tokens["input"] == 10 * submission.tokens["output"] > 0
    with pytest.raises(
        ConfigError, match=f"are of everyday-v3/{track}; expected everyday-v3/craft-8-lite"
    ):
        bench_run("craft-8-lite", player=f"inspect:{log.location}", out=tmp_path / "other")
    with pytest.raises(ConfigError, match="the games have none"):
        bench_run(
            track, player=f"inspect:{log.location}", out=tmp_path / "other", look_ups="partial"
        )
    with pytest.raises(ConfigError, match="has its own numbers"):
        bench_run(track, player=f"inspect:{log.location}", out=tmp_path / "other", tokens=(1, 2))


@pytest.mark.slow
def test_a_log_without_some_of_the_games_gives_no_result(play, tmp_path):
    task = crafting("kitchen", tasks=3, distractor_seeds=2)
    failing = task.dataset[4].input[1].text

    def answer(messages):
        if messages[1].text == failing:
            raise RuntimeError("the model is not there")
        return "1 + 1"

    log = play(task, answer, fail_on_error=False)
    assert "ci_low" not in metrics_of(log)
    with pytest.raises(
        ArtefactError, match=r"5 of 6 games were played; expected each.*tasks=N instead of --limit"
    ):
        read_inspect_log(log.location)

    stopped, half, spoilt = (
        tmp_path / name for name in ("stopped.eval", "half.eval", "spoilt.json")
    )
    log.status = "cancelled"
    inspect_ai().log.write_eval_log(log, str(stopped))
    half.write_bytes(stopped.read_bytes()[:-300])
    log.status = "success"
    log.samples[0].scores["game_score"].metadata["actions"] = "many"
    log.eval.metadata["wordcraft_kg"]["games"] = 5
    inspect_ai().log.write_eval_log(log, str(spoilt))
    for path, fragment in (
        (stopped, r"evaluation has the status cancelled, 5 of 6 games .* inspect eval-retry"),
        (half, "cannot be read as an Inspect AI log"),
        (spoilt, r"spoilt.json is damaged.*actions"),
    ):
        with pytest.raises(ArtefactError, match=fragment):
            read_inspect_log(path)


@pytest.mark.slow
def test_other_logs_and_files_are_refused(play, tmp_path):
    other = play(
        inspect_ai().Task(
            dataset=[inspect_ai().dataset.Sample(input="Say hello.", target="hello")],
            name="greeting",
        ),
        lambda messages: "hello",
    )
    with pytest.raises(
        ArtefactError, match="logs the task 'greeting'; expected wordcraft_kg/crafting"
    ):
        read_inspect_log(other.location)
    for name, text in (
        ("result.json", '{"success": 1}'),
        ("notes.txt", "hello"),
        ("empty.eval", ""),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(ArtefactError, match=f"{name} cannot be read as an Inspect AI log"):
            read_inspect_log(tmp_path / name)
    with pytest.raises(ArtefactError, match="cannot be read as an Inspect AI log"):
        read_inspect_log(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "parameters", "setting", "fragment"),
    [
        (crafting, {"graph": "kitchn"}, "", "kitchen"),
        (crafting, {"graph": 7}, "", "'7'"),
        (crafting, {"part": "tests"}, "part", "'tests'"),
        (crafting, {"depth": 2, "attempts": 1}, "attempts", "expected a whole number, 2 to"),
        (crafting, {"distractor_seeds": 0}, "distractor_seeds", "0"),
        (crafting, {"max_invalid": -1}, "max_invalid", "-1"),
        (crafting, {"knowledge": "full"}, "knowledge", "'full'"),
        (crafting, {"knowledge": "scorer", "scorer": "models/none"}, "", "models/none"),
        (crafting, {"scorer": "models/none"}, "knowledge", "expected scorer with a model folder"),
        (crafting, {"look_ups": 1.5}, "look_ups", "1.5"),
        (discovery, {"base": ["water", "unicorn"]}, "base", "unicorn"),
        (discovery, {"base": 1}, "base", "no entity '1'"),
        (discovery, {"base": True}, "base", "no entity 'True'"),
        (discovery, {"games": 0}, "games", "0"),
    ],
)
def test_a_wrong_parameter_is_an_error_without_a_traceback(make, parameters, setting, fragment):
    with pytest.raises(our_tasks().InspectTaskError, match=fragment) as raised:
        make(**{"graph": "kitchen", **parameters})
    assert raised.value.setting == setting
    prerequisite = importlib.import_module("inspect_ai._util.error").PrerequisiteError
    assert isinstance(raised.value, prerequisite)  # which Inspect shows without a traceback
    assert raised.value.message.replace("\\[", "[") == str(
        raised.value
    )  # its terminal takes brackets for a style


@pytest.mark.slow
def test_inspect_finds_both_tasks_by_the_package_s_name():
    root = Path(wordcraft_kg.__file__).parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    ours = our_tasks()
    assert project["entry-points"]["inspect_ai"] == {"wordcraft_kg": ours.crafting.__module__}
    registry_info = importlib.import_module("inspect_ai._util.registry").registry_info
    assert [registry_info(one).name for one in (ours.crafting, ours.discovery)] == [
        "wordcraft_kg/crafting",
        "wordcraft_kg/discovery",
    ]


def test_without_inspect_the_error_names_the_extra(monkeypatch):
    module = "wordcraft_kg.apps.text_agents.inspect_tasks"
    monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "inspect_ai", None)
    with pytest.raises(MissingExtraError, match=r"Inspect AI is not installed.*'inspect-ai>="):
        importlib.import_module(module)
