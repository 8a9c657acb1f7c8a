"""The tables of studies, from fabricated results whose figures are known."""

import importlib.util
import sys
import zipfile
from pathlib import Path

import msgspec
import pytest
from fabricated import fabricate

from wordcraft_kg.studies.results import Missing, results_text
from wordcraft_kg.studies.study import Claim, built_in, parse_study

DOCS = Path(__file__).parents[1] / "docs"
CLAIM = Claim(text="Guided is better.", left="guided", right="none", source="paper, Somewhere")


@pytest.fixture
def script(monkeypatch):
    """The generator; the generators of the guides import each other."""
    monkeypatch.syspath_prepend(str(DOCS))
    spec = importlib.util.spec_from_file_location("make_results", DOCS / "make_results.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def results_of(guided, name="knowledge", book="everyday"):
    """Results of 100 tasks on three seeds, each won by ``guided`` of five draws, none by chance."""
    points = [({"distractors": 8}, {"none": ["1" * 100] * 3, "guided": guided})]
    results = fabricate(points, title="A fabricated study")
    study = msgspec.structs.replace(
        results.study,
        vary_split=True,
        settings={"book": book},
        grid={"distractors": [8]},
        claims=[CLAIM],
    )
    return msgspec.structs.replace(results, name=f"{name}-{book}", study=study)


def shortened(results):
    """The results of a study with fewer steps than the built-in one."""
    study = msgspec.structs.replace(results.study, settings={"book": "everyday", "steps": 1_000})
    return msgspec.structs.replace(results, study=study)


def cells_of(script, monkeypatch, *results):
    """The texts of the cells by page, table, row and column."""
    monkeypatch.setattr(script, "read_study", lambda name: results[0].study)
    cells = script.cells(script.checked(results))
    return {cell[:4]: cell.text for cell in cells}


FAR = [digit * 100 for digit in "333"]
NEAR = ["2" + "1" * 99, "2" + "1" * 99, "1" * 100]


def test_a_study_gives_tables_of_success_claims_verdicts_and_trainings(script, monkeypatch):
    cells = cells_of(script, monkeypatch, results_of(FAR))
    success = "knowledge", "success, 8 distractors"
    assert cells[*success, "none", "`everyday`"].startswith(".200 [.")
    claim = cells["knowledge", "claims", "Guided is better. | 8 distractors", "`everyday`"]
    assert claim.startswith("reproduced, +.400 [+.")
    row = "[Guided is better.](evidence/knowledge.md) *(Somewhere)*"
    verdict = cells["results", "claims of the paper", row, "`everyday`"]
    assert verdict == '<span class="verdict reproduced">1 reproduced</span>'
    trainings = "[A fabricated study](evidence/knowledge.md) | `everyday`"
    assert cells["results", "trainings", trainings, "trainings"] == "6"
    assert cells["results", "trainings", trainings, "steps"] == "2,000"


def test_an_interval_over_the_tasks_of_a_single_split_has_a_mark(script, monkeypatch):
    row = "knowledge", "success, 8 distractors", "none", "`everyday`"
    results = results_of(FAR)
    first = tuple(run for run in results.runs if run.seed == 0)
    single = msgspec.structs.replace(results, runs=first)
    assert cells_of(script, monkeypatch, single)[row].endswith("]†")
    assert cells_of(script, monkeypatch, results)[row].endswith("]")


def test_the_place_of_a_claim_of_this_project_is_what_follows_its_name(script, monkeypatch):
    results = results_of(FAR)
    claim = msgspec.structs.replace(CLAIM, source="this project; the paper compares them")
    study = msgspec.structs.replace(results.study, claims=[claim])
    cells = cells_of(script, monkeypatch, msgspec.structs.replace(results, study=study))
    row = "[Guided is better.](evidence/knowledge.md) *(the paper compares them)*"
    assert ("results", "claims of this project", row, "`everyday`") in cells


def test_a_difference_that_correction_leaves_to_chance_has_a_mark(script, monkeypatch):
    several = [results_of(FAR), results_of(NEAR, book="little-alchemy-2")]
    cells = cells_of(script, monkeypatch, *several)
    row = "knowledge", "claims", "Guided is better. | 8 distractors"
    assert "‡" not in cells[*row, "`everyday`"]
    assert "‡" in cells[*row, "Little Alchemy 2"]


def test_only_complete_studies_are_taken_and_equal_ones_give_equal_bytes(
    script, monkeypatch, tmp_path
):
    archive = tmp_path / "results.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("sources-everyday.json", results_text(results_of(FAR, "sources")))
        fewer = results_of(FAR, "planning")
        study = msgspec.structs.replace(fewer.study, seeds=fewer.study.seeds + 1)
        more = msgspec.structs.replace(fewer, study=study)
        file.writestr("planning-everyday.json", results_text(more))
    lost = Missing("guided", {"distractors": 8}, 2, "the disk was full")
    collected = {
        "knowledge-everyday": msgspec.structs.replace(
            results_of(FAR), command="wordcraft-kg reproduce knowledge --out /home/me/results"
        ),
        "alone-everyday": msgspec.structs.replace(results_of(FAR, "alone"), missing=(lost,)),
        "mine": results_of(FAR, "mine"),
        "planning-everyday": fewer,
        "sources-everyday": shortened(results_of(NEAR, "sources")),
    }
    monkeypatch.setattr(script, "read_study", lambda name: results_of(FAR).study)
    monkeypatch.setattr(script, "studies_of", lambda folder: list(collected))
    monkeypatch.setattr(script, "collect_study", lambda folder, name: collected[name])
    script.take(tmp_path, archive)
    first = archive.read_bytes()
    script.take(tmp_path, archive)
    assert archive.read_bytes() == first
    taken = {results.name: results for results in script.read_archive(archive)}
    assert list(taken) == ["knowledge-everyday", "planning-everyday", "sources-everyday"]
    assert taken["planning-everyday"].study.seeds == more.study.seeds
    assert taken["sources-everyday"] == results_of(FAR, "sources")
    # No path of the machine is kept.
    assert taken["knowledge-everyday"].command == "wordcraft-kg reproduce knowledge --out results"


def test_the_check_finds_tables_that_are_out_of_date(script, monkeypatch, tmp_path):
    tables = tmp_path / "tables.csv"
    tables.write_text("page,table,row,column,value,low,high\nlinks,MRR,a,b,0.5,,\n")
    monkeypatch.setattr(sys, "argv", ["make_results.py", "--check"])
    monkeypatch.setattr(script, "TABLES", tables)
    monkeypatch.setattr(script, "read_cells", lambda: [])
    monkeypatch.setattr(script, "read_archive", lambda path: [])
    cell = script.Cell("knowledge", "success", "a", "b", "0.5", "", "")
    monkeypatch.setattr(script, "cells", lambda studies: [cell])
    with pytest.raises(SystemExit, match=r"tables.csv is not up to date"):
        script.main()


def test_the_study_of_the_guide_is_one_and_all_built_in_studies_have_a_page(script):
    guide = (DOCS / "studies.md").read_text(encoding="utf-8")
    study = parse_study(guide.partition("```toml\n")[2].partition("```")[0], "docs/studies.md")
    assert len(study.variants) * 2 * study.seeds == 18
    assert set(built_in()) == set(script.ORDER)
