"""A store of cells: what it has is not trained again, what it lacks is added, and what is damaged does not count."""

import json

import msgspec
import pytest
from refusals import refuses
from small_study import RUN_FIGURES, TRAINED, pretend, run_small, small_plan

from wordcraft_kg.base.records import as_values
from wordcraft_kg.reports.pages import render
from wordcraft_kg.studies.cells import cell_file, read_cell
from wordcraft_kg.studies.engine import estimated_hours
from wordcraft_kg.studies.report import make_study_report
from wordcraft_kg.studies.results import write_figures
from wordcraft_kg.studies.store import collect_study
from wordcraft_kg.studies.tables import lines_of
from wordcraft_kg.studies.view import view_study


@pytest.fixture
def store(tmp_path):
    """A store with the cells of a study that was pretended to run."""
    run_small(tmp_path / "first", work=pretend, store=tmp_path / "cells")
    return tmp_path / "cells"


def the_run(plan=None):
    """The last task of a study, a guided agent."""
    plan = plan or small_plan()
    return plan.tasks[plan.runs[-1]]


def test_a_cell_that_is_made_again_has_the_same_bytes_and_needs_its_scorer_trained_again(tmp_path):
    plan = small_plan(text=TRAINED.replace("seeds = 2", "seeds = 1"))
    run_small(tmp_path / "one", plan, store=tmp_path / "cells")
    cells = {path: path.read_bytes() for path in tmp_path.glob("cells/*/*.json")}
    assert len(cells) == 5
    cell_file(tmp_path / "cells", the_run(plan)).unlink()
    began = run_small(tmp_path / "two", plan, store=tmp_path / "cells").began
    assert began == [plan.tasks[the_run(plan).needs[1]].title, the_run(plan).title]
    assert {path: path.read_bytes() for path in tmp_path.glob("cells/*/*.json")} == cells
    kept = [(run.won, run.curve, run.mrr) for run in collect_study(tmp_path / "one", "small").runs]
    assert [(run.won, run.curve, run.mrr) for run in collect_study(tmp_path / "two", "small").runs] == kept


def test_results_from_the_store_are_marked_with_platform_and_versions(tmp_path, store):
    plan = small_plan()
    assert 0 == estimated_hours(plan, tmp_path / "first", store) < estimated_hours(plan, tmp_path / "second")
    cell_file(store, the_run()).unlink()
    assert len(run_small(tmp_path / "second", work=pretend, store=store).began) == 2
    results = collect_study(tmp_path / "second", "small")
    expected = [{"stored": stored, "platform": "here", "versions": {"torch": "2"}} for stored in (True, False)]
    assert as_values(results.origins) == [{**origin, "runs": n} for origin, n in zip(expected, (7, 1), strict=True)]
    assert [run.origin for run in results.runs] == [0] * 7 + [1]
    view = view_study(results)
    page = " ".join(render(make_study_report(view)).split())
    assert "<dt>7 trainings from the store</dt> <dd>here; torch 2</dd>" in page
    assert "<dt>1 training in this folder</dt>" in page
    assert "7 trainings from the store: here; torch 2" in list(lines_of(view, "success"))
    assert results.hours == pytest.approx(2 / 3600, abs=1e-4), "a run and its scorer"


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[:-9],
        lambda text: text.replace('"won":"5"', '"won":"9"'),
        lambda text: text.replace('"distractors":1', '"distractors":2'),
        lambda text: text.replace('"graph":', '"grahp":'),
        lambda text: "[]",
    ],
    ids=["cut", "another result", "of other settings", "another key", "no cell"],
)
def test_a_damaged_or_edited_cell_is_made_again_with_a_warning(tmp_path, store, caplog, damage):
    path = cell_file(store, the_run())
    text = path.read_text()
    path.write_text(damage(text))
    assert path.read_text() != text
    assert the_run().title in run_small(tmp_path / "second", work=pretend, store=store).began
    assert f"{path} is damaged" in caplog.text
    assert path.read_text() == text


def test_other_results_of_the_same_platform_are_warned_of_and_the_cell_stays(tmp_path, store, caplog):
    def another(task, root, platform="here"):
        outcome = pretend(task, root)
        if task.kind == "runs":
            figures = msgspec.structs.replace(RUN_FIGURES, won="6", seconds=9.0, platform=platform)
            write_figures(task.folder(root), figures)
        return outcome

    before = read_cell(the_run(), store)
    run_small(tmp_path / "elsewhere", work=lambda task, root: another(task, root, "elsewhere"))
    run_small(tmp_path / "elsewhere", store=store)
    assert not caplog.text, "other platforms may round otherwise"
    run_small(tmp_path / "here", work=another)
    assert run_small(tmp_path / "here", store=store).began == []
    assert "raise VERSIONS" in caplog.text
    assert read_cell(the_run(), store) == before


def test_a_store_that_is_a_file_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "cells").touch()
    with refuses("store"):
        run_small(tmp_path / "results", work=pretend, store=tmp_path / "cells")
    assert not list(tmp_path.glob("results/*/*/figures.json"))


def test_results_that_were_there_before_the_store_are_added(tmp_path):
    run_small(tmp_path / "results", work=pretend)
    run_small(tmp_path / "results", store=tmp_path / "cells")
    cells = list(tmp_path.glob("cells/*/*.json"))
    assert len(cells) == 9
    assert all(json.loads(path.read_text())["figures"]["seconds"] == 0 for path in cells)
