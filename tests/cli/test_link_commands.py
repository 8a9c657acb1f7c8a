"""The commands of link prediction as a user runs them: output, exit codes and bad input."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

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

TINY = ("--dim", "8", "--epochs", "4", "--folds", "0")
QUICK = (*TINY, "--n3", "0.1")
NAMES = ALL
SLICES = {"all", *RELATIONS}


def build(folder, **settings):
    book = open_book("kitchen")
    write_graph_folder(folder, book, make_split(RecipeGraph.from_book(book), SplitConfig(**settings)), force=True)


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """A folder with a graph, two models of its partial graph and one of its full graph; read only."""
    root = tmp_path_factory.mktemp("trained")
    build(root / "graph")
    for name, extra in (("one", []), ("two", ["--seed", "1"]), ("full", ["--kg", "full"])):
        command = ["train-complex", str(root / "graph"), *QUICK, *extra, "--out", str(root / name), "--quiet"]
        assert main(command) == 0
    return root


@pytest.fixture
def workshop(trained, tmp_path):
    """A copy of the graph and the models, for a test to change."""
    shutil.copytree(trained, tmp_path / "workshop")
    return tmp_path / "workshop"


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
def test_judging_models_names_its_stages(run, trained, tmp_path, monkeypatch, command, stages):
    monkeypatch.setattr(Progress, "INTERVAL", 0.0)
    monkeypatch.setattr(Stages, "INTERVAL", 0.0)
    outcome = run(*(part.format(trained, tmp_path) for part in command))
    assert outcome.code == 0
    for stage in stages:
        assert f"\n{stage}" in f"\n{outcome.err}"


# --- help ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_every_command_prints_help_with_two_examples(run, name):
    outcome = run(*name.split(), "--help")
    assert (outcome.code, outcome.err) == (0, "")
    examples = manual_of(name).module.EXAMPLES
    assert len(examples) >= 2
    assert all(example in outcome.out for example in examples)
    assert "--json" in outcome.out


@pytest.mark.parametrize("name", NAMES)
def test_every_example_is_one_of_our_commands_and_parses(name):
    app = make_app()
    examples = manual_of(name).module.EXAMPLES
    for example in examples:
        program, *tokens = shlex.split(example)
        assert program == "wordcraft-kg"
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        named = command_in(tokens)
        assert named is not None
        assert command is manual_of(named).function
        assert bound.args or bound.kwargs or tokens == named.split()
    assert any(example.startswith(f"wordcraft-kg {name}") for example in examples)


def test_an_option_that_does_not_exist_does_not_parse(refused):
    with pytest.raises(Exception, match="epoch"):
        make_app().parse_args(["train-complex", "kitchen", "--epoch", "3"], exit_on_error=False, print_error=False)
    refused("train-complex", "kitchen", "--epoch", "3", says="--epoch", code=2)


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
def test_wrong_usage_has_exit_code_2_and_an_explanation(run, arguments):
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
def test_help_of_a_command_imports_no_torch(name):
    code = f"import sys\nfrom wordcraft_kg.cli import main\nmain([{name!r}, '--help'])\nprint('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "False"


# --- training --------------------------------------------------------------------------------------------------------


def test_train_complex_prints_one_object_with_what_was_trained(printed, tmp_path):
    values = printed("train-complex", "kitchen", *QUICK, "--out", tmp_path / "model", "--quiet")
    assert {"out", "kg", "epochs", "seconds", "parameters", "train_mrr"} <= set(values)
    assert (values["out"], values["kg"], values["epochs"]) == (str(tmp_path / "model"), "partial", 4)
    assert values["parameters"] == 2 * 8 * (80 + 2)
    assert 0 < values["train_mrr"] < 1
    assert values["seconds"] > 0


def test_train_links_prints_the_same_keys(printed, tmp_path):
    options = ("--model", "distmult", "--dim", "4", "--epochs", "1", "--negatives", "2")
    values = printed("train-links", "kitchen", *options, "--out", tmp_path / "model", "--quiet")
    assert {"out", "kg", "epochs", "seconds", "parameters", "train_mrr"} <= set(values)
    assert (tmp_path / "model" / "model.safetensors").is_file()


def test_a_quiet_training_says_nothing_on_stderr(run, tmp_path):
    for command, extra in (("train-complex", QUICK), ("train-links", ("--model", "distmult", *TINY))):
        outcome = run(command, "kitchen", *extra, "--out", tmp_path / command, "--quiet")
        assert (outcome.code, outcome.err) == (0, "")


def test_progress_goes_to_stderr_and_the_result_to_stdout(run, tmp_path):
    outcome = run("train-complex", "kitchen", "--epochs", 4, "--n3", 0.1, "--folds", 2, "--out", tmp_path / "model")
    assert "epoch 12 of 12" in outcome.err
    assert "epoch 12 of 24" not in outcome.out
    assert f"next: wordcraft-kg evaluate-links {tmp_path / 'model'}" in outcome.out


def test_models_go_to_a_folder_of_their_own_by_default(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run("train-complex", "kitchen", *QUICK, "--kg", "full")
    run("train-links", "kitchen", *TINY, "--model", "DistMult", "--loop", "symmetric")
    assert sorted(path.name for path in (tmp_path / "models").iterdir()) == ["kitchen-distmult-partial", "kitchen-full"]


BAD_SETTINGS = (
    *(("train-complex", "--epochs", "0", "--epochs"), ("train-complex", "--patience", "3", "--patience")),
    *(("train-complex", "--learning-rate", bad, "--learning-rate") for bad in ("nan", "-1")),
    *(("train-complex", option, bad, option) for option, bad in (("--n3", "-1"), ("--eval-every", "2"))),
    ("train-complex", "--device", "nonsense", "--device"),
    ("train-links", "--model", "rotat", "'rotate'"),
    *(("train-links", "--model", name, "wordcraft-kg train-complex") for name in ("complex", "ComplEx")),
    *(("tune-links", "--valid-ratio", bad, bad) for bad in ("0", "nan")),
    *(
        ("tune-links", option, bad, bad)
        for option, bad in (("--trials", "0"), ("--timeout", "0"), ("--model", "rotat"))
    ),
)


@pytest.mark.parametrize(("command", "option", "value", "says"), BAD_SETTINGS)
def test_a_bad_setting_is_one_line_that_names_the_option(refused, tmp_path, command, option, value, says):
    error = refused(command, "kitchen", option, value, "--out", tmp_path / "model", says=says, kind="ConfigError")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_model_folder_that_exists_is_refused_before_anything_is_trained(refused, run, workshop):
    weights = (workshop / "one" / "model.safetensors").read_bytes()
    command = ("train-complex", workshop / "graph", *QUICK, "--seed", "5", "--out", workshop / "one")
    refused(*command, says="--force", kind="OutputExistsError")
    assert (workshop / "one" / "model.safetensors").read_bytes() == weights
    assert (
        run("train-complex", workshop / "graph", *QUICK, "--seed", "5", "--out", workshop / "one", "--force").code == 0
    )
    assert (workshop / "one" / "model.safetensors").read_bytes() != weights


def test_a_file_is_never_replaced_by_a_model(refused, tmp_path):
    (tmp_path / "model").write_text("mine")
    refused("train-complex", "kitchen", *QUICK, "--out", tmp_path / "model", "--force", kind="OutputExistsError")
    assert (tmp_path / "model").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_a_clear_error(refused, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    command = ("train-complex", "kitchen", *QUICK, "--out", tmp_path / "locked" / "model")
    refused(*command, says=str(tmp_path / "locked"), kind="PermissionError")


def test_settings_may_stand_in_a_toml_file_and_the_command_line_goes_first(printed, tmp_path):
    (tmp_path / "mine.toml").write_text("[train-complex]\ndim = 4\nepochs = 3\nlearning_rate = 0.05\n")
    out = tmp_path / "model"
    options = ("--config", tmp_path / "mine.toml", "--epochs", "2", "--out", out, "--quiet")
    assert printed("train-complex", "kitchen", *options)["epochs"] == 2
    written = tomllib.loads((out / "config.toml").read_text())["train-complex"]
    assert (written["dim"], written["epochs"], written["learning_rate"]) == (4, 2, 0.05)


@pytest.mark.parametrize("line", ["epoch = 3", "epochs = 'ten'", "surprise = true"])
def test_a_toml_file_with_a_wrong_setting_is_refused(run, tmp_path, line):
    (tmp_path / "mine.toml").write_text(f"[train-complex]\n{line}\n")
    outcome = run("train-complex", "kitchen", "--config", tmp_path / "mine.toml", "--out", tmp_path / "model")
    assert outcome.code in (1, 2)
    assert line.split()[0] in outcome.err
    assert "Traceback" not in outcome.err
    assert not (tmp_path / "model").exists()


def test_a_models_own_config_file_trains_the_same_model_again(run, workshop):
    options = ("--config", workshop / "one" / "config.toml", "--out", workshop / "again", "--quiet")
    outcome = run("train-complex", workshop / "graph", *options)
    assert outcome.code == 0, outcome.err
    for name in ("model.safetensors", "vocabulary.json"):
        assert (workshop / "again" / name).read_bytes() == (workshop / "one" / name).read_bytes()


# --- interruption ----------------------------------------------------------------------------------------------------


@pytest.fixture
def ctrl_c_in_epoch_2(monkeypatch):
    def press(self, done, total, figures):
        if done == 2:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Progress, "__call__", press)
    return monkeypatch


def test_ctrl_c_in_a_training_ends_with_130_and_the_same_command_goes_on(
    printed, refused, run, workshop, ctrl_c_in_epoch_2
):
    settings = (workshop / "graph", "--dim", "8", "--epochs", "6", "--seed", "3")
    command = ("train-complex", *settings, "--out", workshop / "model")
    outcome = run(*command)
    assert (outcome.code, outcome.out) == (130, "")
    assert f"epoch 3 is saved in '{workshop / 'model'}'. The same command goes on" in outcome.err
    refused("score", workshop / "model", "flour", "combinesWith", "water", says="not done", kind="ArtefactError")
    refused(*command, "--n3", "0.5", says="--n3", kind="ConfigError")
    ctrl_c_in_epoch_2.undo()
    values = printed(*command, "--quiet")
    assert (values["out"], values["epochs"]) == (str(workshop / "model"), 6)
    run("train-complex", *settings, "--out", workshop / "undisturbed")
    weights = [(workshop / name / "model.safetensors").read_bytes() for name in ("model", "undisturbed")]
    assert weights[0] == weights[1]


def test_a_second_ctrl_c_says_truly_what_is_left(run, tmp_path, monkeypatch):
    def press_twice(self, done, total, figures):
        if done == 3:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Progress, "__call__", press_twice)
    outcome = run("train-complex", "kitchen", *QUICK, "--checkpoint-every", "1", "--out", tmp_path / "model")
    assert (outcome.code, outcome.out) == (130, "")
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
    assert "The same command goes on" in outcome.err
    assert "nothing was written" not in outcome.err


def test_ctrl_c_at_once_in_a_forced_training_leaves_the_earlier_model(run, workshop, monkeypatch):
    def press_twice(self, done, total, figures):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    weights = (workshop / "one" / "model.safetensors").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "__call__", press_twice)
        outcome = run("train-complex", workshop / "graph", *QUICK, "--seed", "3", "--out", workshop / "one", "--force")
    assert outcome.code == 130
    assert (workshop / "one" / "model.safetensors").read_bytes() == weights
    assert run("score", workshop / "one", "flour", "combinesWith", "water").code == 0


def test_ctrl_c_elsewhere_ends_with_130_and_one_line(run, workshop, monkeypatch):
    def interrupted(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("wordcraft_kg.reports.pages.render", interrupted)
    outcome = run("evaluate-links", workshop / "one")
    assert (outcome.code, outcome.out) == (130, "")
    assert outcome.err.splitlines()[-1].startswith("interrupted")
    assert not (workshop / "one" / "report").exists()


# --- evaluation ------------------------------------------------------------------------------------------------------


def test_evaluate_links_prints_one_object_with_the_headline_and_its_baselines(printed, workshop):
    values = printed("evaluate-links", workshop / "one")
    for metric in ("mrr", "hits@1", "hits@3", "hits@10"):
        assert set(values[metric]) == SLICES
        assert all(0 <= value <= 1 for value in values[metric].values())
    assert set(values["baselines"]) == {"frequency", "votes", "neighbours", "random"}
    assert {"queries", "leaked_left_out", "mrr_with_leaked", "report"} <= set(values)
    assert 0 < values["mrr_without_near_synonyms"] < 1
    split = open_graph(workshop / "graph").split
    assert values["queries"] == 2 * len(split.held_out("test"))
    assert values["leaked_left_out"] == len(split.triples_of("test")) - len(split.held_out("test"))


def test_evaluate_links_writes_the_report_that_it_names(printed, workshop):
    values = printed("evaluate-links", workshop / "one")
    report = Path(values["report"])
    assert report == workshop / "one" / "report" / "index.html"
    assert f"{values['mrr']['all']:.3f}" in report.read_text(encoding="utf-8")
    written = json.loads((report.parent / "report.json").read_text(encoding="utf-8"))
    assert written["metrics"]["all"]["mrr"] == values["mrr"]["all"]
    assert "train-complex" in written["provenance"]["trained by"] or written["provenance"]["trained by"]
    assert (report.parent / "ranks.csv").is_file()


def test_the_text_of_evaluate_links_names_the_leaks_the_baselines_and_the_report(run, workshop):
    outcome = run("evaluate-links", workshop / "one")
    assert outcome.code == 0
    for expected in ("leaked ones left out", "frequency", "random", "inflated", str(workshop / "one" / "report")):
        assert expected in outcome.out


def line_of(outcome, name):
    """The line of a command's text that begins with a name, "" if there is none."""
    return next((line for line in outcome.out.splitlines() if line.startswith(name)), "")


