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
Alchemy 2.

Splits: each draws a fifth of the recipes or goals of one book, whose tasks keep their difficulty,
and a shift that all its trainings share; trainings add their own. The truth is the mean over all
splits and trainings of this book. The deviations (BOOKS) are estimated from stored tables of three
splits: at depth 1 the means of splits vary .8 to 1.1 times as much as their tasks say (variances),
at depth 2 2.3 to 3.7 times.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtri

from wordcraft_kg.base.artefacts import write_atomically
from wordcraft_kg.base.statistics import (
    bootstrap,
    crossed_difference,
    interval,
    rate_interval,
    student_interval,
    task_bootstrap,
)
from wordcraft_kg.studies import claims

Table = NDArray[np.float64]
Designs = tuple[tuple[int, int], ...]
"""Numbers of splits and of trainings on each."""
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
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(40)


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
        return [claims._metric("steps", run, other) for run, other in pairs]

    expected = float(np.mean(reached(20_000, np.random.default_rng(1))))
    return lambda rng: (student_interval(reached(seeds, rng)) or (0, 1), expected)


def of_tasks(name: str, _: int, tasks: int) -> Trial:
    expected = truth(name, of_one=True)
    return lambda rng: (
        rate_interval(scores(name, rng.normal(size=tasks), 0, rng), None),
        expected,
    )


def of_players(names: tuple[str, str], _: int, tasks: int) -> Trial:
    expected = truth(names[0], of_one=True) - truth(names[1], of_one=True)

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        one, other = rng.normal(size=(2, tasks))
        left = scores(names[0], one, 0, rng)
        right = scores(names[1], ALIKE * one + (1 - ALIKE**2) ** 0.5 * other, 0, rng)
        return crossed_difference(left - right, None)[0][1:], expected

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
    return lambda rng: (
        rate_interval(scores(name, difficulties(groups, rng), 0, rng), groups),
        expected,
    )


def bootstrap_by_goal(name: str, _: int, goals: int) -> Trial:
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
        left = scores(names[0], one, 0, rng)
        right = scores(names[1], ALIKE * one + (1 - ALIKE**2) ** 0.5 * other, 0, rng)
        return crossed_difference(left - right, groups)[0][1:], expected

    return trial


BOOKS = {  # logits: mean, and standard deviations of tasks, splits, trainings and rest; kind
    "no graph": (-1.4, 3.0, 0.03, 0.03, 0.7, "by-recipe"),
    "recipe scorer": (3.0, 3.0, 0.05, 0.03, 0.7, "by-recipe"),
    "full graph": (7.0, 2.0, 0.05, 0.1, 1.0, "by-recipe"),
    "depth 2, planner": (1.5, 2.0, 0.15, 0.05, 0.7, "by-recipe"),
    "depth 2, ComplEx": (-3.0, 2.5, 0.3, 0.3, 0.7, "by-recipe"),
    "no graph, by goal": (-2.5, 3.0, 0.05, 0.05, 0.7, "by-goal"),
    "recipe scorer, by goal": (-1.0, 3.0, 0.03, 0.03, 0.7, "by-goal"),
    "depth 2, ComplEx, by goal": (-5.0, 3.0, 0.6, 0.3, 0.7, "by-goal"),
}
GAINS = [
    ("recipe scorer", "no graph"),
    ("no graph", "no graph"),
    ("full graph", "recipe scorer"),
    ("depth 2, planner", "depth 2, ComplEx"),
    ("recipe scorer, by goal", "no graph, by goal"),
    ("recipe scorer, by goal", "recipe scorer, by goal"),
    ("depth 2, ComplEx, by goal", "no graph, by goal"),
]
"""Variants that are compared on the same splits and tasks."""
HELD_OUT = 0.2
"""Share of the recipes or goals that a split holds out."""
SPLIT_GROUPS = {"by-recipe": 633, "by-goal": 139}
"""Groups that a split of Little Alchemy 2 holds out."""


