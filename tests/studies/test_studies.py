"""Studies: their results and claims, and reports that say what the view says in every format."""

import json
import re
from itertools import product

import jsonschema
import msgspec
import numpy as np
import pytest
from fabricated import GUIDED, NO_GRAPH, fabricate
from markupsafe import escape

from wordcraft_kg.base import ConfigError, OutputExistsError, checked_values, schema_of
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.reports.pages import render, write_report
from wordcraft_kg.studies.claims import check_claim
from wordcraft_kg.studies.report import (
    make_study_report,
    panels_of,
    signed,
    tables_of,
)
from wordcraft_kg.studies.results import Missing
from wordcraft_kg.studies.study import Claim, Study, title_of
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


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [(-0.5, "+z.2f", "−0.50"), (-0.0001, "+z.2f", "+0.00"), (-0.001, "z.2f", "0.00")],
)
def test_numbers_have_a_true_minus_and_none_for_zero(value, form, text):
    assert signed(value, form) == text


def test_columns_without_any_figure_are_left_out(view):
    assert "MRR" in tables_of(view)[0][0]
    alone = tables_of(view_study(fabricate({"no graph": NO_GRAPH[:1]})))[0][0]
    assert tuple(alone) == ("variant", "seeds", "success [seeds, tasks]", "train")


def test_a_report_is_written_whole(view, tmp_path):
    write_report(make_study_report(view), tmp_path / "report")
    names = {"index.html", "report.json", "figure.svg", "figure.pdf"}
    assert {file.name for file in (tmp_path / "report").iterdir()} == names
    values = json.loads((tmp_path / "report" / "report.json").read_text())
    jsonschema.Draft202012Validator(schema_of(StudyView, "urn:x", "x")).validate(values)
    page = (tmp_path / "report" / "index.html").read_text()
    assert "&lt;b&gt;why&lt;/b&gt;" in page
    assert not re.search("<b>why</b>|<i>", page)
    assert 'href="figure.svg"' in page
    with pytest.raises(OutputExistsError):
        write_report(make_study_report(view), tmp_path / "report")


def test_equal_results_have_equal_files(view, tmp_path):
    again = msgspec.json.decode(msgspec.json.encode(view), type=StudyView)
    one, other = make_study_report(view).files, make_study_report(again).files
    assert one["figure.svg"] == other["figure.svg"]


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
    assert "guided 0.800 against no graph 0.200: +0.600 [" in page


BOTH = {"no graph": NO_GRAPH, "guided": GUIDED}


def of(view, variant, point=0):
    return next(entry for entry in view.points[point].variants if entry.variant == variant)


def test_means_of_a_variant_are_those_of_its_runs():
    found = of(view_study(fabricate(BOTH)), "guided")
    assert found.success == (0.6, 0.8, 0.8, 0.8, 1.0)
    assert (found.mean, found.train) == pytest.approx((0.8, 0.5))
    assert found.interval[0] < 0.8 < found.interval[1] < 1


def test_variants_are_paired_by_seed_and_task():
    """A variant is compared with the reference on the same seeds and tasks."""
    view = view_study(fabricate(BOTH))
    assert of(view, "no graph").comparison is None
    found = of(view, "guided").comparison
    assert found.difference == pytest.approx(0.8 - 0.2)
    assert found.interval[0] < 0.6 < found.interval[1]
    assert found.p_value == found.p_corrected < 0.05 < found.interval[0]


def test_only_seeds_that_both_have_are_paired():
    found = of(
        view_study(fabricate({"no graph": NO_GRAPH[:2], "guided": GUIDED[:3]})), "guided"
    ).comparison
    assert found.difference == pytest.approx((0.6 + 0.8) / 2 - 0.1)


def test_the_reference_is_the_one_that_the_study_names():
    view = view_study(fabricate(BOTH, reference="guided"))
    assert of(view, "no graph").comparison.difference == pytest.approx(-0.6)


def test_p_values_are_corrected_over_all_points_of_the_grid():
    view = view_study(fabricate([({"distractors": 8}, BOTH), ({"distractors": 1}, BOTH)]))
    assert view.comparisons == 2
    for point in (0, 1):
        found = of(view, "guided", point).comparison
        assert found.p_value > 0
        assert found.p_corrected == pytest.approx(2 * found.p_value)
    assert [point.title for point in view.points] == ["8 distractors", "1 distractor"]


@pytest.mark.parametrize("pairs", [1, 2, 3])
def test_below_three_seeds_there_is_no_p_value(pairs):
    view = view_study(fabricate({"no graph": NO_GRAPH[:pairs], "guided": GUIDED[:pairs]}))
    found = of(view, "guided").comparison
    assert [value is None for value in (found.p_value, found.p_corrected)] == [pairs < 3] * 2
    assert view.comparisons == (pairs == 3)


