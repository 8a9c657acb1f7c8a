"""``reproduce``: studies that run, go on and are listed, and results that are shown."""

import json

import pytest
from fabricated import fabricate

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
command = "kernel"
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
    assert "1 graph, 4 runs, 1 scorer; 6 to perform" in found.out
    assert "guided, seed 1" in found.out
    assert not (tmp_path / "results").exists()


def test_an_address_is_for_ray_alone(refused, study):
    refused("reproduce", study, "--address", "auto", kind="ConfigError", setting="address")


def test_the_list_has_every_study_with_trainings_and_source(printed, refused):
    studies = printed("reproduce", "--list")["studies"]
    assert list(studies) == built_in()
    assert all(study["trainings"] > 0 and study["source"] for study in studies.values())
    fewer = printed("reproduce", "--list", "--seeds", "1")["studies"]
    assert all(fewer[name]["trainings"] < studies[name]["trainings"] for name in studies)
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
        ('command = "kernel"', 'command = "kernle"', "Did you mean 'kernel'"),
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
    assert lines[2].startswith("  no graph  0.133 [")
    assert "  3 seeds  +0.600 [" in lines[3]
    assert lines[3].endswith("p <.001")


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
        ("--out {folder}/empty", "has no results yet. Run a study first"),
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