@dataclass(frozen=True)
class Book:
    """A book whose tasks keep their difficulty over splits.

    Attributes:
        groups: group of each task, shape (N,).
        difficulty: difficulty of each task for two kinds of agents, shape (2, N).
    """

    groups: NDArray[np.int64]
    difficulty: Table

    def truth(self, name: str, side: int) -> float:
        """Return the mean success over all splits and trainings."""
        mean, of_tasks, of_splits, of_trainings, of_rest, _ = BOOKS[name]
        logits = mean + of_tasks * self.difficulty[side]
        return float(mean_of(logits, math.hypot(of_splits, of_trainings, of_rest)).mean())

    def play(
        self,
        name: str,
        side: int,
        test: NDArray[np.bool_],
        trainings: int,
        rng: np.random.Generator,
    ) -> Table:
        """Return success rates of trainings on a split's test tasks, shape (trainings, tasks)."""
        mean, of_tasks, of_splits, of_trainings, of_rest, _ = BOOKS[name]
        difficulty = self.difficulty[side][test]
        shift = of_splits * rng.normal() + of_trainings * rng.normal(size=(trainings, 1))
        rest = of_rest * rng.normal(size=(trainings, len(difficulty)))
        rates = expit(mean + of_tasks * difficulty + shift + rest)
        return rng.binomial(ATTEMPTS, rates) / ATTEMPTS


def draw_book(kind: str, rng: np.random.Generator) -> Book:
    """Return a book of which a split of this kind holds out as many groups as usual."""
    number = round(SPLIT_GROUPS[kind] / HELD_OUT)
    groups = of_goals(number) if kind == "by-goal" else np.arange(number)
    first = difficulties(groups, rng)
    second = ALIKE * first + (1 - ALIKE**2) ** 0.5 * difficulties(groups, rng)
    return Book(groups, np.stack([first, second]))


def test_parts(book: Book, splits: int, rng: np.random.Generator) -> list[NDArray[np.bool_]]:
    """Return for each split which tasks it holds out."""
    number = int(book.groups.max()) + 1
    held_out = round(HELD_OUT * number)
    return [np.isin(book.groups, rng.permutation(number)[:held_out]) for _ in range(splits)]


def over_splits(name: str, splits: int, trainings: int) -> Trial:
    """Mean success over splits of a book."""

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        book = draw_book(BOOKS[name][-1], rng)
        parts = test_parts(book, splits, rng)
        rates = np.hstack([book.play(name, 0, part, trainings, rng) for part in parts])
        groups = np.concatenate([book.groups[part] for part in parts])
        numbers = np.repeat(np.arange(splits), [part.sum() for part in parts])
        return rate_interval(rates, groups, numbers), book.truth(name, 0)

    return trial


def gain_over_splits(names: tuple[str, str], splits: int, trainings: int) -> Trial:
    """Mean difference of two variants over the same splits, tasks and seeds."""

    def trial(rng: np.random.Generator) -> tuple[tuple[float, float], float]:
        book = draw_book(BOOKS[names[0]][-1], rng)
        parts = test_parts(book, splits, rng)
        gains = [
            book.play(names[0], 0, part, trainings, rng)
            - book.play(names[1], 1, part, trainings, rng)
            for part in parts
        ]
        groups = np.concatenate([book.groups[part] for part in parts])
        numbers = np.repeat(np.arange(splits), [part.sum() for part in parts])
        estimate, _ = crossed_difference(np.hstack(gains), groups, numbers)
        return estimate[1:], book.truth(names[0], 0) - book.truth(names[1], 1)

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


STUDIED = [name for name in SUCCESS if not name.startswith(("finished", "failed"))]
SINGLE = [name for name in STUDIED if not name.startswith("released")]
SPEEDS = [4.0, 8.0, 16.0, 32.0]
GOALS = (20, 60, 139, 234)
"""Numbers of held-out goals; 139 in Little Alchemy 2, 234 in everyday."""
TASKS = (200, 650)
ONE_PLAYER: Designs = ((1, 1),)
ONE_SPLIT: Designs = ((1, 3), (1, 5))
SPLITS: Designs = ((3, 1), (3, 3), (5, 1))


