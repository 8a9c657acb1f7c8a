"""The results page from fabricated results, whose figures are known."""

import importlib.util
import runpy
import shutil
import sys
import zipfile
from pathlib import Path

import msgspec
import pytest
from fabricated import fabricate

from wordcraft_kg.studies.results import Missing, results_text
from wordcraft_kg.studies.study import Claim, built_in, parse_study

DOCS = Path(__file__).parents[1] / "docs"
HEAD = "# Results\n\n<!-- results -->\nold\n<!-- end of results -->\n\nThe end.\n"


@pytest.fixture(autouse=True)
def beside_each_other(monkeypatch):
    """The generators of the guides import each other."""
    monkeypatch.syspath_prepend(str(DOCS))


@pytest.fixture(scope="module")
def script():
    sys.path.insert(0, str(DOCS))
    spec = importlib.util.spec_from_file_location("make_results", DOCS / "make_results.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path.remove(str(DOCS))
    return module


def results_of(won, *, study=None, mrr=None, **changed):
    """Return results of 100 tasks; ``won`` has, for each variant and seed, the share of five draws
    that won, as 0-5."""
    points = won if isinstance(won, list) else [({"distractors": 8}, won)]
    cells = [
        {name: [str(digit) * 100 for digit in digits] for name, digits in won.items()}
        for _, won in points
    ]
    points = [(values, digits) for (values, _), digits in zip(points, cells, strict=True)]
    results = fabricate(points, mrr=mrr or {"guided": 0.25}, title="A fabricated study")
    fields = {
        "scorers": {"partial": {"command": "train-complex"}},
        "settings": {"book": "everyday"},
        "grid": {"distractors": [8, 1]},
        "claims": [
            Claim(text="Guided is better.", left="guided", right="none", source="paper, Somewhere")
        ],
    }
    changed["study"] = msgspec.structs.replace(results.study, **fields | (study or {}))
    graphs = (msgspec.structs.replace(results.graphs[0], name="everyday"),)
    return msgspec.structs.replace(
        results, **{"name": "fabricated-everyday", "graphs": graphs, **changed}
    )


SOME = {"none": [1, 1], "guided": [3, 3]}


def archived(path):
    """Write an archive with the results of a fabricated study, and return its path."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("fabricated-everyday.json", results_text(results_of(SOME)))
    return path


def text_of(script, *results):
    """The page of the claims, and the evidence page of the study."""
    files = script.written(list(results), HEAD)
    return files["results.md"] + files.get("evidence/fabricated.md", "")


def test_the_pages_have_claims_metrics_of_each_variant_and_a_figure(script):
    files = script.written([results_of(SOME)], HEAD)
    lines = files["evidence/fabricated.md"].splitlines()
    assert "<!-- figure: Success, everyday, 8 distractors | success = 8 distractors -->" in lines
    assert lines[1] == "# A fabricated study"
    figures = "*guided* .600 against *none* .200: +.400 [+.362, +.438] (2 seeds, 100 tasks)"
    assert lines[3] == f"**Answer.** Guided is better. `everyday`, 8 distractors: {figures}."
    assert "| guided | .600 [.502, .691] |" in lines
    guided = lines.index(
        "| guided | 2 | .255 | .600 [.502, .691] | +.400 [+.362, +.438] | .300 | .500 |"
    )
    assert "8 distractors, 100 test tasks:" in lines[guided - 5]
    assert lines.index("<details markdown>") < guided
    verdict = "**reproduced**: more (provisional: 2 seeds)"
    assert (
        f"| Guided is better. *(paper, Somewhere)* | 8 distractors | {figures} | {verdict} |"
        in lines
    )
    text = files["results.md"]
    row = "| [A fabricated study](evidence/fabricated.md) | `everyday` | 2,000 | 2 | 4 |"
    assert text.index("## Claims of the paper") < text.index(row)
    assert "1 reproduced (1 provisional), 1 not run." in text
    assert "| [Guided is better.](evidence/fabricated.md) *(Somewhere)* | " in text


def test_what_is_missing_is_named_with_the_reason(script):
    lost = tuple(
        Missing("guided", {"distractors": 1}, seed, "the disk was full") for seed in range(3)
    )
    text = text_of(script, results_of(SOME, missing=lost))
    assert "| 2,000 | 2 | 4 | 3 |" in text
    assert (
        "Missing: 3 trainings (the disk was full), the first guided, 1 distractor, seed 0." in text
    )
    assert "**not run**: no runs for 'guided', distractors 1: the disk was full" in text


def test_no_path_of_the_machine_is_kept(script):
    study = {"settings": {"book": "/home/somebody/mine.json"}}
    command = (
        "wordcraft-kg reproduce all --book /home/somebody/mine.json --out /tmp/results --seeds 3"
    )
    lost = Missing(
        "guided",
        {"distractors": 1},
        0,
        "/home/somebody/results/runs/1/run.json is damaged: train again.",
    )
    results = results_of(SOME, study=study, command=command, missing=(lost,))
    text = results_text(script.without_paths(results))
    assert '"run.json is damaged: train again."' in text
    assert "/home" not in text
    assert "/tmp" not in text
    assert "--book mine.json --out results --seeds 3" in text


def test_the_study_of_the_guide_is_one_and_all_built_in_studies_have_a_page(script):
    guide = (DOCS / "studies.md").read_text(encoding="utf-8")
    study = parse_study(guide.partition("```toml\n")[2].partition("```")[0], "docs/studies.md")
    assert len(study.variants) * 2 * study.seeds == 18
    assert set(built_in()) <= set(script.ORDER)


def test_the_check_finds_a_page_that_is_out_of_date(tmp_path, monkeypatch):
    shutil.copytree(DOCS, tmp_path / "docs")
    script = tmp_path / "docs" / "make_results.py"
    archived(tmp_path / "docs" / "results.zip")
    monkeypatch.setattr(sys, "argv", [str(script), "--check"])
    with pytest.raises(SystemExit, match=r"results.md is not up to date"):
        runpy.run_path(str(script), run_name="__main__")
    for argv in ([str(script)], [str(script), "--check"]):
        monkeypatch.setattr(sys, "argv", argv)
        runpy.run_path(str(script), run_name="__main__")