def with_figures(monkeypatch, **changes):
    """Let `evaluate-links` see figures other than its own."""
    from wordcraft_kg.evaluation import links

    original = links.view_links
    monkeypatch.setattr(
        "wordcraft_kg.reports.link_report.view_links",
        lambda *args, **kwargs: msgspec.structs.replace(original(*args, **kwargs), **changes),
    )


def test_leaked_triples_that_lower_the_figure_are_not_called_inflation(run, workshop, monkeypatch):
    with_figures(monkeypatch, with_leaked=RankingMetrics(60, mrr=0.0, hits_at_1=0.0, hits_at_3=0.0, hits_at_10=0.0))
    line = line_of(run("evaluate-links", workshop / "one"), "with leaked")
    assert "MRR 0.000, no better" in line
    assert "inflated" not in line


def test_without_leaked_triples_nothing_is_said_about_them(run, workshop, monkeypatch):
    with_figures(monkeypatch, leaked_left_out=0)
    outcome = run("evaluate-links", workshop / "one")
    assert "0 leaked ones left out" in outcome.out
    assert not line_of(outcome, "with leaked")


def test_a_full_graph_that_is_too_small_is_not_told_to_hold_out_more(refused, run, tmp_path):
    (tmp_path / "tiny.csv").write_text("ingredient_a,ingredient_b,result\nwater,earth,mud\nmud,fire,brick\n")
    assert run("train-complex", tmp_path / "tiny.csv", "--kg", "full", *QUICK, "--out", tmp_path / "full").code == 0
    message = refused("evaluate-links", tmp_path / "full", kind="SplitError")
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
def test_a_model_that_hardly_fits_is_told_options_that_its_command_has(run, tmp_path, caplog, command, said, unsaid):
    name, *options = command
    least = ("--dim", "1", "--epochs", "1", "--learning-rate", "1e-6", "--quiet")
    assert run(name, "kitchen", *options, *least, "--out", tmp_path / "model").code == 0
    (warning,) = (message for message in caplog.messages if "hardly fits" in message)
    assert said in warning
    assert unsaid not in warning