@dataclass(frozen=True)
class Kind:
    """A kind of interval.

    Attributes:
        make: makes a trial from a scenario and two numbers: trainings and tasks, goals or points of
            a single split, splits and trainings else.
        scenarios: what the trials differ in.
        designs: numbers of splits and trainings.
        sizes: numbers of tasks, goals or points; empty if the scenario has them.
    """

    make: Callable[..., Trial]
    scenarios: Sequence[Any]
    designs: Designs
    sizes: tuple[int, ...] = ()

    def trials(self, splits: int, trainings: int) -> Iterator[Trial]:
        """Yield a trial for each scenario and size."""
        for scenario in self.scenarios:
            if self.designs is SPLITS:
                yield self.make(scenario, splits, trainings)
            else:
                yield from (self.make(scenario, trainings, size) for size in self.sizes or (1,))


KINDS = {
    "mean success over splits": Kind(over_splits, list(BOOKS), SPLITS),
    "mean difference over splits": Kind(gain_over_splits, GAINS, SPLITS),
    "success over trainings and recipes": Kind(success, STUDIED, ONE_SPLIT, TASKS),
    "difference over trainings and recipes": Kind(difference, PAIRS, ONE_SPLIT, TASKS),
    "success over trainings and goals": Kind(success_by_goal, STUDIED, ONE_SPLIT, GOALS),
    "difference over trainings and goals": Kind(difference_by_goal, PAIRS, ONE_SPLIT, GOALS),
    "success if one training in five fails, .75 in place of .97": Kind(
        failing, [("finished, .97", "failed, .75")], ONE_SPLIT, TASKS
    ),
    "one figure per training": Kind(over_seeds, STUDIED, ONE_SPLIT, (650,)),
    "steps of each training to a level": Kind(steps_of_each, SPEEDS, ONE_SPLIT),
    "success of one player over recipes": Kind(of_tasks, SINGLE, ONE_PLAYER, TASKS),
    "difference of two players over recipes": Kind(of_players, PAIRS[:3], ONE_PLAYER, TASKS),
    "success of one player over goals": Kind(of_tasks_by_goal, SINGLE, ONE_PLAYER, GOALS),
    "the same by bootstrap, as evaluate-agent has it": Kind(
        bootstrap_by_goal, SINGLE, ONE_PLAYER, GOALS
    ),
    "difference of two players over goals": Kind(of_players_by_goal, PAIRS[:3], ONE_PLAYER, GOALS),
    "MRR of one scorer over recipes": Kind(of_ranks, [2.0, 20.0], ONE_PLAYER, TASKS),
}


def rows(times: int, only: str) -> Iterator[dict[str, Any]]:
    """Yield the coverage of each kind and design: the mean, lowest and highest over scenarios."""
    for name, kind in KINDS.items():
        for splits, trainings in kind.designs if only in name else ():
            shares = []
            for number, trial in enumerate(kind.trials(splits, trainings)):
                rng = np.random.default_rng(number)
                held = 0
                for _ in range(times):
                    (low, high), expected = trial(rng)
                    held += low <= expected <= high
                shares.append(held / times)
            figures = {"coverage": np.mean(shares), "lowest": min(shares), "highest": max(shares)}
            rounded = {key: round(float(value), 3) for key, value in figures.items()}
            design = {"kind": name, "splits": splits, "trainings": trainings, "studies": times}
            yield {**design, **rounded}


LINE = (
    "{kind:60s} {splits} x {trainings}: {coverage:.3f}, from {lowest:.3f} to {highest:.3f}".format
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=1_000)
    parser.add_argument("--only", default="", help="a part of the kind")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    figures = []
    for row in rows(options.times, options.only):
        figures.append(row)
        print(LINE(**row), flush=True)
    if options.json:
        write_atomically(options.json, "[\n" + ",\n".join(map(json.dumps, figures)) + "\n]\n")


if __name__ == "__main__":
    main()
