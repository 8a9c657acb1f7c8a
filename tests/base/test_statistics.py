"""Statistics over seeds and tasks: against cases by hand, slow references, exhaustive resampling,
and by coverage."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from wordcraft_kg.base import ConfigError, statistics
from wordcraft_kg.base.statistics import (
    bootstrap,
    crossed_difference,
    holm,
    paired_difference,
    rate_interval,
    student_interval,
    task_bootstrap,
    wilson_interval,
)

TASKS = np.array([[1, 1, 0], [0, 0, 0], [1, 1, 1], [1, 1, 1]])


def assert_between_quantiles(bounds, values):
    """Bounds of 20,000 draws lie between the exact quantiles of slightly lower and higher
    probability."""
    for bound, p in zip(bounds, (0.025, 0.975), strict=True):
        low, high = np.quantile(values, [p - 0.01, p + 0.01])
        assert low - 1e-12 <= bound <= high + 1e-12


def test_intervals_follow_the_seed_without_global_randomness():
    """Intervals are repeatable follow the seed and leave the global generator alone."""

    def bounds(seed):
        table = np.random.default_rng(0).integers(0, 2, (50, 7))
        return task_bootstrap(table, None, draws=200, seed=seed)

    np.random.seed(3)  # noqa: NPY002
    first = bounds(0)
    after = np.random.random()  # noqa: NPY002
    assert bounds(0) == first
    assert bounds(1) != first
    np.random.seed(3)  # noqa: NPY002
    assert np.random.random() == after  # noqa: NPY002


@pytest.mark.parametrize("number", [1, 3, 40, 300])
def test_the_cluster_bootstrap_draws_each_resample_alone(number, monkeypatch):
    """Bit for bit, also at the end of the draws that are made together."""
    monkeypatch.setattr(statistics, "_DRAWN_AT_ONCE", 250)
    rng = np.random.default_rng(1)
    clusters = rng.integers(number, size=5 * number)
    values = 1 / rng.integers(1, 80, size=5 * number)
    names = np.unique(clusters).tolist()
    sums = np.bincount(np.searchsorted(names, clusters), weights=values)
    sizes = np.array([(clusters == name).sum() for name in names])
    rng = np.random.default_rng(7)
    expected = []
    for _ in range(20):
        places = rng.integers(len(names), size=len(names)).tolist()
        drawn = np.array([float(places.count(place)) for place in range(len(names))])
        expected.append((drawn @ sums) / (drawn @ sizes))
    assert bootstrap(values, clusters, resamples=20, seed=7).tolist() == expected


def test_the_task_bootstrap_has_the_quantiles_of_all_resamples_of_tasks(monkeypatch):
    monkeypatch.setattr(statistics, "FEWEST_GROUPS", 2)
    exact = [float(np.mean(rows)) for rows in itertools.product(TASKS.astype(bool), repeat=4)]
    assert_between_quantiles(task_bootstrap(TASKS, None, draws=20_000), exact)


def test_the_task_bootstrap_has_the_quantiles_of_all_resamples_of_groups(monkeypatch):
    monkeypatch.setattr(statistics, "FEWEST_GROUPS", 2)
    table = np.concatenate([TASKS, [[0, 0, 1], [0, 0, 0]]])
    groups = [7, 3, 3, 9, 7, 2]
    members = [table[np.array(groups) == group] for group in sorted({*groups})]
    exact = [float(np.concatenate(drawn).mean()) for drawn in itertools.product(members, repeat=4)]
    assert_between_quantiles(task_bootstrap(table, groups, draws=20_000), exact)


def test_equal_tasks_of_a_group_count_once():
    """Each task four times over, in groups, says as much as each task once."""
    rng = np.random.default_rng(0)
    rates, others = rng.random((3, 60)), rng.random((3, 60))
    groups = np.tile(np.arange(60), 4)
    four = np.tile(rates - others, 4)
    once, _ = crossed_difference(rates - others, None)
    repeated, _ = crossed_difference(four, groups)
    naive, _ = crossed_difference(four, None)
    assert repeated == pytest.approx(once)
    assert naive[2] - naive[1] < 0.6 * (once[2] - once[1])
    assert rate_interval(np.tile(rates, 4), groups) == pytest.approx(rate_interval(rates, None))
    solved = rates[:1].T < 0.4
    assert task_bootstrap(np.tile(solved, (4, 1)), groups) == task_bootstrap(solved, None)


def test_the_variance_over_groups_is_that_of_a_slow_jackknife():
    rng = np.random.default_rng(1)
    sizes = [1, 5, 2, 9, 3, 3, 1, 4]
    groups = np.repeat(np.arange(8), sizes)
    values = rng.random(len(groups)) + 0.3 * rng.random(8)[groups]
    left_out = [values[groups != group].mean() for group in range(8)]
    variance = 7 / 8 * sum((mean - values.mean()) ** 2 for mean in left_out)
    degrees = sum(sizes) ** 2 / sum(size**2 for size in sizes) - 1
    import scipy.stats

    half = scipy.stats.t.ppf(0.975, degrees) * variance**0.5
    (value, low, high), _ = crossed_difference(values[None], groups)
    assert [value - low, high - value] == pytest.approx([half, half])


def test_few_groups_get_students_t_and_one_group_says_nothing_of_others():
    rng = np.random.default_rng(0)
    few = np.arange(400) % 3
    table = rng.random((400, 3)) < np.array([0.2, 0.5, 0.8])[few][:, None]
    low, high = task_bootstrap(table, few)
    assert (low, high) == rate_interval(table.mean(axis=1)[None], few)
    assert high - low > task_bootstrap(table, None)[1] - task_bootstrap(table, None)[0]
    one = np.zeros(400, dtype=int)
    rate = float(table.mean())
    assert task_bootstrap(table, one) == pytest.approx(wilson_interval(rate, 1))
    assert crossed_difference(table.T - 0.4, one)[0][1:] == (-1.0, 1.0)
    assert paired_difference(table, ~table, one)[1:] == (-1.0, 1.0)


@pytest.mark.parametrize("attempts", [1, 3])
def test_rates_of_0_and_1_have_the_interval_of_wilson_over_tasks(attempts):
    assert task_bootstrap(np.zeros((30, attempts)), None) == wilson_interval(0, 30)
    assert task_bootstrap(np.ones((30, attempts)), None) == wilson_interval(30, 30)
    assert task_bootstrap([[0, 1], [1, 0]], None) == pytest.approx(wilson_interval(1, 2))
    pairs = np.arange(30) // 2
    assert task_bootstrap(np.ones((30, attempts)), pairs) == wilson_interval(15, 15)


SPLITS = np.repeat([0, 1, 2], 30)


def of_splits(rng):
    """Three splits that vary three times as much as their tasks say."""
    shift = rng.normal(0, 0.1, 3)[SPLITS]
    return crossed_difference(rng.normal(shift, 0.4)[None], None, SPLITS)[0][1:]


"""Tasks of 80 goals."""


REALS = (-math.inf, math.inf)
"""One case of each kind of interval, and one that must fail; `make slow` has all."""


@pytest.mark.parametrize("call", [task_bootstrap, rate_interval, crossed_difference])
@pytest.mark.parametrize("groups", [[0], np.zeros((3, 2)), range(4)])
def test_another_number_of_groups_than_of_tasks_is_refused(call, groups):
    with pytest.raises(ConfigError, match="expected one for each of"):
        call(np.ones((2, 3)), groups)


def test_a_paired_difference_is_that_of_a_slow_bootstrap():
    rng = np.random.default_rng(1)
    x, y = rng.random((60, 3)) < 0.6, rng.random((60, 2)) < 0.4
    slow = []
    for _ in range(4_000):
        rows = rng.integers(60, size=60)
        slow.append(x[rows].mean() - y[rows].mean())
    difference, low, high = paired_difference(x, y, None, draws=4_000)
    assert difference == pytest.approx(x.mean() - y.mean())
    assert [low, high] == pytest.approx(np.quantile(slow, [0.025, 0.975]), abs=0.015)


def test_a_difference_adds_the_variances_of_a_two_way_table():
    """A difference over seeds and tasks adds the variances of a two way table."""
    table = (np.random.default_rng(0).random((3, 5)) + np.array([[0.0], [0.5], [0.2]])) / 4
    size, number = table.shape
    squares = {"seeds": 0.0, "tasks": 0.0, "rest": 0.0}
    for i, j in np.ndindex(size, number):
        of_seed, of_task = table[i].mean() - table.mean(), table[:, j].mean() - table.mean()
        squares["seeds"] += of_seed**2 / (size - 1)
        squares["tasks"] += of_task**2 / (number - 1)
        squares["rest"] += (table[i, j] - of_seed - of_task - table.mean()) ** 2 / (
            (size - 1) * (number - 1)
        )
    variance = 4.302653**2 * (squares["seeds"] - squares["rest"]) + 2.776445**2 * squares["tasks"]
    (value, low, high), _ = crossed_difference(table, None)
    assert value == pytest.approx(table.mean())
    assert [value - low, high - value] == pytest.approx([(variance / table.size) ** 0.5] * 2)


def test_alike_seeds_add_nothing_and_one_task_leaves_students_t():
    """Seeds that differ less than the rest add nothing and one task leaves students t."""
    table = np.array([[0.0, 0.4, 0.3], [0.4, 0.0, 0.3], [0.2, 0.2, 0.3]])
    half = 4.302653 * (0.01 / 9) ** 0.5
    assert crossed_difference(table, None)[0] == pytest.approx(
        (0.7 / 3, 0.7 / 3 - half, 0.7 / 3 + half)
    )
    scores = np.array([0.1, 0.5, 0.3])
    assert crossed_difference(scores[:, None], None)[0][1:] == pytest.approx(
        student_interval(scores, within=REALS)
    )


def test_several_splits_get_students_t_over_their_means():
    """Tasks of a small split count more, and equal numbers of groups are of different splits."""
    rng = np.random.default_rng(0)
    splits = np.repeat([4, 0, 2], [20, 40, 60])
    groups = np.concatenate([np.arange(size) // 2 for size in (20, 40, 60)])
    table = rng.normal(0, 0.1, (2, 120)) + np.array([0.0, 0.3, 0.1])[splits // 2]
    means = [table[:, splits == split].mean() for split in (4, 0, 2)]
    (value, low, high), p_value = crossed_difference(table, groups, splits)
    assert value == pytest.approx(np.mean(means))
    assert (low, high) == pytest.approx(student_interval(means, within=REALS))
    import scipy.stats

    assert p_value == pytest.approx(scipy.stats.ttest_1samp(means, 0).pvalue)
    one, _ = crossed_difference(table, groups)
    assert crossed_difference(table, groups, np.zeros(120, int))[0] == pytest.approx(one)


def test_splits_that_are_alike_by_chance_leave_half_the_noise_of_their_tasks():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.1, 60)
    splits = np.repeat([0, 1, 2], 20)
    groups = np.tile(np.arange(20) // 2, 3)
    for split in range(3):
        noise[splits == split] -= noise[splits == split].mean()
    (_, low, high), p_value = crossed_difference(0.5 + noise[None], groups, splits)
    (_, task_low, task_high), _ = crossed_difference(0.5 + noise[None], np.arange(60) // 2)
    assert high - low == pytest.approx((task_high - task_low) / 2)
    assert 0 < p_value < 1e-9
    low, high = rate_interval(np.ones((1, 60)), groups, splits)
    assert (low, high) == pytest.approx(wilson_interval(30, 30))
    with pytest.raises(ConfigError, match=r"groups of shape \(59,\)"):
        rate_interval(noise[None], None, splits[1:])


@pytest.mark.parametrize("shift", [0.0, 0.05, -0.3, 0.6])
def test_the_p_value_is_the_level_at_which_the_interval_reaches_zero(shift):
    table = (
        np.random.default_rng(0).normal(0, 0.3, (3, 40)) + np.array([[0.1], [0.0], [0.0]]) + shift
    )
    (value, low, _), p_value = crossed_difference(table, None)
    (_, shifted, _), at_bound = crossed_difference(table - low, None)
    assert (shifted, at_bound) == pytest.approx((0, 0.05), abs=1e-6)
    assert (p_value < 0.05) == (abs(value) > value - low)
    import scipy.stats

    scores = table.mean(axis=1, keepdims=True)
    assert crossed_difference(scores, None)[1] == pytest.approx(
        scipy.stats.ttest_1samp(scores[:, 0], 0).pvalue
    )


def test_equal_differences_leave_room_for_other_tasks():
    floor = 1.959964**2 / 4
    assert crossed_difference(np.zeros((3, 4)), None) == (pytest.approx((0, -floor, floor)), 1.0)
    assert crossed_difference(np.ones((3, 4)), None) == (
        pytest.approx((1, 1 - floor, 1)),
        pytest.approx(0.0455, abs=1e-4),
    )
    assert rate_interval([[1, 0], [0, 1]], None) == pytest.approx(wilson_interval(1, 2))


def test_the_interval_of_a_rate_is_wilsons_and_stays_within_0_and_1():
    solved = np.repeat([0.0, 1.0], [30, 70])[None]
    assert rate_interval(solved, None) == pytest.approx(
        wilson_interval(70, 100), abs=2e-3
    )  # n - 1 against n, and Student's t against the normal quantile
    assert rate_interval(np.ones((2, 30)), None) == pytest.approx(wilson_interval(30, 30))
    low, high = rate_interval([[1, 1, 1, 1], [0, 0.1, 0.2, 0.1], [1, 1, 1, 0.9]], None)
    assert 0 <= low < 0.1 < 0.97 < high <= 1


def test_holm_corrects_the_smallest_most():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), max_size=8))
def test_holm_is_never_stricter_than_bonferroni_and_keeps_the_order(values):
    corrected = holm(values)
    assert all(
        p <= q <= min(1.0, len(values) * p) + 1e-12 for p, q in zip(values, corrected, strict=True)
    )
    assert [corrected[i] for i in np.argsort(values, kind="stable")] == sorted(corrected)