def test_a_model_of_the_full_graph_is_evaluated_as_memory(printed, run, workshop):
    values = printed("evaluate-links", workshop / "full")
    assert values["has_seen_the_test_recipes"]
    assert values["queries"] == 2 * len(open_graph(workshop / "graph").graph.triples)
    assert "memory, not prediction" in run("evaluate-links", workshop / "full", "--force").out


def test_a_report_that_exists_is_refused_without_force(refused, run, workshop):
    assert run("evaluate-links", workshop / "one").code == 0
    report = workshop / "one" / "report" / "report.json"
    report.write_text("mine")
    assert "--force" in refused("evaluate-links", workshop / "one", kind="OutputExistsError")
    assert report.read_text() == "mine"
    assert run("evaluate-links", workshop / "one", "--force").code == 0
    assert json.loads(report.read_text())["queries"] > 0


def test_a_report_goes_where_it_is_asked_to(printed, workshop):
    values = printed("evaluate-links", workshop / "one", "--out", workshop / "reports" / "one")
    assert values["report"] == str(workshop / "reports" / "one" / "index.html")
    assert not (workshop / "one" / "report").exists()


def test_a_graph_that_has_moved_is_found_with_graph(refused, run, workshop):
    (workshop / "graph").rename(workshop / "moved")
    assert "--graph" in refused("evaluate-links", workshop / "one", kind="ArtefactError")
    assert run("evaluate-links", workshop / "one", "--graph", workshop / "moved").code == 0


