"""The commands of link prediction as a user runs them: output, exit codes and bad input."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from wordcraft_kg.cli import ALL, command_in, main, make_app, manual_of
from wordcraft_kg.cli.progress import Progress, Stages
from wordcraft_kg.graphs import RecipeGraph, SplitConfig, make_split, open_book
from wordcraft_kg.graphs.folder import open_graph, write_graph_folder
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.ranking import RankingMetrics

Run = Callable[..., Any]
TINY = ("--dim", "8", "--epochs", "4", "--folds", "0")
QUICK = (*TINY, "--n3", "0.1")
NAMES = ALL
SLICES = {"all", *RELATIONS}


def build(folder: Path, **settings: Any) -> None:
    book = open_book("kitchen")
    write_graph_folder(folder, book, make_split(RecipeGraph.from_book(book), SplitConfig(**settings)), force=True)


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a graph, two models of its partial graph and one of its full graph; read only."""
    root = tmp_path_factory.mktemp("trained")
    build(root / "graph")
    for name, extra in (("one", []), ("two", ["--seed", "1"]), ("full", ["--kg", "full"])):
        command = ["train-complex", str(root / "graph"), *QUICK, *extra, "--out", str(root / name), "--quiet"]
        assert main(command) == 0
    return root


@pytest.fixture
def workshop(trained: Path, tmp_path: Path) -> Path:
    """A copy of the graph and the models, for a test to change."""
    shutil.copytree(trained, tmp_path / "workshop")
    return tmp_path / "workshop"


def one_object(outcome: Any) -> dict[str, Any]:
    """The one JSON object on stdout of a command that went well."""
    assert outcome.code == 0, outcome.err
    value = json.loads(outcome.out)
    assert isinstance(value, dict)
    assert outcome.out.count("\n") == 1
    return value


def refused(outcome: Any, kind: str) -> str:
    """The message of a command that was refused: one line, of this kind of error, and no result."""
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.kind == kind
    assert outcome.err.startswith("error: ")
    assert "Traceback" not in outcome.err
    return outcome.err


# --- progress ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "stages"),
    [
        (
            ["evaluate-links", "{0}/one", "--out", "{1}/report"],
            ["ranking heads", "drawing the map", "writing the report"],
        ),
        (["compare", "{0}/one", "{0}/two"], ["ranking tails", "resampling: 1,999 of 2,000"]),
    ],
    ids=lambda value: value[0],
)
def test_judging_models_names_its_stages(
    run: Run, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str], stages: list[str]
):
    monkeypatch.setattr(Progress, "INTERVAL", 0.0)
    monkeypatch.setattr(Stages, "INTERVAL", 0.0)
    outcome = run(*(part.format(trained, tmp_path) for part in command))
    assert outcome.code == 0
    for stage in stages:
        assert f"\n{stage}" in f"\n{outcome.err}"


# --- help ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_every_command_prints_help_with_two_examples(run: Run, name: str):
    outcome = run(*name.split(), "--help")
    assert (outcome.code, outcome.err) == (0, "")
    examples = manual_of(name).examples
    assert len(examples) >= 2
    for example in examples:
        assert example in outcome.out
    assert "--json" in outcome.out


@pytest.mark.parametrize("name", NAMES)
def test_every_example_is_one_of_our_commands_and_parses(name: str):
    app = make_app()
    examples = manual_of(name).examples
    for example in examples:
        program, *tokens = shlex.split(example)
        assert program == "wordcraft-kg"
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        named = command_in(tokens)
        assert named is not None
        assert command is manual_of(named).function
        assert bound.args or bound.kwargs or tokens == named.split()
    assert any(example.startswith(f"wordcraft-kg {name}") for example in examples)


def test_an_option_that_does_not_exist_does_not_parse(run: Run):
    with pytest.raises(Exception, match="epoch"):
        make_app().parse_args(["train-complex", "kitchen", "--epoch", "3"], exit_on_error=False, print_error=False)
    outcome = run("train-complex", "kitchen", "--epoch", "3")
    assert (outcome.code, outcome.out) == (2, "")
    assert "--epoch" in outcome.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("train-complex",),
        ("train-complex", "kitchen", "--epochs", "many"),
        ("train-complex", "kitchen", "--kg", "half"),
        ("score",),
        ("evaluate-links",),
        ("no-such-command",),
    ],
)
def test_wrong_usage_has_exit_code_2_and_an_explanation(run: Run, arguments: tuple[str, ...]):
    outcome = run(*arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.strip()
    assert "Traceback" not in outcome.err


def test_the_start_page_lists_every_command_and_imports_no_torch():
    code = "import sys\nfrom wordcraft_kg.cli import main\ncode = main(['--help'])\nprint(code, 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "0 False"
    for name in NAMES:
        assert f" {name.split()[0]} " in done.stdout


@pytest.mark.parametrize("name", ["train-complex", "train-links", "tune-links", "score"])
def test_help_of_a_command_imports_no_torch(name: str):
    code = f"import sys\nfrom wordcraft_kg.cli import main\nmain([{name!r}, '--help'])\nprint('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "False"


# --- training --------------------------------------------------------------------------------------------------------


def test_train_complex_prints_one_object_with_what_was_trained(run: Run, tmp_path: Path):
    values = one_object(run("train-complex", "kitchen", *QUICK, "--out", tmp_path / "model", "--json", "--quiet"))
    assert {"out", "kg", "epochs", "seconds", "parameters", "train_mrr"} <= set(values)
    assert (values["out"], values["kg"], values["epochs"]) == (str(tmp_path / "model"), "partial", 4)
    assert values["parameters"] == 2 * 8 * (80 + 2)
    assert 0 < values["train_mrr"] < 1
    assert values["seconds"] > 0


def test_train_links_prints_the_same_keys(run: Run, tmp_path: Path):
    options = ("--model", "distmult", "--dim", "4", "--epochs", "1", "--negatives", "2")
    values = one_object(run("train-links", "kitchen", *options, "--out", tmp_path / "model", "--json", "--quiet"))
    assert {"out", "kg", "epochs", "seconds", "parameters", "train_mrr"} <= set(values)
    assert (tmp_path / "model" / "model.safetensors").is_file()


def test_a_quiet_training_says_nothing_on_stderr(run: Run, tmp_path: Path):
    for command, extra in (("train-complex", QUICK), ("train-links", ("--model", "distmult", *TINY))):
        outcome = run(command, "kitchen", *extra, "--out", tmp_path / command, "--quiet")
        assert (outcome.code, outcome.err) == (0, "")


def test_progress_goes_to_stderr_and_the_result_to_stdout(run: Run, tmp_path: Path):
    outcome = run("train-complex", "kitchen", "--epochs", 4, "--n3", 0.1, "--folds", 2, "--out", tmp_path / "model")
    assert "epoch 12 of 12" in outcome.err
    assert "epoch 12 of 24" not in outcome.out
    assert f"next: wordcraft-kg evaluate-links {tmp_path / 'model'}" in outcome.out


def test_models_go_to_a_folder_of_their_own_by_default(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    run("train-complex", "kitchen", *QUICK, "--kg", "full")
    run("train-links", "kitchen", *TINY, "--model", "DistMult", "--loop", "symmetric")
    assert sorted(path.name for path in (tmp_path / "models").iterdir()) == ["kitchen-distmult-partial", "kitchen-full"]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--epochs", "0"),
        ("--learning-rate", "nan"),
        ("--learning-rate", "-1"),
        ("--n3", "-1"),
        ("--patience", "3"),
        ("--eval-every", "2"),
        ("--device", "nonsense"),
    ],
)
def test_a_bad_setting_is_one_line_that_names_the_option(run: Run, tmp_path: Path, option: str, value: str):
    outcome = run("train-complex", "kitchen", option, value, "--out", tmp_path / "model")
    assert option in refused(outcome, "ConfigError")
    assert outcome.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_model_is_one_line_with_a_suggestion(run: Run, tmp_path: Path):
    outcome = run("train-links", "kitchen", "--model", "rotat", "--out", tmp_path / "model")
    assert "'rotate'" in refused(outcome, "ConfigError")
    assert list(tmp_path.iterdir()) == []


