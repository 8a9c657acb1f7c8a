"""Verdicts on fabricated results whose answer is known."""

import math
from itertools import product

import msgspec
import numpy as np
import pytest

from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.studies.claims import judge, view_claims
from wordcraft_kg.studies.results import Missing, RunResult, StudyResults
from wordcraft_kg.studies.study import Claim, Study

TASKS, DRAWS = 400, 5
GRAPH = PlayedGraph("kitchen", "a" * 64, "by-recipe", 0, "b" * 64)
CLAIM = Claim(text="Left is better.", left="left", right="right")


def a_run(variant, success, *, distractors=8, seed=0, curve=(), same_twice=0.0, tasks=TASKS):
    """Return a run whose success on each task is drawn with a mean of its own."""
    draws = np.random.default_rng([seed, distractors, len(variant)]).random((tasks, DRAWS))
    won = (draws < success).sum(1)
    return RunResult(
        variant=variant,
        values={"distractors": distractors},
        seed=seed,
        run=f"runs/{variant}-{distractors}-{seed}",
        graph=0,
        success={"train": success, "test": float(won.mean() / DRAWS)},
        by_plan={"train": success, "test": success},
        endings={"goal": success, "same_twice": same_twice},
        won="".join(map(str, won)),
        draws=DRAWS,
        curve=curve or ((0, 0.0), (100, success / 2), (1000, success)),
        mrr=None,
        steps=1000,
        seconds=1.0,
        steps_per_second=1000,
    )


def results_of(*runs, points=(8,), claims=(), missing=()):
    study = Study(
        title="Fabricated",
        variants={"left": {}, "right": {"features": "random"}},
        grid={"distractors": list(points)},
        claims=list(claims),
    )
    return StudyResults(
        format="wordcraft-kg results 1",
        name="fabricated",
        command="none",
        study=study,
        graphs=(GRAPH,),
        versions={"torch": "2"},
        runs=runs,
        missing=missing,
        hours=0.0,
    )


def both(left, right, *, seeds=3, points=(8,), **of_left):
    """Return results with success of the left and of the right variant at each point."""
    ours, theirs = (dict.fromkeys(points, value) if isinstance(value, float) else value for value in (left, right))
    runs = [
        run
        for point, seed in product(points, range(seeds))
        for run in (
            a_run("left", ours[point], distractors=point, seed=seed, **of_left),
            a_run("right", theirs[point], distractors=point, seed=seed),
        )
    ]
    return results_of(*runs, points=points)


def verdict(results, **changed):
    (judged,) = judge(results, msgspec.structs.replace(CLAIM, **changed))
    return judged.verdict


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


def test_an_interval_that_is_too_wide_decides_nothing():
    assert verdict(both(0.33, 0.3, seeds=2)) == "undecided"


def test_a_difference_smaller_than_two_hundredths_is_none():
    alike = both(1.0, 1.0)
    assert verdict(alike) == "not reproduced"
    assert verdict(alike, expected="less") == "not reproduced"


def test_a_claim_may_compare_with_a_value():
    results = both(0.9, 0.1)
    assert verdict(results, right="", than=1.0, expected="less", by=0.02) == "reproduced"
    assert verdict(results, right="", than=0.95, expected="more") == "not reproduced"


def test_a_claim_about_all_points_is_judged_at_each():
    results = both({8: 0.6, 1: 0.3}, 0.4, points=(8, 1))
    assert [(at.measured[0].values["distractors"], at.verdict) for at in judge(results, CLAIM)] == [
        (8, "reproduced"),
        (1, "not reproduced"),
    ]
    assert len(judge(results, msgspec.structs.replace(CLAIM, at={"distractors": 1}))) == 1


def test_the_right_side_may_be_at_another_point():
    results = both({8: 0.3, 1: 0.6}, 0.4, points=(8, 1))
    change = {"right": "left", "expected": "less", "at": {"distractors": 8}, "right_at": {"distractors": 1}}
    assert verdict(results, **change) == "reproduced"


@pytest.mark.parametrize(
    ("left", "expected"),
    [
        ({8: 0.6, 1: 0.2}, "reproduced"),
        ({8: 0.8, 1: 0.5}, "differs"),
        ({8: 0.6, 1: 0.6}, "not reproduced"),
        ({8: 0.4, 1: 0.6}, "undecided"),
    ],
)
def test_what_varies_is_ahead_here_and_behind_there(left, expected):
    assert verdict(both(left, 0.4, points=(8, 1)), expected="varies") == expected