def test_a_graph_built_again_with_another_split_is_refused(refused, workshop):
    build(workshop / "graph", seed=1)
    for command in (["evaluate-links", workshop / "one"], ["compare", workshop / "one", workshop / "two"]):
        assert "split" in refused(*command, kind="GraphMismatchError")
    assert not (workshop / "one" / "report").exists()


def test_a_leak_is_an_exit_code_of_1_and_said_on_stderr(run, workshop, monkeypatch):
    monkeypatch.setattr(Split, "held_out", lambda self, part: self.triples_of(part))
    outcome = run("evaluate-links", workshop / "one", "--json")
    assert outcome.code == 1
    assert "CHECK FAILED: no evaluated triple is in the training triples" in outcome.err
    assert not json.loads(outcome.out)["checks_passed"]


def test_too_few_unseen_triples_are_an_error_that_suggests_another_ratio(refused, run, tmp_path):
    build(tmp_path / "graph", train_ratio=0.99)
    assert run("train-complex", tmp_path / "graph", *QUICK, "--out", tmp_path / "model").code == 0
    assert "--train-ratio" in refused("evaluate-links", tmp_path / "model", kind="SplitError")
    assert not (tmp_path / "model" / "report").exists()


def test_a_missing_or_foreign_folder_is_a_clear_error_everywhere(refused, trained, tmp_path):
    for command in (
        ["evaluate-links", "{}"],
        ["score", "{}", "flour", "combinesWith", "water"],
        ["compare", "{}", str(trained / "one")],
        ["compare", str(trained / "one"), "{}"],
    ):
        for folder, expected in ((tmp_path / "nowhere", "does not exist"), (trained / "graph", "is a graph folder")):
            assert expected in refused(*(part.format(folder) for part in command), kind="ArtefactError")


@pytest.mark.parametrize("name", ["model.safetensors", "vocabulary.json", "config.toml", "metrics.json", "trace.jsonl"])
def test_a_damaged_model_is_a_clear_error(refused, workshop, name):
    path = workshop / "one" / name
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    assert name in refused("evaluate-links", workshop / "one", kind="ArtefactError")


# --- scores ----------------------------------------------------------------------------------------------------------


