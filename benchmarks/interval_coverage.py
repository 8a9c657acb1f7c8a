"""Simulate how often the printed 95 % intervals hold the truth, for few seeds and realistic
variances.

    python benchmarks/interval_coverage.py --json interval-coverage.json

Agents: training s solves an attempt at task k with the logit ``mean + task_k + seed_s + rest_sk``
(normal, with the standard deviations of SUCCESS), and a task's score is the mean of five attempts.
The scenarios span the means and the variances of the committed studies: the success of trainings
has a standard deviation of .00 to .03, and of .02, .12 and .30 with the released code's settings;
one scenario has single failed trainings. The truth is the mean over fresh seeds and tasks or, for
an interval over seeds, over fresh seeds on these tasks.

Goals: tasks have a goal, and tasks of a goal are alike; goals have 1 to 40 tasks, as in Little
Alchemy 2. Three to five splits of a book hold out a fifth of its goals each, with one training; the
truth is that of fresh goals.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtri
from split_intervals import split_interval

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import (
    bootstrap,
    correlation,
    crossed_difference,
    interval,
    paired_difference,
    rate_interval,
    student_interval,
    task_bootstrap,
)
from wordcraft_kg.studies import claims, view

Table = NDArray[np.float64]
Trial = Callable[[np.random.Generator], tuple[tuple[float, float], float]]
"""Draw data, and return an interval with the truth."""
ATTEMPTS = 5
SUCCESS = {  # logits: mean, and standard deviations of tasks, seeds and rest
    "no graph, .29": (-2.0, 3.0, 0.0, 0.5),
    "few successes, .05": (-6.0, 3.0, 0.1, 1.0),
    "w, .84": (3.5, 3.0, 0.1, 0.7),
    "random vectors, .51": (0.0, 1.5, 0.2, 2.0),
    "by goal, .29": (-2.0, 3.0, 0.3, 0.7),
    "full graph, .99": (7.0, 2.0, 0.0, 1.0),
    "released code, .67": (1.6, 2.0, 1.2, 2.0),
    "released code, .97": (5.5, 1.0, 0.9, 2.0),
    "released code, .64": (1.0, 1.5, 2.7, 1.0),
    "finished, .97": (5.5, 1.0, 0.0, 2.0),
    "failed, .75": (1.8, 1.0, 0.0, 2.0),
}
PAIRS = [
    ("by goal, .29", "no graph, .29"),
    ("w, .84", "no graph, .29"),
    ("random vectors, .51", "no graph, .29"),
]
PAIRS += [
    ("by goal, .29", "by goal, .29"),
    ("released code, .67", "no graph, .29"),
    ("full graph, .99", "w, .84"),
]
PAIRS += [("released code, .64", "no graph, .29")]
ALIKE = 0.7
"""Correlation of the difficulty of a task for two kinds of agents."""
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(120)


def mean_of(logits: Table, deviation: float) -> Table:
    """Return the mean of expit over normal noise around logits."""
    return expit(logits[..., None] + deviation * NODES) @ WEIGHTS / WEIGHTS.sum()


def truth(name: str, *, of_one: bool = False) -> float:
    mean, of_tasks, of_seeds, of_rest = SUCCESS[name]
    return float(
        mean_of(
            np.array(mean), float(np.hypot.reduce([of_tasks, 0 if of_one else of_seeds, of_rest]))
        )
    )


def scores(name: str, difficulty: Table, seeds: int, rng: np.random.Generator) -> Table:
    """Return the success rates of ``seeds`` trainings, or of 0, an average one, on tasks, shape
    (seeds, tasks)."""
    mean, of_tasks, of_seeds, of_rest = SUCCESS[name]
    skill = of_seeds * rng.normal(size=(seeds, 1)) if seeds else np.zeros((1, 1))
    logits = (
        mean
        + of_tasks * difficulty
        + skill
        + of_rest * rng.normal(size=(len(skill), len(difficulty)))
    )
    return rng.binomial(ATTEMPTS, expit(logits)) / ATTEMPTS


def success(name: str, seeds: int, tasks: int) -> Trial:
    expected = truth(name)
    return lambda rng: (
        rate_interval(scores(name, rng.normal(size=tasks), seeds, rng), None),
        expected,
    )


def failing(names: tuple[str, str], seeds: int, tasks: int) -> Trial:
    """Success of trainings of the kind ``names[1]`` with the probability .2, and of the kind
    ``names[0]`` else."""
    expected = 0.8 * truth(names[0]) + 0.2 * truth(names[1])

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        difficulty = rng.normal(size=tasks)
        kinds = [names[int(rng.random() < 0.2)] for _ in range(seeds)]
        return rate_interval(
            np.concatenate([scores(kind, difficulty, 1, rng) for kind in kinds]), None
        ), expected

    return trial


def difference(names: tuple[str, str], seeds: int, tasks: int) -> Trial:
    expected = truth(names[0]) - truth(names[1])

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        one, other = rng.normal(size=(2, tasks))
        left = scores(names[0], one, seeds, rng)
        right = scores(names[1], ALIKE * one + (1 - ALIKE**2) ** 0.5 * other, seeds, rng)
        return crossed_difference(left - right, None)[0][1:], expected

    return trial


def over_seeds(name: str, seeds: int, tasks: int) -> Trial:
    mean, of_tasks, of_seeds, of_rest = SUCCESS[name]

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        difficulty = rng.normal(size=tasks)
        expected = mean_of(mean + of_tasks * difficulty, float(np.hypot(of_seeds, of_rest))).mean()
        return student_interval(scores(name, difficulty, seeds, rng).mean(axis=1)) or (0, 1), float(
            expected
        )

    return trial


STEPS = np.arange(21) * 50_000


def curves(seeds: int, rng: np.random.Generator, speed: float) -> Table:
    """Return learning curves from .016 to .3, shape (seeds, STEPS), with noise as of the agents
    without a graph."""
    rates = speed * rng.lognormal(0, 0.15, (seeds, 1))
    ends = (
        0.284 + 0.004 * rng.normal(size=(seeds, 1)) + 0.002 * rng.normal(size=(seeds, len(STEPS)))
    )
    return 0.016 + ends * (1 - np.exp(-rates * STEPS / STEPS[-1]))


def runs(found: Table) -> list[Any]:
    """Return finished trainings, as far as steps need them."""
    points = [tuple(zip(STEPS.tolist(), curve, strict=True)) for curve in found.tolist()]
    return [
        SimpleNamespace(seed=seed, curve=curve, steps=int(STEPS[-1]))
        for seed, curve in enumerate(points)
    ]


def steps_of_each(speed: float, seeds: int, _: int) -> Trial:
    """Steps of each training to 95 % of another's end, as a share, as claims count them."""

    def reached(number: int, rng: np.random.Generator) -> list[float]:
        pairs = zip(runs(curves(number, rng, speed)), runs(curves(number, rng, 4.0)), strict=True)
        return [claims._figures("steps", run, other)[0] for run, other in pairs]

    expected = float(np.mean(reached(20_000, np.random.default_rng(1))))
    return lambda rng: (student_interval(reached(seeds, rng)) or (0, 1), expected)


