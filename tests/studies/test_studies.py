"""The figures of a study, from made-up results whose figures are known."""

import msgspec
import numpy as np
import pytest
from fabricated import GUIDED, NO_GRAPH, fabricate, three_train_fractions

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import as_values, checked_values
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.studies.results import Missing
from wordcraft_kg.studies.view import StudyView, title_of, view_study

BOTH = {"no graph": NO_GRAPH, "guided": GUIDED}


def of(view, variant, point=0):
    return next(entry for entry in view.points[point].variants if entry.variant == variant)


def test_means_of_a_variant_are_those_of_its_runs():
    found = of(view_study(fabricate(BOTH)), "guided")
    assert found.success == (0.6, 0.8, 0.8, 0.8, 1.0)
    assert (found.mean, found.by_plan, found.train) == pytest.approx((0.8, 0.4, 0.5))
    assert found.seed_interval[0] < 0.8 < found.seed_interval[1]
    assert found.interval[0] < 0.8 < found.interval[1] < 1


def test_variants_are_paired_by_seed_and_task():
    """A variant is compared with the reference on the same seeds and tasks."""
    view = view_study(fabricate(BOTH))
    assert of(view, "no graph").comparison is None
    found = of(view, "guided").comparison
    assert found.difference == pytest.approx(0.8 - 0.2)
    assert found.pairs == 5
    assert found.interval[0] < 0.6 < found.interval[1]
    assert found.p_value == found.p_corrected < 0.05 < found.interval[0]


def test_only_seeds_that_both_have_are_paired():
    found = of(
        view_study(fabricate({"no graph": NO_GRAPH[:2], "guided": GUIDED[:3]})), "guided"
    ).comparison
    assert (found.pairs, found.difference) == (2, pytest.approx((0.6 + 0.8) / 2 - 0.1))


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


def test_intervals_over_two_or_three_seeds_are_wider_than_their_range():
    found = of(view_study(fabricate({"guided": GUIDED[:3]})), "guided")
    assert found.seed_interval == student_interval(found.success)
    assert found.seed_interval[0] < min(found.success)
    assert found.seed_interval[1] > max(found.success)


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


def test_steps_to_the_references_end_are_of_the_mean_curve():
    curves = {
        "no graph": [[(0, 0.0), (10, 0.3), (20, 0.3)], [(0, 0.0), (10, 0.3), (20, 0.5)]],
        "fast": [[(0, 0.0), (10, 0.5), (20, 0.9)], [(0, 0.0), (10, 0.5), (20, 0.9)]],
        "slow": [[(0, 0.0), (10, 0.1), (20, 0.2)], [(0, 0.0), (10, 0.1), (20, 0.2)]],
    }
    view = view_study(fabricate(dict.fromkeys(curves, NO_GRAPH[:2]), curves=curves))
    assert [entry.reached for entry in view.points[0].variants] == [20, 8, None]
    assert of(view, "fast").reached_interval == (0, None)  # two seeds are few
    curves = {name: 4 * of_seeds for name, of_seeds in curves.items()}
    view = view_study(fabricate(dict.fromkeys(curves, ["333"] * 8), curves=curves))
    assert [entry.reached for entry in view.points[0].variants] == [20, 8, None]
    low, high = of(view, "fast").reached_interval
    assert 5 < low < 8 < high < 11
    assert of(view, "slow").reached_interval == (None, None)
    assert of(view, "no graph").reached_interval[1] == 20


def test_dose_response_is_apart_for_each_way_of_scoring_train_tasks():
    folds, memory = view_study(three_train_fractions()).scatters
    assert (folds.in_sample, memory.in_sample) == (False, True)
    assert [(at.label, at.mrr, at.success) for at in folds.points] == [
        ("train_fraction 0.2", pytest.approx(0.105), pytest.approx(0.2)),
        ("train_fraction 0.5", pytest.approx(0.205), pytest.approx(0.5)),
        ("train_fraction 1", pytest.approx(0.305), pytest.approx(0.7)),
    ]
    assert folds.points[0].mrr_range == pytest.approx((0.1, 0.11))
    assert folds.pearson.value == pytest.approx(np.corrcoef([1, 2, 3], [0.2, 0.5, 0.7])[0, 1])
    assert folds.spearman.value == pytest.approx(1)
    assert memory.pearson is None  # success does not vary
    assert folds.steps_spearman is None
    assert folds.without == pytest.approx(0.1)


