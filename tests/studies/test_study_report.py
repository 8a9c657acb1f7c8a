"""The report of a study: its tables say what its view says, in every format, and its files are the
same each time."""

import csv
import io
import json
import re
from itertools import product

import jsonschema
import msgspec
import pytest
from fabricated import GUIDED, NO_GRAPH, fabricate, three_train_fractions
from markupsafe import escape

from wordcraft_kg.base.errors import OutputExistsError
from wordcraft_kg.base.records import schema_of
from wordcraft_kg.reports.pages import render
from wordcraft_kg.studies.report import (
    as_csv,
    make_study_report,
    panels_of,
    signed,
    tables_of,
    write_study_report,
)
from wordcraft_kg.studies.results import Missing
from wordcraft_kg.studies.study import Claim
from wordcraft_kg.studies.view import StudyView, view_study

ODD = r"a_b & 50% | <i>#{x}^~\ *y*"


@pytest.fixture(scope="module")
def view():
    cells = {"no graph": NO_GRAPH, "guided": GUIDED, ODD: NO_GRAPH[::-1]}
    results = fabricate(
        [({"distractors": 8}, cells), ({"distractors": 1}, cells)],
        mrr={"guided": 0.2},
        title="Graphs & <agents>",
    )
    gap = Missing("guided", {"distractors": 2}, 3, "<b>why</b>")
    return view_study(msgspec.structs.replace(results, missing=(gap,)))


def test_csv_has_a_row_for_each_variant_of_each_point(view):
    rows = list(csv.DictReader(io.StringIO(as_csv(view))))
    cells = [(row["distractors"], row["variant"]) for row in rows]
    assert cells == list(product("81", ("no graph", "guided", ODD)))
    found = rows[1]
    assert (float(found["success"]), float(found["difference"])) == pytest.approx((0.8, 0.6))
    assert float(found["mrr"]) == pytest.approx(0.22)
    assert float(found["p_value"]) < float(found["p_holm"])
    assert (rows[0]["difference"], rows[0]["mrr"]) == ("", "")
    entry = view.points[0].variants[1]
    assert [float(found[f"success_{end}"]) for end in ("low", "high")] == pytest.approx(
        entry.interval, rel=1e-5
    )


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [(-0.5, "+.2f", "−0.50"), (-0.0001, "+.2f", "+0.00"), (-0.001, ".2f", "0.00")],
)
def test_numbers_have_a_true_minus_and_none_for_zero(value, form, text):
    assert signed(value, form) == text


def test_columns_without_any_figure_are_left_out(view):
    assert "MRR" in tables_of(view)[0].headings
    alone = tables_of(view_study(fabricate({"no graph": NO_GRAPH[:1]})))[0].headings
    assert alone == ("variant", "seeds", "success [seeds, tasks]", "train", "reached after")


def test_a_report_is_written_whole(view, tmp_path):
    files = write_study_report(view, tmp_path / "report")
    names = "index.html report.json table.csv figure.svg figure.pdf"
    assert [file.name for file in files] == names.split()
    assert sorted(files) == sorted((tmp_path / "report").iterdir())
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.Draft202012Validator(schema_of(StudyView, "urn:x", "x")).validate(values)
    page = files[0].read_text()
    assert "&lt;b&gt;why&lt;/b&gt;" in page
    assert not re.search("<b>why</b>|<i>", page)
    assert 'href="figure.svg"' in page
    with pytest.raises(OutputExistsError):
        write_study_report(view, tmp_path / "report")


def test_equal_results_have_equal_files(view, tmp_path):
    again = msgspec.json.decode(msgspec.json.encode(view), type=StudyView)
    one, other = make_study_report(view).files, make_study_report(again).files
    for name in ("table.csv", "figure.svg"):
        assert one[name] == other[name]


def test_a_study_of_doses_is_drawn_by_mrr():
    view = view_study(three_train_fractions())
    ((title, chart),) = panels_of(view).items()
    assert title == ""
    drawn = escape(chart)
    assert all(
        label in drawn for label in ("cross-fitted", "in-sample", "no graph", "train_fraction 0.5")
    )
    assert "train tasks scored in-sample</th><td>3</td>" in " ".join(
        render(make_study_report(view)).split()
    )


def test_bars_are_drawn_where_there_are_no_curves():
    curves = {"no graph": [[(2000, 0.1)]] * 5}
    (chart,) = panels_of(view_study(fabricate({"no graph": NO_GRAPH}, curves=curves))).values()
    assert "over seeds and tasks" in escape(chart)


def test_the_page_says_of_each_claim_whether_it_holds():
    claims = [
        Claim(text="Guided agents <b>are</b> better.", left="guided", right="no graph"),
        Claim(text="They are worse.", left="guided", right="no graph", expected="less"),
    ]
    results = fabricate({"no graph": NO_GRAPH, "guided": GUIDED})
    study = msgspec.structs.replace(results.study, claims=claims)
    page = render(make_study_report(view_study(msgspec.structs.replace(results, study=study))))
    assert "<h3>Guided agents &lt;b&gt;are&lt;/b&gt; better.</h3>" in page
    assert page.index("<b>reproduced</b>: more") < page.index("<b>not reproduced</b>: it is more")
    assert "guided .800 against no graph .200: +.600 [" in page