def steps_of_mean(speed: float, seeds: int, _: int) -> Trial:
    """Steps until the mean curve reaches the mean end of the reference, as tables count them."""

    def reached(number: int, rng: np.random.Generator) -> tuple[int | None, Any]:
        return view._reached(runs(curves(number, rng, speed)), runs(curves(number, rng, 4.0)))

    expected = reached(20_000, np.random.default_rng(1))[0]
    assert expected is not None

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        low, high = (np.inf if end is None else end for end in reached(seeds, rng)[1])
        return (low, high), expected

    return trial


def of_tasks(name: str, _: int, tasks: int) -> Trial:
    expected = truth(name, of_one=True)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        solved = scores(name, rng.normal(size=tasks), 0, rng)[0] * ATTEMPTS
        return task_bootstrap(
            (np.arange(ATTEMPTS) < solved[:, None] - 0.5).astype(int), None, draws=1_000
        ), expected

    return trial


def of_players(names: tuple[str, str], _: int, tasks: int) -> Trial:
    expected = truth(names[0], of_one=True) - truth(names[1], of_one=True)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        one, other = rng.normal(size=(2, tasks))
        solved = [
            scores(name, skill, 0, rng)[0][:, None] * ATTEMPTS > np.arange(ATTEMPTS) + 0.5
            for name, skill in zip(
                names, (one, ALIKE * one + (1 - ALIKE**2) ** 0.5 * other), strict=True
            )
        ]
        return paired_difference(*solved, None, draws=1_000)[1:], expected

    return trial