def test_an_agent_that_always_succeeds_is_not_certain_to():
    found = of(view_study(fabricate({"perfect": ["555", "555"]})), "perfect")
    assert found.interval[0] < 1
    assert found.interval[1] == 1


def test_curves_are_means_over_seeds_at_steps_that_all_have():
    curves = {"no graph": [[(0, 0.0), (10, 0.2), (20, 0.4)], [(0, 0.2), (20, 0.6)]]}
    found = of(view_study(fabricate({"no graph": NO_GRAPH[:2]}, curves=curves)), "no graph").curve
    assert [(at.step, at.success) for at in found] == [
        (0, pytest.approx(0.1)),
        (20, pytest.approx(0.5)),
    ]
    assert (found[1].low, found[1].high) == student_interval([0.4, 0.6]) == (0, 1)


def test_a_view_has_a_place_for_each_of_its_values(view):
    assert msgspec.convert(checked_values(view), StudyView) == view


def moved(results, number, key):
    """Return results with a run on another graph or split."""
    other, runs = msgspec.structs.replace(results.graphs[0], **{key: "c" * 64}), list(results.runs)
    runs[number] = msgspec.structs.replace(runs[number], graph=1)
    return msgspec.structs.replace(results, graphs=(*results.graphs, other), runs=tuple(runs))


def on_splits(won):
    """Return results whose seeds were played on a split each, of 5, 4 and 3 tasks."""
    results = fabricate(
        {name: [digits[seed:] for seed, digits in enumerate(rows)] for name, rows in won.items()}
    )
    graph = results.graphs[0]
    graphs = tuple(msgspec.structs.replace(graph, split=f"{seed}" * 64) for seed in range(3))
    runs = tuple(msgspec.structs.replace(run, graph=run.seed) for run in results.runs)
    study = msgspec.structs.replace(results.study, vary_split=True)
    return msgspec.structs.replace(results, graphs=graphs, runs=runs, study=study)


def test_runs_on_a_split_each_are_compared_in_pairs_with_intervals_over_splits():
    results = on_splits(
        {"no graph": ["00000", "50000", "05000"], "guided": ["55500", "55550", "55055"]}
    )
    view = view_study(results)
    guided = of(view, "guided")
    assert guided.mean == pytest.approx((3 / 5 + 3 / 4 + 2 / 3) / 3)
    assert guided.comparison.difference == pytest.approx((3 / 5 + 3 / 4 + 2 / 3) / 3)
    low, high = guided.comparison.interval
    assert student_interval([3 / 5, 3 / 4, 2 / 3]) == pytest.approx((low, high))
    assert view.points[0].tasks == 12
    assert {"success [splits]", "difference [splits]"} < tables_of(view)[0][0].keys()
    claim = Claim("Guided is better.", "guided", "no graph", by=0.1)
    (verdict,) = check_claim(results, claim)
    assert verdict.verdict == "reproduced"
    (measured,) = verdict.measured
    assert (measured.splits, measured.tasks) == (3, 12)
    assert measured.p_value == guided.comparison.p_value
    assert measured.difference == pytest.approx(guided.comparison.difference)


def test_variants_on_different_graphs_are_not_compared():
    view = view_study(
        moved(fabricate({"no graph": NO_GRAPH[:1], "guided": GUIDED[:1]}), 1, "split")
    )
    assert of(view, "guided").comparison is None
    assert len(view.points[0].graphs) == 2


def test_a_study_without_runs_is_refused_with_the_first_reason():
    results = fabricate({"no graph": []})
    lost = (Missing("no graph", {}, 0, "the disk was full"),)
    with pytest.raises(ConfigError, match=r"no finished run, 1 missing.*disk was full.*reproduce"):
        view_study(msgspec.structs.replace(results, missing=lost))


def test_points_of_the_grid_in_words():
    values = {"book": "everyday", "distractors": 1, "in_sample": True, "scorer.train_fraction": 0.5}
    assert title_of(values) == "everyday, 1 distractor, in_sample true, scorer.train_fraction 0.5"


CLAIM = Claim(text="Left is better.", left="left", right="right")


def a_run(variant, success, *, distractors=8, seed=0, curve=(), same_twice=0.0, tasks=400):
    """Return a run whose success on each task is drawn with a mean of its own."""
    rates = np.random.default_rng([seed, distractors, len(variant)]).random((tasks, 5))
    won = "".join(map(str, (rates < success).sum(1)))
    curve = curve or ((0, 0.0), (100, success / 2), (1000, success))
    (run,) = fabricate(
        [({"distractors": distractors}, {variant: [won]})], curves={variant: [curve]}
    ).runs
    reached = run.success["test"]
    ends = {"goal": reached, "same_twice": same_twice, "no_recipe": 1 - reached - same_twice}
    return msgspec.structs.replace(run, seed=seed, terminations=ends, steps=1000)


