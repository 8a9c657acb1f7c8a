"""Verdicts on fabricated results whose answer is known."""

from itertools import product

import msgspec
import numpy as np
import pytest
from fabricated import fabricate

from wordcraft_kg.studies.claims import check_claim, view_claims
from wordcraft_kg.studies.results import Missing
from wordcraft_kg.studies.study import Claim, Study

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
    return msgspec.structs.replace(results, study=study, graphs=graphs, runs=runs, missing=missing)


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


LOST = Missing("right", {"distractors": 8}, 0, "the disk was full")
ON_ANOTHER_SPLIT = msgspec.structs.replace(a_run("right", 0.5), graph=1)


@pytest.mark.parametrize(
    ("results", "at", "why"),
    [
        (results_of(a_run("left", 0.5), missing=(LOST,)), {}, "the disk was full"),
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
    assert [check_claim(both(a, b), noted)[0].note for a, b in ((0.6, 0.3), (0.3, 0.6))] == [
        "",
        "because",
    ]


def test_claims_come_from_the_record_unless_others_are_given():
    """The claims of a study are those of its record unless others are given."""
    results = results_of(a_run("left", 0.6), a_run("right", 0.3), claims=[CLAIM])
    assert [entry.text for entry in view_claims(results)] == [CLAIM.text]
    assert not view_claims(results, [])
