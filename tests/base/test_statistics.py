"""Statistics over seeds and tasks: against cases by hand, slow references, exhaustive resampling, and by coverage."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import (
    correlation,
    crossed_bootstrap,
    holm,
    interval_p_value,
    paired_difference,
    resampled_means,
    student_interval,
    task_bootstrap,
    wilson_interval,
)

TASKS = np.array([[1, 1, 0], [0, 0, 0], [1, 1, 1], [1, 1, 1]])


def assert_between_quantiles(bounds, values):
    """Bounds of 20,000 draws lie between the exact quantiles of slightly lower and higher probability."""
    for bound, p in zip(bounds, (0.025, 0.975), strict=True):
        low, high = np.quantile(values, [p - 0.01, p + 0.01])
        assert low - 1e-12 <= bound <= high + 1e-12


def test_intervals_are_repeatable_follow_the_seed_and_leave_the_global_generator_alone():
    def bounds(seed):
        return [
            crossed_bootstrap(np.random.default_rng(0).random((5, 7)), draws=200, seed=seed),
            task_bootstrap(np.random.default_rng(0).integers(0, 2, (50, 7)), draws=200, seed=seed),
        ]

    np.random.seed(3)  # noqa: NPY002
    first = bounds(0)
    after = np.random.random()  # noqa: NPY002
    assert bounds(0) == first
    assert bounds(1)[0] != first[0]
    assert bounds(1)[1] != first[1]
    np.random.seed(3)  # noqa: NPY002
    assert np.random.random() == after  # noqa: NPY002


def test_the_task_bootstrap_has_the_quantiles_of_all_resamples_of_tasks():
    exact = [float(np.mean(rows)) for rows in itertools.product(TASKS.astype(bool), repeat=4)]
    assert_between_quantiles(task_bootstrap(TASKS, draws=20_000), exact)


@pytest.mark.parametrize("attempts", [1, 3])
def test_rates_of_0_and_1_have_the_interval_of_wilson_over_tasks(attempts):
    assert task_bootstrap(np.zeros((30, attempts))) == wilson_interval(0, 30)
    assert task_bootstrap(np.ones((30, attempts))) == wilson_interval(30, 30)
    assert task_bootstrap([[0, 1], [1, 0]]) == pytest.approx(wilson_interval(1, 2))


def successes(rng):
    return rng.random((60, 8)) < rng.beta(0.5, 0.5, (60, 1))  # mostly always or never solved


REALS = (-math.inf, math.inf)
COVERAGE = {
    "three seeds, Student": (1_000, 0, lambda rng: student_interval(rng.normal(size=3), within=REALS), 0.93, 0.97),
    "two seeds, Student": (1_000, 0, lambda rng: student_interval(rng.normal(size=2), within=REALS), 0.93, 0.97),
    "tasks": (400, 0.5, lambda rng: task_bootstrap(successes(rng), draws=300), 0.9, 0.99),
    "tasks, naively": (400, 0.5, lambda rng: wilson_interval(int(successes(rng).sum()), 480), 0, 0.8),
}


@pytest.mark.parametrize(("times", "truth", "bounds_of", "low", "high"), COVERAGE.values(), ids=COVERAGE)
def test_intervals_of_fresh_scores_hold_the_truth_as_often_as_they_say(times, truth, bounds_of, low, high):
    rng = np.random.default_rng(0)
    bounds = [bounds_of(rng) for _ in range(times)]
    assert low < sum(left <= truth <= right for left, right in bounds) / times < high


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        ([], "at least one"),
        (np.zeros((3, 0)), "at least one"),
        ([0.1, math.nan], r"scores\[1\]: nan"),
        ([[0.1, 0.2], [math.inf, 0.2]], r"scores\[1, 0\]: inf"),
        ([[0.1], [0.2, 0.3]], "same length"),
        (["a", "b"], "numbers"),
        (None, "scores"),
    ],
)
def test_scores_that_cannot_be_summed_up_are_refused(scores, message):
    with pytest.raises(ConfigError, match=message):
        student_interval(scores)
    with pytest.raises(ConfigError, match=message.replace("scores", "successes")):
        task_bootstrap(scores)


BY_TASK = r"expected \(tasks, attempts\)"
REFUSED = [
    *((task_bootstrap, (np.ones(shape),), BY_TASK) for shape in ((), (2, 3, 4))),
    *((task_bootstrap, (table,), "expected") for table in (np.ones(4), [[0, 2]], [[0.5, 1]], [[-1, 1]])),
    *((crossed_bootstrap, (table,), "scores") for table in ([0.1, 0.2], [], [[math.nan]])),
    (paired_difference, (np.zeros((3, 1)), np.zeros((4, 1))), "of the same tasks"),
]


@pytest.mark.parametrize(("call", "arguments", "message"), REFUSED)
def test_tables_of_another_shape_or_content_are_refused(call, arguments, message):
    with pytest.raises(ConfigError, match=message):
        call(*arguments)


def test_a_paired_difference_is_that_of_a_slow_bootstrap():
    rng = np.random.default_rng(1)
    x, y = rng.random((30, 3)) < 0.6, rng.random((30, 2)) < 0.4
    slow = []
    for _ in range(4_000):
        rows = rng.integers(30, size=30)
        slow.append(np.mean([x[row].mean() - y[row].mean() for row in rows]))
    difference, low, high = paired_difference(x, y, draws=4_000)
    assert difference == pytest.approx(x.mean() - y.mean())
    assert [low, high] == pytest.approx(np.quantile(slow, [0.025, 0.975]), abs=0.015)


def all_crossed_means(table):
    """The mean of every table made of rows and columns drawn with replacement."""
    rows, columns = (list(itertools.product(range(size), repeat=size)) for size in table.shape)
    return [float(np.mean(table[np.ix_(r, c)])) for r in rows for c in columns]


@pytest.mark.parametrize("transposed", [False, True])
def test_crossed_bootstrap_draws_rows_and_columns(transposed):
    table = np.array([[0.1, 0.2, 0.1], [0.8, 0.9, 1.0], [0.4, 0.6, 0.5]])
    table = table.T if transposed else table
    means = all_crossed_means(table)
    assert_between_quantiles(crossed_bootstrap(table, draws=20_000), means)


@pytest.mark.parametrize("chunk", [1, 7, 10**6])
def test_crossed_bootstrap_does_not_depend_on_the_chunk(chunk, monkeypatch):
    table = np.random.default_rng(0).random((4, 30))
    expected = crossed_bootstrap(table)
    monkeypatch.setattr("wordcraft_kg.base.statistics.CHUNK", chunk * 30)
    assert crossed_bootstrap(table) == pytest.approx(expected, abs=0.02)


def test_crossed_bootstrap_of_one_seed_is_that_of_its_tasks():
    table = np.random.default_rng(0).integers(0, 2, (60, 1))
    assert crossed_bootstrap(table.T, draws=20_000) == pytest.approx(task_bootstrap(table, draws=20_000), abs=0.01)


def test_resampled_means_keep_rows_together():
    drawn = resampled_means([[0.0, 10.0], [1.0, 11.0], [2.0, 12.0]], draws=500)
    assert drawn.shape == (500, 2)
    np.testing.assert_allclose(drawn[:, 1] - drawn[:, 0], 10)
    possible = {round(sum(rows) / 3, 9) for rows in itertools.product(range(3), repeat=3)}
    assert {round(value, 9) for value in drawn[:, 0]} == possible


def test_a_p_value_is_that_of_the_interval_it_is_made_from():
    assert interval_p_value(1.0, (0.0, 2.0)) == pytest.approx(0.05)
    assert interval_p_value(-1.0, (-2.0, 0.0)) == pytest.approx(0.05)
    assert interval_p_value(2.0, (1.0, 3.0)) == pytest.approx(math.erfc(2 * 1.959964 / math.sqrt(2)), rel=1e-4)
    assert interval_p_value(0.0, (-1.0, 1.0)) == pytest.approx(1.0)
    assert interval_p_value(0.3, (0.3, 0.3)) == 0.0
    assert interval_p_value(0.0, (0.0, 0.0)) == 1.0


def test_holm_corrects_the_smallest_most():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.9]) == [1.0, 1.0]
    assert holm([]) == []
    with pytest.raises(ConfigError, match=r"1\.5"):
        holm([1.5])


@given(st.lists(st.floats(0, 1), max_size=8))
def test_holm_is_never_stricter_than_bonferroni_and_keeps_the_order(values):
    corrected = holm(values)
    assert all(p <= q <= min(1.0, len(values) * p) + 1e-12 for p, q in zip(values, corrected, strict=True))
    assert [corrected[i] for i in np.argsort(values, kind="stable")] == sorted(corrected)


@pytest.mark.parametrize("kind", ["pearson", "spearman"])
def test_correlation_is_scipys_and_resamples_whole_cells(kind):
    import scipy.stats

    x, y = [0.1, 0.4, 0.5, 0.9], [2.0, 1.0, 5.0, 5.0]
    theirs = {"pearson": scipy.stats.pearsonr, "spearman": scipy.stats.spearmanr}[kind]
    value, low, high = correlation(x, y, kind, draws=20_000) or (0, 0, 0)
    assert value == pytest.approx(theirs(x, y).statistic)
    drawn = [([x[i] for i in rows], [y[i] for i in rows]) for rows in itertools.product(range(4), repeat=4)]
    values = [theirs(a, b).statistic for a, b in drawn if len(set(a)) > 1 and len(set(b)) > 1]
    assert_between_quantiles((low, high), values)


def test_correlation_needs_three_cells_that_vary():
    assert correlation([1, 2], [1, 2]) is None
    assert correlation([1, 1, 1], [1, 2, 3]) is None
    with pytest.raises(ConfigError, match="one number for each cell"):
        correlation([1, 2, 3], [1, 2])