def with_won(run, won, **changed):
    """Return a run with other successes on its tasks, and the figures that follow."""
    success = sum(map(int, won)) / (run.distractor_seeds * len(won))
    ends = {"goal": success, "no_recipe": 1 - success}
    figures = {"success": {"test": success}, "by_plan": {"test": success / 2}}
    return msgspec.structs.replace(run, won=won, terminations=ends, **figures, **changed)


def results_of(*runs, points=(8,), claims=(), missing=()):
    variants = {"left": {}, "right": {"features": "random"}}
    study = Study("Fabricated", variants, grid={"distractors": list(points)}, claims=list(claims))
    results = fabricate({})
    graphs = (
        *results.graphs,
        msgspec.structs.replace(results.graphs[0], kind="by-goal", split="c" * 64),
    )
    # Each run brings the groups of its tasks: each task is one.
    groups = {tuple(range(len(run.won))): None for run in runs}
    numbered = tuple(
        msgspec.structs.replace(run, groups=[*groups].index(tuple(range(len(run.won)))))
        for run in runs
    )
    return msgspec.structs.replace(
        results, study=study, graphs=graphs, runs=numbered, missing=missing, groups=tuple(groups)
    )


def both(left, right, *, seeds=3, points=(8,), **of_left):
    """Return results with success of the left and of the right variant at each point."""
    ours, theirs = (
        dict.fromkeys(points, value) if isinstance(value, float) else value
        for value in (left, right)
    )
    runs = [
        a_run(variant, success[point], distractors=point, seed=seed, **more)
        for point, seed in product(points, range(seeds))
        for variant, success, more in (("left", ours, of_left), ("right", theirs, {}))
    ]
    return results_of(*runs, points=points)


def verdict(results, **changed):
    (entry,) = check_claim(results, msgspec.structs.replace(CLAIM, **changed))
    return entry.verdict


@pytest.mark.parametrize(
    ("left", "right", "changed", "expected"),
    [
        (0.6, 0.3, {}, "reproduced"),
        (0.6, 0.3, {"by": 0.2}, "reproduced"),
        (0.6, 0.3, {"by": 0.29}, "differs"),
        (0.6, 0.3, {"by": 0.5}, "differs"),
        (0.3, 0.6, {}, "not reproduced"),
        (0.3, 0.3, {"by": 0.2}, "not reproduced"),
        (0.3, 0.6, {"expected": "less", "by": 0.2}, "reproduced"),
        (0.3, 0.6, {"expected": "less", "by": 0.5}, "differs"),
        (0.6, 0.3, {"expected": "less"}, "not reproduced"),
        (0.3, 0.3, {"expected": "comparable", "by": 0.05}, "reproduced"),
        (0.3, 0.3, {"expected": "comparable", "by": 0.001}, "undecided"),
        (0.35, 0.3, {"expected": "comparable", "by": 0.05}, "differs"),
        (0.6, 0.3, {"expected": "comparable", "by": 0.05}, "not reproduced"),
    ],
)
def test_a_verdict_follows_from_where_the_interval_lies(left, right, changed, expected):
    assert verdict(both(left, right), **changed) == expected


OF_VALUE = {"right": "", "expected": "less"}

OTHER_POINT = {
    "right": "left",
    "expected": "less",
    "at": {"distractors": 8},
    "right_at": {"distractors": 1},
}

EARLY = {"curve": ((0, 0.9), (110, 0.5), (1000, 0.3))}