def test_a_model_folder_that_exists_is_refused_before_anything_is_trained(run: Run, workshop: Path):
    weights = (workshop / "one" / "model.safetensors").read_bytes()
    outcome = run("train-complex", workshop / "graph", *QUICK, "--seed", "5", "--out", workshop / "one")
    assert "--force" in refused(outcome, "OutputExistsError")
    assert (workshop / "one" / "model.safetensors").read_bytes() == weights
    assert (
        run("train-complex", workshop / "graph", *QUICK, "--seed", "5", "--out", workshop / "one", "--force").code == 0
    )
    assert (workshop / "one" / "model.safetensors").read_bytes() != weights


def test_a_file_is_never_replaced_by_a_model(run: Run, tmp_path: Path):
    (tmp_path / "model").write_text("mine")
    outcome = run("train-complex", "kitchen", *QUICK, "--out", tmp_path / "model", "--force")
    refused(outcome, "OutputExistsError")
    assert (tmp_path / "model").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_a_clear_error(run: Run, tmp_path: Path):
    (tmp_path / "locked").mkdir(mode=0o500)
    outcome = run("train-complex", "kitchen", *QUICK, "--out", tmp_path / "locked" / "model")
    assert str(tmp_path / "locked") in refused(outcome, "PermissionError")


def test_settings_may_stand_in_a_toml_file_and_the_command_line_goes_first(run: Run, tmp_path: Path):
    (tmp_path / "mine.toml").write_text("[train-complex]\ndim = 4\nepochs = 3\nlearning_rate = 0.05\n")
    out = tmp_path / "model"
    options = ("--config", tmp_path / "mine.toml", "--epochs", "2", "--out", out, "--json", "--quiet")
    assert one_object(run("train-complex", "kitchen", *options))["epochs"] == 2
    written = tomllib.loads((out / "config.toml").read_text())["train-complex"]
    assert (written["dim"], written["epochs"], written["learning_rate"]) == (4, 2, 0.05)


@pytest.mark.parametrize("line", ["epoch = 3", "epochs = 'ten'", "surprise = true"])
def test_a_toml_file_with_a_wrong_setting_is_refused(run: Run, tmp_path: Path, line: str):
    (tmp_path / "mine.toml").write_text(f"[train-complex]\n{line}\n")
    outcome = run("train-complex", "kitchen", "--config", tmp_path / "mine.toml", "--out", tmp_path / "model")
    assert outcome.code in (1, 2)
    assert line.split()[0] in outcome.err
    assert "Traceback" not in outcome.err
    assert not (tmp_path / "model").exists()


def test_a_models_own_config_file_trains_the_same_model_again(run: Run, workshop: Path):
    options = ("--config", workshop / "one" / "config.toml", "--out", workshop / "again", "--quiet")
    outcome = run("train-complex", workshop / "graph", *options)
    assert outcome.code == 0, outcome.err
    for name in ("model.safetensors", "vocabulary.json"):
        assert (workshop / "again" / name).read_bytes() == (workshop / "one" / name).read_bytes()


# --- interruption ----------------------------------------------------------------------------------------------------


@pytest.fixture
def ctrl_c_in_epoch_2(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    def press(self: Progress, done: int, total: int, figures: dict[str, float]) -> None:
        if done == 2:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Progress, "__call__", press)
    return monkeypatch