def test_score_prints_one_object_with_the_score_of_a_triple(printed, trained):
    from wordcraft_kg.models.scorers.folder import load_scorer

    values = printed("score", trained / "one", "flour", "combinesWith", "water")
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
def test_score_lists_the_best_entities_of_an_open_slot(printed, run, trained, arguments):
    from wordcraft_kg.models.scorers.folder import load_scorer

    values = printed("score", trained / "one", *arguments, "--top", "3")
    head, relation, tail = ("" if slot in ("_", "?") else slot for slot in (*arguments, "")[:3])
    expected = load_scorer(trained / "one").top(head or None, relation, tail or None, limit=3)
    assert (values["head"], values["tail"]) == (head or None, tail or None)
    assert [(row["entity"], row["score"]) for row in values["top"]] == expected
    text = run("score", trained / "one", *arguments, "--top", "3").out.splitlines()
    for line, (name, _) in zip(text, expected, strict=True):
        assert f"{head or name} componentOf {tail or name}" in line


def parts_of(trained):
    """The triples of the graph by label, each with the part whose recipes give it, train before test."""
    opened = open_graph(trained / "graph")
    found = {}
    for part in ("test", "train"):
        for head, relation, tail in opened.split.triples_of(part).tolist():
            found[opened.graph.entities[head], RELATIONS[relation], opened.graph.entities[tail]] = part
    return found


def test_score_says_which_recipes_give_each_triple(printed, run, trained):
    known = parts_of(trained)
    found = printed("score", trained / "one", "_", "componentOf", "bread", "--top", "80")
    parts = [row["known"] for row in found["top"]]
    assert parts == [known.get((row["entity"], "componentOf", "bread"), "new") for row in found["top"]]
    assert set(parts) == {"train", "test", "new"}
    assert found["trained_on"] == "partial"
    lines = run("score", trained / "one", "_", "componentOf", "bread", "--top", "80").out.splitlines()
    assert [line.split()[1] for line in lines] == parts
    for triple, part in list(known.items())[::97]:
        assert printed("score", trained / "one", *triple)["known"] == part


def test_score_says_how_probable_triples_outside_training_are(printed, run, tmp_path):
    build(tmp_path / "graph")
    run("train-complex", tmp_path / "graph", "--dim", "8", "--epochs", "4", "--folds", "3", "--out", tmp_path / "model")
    model, scorer = tmp_path / "model", load_scorer(tmp_path / "model")
    assert isinstance(scorer, CrossFitted)
    found = printed("score", model, "_", "componentOf", "bread", "--top", "80")["top"]
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
    rows = printed("score", model, "--in", queries, "--top", "80")["rows"]
    assert rows[0]["probability"] == pytest.approx(new["probability"])
    assert [row["probability"] for row in rows[1:]] == [row["probability"] for row in found]
    run("score", model, "--in", queries, "--out", tmp_path / "scores.csv")
    header, first, *_ = (tmp_path / "scores.csv").read_text().splitlines()
    assert header.endswith(",known,probability")
    assert float(first.rsplit(",", 1)[1]) == pytest.approx(new["probability"], rel=1e-4)


def test_validation_triples_are_known_as_such(printed, run, tmp_path):
    build(tmp_path / "graph", train_ratio=0.8, valid_ratio=0.1)
    run("train-complex", tmp_path / "graph", *QUICK, "--out", tmp_path / "model")
    opened = open_graph(tmp_path / "graph")
    head, relation, tail = opened.split.held_out("valid")[0]
    triple = (opened.graph.entities[head], RELATIONS[relation], opened.graph.entities[tail])
    assert printed("score", tmp_path / "model", *triple)["known"] == "valid"


def test_new_only_lists_the_best_that_the_book_does_not_have(printed, refused, trained):
    query = ("score", trained / "one", "_", "componentOf", "bread")
    everything = printed(*query, "--top", "80")["top"]
    new = printed(*query, "--top", "7", "--new-only")["top"]
    assert new == [row for row in everything if row["known"] == "new"][:7]


def test_score_says_that_a_model_of_the_full_graph_has_seen_the_test_triples(run, trained):
    note = "trained on the full graph: it has seen test triples too"
    triple = next(triple for triple, part in parts_of(trained).items() if part == "test")
    assert note in run("score", trained / "full", *triple).out
    assert note not in run("score", trained / "one", *triple).out
    assert note in run("score", trained / "full", "_", "componentOf", "bread", "--top", "80").out
    assert note not in run("score", trained / "full", "_", "componentOf", "bread", "--top", "80", "--new-only").out


def test_without_its_graph_a_model_still_scores_but_not_new_only(printed, refused, run, workshop, caplog):
    (workshop / "graph").rename(workshop / "moved")
    query = ("score", workshop / "one", "_", "componentOf", "bread")
    with_graph = printed(*query, "--graph", workshop / "moved")["top"]
    assert not caplog.records
    without = printed(*query)
    assert [row["entity"] for row in without["top"]] == [row["entity"] for row in with_graph]
    assert {row["known"] for row in without["top"]} == {None}
    assert without["trained_on"] is None
    assert "not shown which triples are known" in caplog.text
    assert "--graph" in caplog.text
    assert "--graph" in refused(*query, "--new-only", kind="ArtefactError")
    assert run(*query, "--graph", "everyday").kind == "GraphMismatchError"


