"""``reproduce``: studies that run, go on and are listed, and results that are shown."""

import json
import shutil
from pathlib import Path

import pytest
from fabricated import fabricate
from helpers import write_graph
from quick import SMALL, TINY, contents, same

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import whole_numbers
from wordcraft_kg.studies.results import results_text
from wordcraft_kg.studies.study import built_in

STUDY = """
title = "A comparison"
seeds = 2
[settings]
book = "kitchen"
steps = 512
distractors = 2
[scorers.plain]
command = "train-complex"
epochs = 1
dim = 4
folds = 2
seed = 0
[variants.none]
[variants.guided]
scorer = "plain"
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.mark.slow
def test_a_sweep_trains_missing_runs_and_writes_its_results(printed, run, study, tmp_path):
    out = tmp_path / "results"
    assert printed("reproduce", study, "--out", out, "--jobs", 1)["studies"]["study"]["done"] == 6
    results = json.loads((out / "reports/study/results.json").read_text())
    assert [row["variant"] for row in results["runs"]] == ["none", "none", "guided", "guided"]
    assert printed("reproduce", "--show", "--out", out)["study"]["command"].startswith(
        "wordcraft-kg"
    )
    again = run("reproduce", study, "--out", out, "--seeds", 1)
    assert again.code == 0
    assert "0 tasks done, 4 already done, 0 failed" in again.out


def test_a_dry_run_lists_everything_and_does_nothing(run, study, tmp_path):
    found = run("reproduce", study, "--out", tmp_path / "results", "--dry-run")
    assert found.code == 0
    assert "6 tasks; 6 to perform" in found.out
    assert "guided, seed 1" in found.out
    assert not (tmp_path / "results").exists()


def test_an_address_is_for_ray_alone(refused, study):
    refused("reproduce", study, "--address", "auto", kind="ConfigError", setting="address")


def test_the_list_has_every_study_with_trainings_and_source(printed, refused):
    studies = printed("reproduce", "--list")["studies"]
    assert list(studies) == built_in()
    assert all(study["trainings"] > 0 and study["source"] for study in studies.values())
    refused("reproduce", "--list", "--book", "kitchen", kind="ConfigError")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "distractors = 2",
            "distractor = 2",
            "unknown setting 'settings.distractor'. Did you mean 'distractors'",
        ),
        (
            "[variants.none]",
            '[variants.other]\nscorer = "plain"\n[variants.none]',
            "'other' and 'guided' are the same",
        ),
        ('[variants.none]\n[variants.guided]\nscorer = "plain"', "", "variants"),
        ("title =", "title", "not a TOML file"),
        ('"train-complex"', '"train-compelx"', "Did you mean 'train-complex'"),
        ('scorer = "plain"', 'scorer = "plan"', "Did you mean 'plain'"),
        ("", "", "is a file; expected a results folder"),
    ],
)
def test_a_wrong_study_or_output_is_refused_before_anything_starts(
    refused, study, tmp_path, old, new, says
):
    assert old in STUDY
    study.write_text(STUDY.replace(old, new) if old else STUDY)
    refused("reproduce", study, "--out", tmp_path / "results" if old else study, says=says)
    assert list(tmp_path.iterdir()) == [study]


NO_GRAPH = ["00000", "50000", "05000"]

GUIDED = ["55500", "55550", "55055"]


@pytest.fixture
def file(tmp_path):
    """A file of results with figures that are known."""
    path = tmp_path / "made-up.json"
    found = fabricate({"no graph": NO_GRAPH, "guided": GUIDED}, mrr={"guided": 0.2}, title="Graphs")
    path.write_text(results_text(found), encoding="utf-8")
    return path


def test_a_file_of_results_is_shown(run, file):
    done = run("reproduce", file, "--show")
    assert done.code == 0
    lines = done.out.splitlines()
    assert lines[:2] == ["Graphs: success on test tasks", "kitchen, by-recipe (5 test tasks)"]
    assert lines[3].startswith("no graph  3      0.133 [")
    assert "  +0.600 [" in lines[4]
    assert lines[4].endswith("  <.001")
    assert len(lines[4]) < 80


def test_json_has_all_figures_and_the_report(printed, run, file, tmp_path):
    found = printed("reproduce", file, "--show", "--plot")
    assert found["report"] == str(tmp_path / "reports" / "made-up")
    assert found["study"]["points"][0]["variants"][1]["comparison"]["difference"] == pytest.approx(
        0.6
    )
    assert (tmp_path / "reports" / "made-up" / "figure.svg").is_file()
    assert run("reproduce", file, "--show", "--plot").kind == "OutputExistsError"
    assert run("reproduce", file, "--show", "--plot", "--force").code == 0
    assert printed("reproduce", file, "--show")["report"] is None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("--out {folder}/empty", "has results of no study yet; name a study"),
        ("x --out {folder}/empty", "has no study 'x'"),
        ("{folder}/broken.json", "damaged"),
        ("{folder}/none.json --plot", "no finished run"),
    ],
)
def test_results_that_cannot_be_shown_are_refused(refused, file, arguments, says):
    (file.parent / "empty" / "studies").mkdir(parents=True)
    (file.parent / "broken.json").write_text('{"format": "other"}')
    (file.parent / "none.json").write_text(results_text(fabricate({"no graph": []})))
    refused("reproduce", "--show", *arguments.format(folder=file.parent).split(), says=says)
    assert not (file.parent / "reports").exists()


AGENT = (*SMALL, "--distractors", 2)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0-4", [0, 1, 2, 3, 4]),
        ("7", [7]),
        ("0,3,7", [0, 3, 7]),
        ("2-3, 0-2", [2, 3, 0, 1]),
        ("5-5,5", [5]),
    ],
)
def test_seeds_are_numbers_and_ranges_each_once(text, expected):
    assert whole_numbers("seeds", [text]) == expected


@pytest.mark.parametrize(
    "text", ["", "a", "4-0", "-1", "1-", "0,,1", "1.5", "0-1000", "0-999,2000", "9" * 30]
)
def test_what_is_no_list_of_seeds_is_refused(text):
    with pytest.raises(ConfigError) as error:
        whole_numbers("seeds", [text])
    assert error.value.setting == "seeds"


@pytest.mark.parametrize(
    ("command", "weights"),
    [
        (("train-agent", *AGENT, "--seed", 1), ("policy.safetensors", "plain/seed-1")),
        pytest.param(
            ("train-complex", *TINY, "--seed", 3),
            ("model.safetensors", "links/seed-3"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_each_seed_is_an_ordinary_run(run, world, trained, tmp_path, command, weights):
    name, *options = command
    assert run(name, world / "graph", *options, "--out", tmp_path / "single").code == 0
    assert same(
        weights[0], (trained if "links" in weights[1] else world) / weights[1], tmp_path / "single"
    )


@pytest.mark.parametrize(
    ("command", "options"),
    [("train-agent", AGENT), pytest.param("train-complex", TINY, marks=pytest.mark.slow)],
)
def test_seeds_that_are_done_are_kept_and_others_are_added(
    printed, world, trained, tmp_path, command, options
):
    source = trained / "links" if command == "train-complex" else world / "plain"
    shutil.copytree(source, tmp_path / "seeds")
    values = printed(
        command, world / "graph", *options, "--seeds", "0,4", "--out", tmp_path / "seeds"
    )
    assert values["out"] == str(tmp_path / "seeds")
    assert values["seeds"].keys() == {"0", "4"}
    assert all(Path(one["out"]).is_dir() for one in values["seeds"].values())
    assert contents(source).items() <= contents(tmp_path / "seeds").items()
    assert (tmp_path / "seeds/seed-4/run.json").is_file()
    if command == "train-complex":
        forced = ("--n3", "0.2", "--seeds", "0,3", "--out", tmp_path / "seeds", "--force")
        assert printed(command, trained / "graph", *options, *forced)["seeds"].keys() == {"0", "3"}
        for seed in ("seed-0", "seed-3"):
            assert not same("model.safetensors", tmp_path / "seeds" / seed, source / seed)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--learning-rate 0.1", "was trained with --learning-rate "),
        ("--max-attempts 2", "--max-attempts None, and this command has 2"),
        ("--scorer {trained}/one", "another scorer"),
        ("{other}", "another split"),
        ("everyday", "another graph"),
    ],
)
def test_a_seed_with_other_settings_or_data_is_not_taken_for_the_same(
    refused, world, trained, tmp_path, options, says
):
    write_graph(tmp_path / "other", seed=1)
    words = options.format(trained=trained, other=tmp_path / "other").split()
    graph = [] if words[0].startswith("--") else [words.pop()]
    command = (
        "train-agent",
        *(graph or [world / "graph"]),
        *AGENT,
        *words,
        "--seeds",
        "0-1",
        "--out",
    )
    before = contents(world / "plain")
    refused(*command, world / "plain", says=says, kind="ConfigError")
    assert contents(world / "plain") == before


def test_the_same_graph_by_another_name_keeps_the_seeds(run, refused, world, trained):
    """The same graph by another name keeps the seeds and another trainer does not."""
    before = contents(world / "plain")
    assert (
        run("train-agent", "kitchen", *AGENT, "--seeds", "0-1", "--out", world / "plain").code == 0
    )
    links = ("train-complex", trained / "graph", *TINY, "--seeds", "0", "--out")
    refused(*links, world / "plain", kind="OutputExistsError")
    refused(
        *links, trained / "links", "--n3", "0.2", says="this command has 0.2", kind="ConfigError"
    )
    single = (
        "train-agent",
        world / "graph",
        *AGENT,
        "--seeds",
        "0-1",
        "--out",
        world / "plain/seed-0",
    )
    refused(*single, says="is a single run", kind="OutputExistsError")
    assert contents(world / "plain") == before


@pytest.mark.parametrize(
    "command",
    [
        "evaluate-agent {world}/plain",
        "explain {world}/plain",
        "evaluate-links {trained}/links",
        "score {trained}/links flour combinesWith",
        "train-agent kitchen --out {trained}/links/never --scorer {trained}/links",
    ],
)
def test_a_folder_of_seeds_is_refused_where_one_run_is_needed(refused, world, trained, command):
    """Where one run is needed a folder of seeds is refused with one of them."""
    message = refused(*command.format(world=world, trained=trained).split(), kind="ArtefactError")
    folder = world / "plain" if "{world}" in command else trained / "links"
    assert f"holds a run for each of 2 seeds; give one run, such as {folder / 'seed-0'}." in message
    assert not (trained / "links/never").exists()