def test_steps_are_correlated_with_never_as_the_latest():
    points = [({"distractors": 8}, {"no graph": ["50000"], **{name: ["55000"] for name in "abc"}})]
    curves = {
        "no graph": [[(10, 0.1), (20, 0.5)]],
        "a": [[(10, 0.1), (20, 0.2)]],
        "b": [[(10, 0.1), (20, 0.6)]],
        "c": [[(10, 0.6), (20, 0.6)]],
    }
    mrr = {"a": 0.1, "b": 0.2, "c": 0.3}
    (scatter,) = view_study(fabricate(points, mrr=mrr, curves=curves, drawing="scatter")).scatters
    assert [at.reached for at in scatter.points] == [
        None,
        18,
        10,
    ]  # b: three quarters of the way from 10 to 20
    assert scatter.steps_spearman.value == pytest.approx(-1)


@pytest.mark.parametrize(
    ("values", "label"),
    [
        ({"scorer.train_fraction": 0.1, "scorer.label_noise": 0.0}, "train_fraction 0.1"),
        ({"scorer.train_fraction": 1.0, "scorer.label_noise": 0.3}, "label_noise 0.3"),
        ({"scorer.train_fraction": 1.0, "scorer.label_noise": 0.0}, "train_fraction 1"),
        (
            {"scorer.train_fraction": 0.5, "scorer.label_noise": 0.1},
            "train_fraction 0.5, label_noise 0.1",
        ),
        ({}, "a"),
    ],
)
def test_a_dose_is_labelled_by_what_is_not_whole(values, label):
    (scatter,) = view_study(
        fabricate([(values, {"a": NO_GRAPH})], mrr={"a": 0.1}, drawing="scatter")
    ).scatters
    assert scatter.points[0].label == label


def test_a_view_places_values_and_equal_results_alike():
    """A view has a place for each of its values and equal results have equal ones."""
    view = view_study(three_train_fractions())
    assert msgspec.convert(checked_values(view), StudyView) == view
    assert as_values(view_study(three_train_fractions())) == as_values(view)


def moved(results, number, key):
    """Return results with a run on another graph or split."""
    other, runs = msgspec.structs.replace(results.graphs[0], **{key: "c" * 64}), list(results.runs)
    runs[number] = msgspec.structs.replace(runs[number], graph=1)
    return msgspec.structs.replace(results, graphs=(*results.graphs, other), runs=tuple(runs))


@pytest.mark.parametrize("key", ["hash", "split"])
def test_runs_of_a_cell_on_different_graphs_are_not_averaged(key):
    results = moved(fabricate({"no graph": NO_GRAPH}), 3, key)
    with pytest.raises(
        ConfigError,
        match=r"'no graph': seeds 0 and 3 were played on different graphs, splits or tasks.*cccc",
    ):
        view_study(results)


def test_variants_on_different_graphs_are_not_compared():
    view = view_study(
        moved(fabricate({"no graph": NO_GRAPH[:1], "guided": GUIDED[:1]}), 1, "split")
    )
    assert of(view, "guided").comparison is None
    assert len(view.points[0].graphs) == 2


RUNS = fabricate({"no graph": NO_GRAPH[:1]}).runs
LOST = (Missing("no graph", {}, 0, "the disk was full"),)


@pytest.mark.parametrize(
    ("won", "more", "why"),
    [
        (["50000", "5000"], {}, r"5 tasks, 5 distractor seeds; .* 4 tasks, 5"),
        ([], {"runs": RUNS * 2}, "seed 0 occurs twice"),
        ([], {"missing": LOST}, r"no finished run, 1 missing.*disk was full.*kg reproduce made-up"),
    ],
    ids=["other tasks", "a seed twice", "no runs"],
)
def test_runs_that_cannot_be_averaged_are_refused(won, more, why):
    with pytest.raises(ConfigError, match=why):
        view_study(msgspec.structs.replace(fabricate({"no graph": won}), **more))


def test_points_of_the_grid_in_words():
    values = {"book": "everyday", "distractors": 1, "in_sample": True, "scorer.train_fraction": 0.5}
    assert title_of(values) == "everyday, 1 distractor, in_sample true, scorer.train_fraction 0.5"