WITHIN = 0.5
"""Share of the variance of difficulty between goals; intervals by task are then 1.3 to 1.8 times
too narrow."""


def of_goals(goals: int) -> NDArray[np.int64]:
    """Return the goal of each task: goals have 1 to 40 tasks, half of them up to 3."""
    places = (np.arange(goals) + 0.5) / goals
    return np.repeat(np.arange(goals), np.ceil(np.exp(1 + ndtri(places))).clip(max=40).astype(int))


def difficulties(groups: NDArray[np.int64], rng: np.random.Generator) -> Table:
    """Return the difficulty of tasks with goals, standard normal and alike for tasks of a goal."""
    of_goal, own = rng.normal(size=groups.max() + 1)[groups], rng.normal(size=len(groups))
    return WITHIN**0.5 * of_goal + (1 - WITHIN) ** 0.5 * own


def attempts_of(rates: Table) -> NDArray[np.int64]:
    """Return the successes of single attempts with these rates, shape (tasks, ATTEMPTS)."""
    return (np.arange(ATTEMPTS) < rates[:, None] * ATTEMPTS - 0.5).astype(int)


def success_by_goal(name: str, seeds: int, goals: int) -> Trial:
    expected, groups = truth(name), of_goals(goals)
    return lambda rng: (
        rate_interval(scores(name, difficulties(groups, rng), seeds, rng), groups),
        expected,
    )


def difference_by_goal(names: tuple[str, str], seeds: int, goals: int) -> Trial:
    expected, groups = truth(names[0]) - truth(names[1]), of_goals(goals)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        one, other = difficulties(groups, rng), difficulties(groups, rng)
        left = scores(names[0], one, seeds, rng)
        right = scores(names[1], ALIKE * one + (1 - ALIKE**2) ** 0.5 * other, seeds, rng)
        return crossed_difference(left - right, groups)[0][1:], expected

    return trial


def of_tasks_by_goal(name: str, _: int, goals: int) -> Trial:
    expected, groups = truth(name, of_one=True), of_goals(goals)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        rates = scores(name, difficulties(groups, rng), 0, rng)[0]
        return task_bootstrap(attempts_of(rates), groups, draws=1_000), expected

    return trial


def of_players_by_goal(names: tuple[str, str], _: int, goals: int) -> Trial:
    expected, groups = (
        truth(names[0], of_one=True) - truth(names[1], of_one=True),
        of_goals(goals),
    )

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        one, other = difficulties(groups, rng), difficulties(groups, rng)
        alike = ALIKE * one + (1 - ALIKE**2) ** 0.5 * other
        solved = [
            attempts_of(scores(name, skill, 0, rng)[0])
            for name, skill in zip(names, (one, alike), strict=True)
        ]
        return paired_difference(*solved, groups, draws=1_000)[1:], expected

    return trial


def over_splits(name: str, splits: int, goals: int) -> Trial:
    """Mean success over splits of a book with five times ``goals`` goals; a training for each
    split."""
    expected, groups = truth(name), of_goals(5 * goals)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        difficulty, rates, errors = difficulties(groups, rng), [], []
        for _ in range(splits):
            held_out = np.isin(groups, rng.permutation(5 * goals)[:goals])
            rate = float(scores(name, difficulty[held_out], 1, rng).mean())
            rates.append(rate)
            errors.append((rate * (1 - rate) / held_out.sum()) ** 0.5)
        return split_interval(rates, errors), expected

    return trial


def of_ranks(median: float, _: int, recipes: int) -> Trial:
    """MRR over four queries of each recipe, whose ranks are alike."""

    def ranks(number: int, rng: np.random.Generator) -> Table:
        return np.ceil(
            np.exp(
                np.log(median) + rng.normal(size=(number, 1)) * 1.5 + rng.normal(size=(number, 4))
            )
        )

    expected = float((1 / ranks(400_000, np.random.default_rng(1))).mean())
    clusters = np.repeat(np.arange(recipes), 4)
    return lambda rng: (
        interval(bootstrap((1 / ranks(recipes, rng)).ravel(), clusters, resamples=500)),
        expected,
    )