@pytest.mark.parametrize(
    ("sides", "more", "changed", "expected"),
    [
        pytest.param((0.33, 0.3), {"seeds": 2}, {}, "undecided", id="too wide"),
        pytest.param((1.0, 1.0), {}, {}, "not reproduced", id="smaller than two hundredths"),
        pytest.param(
            (1.0, 1.0), {}, {"expected": "less"}, "not reproduced", id="the same for less"
        ),
        pytest.param(
            (0.9, 0.1), {}, {**OF_VALUE, "than": 1.0, "by": 0.02}, "reproduced", id="value"
        ),
        pytest.param(
            (0.9, 0.1), {}, {"right": "", "than": 0.95}, "not reproduced", id="larger value"
        ),
        pytest.param(
            ({8: 0.3, 1: 0.6}, 0.4),
            {"points": (8, 1)},
            OTHER_POINT,
            "reproduced",
            id="another point",
        ),
        pytest.param(
            (0.3, 0.3),
            EARLY,
            {"measure": "early"},
            "reproduced",
            id="nearest to a tenth of the steps",
        ),
        pytest.param(
            (0.6, 0.3), {"seeds": 1}, {}, "undecided", id="one seed, though sure over tasks"
        ),
        pytest.param(
            (0.6, 0.3), {"seeds": 1}, {"measure": "early"}, "undecided", id="one seed, early"
        ),
    ]
    + [
        pytest.param(
            (left, 0.4), {"points": (8, 1)}, {"expected": "varies"}, expected, id=f"varies {left}"
        )
        for left, expected in (
            ({8: 0.6, 1: 0.2}, "reproduced"),
            ({8: 0.8, 1: 0.5}, "differs"),
            ({8: 0.6, 1: 0.6}, "not reproduced"),
            ({8: 0.4, 1: 0.6}, "undecided"),
        )
    ]
    + [
        pytest.param(
            (0.1, 0.4),
            {"same_twice": 0.7},
            {"right": "", "than": than, "measure": "same_twice"},
            expected,
        )
        for than, expected in ((0.5, "reproduced"), (0.8, "not reproduced"))
    ],
)
def test_a_claim_has_the_verdict_of_its_measure_and_points(sides, more, changed, expected):
    assert verdict(both(*sides, **more), **changed) == expected


def test_amounts_at_two_points_are_compared_by_seed_and_task():
    at_8 = both(0.6, 0.4).runs
    lost = [(run, run.won if run.variant == "right" else "0" * 20 + run.won[20:]) for run in at_8]
    at_1 = [with_won(run, won, values={"distractors": 1}) for run, won in lost]
    (entry,) = check_claim(
        results_of(*at_8, *at_1, points=(8, 1)), msgspec.structs.replace(CLAIM, expected="varies")
    )
    assert entry.measured[0].low < entry.measured[1].high
    assert (entry.verdict, entry.why) == (
        "differs",
        "more at all 2 points, but by different amounts",
    )


def test_a_claim_about_all_points_is_judged_at_each():
    results = both({8: 0.6, 1: 0.3}, 0.4, points=(8, 1))
    assert [
        (at.measured[0].values["distractors"], at.verdict) for at in check_claim(results, CLAIM)
    ] == [
        (8, "reproduced"),
        (1, "not reproduced"),
    ]
    assert len(check_claim(results, msgspec.structs.replace(CLAIM, at={"distractors": 1}))) == 1


def test_steps_are_counted_until_the_other_curve_is_reached():
    """Steps are counted until the curve of the other is reached or else are all."""
    of_steps = msgspec.structs.replace(CLAIM, measure="steps", expected="less")
    (entry,) = check_claim(both(0.6, 0.4, curve=((0, 0.0), (100, 0.39), (1000, 0.6))), of_steps)
    # .38 is 38/39 of the way to 100, and the right curve has a line from .39 at 100 to .4 at 1,000.
    assert (entry.measured[0].left, entry.measured[0].right) == pytest.approx((0.1 * 38 / 39, 0.91))
    assert (entry.verdict, entry.measured[0].tasks) == ("reproduced", 0)
    (entry,) = check_claim(both(0.2, 0.4), of_steps)
    assert entry.measured[0].left == 1.0


CLAIMS_LOST = Missing("right", {"distractors": 8}, 0, "the disk was full")

ON_ANOTHER_SPLIT = msgspec.structs.replace(a_run("right", 0.5), graph=1)


@pytest.mark.parametrize(
    ("results", "at", "why"),
    [
        (results_of(a_run("left", 0.5), missing=(CLAIMS_LOST,)), {}, "the disk was full"),
        (both(0.6, 0.3), {"distractors": 2}, "the study has no results at such points"),
        (
            results_of(a_run("left", 0.5, tasks=10), a_run("right", 0.5, tasks=11)),
            {},
            "different tasks",
        ),
        (results_of(a_run("left", 0.5), ON_ANOTHER_SPLIT), {}, "different tasks"),
    ],
    ids=["missing", "no such point", "other tasks", "as many tasks of another split"],
)
def test_a_claim_that_was_not_run_says_why(results, at, why):
    (entry,) = check_claim(results, msgspec.structs.replace(CLAIM, at=at))
    assert entry.verdict == "not run"
    assert why in entry.why


def test_a_note_is_shown_where_a_claim_does_not_hold():
    noted = msgspec.structs.replace(CLAIM, note="because")
    pages = []
    for a, b in ((0.6, 0.3), (0.3, 0.6)):
        results = both(a, b)
        study = msgspec.structs.replace(results.study, claims=[noted])
        view = view_study(msgspec.structs.replace(results, study=study))
        pages.append("because" in render(make_study_report(view)))
    assert pages == [False, True]