def test_ctrl_c_in_a_training_ends_with_130_and_the_same_command_goes_on(
    run: Run, workshop: Path, ctrl_c_in_epoch_2: pytest.MonkeyPatch
):
    settings = (workshop / "graph", "--dim", "8", "--epochs", "6", "--seed", "3")
    command = ("train-complex", *settings, "--out", workshop / "model")
    outcome = run(*command)
    assert (outcome.code, outcome.out) == (130, "")
    assert f"epoch 3 is saved in '{workshop / 'model'}'. The same command goes on" in outcome.err
    assert "not done" in refused(run("score", workshop / "model", "flour", "combinesWith", "water"), "ArtefactError")
    assert "--n3" in refused(run(*command, "--n3", "0.5"), "ConfigError")
    ctrl_c_in_epoch_2.undo()
    values = one_object(run(*command, "--json", "--quiet"))
    assert (values["out"], values["epochs"]) == (str(workshop / "model"), 6)
    run("train-complex", *settings, "--out", workshop / "undisturbed")
    weights = [(workshop / name / "model.safetensors").read_bytes() for name in ("model", "undisturbed")]
    assert weights[0] == weights[1]


def test_a_second_ctrl_c_says_truly_what_is_left(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def press_twice(self: Progress, done: int, total: int, figures: dict[str, float]) -> None:
        if done == 3:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Progress, "__call__", press_twice)
    outcome = run("train-complex", "kitchen", *QUICK, "--checkpoint-every", "1", "--out", tmp_path / "model")
    assert (outcome.code, outcome.out) == (130, "")
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
    assert "The same command goes on" in outcome.err
    assert "nothing was written" not in outcome.err


def test_ctrl_c_at_once_in_a_forced_training_leaves_the_earlier_model(
    run: Run, workshop: Path, monkeypatch: pytest.MonkeyPatch
):
    def press_twice(self: Progress, done: int, total: int, figures: dict[str, float]) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    weights = (workshop / "one" / "model.safetensors").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "__call__", press_twice)
        outcome = run("train-complex", workshop / "graph", *QUICK, "--seed", "3", "--out", workshop / "one", "--force")
    assert outcome.code == 130
    assert (workshop / "one" / "model.safetensors").read_bytes() == weights
    assert run("score", workshop / "one", "flour", "combinesWith", "water").code == 0