def test_steps_are_counted_until_the_curve_of_the_other_is_reached():
    quick = ((0, 0.0), (100, 0.39), (1000, 0.6))
    results = both(0.6, 0.4, curve=quick)
    (judged,) = judge(results, msgspec.structs.replace(CLAIM, measure="steps", expected="less"))
    assert (judged.measured[0].left, judged.measured[0].right) == pytest.approx((0.1, 1.0))
    assert judged.verdict == "reproduced"
    assert judged.measured[0].tasks == 0


def test_a_level_that_is_never_reached_takes_all_steps():
    results = both(0.2, 0.4)
    (judged,) = judge(results, msgspec.structs.replace(CLAIM, measure="steps", expected="less"))
    assert judged.measured[0].left == 1.0


def test_early_is_the_point_of_the_curve_nearest_to_a_tenth_of_the_steps():
    assert verdict(both(0.3, 0.3, curve=((0, 0.9), (110, 0.5), (1000, 0.3))), measure="early") == "reproduced"


def test_pairs_of_an_entity_with_itself_are_counted_by_how_episodes_ended():
    results = both(0.1, 0.4, same_twice=0.7)
    assert verdict(results, right="", than=0.5, measure="same_twice") == "reproduced"
    assert verdict(results, right="", than=0.8, measure="same_twice") == "not reproduced"


def test_the_interval_over_seeds_is_students():
    runs = []
    for seed, height in enumerate((0.1, 0.2, 0.6)):
        runs += [
            a_run("left", 0.3, seed=seed, curve=((100, height), (1000, 0.3))),
            a_run("right", 0.3, seed=seed, curve=((100, 0.0), (1000, 0.3))),
        ]
    (judged,) = judge(results_of(*runs), msgspec.structs.replace(CLAIM, measure="early"))
    # t of 2 degrees of freedom at .975 is 4.302653; the deviation of .1, .2, .6 is sqrt(.07).
    half = 4.302653 * math.sqrt(0.07 / 3)
    assert judged.measured[0].low == pytest.approx(0.3 - half, abs=1e-6)
    assert judged.measured[0].high == pytest.approx(0.3 + half, abs=1e-6)
    assert judged.verdict == "undecided"


def test_one_seed_decides_nothing():
    """Over tasks alone the difference would be sure; a claim is about agents, not about two trainings."""
    results = both(0.6, 0.3, seeds=1)
    assert verdict(results) == "undecided"
    assert verdict(results, measure="early") == "undecided"


def test_a_claim_without_runs_says_why():
    lost = Missing("right", {"distractors": 8}, 0, "the disk was full")
    (judged,) = judge(results_of(a_run("left", 0.5), missing=(lost,)), CLAIM)
    assert judged.verdict == "not run"
    assert "the disk was full" in judged.why


def test_a_claim_about_points_that_were_not_run_says_so():
    (judged,) = judge(both(0.6, 0.3), msgspec.structs.replace(CLAIM, at={"distractors": 2}))
    assert (judged.verdict, judged.why) == ("not run", "the study was run without such points")


def test_variants_that_played_other_tasks_are_not_compared():
    (judged,) = judge(results_of(a_run("left", 0.5, tasks=10), a_run("right", 0.5, tasks=11)), CLAIM)
    assert judged.verdict == "not run"
    assert "different tasks" in judged.why


def test_as_many_tasks_of_another_split_are_others():
    results = results_of(a_run("left", 0.5), msgspec.structs.replace(a_run("right", 0.5), graph=1))
    other = PlayedGraph("kitchen", "a" * 64, "by-goal", 0, "c" * 64)
    (judged,) = judge(msgspec.structs.replace(results, graphs=(GRAPH, other)), CLAIM)
    assert judged.verdict == "not run"
    assert "different tasks" in judged.why


def test_only_seeds_that_both_have_are_compared():
    runs = [a_run("left", 0.6, seed=seed) for seed in (0, 1)] + [a_run("right", 0.3, seed=seed) for seed in (1, 2)]
    (judged,) = judge(results_of(*runs), CLAIM)
    assert judged.measured[0].seeds == 1


def test_a_note_is_shown_where_a_claim_does_not_hold():
    noted = msgspec.structs.replace(CLAIM, note="because")
    assert [judge(both(a, b), noted)[0].note for a, b in ((0.6, 0.3), (0.3, 0.6))] == ["", "because"]


def test_the_claims_of_a_study_are_those_of_its_record_unless_others_are_given():
    results = results_of(a_run("left", 0.6), a_run("right", 0.3), claims=[CLAIM])
    assert [judged.text for judged in view_claims(results)] == [CLAIM.text]
    assert not view_claims(results, [])
