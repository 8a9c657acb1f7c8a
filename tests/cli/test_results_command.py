"""``wordcraft-kg reproduce --show``: figures of a results folder or of a file of results."""

import pytest
from fabricated import fabricate

from wordcraft_kg.studies.results import results_text

NO_GRAPH = ["00000", "50000", "05000"]
GUIDED = ["55500", "55550", "55055"]


@pytest.fixture
def file(tmp_path):
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
    assert lines[3].endswith("P(better) 1.00  p <.001")


@pytest.mark.parametrize(
    ("metric", "text"),
    [
        ("iqm", "0.733 ["),
        ("by-plan", "0.367  3 seeds"),
        ("train", "0.500  3 seeds"),
        ("mrr", "0.210 [0.200, 0.220]"),
        ("steps", "1,000  "),
    ],
)
def test_other_metrics_are_shown(run, file, metric, text):
    done = run("reproduce", file, "--show", "--metric", metric)
    assert f"  guided    {text}" in done.out


def test_json_has_all_figures_and_the_report(printed, run, file, tmp_path):
    found = printed("reproduce", file, "--show", "--plot")
    assert found["report"] == str(tmp_path / "reports" / "made-up")
    assert found["study"]["points"][0]["variants"][1]["comparison"]["difference"] == pytest.approx(0.6)
    assert (tmp_path / "reports" / "made-up" / "figure.svg").is_file()
    assert run("reproduce", file, "--show", "--plot").kind == "OutputExistsError"
    assert run("reproduce", file, "--show", "--plot", "--force").code == 0
    assert printed("reproduce", file, "--show")["report"] is None


def test_out_implies_a_report(run, file, tmp_path):
    done = run("reproduce", file, "--show", "--report", tmp_path / "there")
    assert f"open {tmp_path / 'there' / 'index.html'}" in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", "{folder}/nothing"), "is no results folder"),
        (("--out", "{folder}/empty"), "has no study yet; name one, or compare all runs with --by"),
        (("x", "--out", "{folder}/empty"), "has no study 'x'"),
        (("{folder}/made-up.json", "--by", "scorer"), "cannot be combined"),
        (("x", "--out", "{folder}/empty", "--by", "scorer"), "'x' and --by cannot be combined"),
        (("--out", "{folder}/empty", "--by", "scorer"), "'scorer'"),
        (("--seeds", "2"), "--seeds is for studies that are run"),
        (("{folder}/broken.json",), "damaged"),
        (("{folder}/nothing.json",), "no such file"),
        (("{folder}/study.toml",), "expected its results"),
    ],
)
def test_what_cannot_be_shown_is_said(refused, file, arguments, message):
    (file.parent / "empty" / "studies").mkdir(parents=True)
    (file.parent / "broken.json").write_text('{"format": "other"}')
    refused("reproduce", "--show", *(argument.format(folder=file.parent) for argument in arguments), says=message)


def test_results_without_runs_are_an_error(refused, tmp_path):
    (tmp_path / "none.json").write_text(results_text(fabricate({"no graph": []})))
    refused("reproduce", tmp_path / "none.json", "--show", "--plot", says="no finished run", kind="ConfigError")
    assert not (tmp_path / "reports").exists()