def test_an_entity_called_like_an_open_slot_goes_before_it(printed, run, tmp_path):
    book = tmp_path / "book.csv"
    rows = [f"{a},{b},{c}" for a, b, c in open_book("kitchen").recipes]
    book.write_text("ingredient_a,ingredient_b,result\n_,water,bread\n" + "\n".join(rows))
    run("train-complex", book, *QUICK, "--out", tmp_path / "model")
    values = printed("score", tmp_path / "model", "_", "combinesWith", "water")
    assert (values["head"], values["known"]) == ("_", "train")
    assert printed("score", tmp_path / "model", "?", "combinesWith", "water")["head"] is None
    assert printed("score", tmp_path / "model", "water", "combinesWith")["tail"] is None


# --- files of queries ------------------------------------------------------------------------------------------------

QUERIES = "head,relation,tail\nflour,combinesWith,water\n\n_,componentOf,bread\nflour,componentOf,\n"


def test_a_file_of_queries_gives_what_single_ones_give(printed, trained, tmp_path):
    (tmp_path / "pairs.csv").write_text(QUERIES)
    found = printed("score", trained / "one", "--in", tmp_path / "pairs.csv", "--top", "3")
    assert (found["queries"], found["found"], len(found["rows"])) == (3, 7, 7)
    triple, *listed = found["rows"]
    single = printed("score", trained / "one", "flour", "combinesWith", "water")
    assert (triple["line"], triple["rank"], triple["known"]) == (2, None, single["known"])
    assert triple["score"] == pytest.approx(single["score"])
    for line, query, rows in (
        (4, ("_", "componentOf", "bread"), listed[:3]),
        (5, ("flour", "componentOf"), listed[3:]),
    ):
        best = printed("score", trained / "one", *query, "--top", "3")["top"]
        assert [(row["line"], row["rank"]) for row in rows] == [(line, 1), (line, 2), (line, 3)]
        open_slot = "head" if query[0] == "_" else "tail"
        assert [(row[open_slot], row["score"], row["known"]) for row in rows] == [
            (row["entity"], row["score"], row["known"]) for row in best
        ]


@pytest.mark.parametrize("ending", ["csv", "tsv"])
def test_the_scores_of_a_file_go_to_a_file(printed, refused, run, trained, tmp_path, ending):
    (tmp_path / "pairs.csv").write_text(QUERIES)
    out = tmp_path / "new" / f"scores.{ending}"
    command = ("score", trained / "one", "--in", tmp_path / "pairs.csv", "--top", "3", "--out", out)
    assert printed(*command)["out"] == str(out)
    rows = printed(*command[:6])["rows"]
    header, *lines = [line.split("," if ending == "csv" else "\t") for line in out.read_text().splitlines()]
    assert header == ["line", "head", "relation", "tail", "score", "rank", "known", "probability"]
    assert [line[1:4] for line in lines] == [[row["head"], row["relation"], row["tail"]] for row in rows]
    assert [np.float32(line[4]) for line in lines] == [np.float32(row["score"]) for row in rows]
    assert [line[5] for line in lines] == ["" if row["rank"] is None else str(row["rank"]) for row in rows]
    before = out.read_bytes()
    assert "--force" in refused(*command, kind="OutputExistsError")
    assert out.read_bytes() == before
    assert run(*command, "--force").code == 0


def test_new_only_leaves_known_triples_out_of_a_file_too(printed, trained, tmp_path):
    triples = trained / "graph" / "triples" / "full.tsv"
    assert printed("score", trained / "one", "--in", triples, "--new-only").get("rows", []) == []
    rows = printed("score", trained / "one", "--in", triples)["rows"]
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
    refused, trained, tmp_path, content, message
):
    (tmp_path / "pairs.csv").write_text(content, encoding="latin-1")
    command = ("score", trained / "one", "--in", tmp_path / "pairs.csv", "--out", tmp_path / "scores.csv")
    assert message in refused(*command, kind="QueryFileError")
    assert [path.name for path in tmp_path.iterdir()] == ["pairs.csv"]


def test_a_folder_is_no_file_of_queries(refused, trained):
    refused("score", trained / "one", "--in", trained, says="is not a file", kind="QueryFileError")


def test_score_lists_ten_entities_unless_told_otherwise(printed, trained):
    assert len(printed("score", trained / "one", "?", "componentOf", "bread")["top"]) == 10
    assert len(printed("score", trained / "one", "?", "componentOf", "bread", "--top", "500")["top"]) == 80


