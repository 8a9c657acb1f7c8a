"""A search for settings: the best on validation tasks, which test tasks then measure."""

import msgspec
import pytest

from wordcraft_kg.base.errors import ConfigError, TrainingError
from wordcraft_kg.studies.plan import make_plan
from wordcraft_kg.studies.search import search
from wordcraft_kg.studies.study import Range, Study, parse_study

SETTINGS = {"book": "kitchen", "steps": 64, "valid_ratio": 0.1}
SPACE = {
    "learning_rate": Range(0.001, 0.02, log=True),
    "policy": ["pairs", "attention"],
    "unroll": Range(2, 6),
}
STUDY = Study("A search", {"agent": {}}, seeds=1, settings=SETTINGS, search=SPACE, trials=15)


def test_the_best_trial_wins_and_equal_searches_try_equal_settings():
    def score(trial):
        rate, policy = trial.settings["learning_rate"], trial.settings["policy"]
        tried.append((rate, policy, trial.settings["unroll"]))
        return -abs(rate - 0.01) + (policy == "attention")

    tried = []
    best = search(STUDY, score)
    first = list(tried)
    closest = min(abs(rate - 0.01) for rate, policy, _ in first if policy == "attention")
    assert best.settings["policy"] == "attention"
    assert abs(best.settings["learning_rate"] - 0.01) == closest
    assert best.search == {}
    assert len(first) == 15
    assert {type(unroll) for *_, unroll in first} == {int}
    tried.clear()
    search(STUDY, score)
    assert tried == first


def test_a_setting_out_of_range_is_refused_without_a_traceback(capfd):
    study = msgspec.structs.replace(STUDY, search=SPACE | {"learning_rate": [-1.0]})
    with pytest.raises(ConfigError, match="learning_rate"):
        search(study, lambda trial: len(make_plan(trial, "study").runs))
    assert "Traceback" not in capfd.readouterr().err


def test_a_failed_trial_loses_and_a_search_without_another_fails(caplog):
    def score(trial):
        if trial.settings["policy"] == "pairs" or not survives:
            raise TrainingError("the loss is no longer finite")
        return 0.5

    survives = True
    best = search(STUDY, score)
    assert best.settings["policy"] == "attention"
    assert "best of 15 trials" in best.title
    assert "the loss is no longer finite" in caplog.text
    survives = False
    with pytest.raises(TrainingError, match="no longer finite"):
        search(STUDY, score)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"search": {}}, "no table .search."),
        ({"variants": {"a": {}, "b": {"depth": 2}}}, "one variant"),
        ({"grid": {"depth": [1, 2]}}, "one variant"),
        ({"variants": {"a": {"player": "random pair"}}}, "not for a 'player'"),
        ({"settings": {"book": "kitchen"}}, "`valid_ratio`"),
        ({"search": {"distractors": [1, 8]}}, "search.distractors changes the tasks"),
        ({"search": {"split": ["by-goal", "by-recipe"]}}, "search.split changes the tasks"),
    ],
)
def test_a_search_without_a_fair_choice_is_refused(changes, says):
    with pytest.raises(ConfigError, match=says):
        search(msgspec.structs.replace(STUDY, **changes), lambda trial: 0.0)


@pytest.mark.parametrize(
    ("space", "says"),
    [
        ("learning_rates = [1, 2]", "unknown setting 'search.learning_rates'.*learning_rate"),
        ("steps = {low = 5, high = 5}", "no values to search"),
        ("learning_rate = {low = 0.1, high = inf}", "no values to search"),
        ("learning_rate = {low = 0, high = 1, log = true}", "no values to search"),
        ("learning_rate = {low = 0, high = 1, lgo = true}", "lgo"),
    ],
)
def test_a_faulty_search_is_refused_by_its_setting(space, says):
    with pytest.raises(ConfigError, match=says):
        parse_study(f"title = 'x'\n[search]\n{space}\n[variants.a]\n", "study")


def test_a_variant_cannot_undo_the_search():
    text = "title = 'x'\n[search]\nunroll = [2, 4]\n[variants.a]\nunroll = 3\n"
    with pytest.raises(ConfigError, match="unroll is also in the grid or search"):
        parse_study(text, "study")


@pytest.mark.slow
def test_a_search_reports_its_best_settings_on_test_tasks(run, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(
        "title = 'Rates'\nseeds = 1\ntrials = 2\n[settings]\nbook = 'kitchen'\nsteps = 256\n"
        "valid_ratio = 0.1\n[search]\nlearning_rate = {low = 0.001, high = 0.01}\n[variants.a]\n"
    )
    refused("reproduce", "study.toml", says="--search")
    words = ("reproduce", "--search", "study.toml", "--jobs", 1, "--table", "best.tex")
    done = run(*words)
    assert done.code == 0, done.err
    assert "best of 2 trials, validation success" in done.out
    assert r"\toprule" in (tmp_path / "best.tex").read_text()
    assert (tmp_path / "results/reports/study/figure.pdf").read_bytes().startswith(b"%PDF")