def of_points(kind: str, _: int, points: int) -> Trial:
    """Pearson's correlation of .8 and Spearman's of the same normal points."""
    expected = 0.8 if kind == "pearson" else 6 / np.pi * np.arcsin(0.8 / 2)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        x, y = rng.multivariate_normal([0, 0], [[1, 0.8], [0.8, 1]], size=points).T
        found = correlation(x, y, kind)  # type: ignore[arg-type]
        assert found
        return found[1:], float(expected)

    return trial


STUDIED = [name for name in SUCCESS if not name.startswith(("finished", "failed"))]
SINGLE = [name for name in STUDIED if not name.startswith("released")]
SPEEDS = [4.0, 8.0, 16.0, 32.0]
SEEDS, NONE = (2, 3, 5), (1,)
GOALS = (20, 60, 139)
KINDS: dict[str, tuple[Any, Any, tuple[int, ...], tuple[int, ...]]] = {
    "success over seeds and tasks": (success, STUDIED, SEEDS, (200, 650)),
    "the same if one training in five fails, .75 in place of .97": (
        failing,
        [("finished, .97", "failed, .75")],
        SEEDS,
        (200, 650),
    ),
    "difference over seeds and tasks": (difference, PAIRS, SEEDS, (200, 650)),
    "one figure per training, over seeds": (over_seeds, STUDIED, SEEDS, (650,)),
    "steps of each training to a level, over seeds": (steps_of_each, SPEEDS, SEEDS, NONE),
    "steps of the mean curve to a level": (steps_of_mean, [6.0, *SPEEDS[1:]], SEEDS, NONE),
    "success of one player over tasks": (of_tasks, SINGLE, NONE, (200, 650)),
    "difference of two players over tasks": (of_players, PAIRS[:3], NONE, (200, 650)),
    "success over seeds and goals": (success_by_goal, STUDIED, SEEDS, GOALS),
    "difference over seeds and goals": (difference_by_goal, PAIRS, SEEDS, GOALS),
    "success of one player over goals": (of_tasks_by_goal, SINGLE, NONE, GOALS),
    "difference of two players over goals": (of_players_by_goal, PAIRS[:3], NONE, GOALS),
    "mean over splits (as many as seeds) of a book by goal": (over_splits, SINGLE, (3, 5), (139,)),
    "MRR of one scorer over recipes": (of_ranks, [2.0, 20.0], NONE, (200, 650)),
    "correlation over scorers": (of_points, ["pearson", "spearman"], NONE, (14,)),
}
"""Kinds of intervals: what makes a trial, scenarios, numbers of seeds (1: none) and numbers of
tasks or points."""


def rows(times: int, only: str) -> Iterator[dict[str, Any]]:
    """Yield the coverage of each kind: the mean over scenarios and numbers of tasks, the lowest and
    the highest."""
    for kind, (make, scenarios, seeds, sizes) in KINDS.items():
        for number in seeds if only in kind else ():
            found = []
            for scenario, size in product(scenarios, sizes):
                trial, rng = make(scenario, number, size), np.random.default_rng(len(found))
                drawn = [trial(rng) for _ in range(times)]
                found.append(
                    float(np.mean([low <= expected <= high for (low, high), expected in drawn]))
                )
            figures = {
                "coverage": float(np.mean(found)),
                "lowest": min(found),
                "highest": max(found),
            }
            yield {"kind": kind, "seeds": number} | {
                name: round(value, 3) for name, value in figures.items()
            }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=2_000)
    parser.add_argument("--only", default="", help="a part of the kind")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = []
    for row in rows(options.times, options.only):
        found.append(row)
        print(
            "{kind:60s} seeds {seeds}: {coverage:.3f}, from {lowest:.3f} to {highest:.3f}".format(
                **row
            ),
            flush=True,
        )
    if options.json:
        write_atomically(options.json, "[\n" + ",\n".join(map(json.dumps, found)) + "\n]\n")


if __name__ == "__main__":
    main()