BAD_QUESTIONS = (
    ("bred componentOf flour", "'bread'", "UnknownEntityError"),
    ("flour componentOf bred", "'bread'", "UnknownEntityError"),
    ("flour combineWith water", "'combinesWith'", "UnknownEntityError"),
    ("? componentOf ?", "both slots are open", "ConfigError"),
    ("? componentOf", "both slots are open", "ConfigError"),
    ("? componentOf bread --top 0", "--top 0", "ConfigError"),
    ("? componentOf bread --top -1", "--top -1", "ConfigError"),
    ("flour combinesWith water --new-only", "--new-only", "ConfigError"),
    ("", "--in", "ConfigError"),
    ("flour", "--in", "ConfigError"),
    ("flour combinesWith --in x.csv", "--in", "ConfigError"),
    ("flour combinesWith --out x", "--in", "ConfigError"),
)


@pytest.mark.parametrize(("question", "says", "kind"), BAD_QUESTIONS)
def test_a_question_that_cannot_be_answered_is_refused(refused, trained, question, says, kind):
    refused("score", trained / "one", *question.split(), says=says, kind=kind)


# --- comparison ------------------------------------------------------------------------------------------------------


def test_compare_links_prints_one_object_with_the_paired_difference(printed, trained):
    values = printed("compare", trained / "one", trained / "two")
    assert {"graph", "split", "queries", "triples", "models", "best"} <= set(values)
    one, two = values["models"]
    assert (one["name"], two["name"]) == ("one", "two")
    assert two["difference"] == pytest.approx(two["mrr"] - one["mrr"])
    assert two["difference_ci"][0] <= two["difference"] <= two["difference_ci"][1]
    assert "difference" not in one


def test_compare_links_agrees_with_the_reports_of_all(printed, workshop):
    names = ("one", "two")
    values = printed("compare", *(workshop / name for name in names))
    for name, found in zip(names, values["models"], strict=True):
        report = printed("evaluate-links", workshop / name)
        for metric in ("mrr", "hits@1", "hits@3", "hits@10"):
            assert found[metric] == report[metric]["all"]


def test_a_model_does_not_differ_from_itself(printed, run, trained):
    values = printed("compare", trained / "one", trained / "one")["models"][1]
    assert (values["difference"], values["difference_ci"], values["probability_better"]) == (0, [0, 0], 0.5)
    assert "no difference is shown" in run("compare", trained / "one", trained / "one").out


def test_models_of_one_name_are_told_apart_by_their_paths(printed, workshop):
    shutil.copytree(workshop / "two", workshop / "copies" / "one")
    paths = [workshop / "one", workshop / "copies" / "one"]
    values = printed("compare", *paths, "--graph", workshop / "graph")
    assert [found["name"] for found in values["models"]] == [str(path) for path in paths]


def test_several_models_are_compared_with_the_first_on_a_page(printed, refused, run, trained, tmp_path):
    page = tmp_path / "new" / "comparison.html"
    command = ("compare", *(trained / name for name in ("one", "two", "full")), "--out", page)
    text = run(*command).out.splitlines()
    assert [line.split()[0] for line in text[1:4]] == ["one", "two", "full"]
    assert "widened for 3 pairs of models (Bonferroni)" in text[-2]
    assert text[-1] == f"wrote {page}"
    assert "3 link predictors on the same queries" in page.read_text()
    before = page.read_bytes()
    assert "--force" in refused(*command, kind="OutputExistsError")
    assert page.read_bytes() == before
    assert printed(*command, "--force")["out"] == str(page)
    assert page.read_bytes() == before


def test_a_folder_of_seeds_is_compared_as_one_model(printed, run, workshop):
    seeds = ("--seeds", "4,5", "--out", workshop / "seeds")
    run("train-complex", workshop / "graph", *QUICK, "--quiet", *seeds)
    command = ("compare", workshop / "one", workshop / "seeds")
    found = printed(*command)["models"][1]
    assert (found["name"], found["seeds"]) == ("seeds", [4, 5])
    assert found["mrr"] == pytest.approx(np.mean(found["mrr_of_seeds"]))
    assert "2 seeds" in run(*command).out


def test_models_of_different_splits_are_not_compared(refused, run, workshop):
    build(workshop / "other", seed=1)
    assert run("train-complex", workshop / "other", *QUICK, "--out", workshop / "three").code == 0
    refused("compare", workshop / "one", workshop / "three", says="different splits", kind="GraphMismatchError")


def test_comparing_with_a_model_of_the_full_graph_says_that_it_has_seen_the_triples(run, trained):
    assert "has seen these triples" in run("compare", trained / "one", trained / "full").out
    assert "has seen these triples" not in run("compare", trained / "one", trained / "two").out


@pytest.mark.parametrize("resamples", ["0", "-5"])
def test_comparing_without_resamples_is_refused(refused, trained, resamples):
    command = ("compare", trained / "one", trained / "two", "--resamples", resamples)
    refused(*command, says=f"--resamples {resamples}", kind="ConfigError")


# --- other models ----------------------------------------------------------------------------------------------------