def test_ctrl_c_elsewhere_ends_with_130_and_one_line(run: Run, workshop: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*arguments: Any, **settings: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("wordcraft_kg.reports.pages.render", interrupted)
    outcome = run("evaluate-links", workshop / "one")
    assert (outcome.code, outcome.out) == (130, "")
    assert outcome.err.splitlines()[-1].startswith("interrupted")
    assert not (workshop / "one" / "report").exists()


# --- evaluation ------------------------------------------------------------------------------------------------------


def test_evaluate_links_prints_one_object_with_the_headline_and_its_baselines(run: Run, workshop: Path):
    values = one_object(run("evaluate-links", workshop / "one", "--json"))
    for metric in ("mrr", "hits@1", "hits@3", "hits@10"):
        assert set(values[metric]) == SLICES
        assert all(0 <= value <= 1 for value in values[metric].values())
    assert set(values["baselines"]) == {"frequency", "votes", "neighbours", "random"}
    assert {"queries", "leaked_left_out", "mrr_with_leaked", "report"} <= set(values)
    assert 0 < values["mrr_without_near_synonyms"] < 1
    split = open_graph(workshop / "graph").split
    assert values["queries"] == 2 * len(split.held_out("test"))
    assert values["leaked_left_out"] == len(split.triples_of("test")) - len(split.held_out("test"))


def test_evaluate_links_writes_the_report_that_it_names(run: Run, workshop: Path):
    values = one_object(run("evaluate-links", workshop / "one", "--json"))
    report = Path(values["report"])
    assert report == workshop / "one" / "report" / "index.html"
    assert f"{values['mrr']['all']:.3f}" in report.read_text(encoding="utf-8")
    written = json.loads((report.parent / "report.json").read_text(encoding="utf-8"))
    assert written["metrics"]["all"]["mrr"] == values["mrr"]["all"]
    assert "train-complex" in written["provenance"]["trained by"] or written["provenance"]["trained by"]
    assert (report.parent / "ranks.csv").is_file()


def test_the_text_of_evaluate_links_names_the_leaks_the_baselines_and_the_report(run: Run, workshop: Path):
    outcome = run("evaluate-links", workshop / "one")
    assert outcome.code == 0
    for expected in ("leaked ones left out", "frequency", "random", "inflated", str(workshop / "one" / "report")):
        assert expected in outcome.out


def line_of(outcome: Any, name: str) -> str:
    """The line of a command's text that begins with a name, "" if there is none."""
    return next((line for line in outcome.out.splitlines() if line.startswith(name)), "")


def with_figures(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> None:
    """Let `evaluate-links` see figures other than its own."""
    from wordcraft_kg.evaluation import links

    original = links.view_links
    monkeypatch.setattr(
        "wordcraft_kg.reports.link_report.view_links",
        lambda *args, **kwargs: msgspec.structs.replace(original(*args, **kwargs), **changes),
    )


def test_leaked_triples_that_lower_the_figure_are_not_called_inflation(
    run: Run, workshop: Path, monkeypatch: pytest.MonkeyPatch
):
    with_figures(monkeypatch, with_leaked=RankingMetrics(60, mrr=0.0, hits_at_1=0.0, hits_at_3=0.0, hits_at_10=0.0))
    line = line_of(run("evaluate-links", workshop / "one"), "with leaked")
    assert "MRR 0.000, no better" in line
    assert "inflated" not in line


def test_without_leaked_triples_nothing_is_said_about_them(run: Run, workshop: Path, monkeypatch: pytest.MonkeyPatch):
    with_figures(monkeypatch, leaked_left_out=0)
    outcome = run("evaluate-links", workshop / "one")
    assert "0 leaked ones left out" in outcome.out
    assert not line_of(outcome, "with leaked")


def test_a_full_graph_that_is_too_small_is_not_told_to_hold_out_more(run: Run, tmp_path: Path):
    (tmp_path / "tiny.csv").write_text("ingredient_a,ingredient_b,result\nwater,earth,mud\nmud,fire,brick\n")
    assert run("train-complex", tmp_path / "tiny.csv", "--kg", "full", *QUICK, "--out", tmp_path / "full").code == 0
    message = refused(run("evaluate-links", tmp_path / "full"), "SplitError")
    assert "only 8 triples in the whole graph" in message
    assert "--train-ratio" not in message


@pytest.mark.parametrize(
    ("command", "said", "unsaid"),
    [
        (("train-complex", "--n3", "0.1"), "--dim", "--loop"),
        (("train-links", "--model", "distmult"), "--loop symmetric", "--n3"),
        (("train-links", "--model", "distmult", "--loop", "symmetric"), "--epochs", "--loop"),
    ],
)
def test_a_model_that_hardly_fits_is_told_options_that_its_command_has(
    run: Run, tmp_path: Path, caplog: pytest.LogCaptureFixture, command: tuple[str, ...], said: str, unsaid: str
):
    name, *options = command
    least = ("--dim", "1", "--epochs", "1", "--learning-rate", "1e-6", "--quiet")
    assert run(name, "kitchen", *options, *least, "--out", tmp_path / "model").code == 0
    (warning,) = (message for message in caplog.messages if "hardly fits" in message)
    assert said in warning
    assert unsaid not in warning


def test_a_model_of_the_full_graph_is_evaluated_as_memory(run: Run, workshop: Path):
    values = one_object(run("evaluate-links", workshop / "full", "--json"))
    assert values["has_seen_the_test_recipes"]
    assert values["queries"] == 2 * len(open_graph(workshop / "graph").graph.triples)
    assert "memory, not prediction" in run("evaluate-links", workshop / "full", "--force").out


def test_a_report_that_exists_is_refused_without_force(run: Run, workshop: Path):
    assert run("evaluate-links", workshop / "one").code == 0
    report = workshop / "one" / "report" / "report.json"
    report.write_text("mine")
    assert "--force" in refused(run("evaluate-links", workshop / "one"), "OutputExistsError")
    assert report.read_text() == "mine"
    assert run("evaluate-links", workshop / "one", "--force").code == 0
    assert json.loads(report.read_text())["queries"] > 0


def test_a_report_goes_where_it_is_asked_to(run: Run, workshop: Path):
    values = one_object(run("evaluate-links", workshop / "one", "--out", workshop / "reports" / "one", "--json"))
    assert values["report"] == str(workshop / "reports" / "one" / "index.html")
    assert not (workshop / "one" / "report").exists()


def test_a_graph_that_has_moved_is_found_with_graph(run: Run, workshop: Path):
    (workshop / "graph").rename(workshop / "moved")
    assert "--graph" in refused(run("evaluate-links", workshop / "one"), "ArtefactError")
    assert run("evaluate-links", workshop / "one", "--graph", workshop / "moved").code == 0


def test_a_graph_built_again_with_another_split_is_refused(run: Run, workshop: Path):
    build(workshop / "graph", seed=1)
    for command in (["evaluate-links", workshop / "one"], ["compare", workshop / "one", workshop / "two"]):
        assert "split" in refused(run(*command), "GraphMismatchError")
    assert not (workshop / "one" / "report").exists()


def test_a_leak_is_an_exit_code_of_1_and_said_on_stderr(run: Run, workshop: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Split, "held_out", lambda self, part: self.triples_of(part))
    outcome = run("evaluate-links", workshop / "one", "--json")
    assert outcome.code == 1
    assert "CHECK FAILED: no evaluated triple is in the training triples" in outcome.err
    assert not json.loads(outcome.out)["checks_passed"]


def test_too_few_unseen_triples_are_an_error_that_suggests_another_ratio(run: Run, tmp_path: Path):
    build(tmp_path / "graph", train_ratio=0.99)
    assert run("train-complex", tmp_path / "graph", *QUICK, "--out", tmp_path / "model").code == 0
    assert "--train-ratio" in refused(run("evaluate-links", tmp_path / "model"), "SplitError")
    assert not (tmp_path / "model" / "report").exists()


def test_a_missing_or_foreign_folder_is_a_clear_error_everywhere(run: Run, trained: Path, tmp_path: Path):
    for command in (
        ["evaluate-links", "{}"],
        ["score", "{}", "flour", "combinesWith", "water"],
        ["compare", "{}", str(trained / "one")],
        ["compare", str(trained / "one"), "{}"],
    ):
        for folder, expected in ((tmp_path / "nowhere", "does not exist"), (trained / "graph", "is a graph folder")):
            assert expected in refused(run(*(part.format(folder) for part in command)), "ArtefactError")


@pytest.mark.parametrize("name", ["model.safetensors", "vocabulary.json", "config.toml", "metrics.json", "trace.jsonl"])
def test_a_damaged_model_is_a_clear_error(run: Run, workshop: Path, name: str):
    path = workshop / "one" / name
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    assert name in refused(run("evaluate-links", workshop / "one"), "ArtefactError")


# --- scores ----------------------------------------------------------------------------------------------------------


def test_score_prints_one_object_with_the_score_of_a_triple(run: Run, trained: Path):
    from wordcraft_kg.models.scorers.folder import load_scorer

    values = one_object(run("score", trained / "one", "flour", "combinesWith", "water", "--json"))
    scorer = load_scorer(trained / "one")
    assert {"head", "relation", "tail", "score"} <= set(values)
    assert (values["head"], values["relation"], values["tail"]) == ("flour", "combinesWith", "water")
    assert values["score"] == pytest.approx(float(scorer.score("flour", "combinesWith", "water")))
    better = (scorer.score("flour", "combinesWith", torch.arange(80)) > values["score"]).sum()
    assert values["rank_as_tail"] == 1 + int(better)


@pytest.mark.parametrize(
    "arguments",
    [
        ("_", "componentOf", "bread"),
        ("?", "componentOf", "bread"),
        ("flour", "componentOf", "_"),
        ("flour", "componentOf", "?"),
        ("flour", "componentOf"),
    ],
)
def test_score_lists_the_best_entities_of_an_open_slot(run: Run, trained: Path, arguments: tuple[str, ...]):
    from wordcraft_kg.models.scorers.folder import load_scorer

    values = one_object(run("score", trained / "one", *arguments, "--top", "3", "--json"))
    head, relation, tail = ("" if slot in ("_", "?") else slot for slot in (*arguments, "")[:3])
    expected = load_scorer(trained / "one").top(head or None, relation, tail or None, limit=3)
    assert (values["head"], values["tail"]) == (head or None, tail or None)
    assert [(row["entity"], row["score"]) for row in values["top"]] == expected
    text = run("score", trained / "one", *arguments, "--top", "3").out.splitlines()
    for line, (name, _) in zip(text, expected, strict=True):
        assert f"{head or name} componentOf {tail or name}" in line


def parts_of(trained: Path) -> dict[tuple[str, str, str], str]:
    """The triples of the graph by label, each with the part whose recipes give it, train before test."""
    opened = open_graph(trained / "graph")
    found = {}
    for part in ("test", "train"):
        for head, relation, tail in opened.split.triples_of(part).tolist():
            found[opened.graph.entities[head], RELATIONS[relation], opened.graph.entities[tail]] = part
    return found


def test_score_says_which_recipes_give_each_triple(run: Run, trained: Path):
    known = parts_of(trained)
    found = one_object(run("score", trained / "one", "_", "componentOf", "bread", "--top", "80", "--json"))
    parts = [row["known"] for row in found["top"]]
    assert parts == [known.get((row["entity"], "componentOf", "bread"), "new") for row in found["top"]]
    assert set(parts) == {"train", "test", "new"}
    assert found["trained_on"] == "partial"
    lines = run("score", trained / "one", "_", "componentOf", "bread", "--top", "80").out.splitlines()
    assert [line.split()[1] for line in lines] == parts
    for triple, part in list(known.items())[::97]:
        assert one_object(run("score", trained / "one", *triple, "--json"))["known"] == part


def test_score_says_how_probable_triples_outside_training_are(run: Run, tmp_path: Path):
    build(tmp_path / "graph")
    run("train-complex", tmp_path / "graph", "--dim", "8", "--epochs", "4", "--folds", "3", "--out", tmp_path / "model")
    model, scorer = tmp_path / "model", load_scorer(tmp_path / "model")
    assert isinstance(scorer, CrossFitted)
    found = one_object(run("score", model, "_", "componentOf", "bread", "--top", "80", "--json"))["top"]
    for row in found:
        known = row["known"] == "train"
        expected = None if known else float(scorer.probability(row["entity"], "componentOf", "bread"))
        assert row["probability"] == (None if expected is None else pytest.approx(expected))
    lines = run("score", model, "_", "componentOf", "bread", "--top", "80").out.splitlines()
    assert [line.endswith(" %") for line in lines] == [row["known"] != "train" for row in found]
    new = next(row for row in found if row["known"] == "new")
    single = run("score", model, new["entity"], "componentOf", "bread").out
    assert f"probability {100 * new['probability']:.2g} %" in single
    queries = tmp_path / "queries.csv"
    queries.write_text(f"head,relation,tail\n{new['entity']},componentOf,bread\n_,componentOf,bread\n")
    rows = one_object(run("score", model, "--in", queries, "--top", "80", "--json"))["rows"]
    assert rows[0]["probability"] == pytest.approx(new["probability"])
    assert [row["probability"] for row in rows[1:]] == [row["probability"] for row in found]
    run("score", model, "--in", queries, "--out", tmp_path / "scores.csv")
    header, first, *_ = (tmp_path / "scores.csv").read_text().splitlines()
    assert header.endswith(",known,probability")
    assert float(first.rsplit(",", 1)[1]) == pytest.approx(new["probability"], rel=1e-4)


def test_validation_triples_are_known_as_such(run: Run, tmp_path: Path):
    build(tmp_path / "graph", train_ratio=0.8, valid_ratio=0.1)
    run("train-complex", tmp_path / "graph", *QUICK, "--out", tmp_path / "model")
    opened = open_graph(tmp_path / "graph")
    head, relation, tail = opened.split.held_out("valid")[0]
    triple = (opened.graph.entities[head], RELATIONS[relation], opened.graph.entities[tail])
    assert one_object(run("score", tmp_path / "model", *triple, "--json"))["known"] == "valid"


def test_new_only_lists_the_best_that_the_book_does_not_have(run: Run, trained: Path):
    query = ("score", trained / "one", "_", "componentOf", "bread")
    everything = one_object(run(*query, "--top", "80", "--json"))["top"]
    new = one_object(run(*query, "--top", "7", "--new-only", "--json"))["top"]
    assert new == [row for row in everything if row["known"] == "new"][:7]
    message = refused(run("score", trained / "one", "flour", "combinesWith", "water", "--new-only"), "ConfigError")
    assert "--new-only" in message


def test_score_says_that_a_model_of_the_full_graph_has_seen_the_test_triples(run: Run, trained: Path):
    note = "trained on the full graph: it has seen test triples too"
    triple = next(triple for triple, part in parts_of(trained).items() if part == "test")
    assert note in run("score", trained / "full", *triple).out
    assert note not in run("score", trained / "one", *triple).out
    assert note in run("score", trained / "full", "_", "componentOf", "bread", "--top", "80").out
    assert note not in run("score", trained / "full", "_", "componentOf", "bread", "--top", "80", "--new-only").out


def test_without_its_graph_a_model_still_scores_but_not_new_only(
    run: Run, workshop: Path, caplog: pytest.LogCaptureFixture
):
    (workshop / "graph").rename(workshop / "moved")
    query = ("score", workshop / "one", "_", "componentOf", "bread")
    with_graph = one_object(run(*query, "--graph", workshop / "moved", "--json"))["top"]
    assert not caplog.records
    without = one_object(run(*query, "--json"))
    assert [row["entity"] for row in without["top"]] == [row["entity"] for row in with_graph]
    assert {row["known"] for row in without["top"]} == {None}
    assert without["trained_on"] is None
    assert "not shown which triples are known" in caplog.text
    assert "--graph" in caplog.text
    assert "--graph" in refused(run(*query, "--new-only"), "ArtefactError")
    assert run(*query, "--graph", "everyday").kind == "GraphMismatchError"


def test_an_entity_called_like_an_open_slot_goes_before_it(run: Run, tmp_path: Path):
    book = tmp_path / "book.csv"
    rows = [f"{a},{b},{c}" for a, b, c in open_book("kitchen").recipes]
    book.write_text("ingredient_a,ingredient_b,result\n_,water,bread\n" + "\n".join(rows))
    run("train-complex", book, *QUICK, "--out", tmp_path / "model")
    values = one_object(run("score", tmp_path / "model", "_", "combinesWith", "water", "--json"))
    assert (values["head"], values["known"]) == ("_", "train")
    assert one_object(run("score", tmp_path / "model", "?", "combinesWith", "water", "--json"))["head"] is None
    assert one_object(run("score", tmp_path / "model", "water", "combinesWith", "--json"))["tail"] is None


# --- files of queries ------------------------------------------------------------------------------------------------

QUERIES = "head,relation,tail\nflour,combinesWith,water\n\n_,componentOf,bread\nflour,componentOf,\n"


def test_a_file_of_queries_gives_what_single_ones_give(run: Run, trained: Path, tmp_path: Path):
    (tmp_path / "pairs.csv").write_text(QUERIES)
    found = one_object(run("score", trained / "one", "--in", tmp_path / "pairs.csv", "--top", "3", "--json"))
    assert (found["queries"], found["found"], len(found["rows"])) == (3, 7, 7)
    triple, *listed = found["rows"]
    single = one_object(run("score", trained / "one", "flour", "combinesWith", "water", "--json"))
    assert (triple["line"], triple["rank"], triple["known"]) == (2, None, single["known"])
    assert triple["score"] == pytest.approx(single["score"])
    for line, query, rows in (
        (4, ("_", "componentOf", "bread"), listed[:3]),
        (5, ("flour", "componentOf"), listed[3:]),
    ):
        best = one_object(run("score", trained / "one", *query, "--top", "3", "--json"))["top"]
        assert [(row["line"], row["rank"]) for row in rows] == [(line, 1), (line, 2), (line, 3)]
        open_slot = "head" if query[0] == "_" else "tail"
        assert [(row[open_slot], row["score"], row["known"]) for row in rows] == [
            (row["entity"], row["score"], row["known"]) for row in best
        ]


@pytest.mark.parametrize("ending", ["csv", "tsv"])
def test_the_scores_of_a_file_go_to_a_file(run: Run, trained: Path, tmp_path: Path, ending: str):
    (tmp_path / "pairs.csv").write_text(QUERIES)
    out = tmp_path / "new" / f"scores.{ending}"
    command = ("score", trained / "one", "--in", tmp_path / "pairs.csv", "--top", "3", "--out", out)
    assert one_object(run(*command, "--json"))["out"] == str(out)
    rows = one_object(run(*command[:6], "--json"))["rows"]
    header, *lines = [line.split("," if ending == "csv" else "\t") for line in out.read_text().splitlines()]
    assert header == ["line", "head", "relation", "tail", "score", "rank", "known", "probability"]
    assert [line[1:4] for line in lines] == [[row["head"], row["relation"], row["tail"]] for row in rows]
    assert [np.float32(line[4]) for line in lines] == [np.float32(row["score"]) for row in rows]
    assert [line[5] for line in lines] == ["" if row["rank"] is None else str(row["rank"]) for row in rows]
    before = out.read_bytes()
    assert "--force" in refused(run(*command), "OutputExistsError")
    assert out.read_bytes() == before
    assert run(*command, "--force").code == 0


def test_new_only_leaves_known_triples_out_of_a_file_too(run: Run, trained: Path, tmp_path: Path):
    triples = trained / "graph" / "triples" / "full.tsv"
    assert one_object(run("score", trained / "one", "--in", triples, "--new-only", "--json")).get("rows", []) == []
    rows = one_object(run("score", trained / "one", "--in", triples, "--json"))["rows"]
    assert [row["known"] for row in rows] == [
        parts_of(trained)[row["head"], row["relation"], row["tail"]] for row in rows
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("flour,combinesWith,water\nflour,combinesWith,watr\n", "line 2: no entity 'watr'. Did you mean 'water'"),
        ("flour,combineWith,water\n", "line 1: no relation 'combineWith'"),
        ("head,relation,tail\n_,componentOf,?\n", "line 2: both slots are open"),
        ("\n\nflour,water\n", "line 3: 'flour,water' has 2 columns; expected head, relation, tail"),
        ('flour,combinesWith,"wa\n', "line 1: "),
        ("head,relation,tail\n", "has no query"),
        ("", "has no query"),
        ("\xff", "not UTF-8"),
    ],
)
def test_a_wrong_file_of_queries_is_refused_with_the_line_and_writes_nothing(
    run: Run, trained: Path, tmp_path: Path, content: str, message: str
):
    (tmp_path / "pairs.csv").write_text(content, encoding="latin-1")
    command = ("score", trained / "one", "--in", tmp_path / "pairs.csv", "--out", tmp_path / "scores.csv")
    assert message in refused(run(*command), "QueryFileError")
    assert [path.name for path in tmp_path.iterdir()] == ["pairs.csv"]


@pytest.mark.parametrize(
    "arguments", [(), ("flour",), ("flour", "combinesWith", "--in", "x.csv"), ("flour", "combinesWith", "--out", "x")]
)
def test_score_wants_a_query_or_a_file_of_them(run: Run, trained: Path, arguments: tuple[str, ...]):
    assert "--in" in refused(run("score", trained / "one", *arguments), "ConfigError")
    assert "is not a file" in refused(run("score", trained / "one", "--in", trained), "QueryFileError")


def test_score_lists_ten_entities_unless_told_otherwise(run: Run, trained: Path):
    assert len(one_object(run("score", trained / "one", "?", "componentOf", "bread", "--json"))["top"]) == 10
    assert (
        len(one_object(run("score", trained / "one", "?", "componentOf", "bread", "--top", "500", "--json"))["top"])
        == 80
    )


@pytest.mark.parametrize("slot", [0, 2])
def test_score_suggests_entities_for_an_unknown_one(run: Run, trained: Path, slot: int):
    triple = ["flour", "componentOf", "flour"]
    triple[slot] = "bred"
    message = refused(run("score", trained / "one", *triple), "UnknownEntityError")
    assert "'bred'" in message
    assert "'bread'" in message


def test_score_suggests_a_relation_for_an_unknown_one(run: Run, trained: Path):
    message = refused(run("score", trained / "one", "flour", "combineWith", "water"), "UnknownEntityError")
    assert "'combinesWith'" in message


@pytest.mark.parametrize("arguments", [("?", "componentOf", "?"), ("?", "componentOf")])
def test_score_wants_one_slot_filled(run: Run, trained: Path, arguments: tuple[str, ...]):
    assert "both slots are open" in refused(run("score", trained / "one", *arguments), "ConfigError")


@pytest.mark.parametrize("top", ["0", "-1"])
def test_score_wants_to_list_at_least_one(run: Run, trained: Path, top: str):
    outcome = run("score", trained / "one", "?", "componentOf", "bread", "--top", top)
    assert f"--top {top}" in refused(outcome, "ConfigError")


# --- comparison ------------------------------------------------------------------------------------------------------


def test_compare_links_prints_one_object_with_the_paired_difference(run: Run, trained: Path):
    values = one_object(run("compare", trained / "one", trained / "two", "--json"))
    assert {"graph", "split", "queries", "triples", "models", "best"} <= set(values)
    one, two = values["models"]
    assert (one["name"], two["name"]) == ("one", "two")
    assert two["difference"] == pytest.approx(two["mrr"] - one["mrr"])
    assert two["difference_ci"][0] <= two["difference"] <= two["difference_ci"][1]
    assert "difference" not in one


def test_compare_links_agrees_with_the_reports_of_all(run: Run, workshop: Path):
    names = ("one", "two")
    values = one_object(run("compare", *(workshop / name for name in names), "--json"))
    for name, found in zip(names, values["models"], strict=True):
        report = one_object(run("evaluate-links", workshop / name, "--json"))
        for metric in ("mrr", "hits@1", "hits@3", "hits@10"):
            assert found[metric] == report[metric]["all"]


def test_a_model_does_not_differ_from_itself(run: Run, trained: Path):
    values = one_object(run("compare", trained / "one", trained / "one", "--json"))["models"][1]
    assert (values["difference"], values["difference_ci"], values["probability_better"]) == (0, [0, 0], 0.5)
    assert "no difference is shown" in run("compare", trained / "one", trained / "one").out


def test_models_of_one_name_are_told_apart_by_their_paths(run: Run, workshop: Path):
    shutil.copytree(workshop / "two", workshop / "copies" / "one")
    paths = [workshop / "one", workshop / "copies" / "one"]
    values = one_object(run("compare", *paths, "--graph", workshop / "graph", "--json"))
    assert [found["name"] for found in values["models"]] == [str(path) for path in paths]


def test_several_models_are_compared_with_the_first_on_a_page(run: Run, trained: Path, tmp_path: Path):
    page = tmp_path / "new" / "comparison.html"
    command = ("compare", *(trained / name for name in ("one", "two", "full")), "--out", page)
    text = run(*command).out.splitlines()
    assert [line.split()[0] for line in text[1:4]] == ["one", "two", "full"]
    assert "widened for 3 pairs of models (Bonferroni)" in text[-2]
    assert text[-1] == f"wrote {page}"
    assert "3 link predictors on the same queries" in page.read_text()
    before = page.read_bytes()
    assert "--force" in refused(run(*command), "OutputExistsError")
    assert page.read_bytes() == before
    assert one_object(run(*command, "--force", "--json"))["out"] == str(page)
    assert page.read_bytes() == before


def test_a_folder_of_seeds_is_compared_as_one_model(run: Run, workshop: Path):
    seeds = ("--seeds", "4,5", "--out", workshop / "seeds")
    run("train-complex", workshop / "graph", *QUICK, "--quiet", *seeds)
    command = ("compare", workshop / "one", workshop / "seeds")
    found = one_object(run(*command, "--json"))["models"][1]
    assert (found["name"], found["seeds"]) == ("seeds", [4, 5])
    assert found["mrr"] == pytest.approx(np.mean(found["mrr_of_seeds"]))
    assert "2 seeds" in run(*command).out


def test_models_of_different_splits_are_not_compared(run: Run, workshop: Path):
    build(workshop / "other", seed=1)
    assert run("train-complex", workshop / "other", *QUICK, "--out", workshop / "three").code == 0
    outcome = run("compare", workshop / "one", workshop / "three")
    assert "different splits" in refused(outcome, "GraphMismatchError")


def test_comparing_with_a_model_of_the_full_graph_says_that_it_has_seen_the_triples(run: Run, trained: Path):
    assert "has seen these triples" in run("compare", trained / "one", trained / "full").out
    assert "has seen these triples" not in run("compare", trained / "one", trained / "two").out


@pytest.mark.parametrize("resamples", ["0", "-5"])
def test_comparing_without_resamples_is_refused(run: Run, trained: Path, resamples: str):
    outcome = run("compare", trained / "one", trained / "two", "--resamples", resamples)
    assert f"--resamples {resamples}" in refused(outcome, "ConfigError")


# --- other models ----------------------------------------------------------------------------------------------------


def test_the_models_that_can_be_trained_are_listed_with_their_commands(run: Run):
    listed = {
        model["name"]: model["command"] for model in one_object(run("train-links", "--list-models", "--json"))["models"]
    }
    assert listed["ComplEx"] == "train-complex"
    assert listed["RotatE"] == "train-links --model RotatE"
    assert not {"CompGCN", "DistMultLiteral", "NodePiece", "FixedModel"} & set(listed)
    assert "wordcraft-kg train-links --model TuckER" in run("train-links", "--list-models").out


def test_a_listed_model_trains_under_its_listed_name(run: Run, tmp_path: Path):
    assert run("train-links", "kitchen", "--model", "SimplE", *TINY, "--out", tmp_path / "model").code == 0


@pytest.mark.parametrize("name", ["complex", "ComplEx"])
def test_complex_means_the_papers_and_has_its_own_command(run: Run, tmp_path: Path, name: str):
    outcome = run("train-links", "kitchen", "--model", name, "--out", tmp_path / "model")
    assert "wordcraft-kg train-complex" in refused(outcome, "ConfigError")
    assert list(tmp_path.iterdir()) == []


# --- tuning ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def fast_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search among few epochs, so that a trial takes a moment."""
    from optuna.distributions import IntDistribution

    monkeypatch.setattr("wordcraft_kg.models.links.tuning._EPOCHS", IntDistribution(2, 4, step=2))


@pytest.mark.usefixtures("fast_search")
@pytest.mark.parametrize(("model", "command"), [("complex", "train-complex"), ("distmult", "train-links")])
def test_tuned_settings_are_a_file_that_training_takes(run: Run, tmp_path: Path, model: str, command: str):
    out = tmp_path / "tuned" / "kitchen"
    values = one_object(
        run("tune-links", "kitchen", "--model", model, "--trials", "2", "--out", out, "--json", "--quiet")
    )
    assert (values["trials"], values["out"], values["command"]) == (2, str(out), command)
    assert 0 < values["valid_mrr"] < 1
    assert values["valid_mrr"] == max(trial["valid_mrr"] for trial in values["table"])
    settings = tomllib.loads(Path(values["config"]).read_text())[command]
    assert settings == values["settings"]
    outcome = run(command, "kitchen", "--config", values["config"], "--out", tmp_path / "model", "--json", "--quiet")
    assert one_object(outcome)["epochs"] == settings["epochs"]
    trained = tomllib.loads((tmp_path / "model" / "config.toml").read_text())[command]
    assert trained.items() >= settings.items()


@pytest.mark.usefixtures("fast_search")
def test_a_search_prints_its_trials_and_its_own_progress_only(run: Run, tmp_path: Path):
    outcome = run("tune-links", "kitchen", "--trials", "2", "--out", tmp_path / "search")
    assert outcome.code == 0
    head, *rows = outcome.out.splitlines()[:3]
    assert head.split()[:3] == ["trial", "valid", "MRR"]
    assert [row.split()[0] for row in rows] == ["1", "2"]
    assert "tuning complex: trial 2 of 2, best MRR" in outcome.err
    assert all(line.startswith("tuning complex: ") for line in outcome.err.splitlines())


def test_a_folder_that_is_not_a_search_is_refused(run: Run, tmp_path: Path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    for force in ((), ("--force",)):
        outcome = run("tune-links", "kitchen", *force, "--out", tmp_path / "mine")
        assert "Choose another --out" in refused(outcome, "OutputExistsError")
    assert (tmp_path / "mine" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("option", "value"),
    [("--trials", "0"), ("--valid-ratio", "0"), ("--valid-ratio", "nan"), ("--model", "rotat"), ("--timeout", "0")],
)
def test_a_bad_setting_of_the_search_is_one_line(run: Run, tmp_path: Path, option: str, value: str):
    outcome = run("tune-links", "kitchen", option, value, "--out", tmp_path / "search")
    assert value in refused(outcome, "ConfigError")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_tuning_over_the_whole_range_on_the_kitchen(run: Run, tmp_path: Path):
    assert run("tune-links", "kitchen", "--trials", "3", "--out", tmp_path / "search").code == 0
    best = tmp_path / "search" / "best.toml"
    values = one_object(run("train-complex", "kitchen", "--config", best, "--out", tmp_path / "model", "--json"))
    assert values["epochs"] >= 20


# --- the whole way ---------------------------------------------------------------------------------------------------


def test_the_start_page_works_from_a_book_to_a_report(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert run("build-graph", "kitchen", "--out", "graphs/kitchen").code == 0
    assert run("train-complex", "graphs/kitchen", "--out", "models/kitchen", *QUICK).code == 0
    values = one_object(run("evaluate-links", "models/kitchen", "--json"))
    assert Path(values["report"]).is_file()
    assert values["mrr"]["all"] > values["baselines"]["random"]["all"]


@pytest.mark.slow
def test_complex_with_its_defaults_predicts_unseen_links_better_than_frequency(run: Run, tmp_path: Path):
    assert run("train-complex", "kitchen", "--out", tmp_path / "partial").code == 0
    values = one_object(run("evaluate-links", tmp_path / "partial", "--json"))
    assert values["mrr"]["all"] > 1.2 * values["baselines"]["frequency"]["all"]
    assert values["mrr_with_leaked"] > values["mrr"]["all"]
    trained = one_object(run("train-complex", "kitchen", "--kg", "full", "--out", tmp_path / "full", "--json"))
    assert trained["train_mrr"] > 0.99


def test_a_model_trained_from_a_script_file_is_the_commands_model(trained: Path, tmp_path: Path):
    from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.training import train_links

    config = LinksConfig(str(trained / "graph"), ComplExConfig(dim=8, epochs=4, n3=0.1, folds=0))
    here = train_links(config, tmp_path / "model").folder
    assert (here / "model.safetensors").read_bytes() == (trained / "one" / "model.safetensors").read_bytes()
    assert not np.array_equal(
        np.frombuffer((trained / "two" / "model.safetensors").read_bytes(), dtype=np.uint8),
        np.frombuffer((trained / "one" / "model.safetensors").read_bytes(), dtype=np.uint8),
    )