def test_the_models_that_can_be_trained_are_listed_with_their_commands(printed, run):
    listed = {model["name"]: model["command"] for model in printed("train-links", "--list-models")["models"]}
    assert listed["ComplEx"] == "train-complex"
    assert listed["RotatE"] == "train-links --model RotatE"
    assert not {"CompGCN", "DistMultLiteral", "NodePiece", "FixedModel"} & set(listed)
    assert "wordcraft-kg train-links --model TuckER" in run("train-links", "--list-models").out


def test_a_listed_model_trains_under_its_listed_name(run, tmp_path):
    assert run("train-links", "kitchen", "--model", "SimplE", *TINY, "--out", tmp_path / "model").code == 0


# --- tuning ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def fast_search(monkeypatch):
    """Search among few epochs, so that a trial takes a moment."""
    from optuna.distributions import IntDistribution

    monkeypatch.setattr("wordcraft_kg.models.links.tuning._EPOCHS", IntDistribution(2, 4, step=2))


@pytest.mark.usefixtures("fast_search")
@pytest.mark.parametrize(("model", "command"), [("complex", "train-complex"), ("distmult", "train-links")])
def test_tuned_settings_are_a_file_that_training_takes(printed, tmp_path, model, command):
    out = tmp_path / "tuned" / "kitchen"
    values = printed("tune-links", "kitchen", "--model", model, "--trials", "2", "--out", out, "--quiet")
    assert (values["trials"], values["out"], values["command"]) == (2, str(out), command)
    assert 0 < values["valid_mrr"] < 1
    assert values["valid_mrr"] == max(trial["valid_mrr"] for trial in values["table"])
    settings = tomllib.loads(Path(values["config"]).read_text())[command]
    assert settings == values["settings"]
    again = printed(command, "kitchen", "--config", values["config"], "--out", tmp_path / "model", "--quiet")
    assert again["epochs"] == settings["epochs"]
    trained = tomllib.loads((tmp_path / "model" / "config.toml").read_text())[command]
    assert trained.items() >= settings.items()


@pytest.mark.usefixtures("fast_search")
def test_a_search_prints_its_trials_and_its_own_progress_only(run, tmp_path):
    outcome = run("tune-links", "kitchen", "--trials", "2", "--out", tmp_path / "search")
    assert outcome.code == 0
    head, *rows = outcome.out.splitlines()[:3]
    assert head.split()[:3] == ["trial", "valid", "MRR"]
    assert [row.split()[0] for row in rows] == ["1", "2"]
    assert "tuning complex: trial 2 of 2, best MRR" in outcome.err
    assert all(line.startswith("tuning complex: ") for line in outcome.err.splitlines())


def test_a_folder_that_is_not_a_search_is_refused(refused, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    for force in ((), ("--force",)):
        command = ("tune-links", "kitchen", *force, "--out", tmp_path / "mine")
        refused(*command, says="Choose another --out", kind="OutputExistsError")
    assert (tmp_path / "mine" / "notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_tuning_over_the_whole_range_on_the_kitchen(printed, run, tmp_path):
    assert run("tune-links", "kitchen", "--trials", "3", "--out", tmp_path / "search").code == 0
    best = tmp_path / "search" / "best.toml"
    values = printed("train-complex", "kitchen", "--config", best, "--out", tmp_path / "model")
    assert values["epochs"] >= 20


# --- the whole way ---------------------------------------------------------------------------------------------------


def test_the_start_page_works_from_a_book_to_a_report(printed, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("build-graph", "kitchen", "--out", "graphs/kitchen").code == 0
    assert run("train-complex", "graphs/kitchen", "--out", "models/kitchen", *QUICK).code == 0
    values = printed("evaluate-links", "models/kitchen")
    assert Path(values["report"]).is_file()
    assert values["mrr"]["all"] > values["baselines"]["random"]["all"]


@pytest.mark.slow
def test_complex_with_its_defaults_predicts_unseen_links_better_than_frequency(printed, run, tmp_path):
    assert run("train-complex", "kitchen", "--out", tmp_path / "partial").code == 0
    values = printed("evaluate-links", tmp_path / "partial")
    assert values["mrr"]["all"] > 1.2 * values["baselines"]["frequency"]["all"]
    assert values["mrr_with_leaked"] > values["mrr"]["all"]
    trained = printed("train-complex", "kitchen", "--kg", "full", "--out", tmp_path / "full")
    assert trained["train_mrr"] > 0.99


def test_a_model_trained_from_a_script_file_is_the_commands_model(trained, tmp_path):
    from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
    from wordcraft_kg.models.links.training import train_links

    config = LinksConfig(str(trained / "graph"), ComplExConfig(dim=8, epochs=4, n3=0.1, folds=0))
    here = train_links(config, tmp_path / "model").folder
    assert (here / "model.safetensors").read_bytes() == (trained / "one" / "model.safetensors").read_bytes()
    assert not np.array_equal(
        np.frombuffer((trained / "two" / "model.safetensors").read_bytes(), dtype=np.uint8),
        np.frombuffer((trained / "one" / "model.safetensors").read_bytes(), dtype=np.uint8),
    )
