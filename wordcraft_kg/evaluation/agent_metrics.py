"""Metrics of trained agents: success with intervals, gains by sources, and training curves.

Success is over evaluated runs of an agent, for all tasks or groups of tasks. A gain says what the
finished agent gets from a source: it plays the same tables again with the scores of the source set
to 0. What an agent would have learned without the source, only another training says. Curves are
also of unfinished runs: success, statistics and mixing weights λ.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import compress
from typing import Annotated, Literal, get_args

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_folder import AgentRun, OpenedAgent
from wordcraft_kg.agents.agent_records import TERMINATION_REASONS, TerminationReason
from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.base.statistics import paired_difference, student_interval, task_bootstrap
from wordcraft_kg.graphs import Ids, RecipeGraph, TaskSet, layers
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.sources import ALPHA, source_names, with_letters

# Above any rank or count, and far below the limit of int64.
OPEN_END = 10**9


def binned(
    values: Ids, bounds: Sequence[tuple[int, int]]
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Sort values into bins.

    Args:
        values: integers, shape (N,).
        bounds: lowest and highest value of each bin, both included; :data:`OPEN_END` for no upper
            bound.

    Yields:
        The name of each bin, such as ``3–4`` or ``9+``, and a mask, shape (N,).
    """
    for low, high in bounds:
        if low == high:
            name = str(low)
        elif high == OPEN_END:
            name = f"{low}+"
        else:
            name = f"{low}–{high}"
        yield name, (values >= low) & (values <= high)


OTHER_BOOK = "goals that the other book "
MADE = OTHER_BOOK + "makes"
NOT_MADE = OTHER_BOOK + "does not make"


def goal_groups(
    graph: RecipeGraph, goals: Ids, made: Collection[str] | None
) -> dict[str, NDArray[np.bool_]]:
    """Group goals by whether another book makes them.

    Args:
        graph: the recipe graph.
        goals: ids of the goals, shape (N,); a goal may occur several times.
        made: labels that the other book makes, see
            :attr:`~wordcraft_kg.models.model.History.made_by_other_books`; None without another
            book.

    Returns:
        A mask over ``goals`` for each group, shape (N,), by the group's name; empty if ``made`` is
        None.
    """
    if made is None:
        return {}
    # By label: the other book has ids of its own, and entities that this graph lacks.
    is_made = np.array([label in made for label in graph.labels(goals)], dtype=bool)
    return {MADE: is_made, NOT_MADE: ~is_made}


# Narrow bins for few train recipes, wide ones for many, because few goals have many.
_TRAIN_RECIPES = ((0, 0), (1, 1), (2, 2), (3, 4), (5, 8), (9, OPEN_END))
_LAYERS = ((0, 3), (4, 6), (7, 9), (10, OPEN_END))
NEVER = "never"
"""Name of the crafting layer for goals that cannot be made."""
Interval = tuple[float, float]
Slice = Literal["train_recipes", "layer", "other_book"]


class AgainstScorer(Record):
    """An agent's decisions and success beside its scorer alone, on the same tables.

    Attributes:
        scorer: sources that the scorer alone follows, such as `recipe (w)`.
        differs: share of episodes in which the agent combines other pairs than the scorer alone.
        success, scorer_success: success rate of agent and scorer in these episodes; None without
            such episodes.
        gain: success rate of the agent minus that of the scorer, over all episodes.
        gain_ci: 95 % interval for `gain`, by resampling groups of tasks.
    """

    scorer: str
    differs: Share
    success: Share | None
    scorer_success: Share | None
    gain: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    gain_ci: Interval


class AgentSuccess(Record):
    """An agent's success rate with one distractor count; the intervals are at 95 %.

    Attributes:
        mean: success rate, the mean over the agent's runs.
        seed_ci: interval over training seeds by Student's t; None for a single run.
        task_ci: interval over tasks, by bootstrap of the groups that the split holds out together.
        seeds: success rate of each run.
        by_plan: share of episodes that make the goal by one of the task's plans.
        difference: success rate minus that of the first agent on the same tasks; None for the first
            agent.
        difference_ci: interval for `difference`, by resampling groups of tasks in pairs; None for
            the first agent.
        against_scorer: comparison with the agent's scorer alone; None for an agent without a
            scorer.
    """

    mean: Share
    seed_ci: Interval | None
    task_ci: Interval
    seeds: Annotated[tuple[Share, ...], msgspec.Meta(min_length=1)]
    by_plan: Share
    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)] | None = None
    difference_ci: Interval | None = None
    against_scorer: AgainstScorer | None = None

    @property
    def widest_ci(self) -> Interval:
        """The wider interval, over seeds or over tasks: seeds may be alike by chance."""
        if self.seed_ci is None:
            return self.task_ci
        return max(self.seed_ci, self.task_ci, key=lambda ends: ends[1] - ends[0])


class SliceSuccess(Record):
    """Success rate on a named group of tasks (a slice).

    Attributes:
        slice: the group's name.
        tasks: number of tasks in the group.
        success: share of successful episodes, over all runs and tables.
        ci: 95 % interval, by resampling groups of tasks.
    """

    slice: str
    tasks: Annotated[int, msgspec.Meta(ge=1)]
    success: Share
    ci: Interval


def _successes(results: Sequence[Evaluation]) -> NDArray[np.bool_]:
    # Runs side by side, shape (tasks, runs × tables): a resampled task keeps all its episodes.
    return np.concatenate([result.success for result in results], axis=1)


def compare_with_scorer(
    results: Sequence[Evaluation], scorer: str, alone: Evaluation
) -> AgainstScorer:
    """Compare an agent's evaluated runs with the agent's scorer alone.

    Args:
        results: an evaluation of each run, on the same tables.
        scorer: the sources that the scorer alone follows, such as `recipe (w)`.
        alone: the evaluation of the scorer alone on these tables.

    Returns:
        The comparison over all runs.
    """
    differs = np.concatenate([result.decisions != alone.decisions for result in results], axis=1)
    success = _successes(results)
    # The scorer has no training seeds, so its one evaluation stands beside each run.
    scorer_success = _successes([alone] * len(results))
    # All episodes count for the gain: where decisions are equal the difference is 0, and leaving
    # these episodes out would choose tasks by the outcome.
    gain, low, high = paired_difference(success, scorer_success, alone.groups)
    # Without a single other decision, a success rate in these episodes has no meaning.
    any_differs = bool(differs.any())
    return AgainstScorer(
        scorer=scorer,
        differs=float(differs.mean()),
        success=float(success[differs].mean()) if any_differs else None,
        scorer_success=float(scorer_success[differs].mean()) if any_differs else None,
        gain=gain,
        gain_ci=(low, high),
    )


def success_of(
    results: Sequence[Evaluation],
    reference: Sequence[Evaluation] | None,
    against_scorer: AgainstScorer | None = None,
) -> AgentSuccess:
    """Return the success rate over an agent's evaluated runs.

    Args:
        results: an evaluation of each run, on the same tables.
        reference: evaluations of the first agent's runs, to compare with; None for no comparison.
        against_scorer: the comparison with the agent's scorer alone; None without a scorer.

    Returns:
        The rates and their intervals.
    """
    # Seeds and tasks are two separate sources of chance, so each has an interval of its own.
    means = [float(result.success.mean()) for result in results]
    success = AgentSuccess(
        mean=float(np.mean(means)),
        seed_ci=student_interval(means),
        task_ci=task_bootstrap(_successes(results), results[0].groups),
        seeds=tuple(means),
        by_plan=float(np.mean([result.by_plan.mean() for result in results])),
        against_scorer=against_scorer,
    )
    if reference is None:
        return success
    # Both agents have played the same tables: pairs take the tasks' difficulty out of the interval.
    groups = results[0].groups
    difference, low, high = paired_difference(_successes(results), _successes(reference), groups)
    return msgspec.structs.replace(success, difference=difference, difference_ci=(low, high))


def outcomes_of(results: Sequence[Evaluation]) -> dict[TerminationReason, Share]:
    """Return the episode share for each termination reason, averaged over runs."""
    shares = pd.DataFrame([result.shares() for result in results])
    return {reason: float(shares[reason].to_numpy().mean()) for reason in TERMINATION_REASONS}


def slices_of(
    agent: OpenedAgent,
    tasks: TaskSet,
    results: Sequence[Evaluation],
    made_by_other_books: Collection[str] | None,
) -> dict[Slice, tuple[SliceSuccess, ...]]:
    """Return an agent's success rates on groups of tasks.

    Args:
        agent: a run of the agent; its split counts the train recipes for a goal.
        tasks: the tasks, of which the results have played all or a sample.
        results: the evaluations of the agent's runs, on the same tasks.
        made_by_other_books: labels that other books in the training of scorers make; None without
            such a scorer.

    Returns:
        Success by train recipes for the goal, by crafting rounds to the goal, and on the goals that
        other books make and all other goals; no empty groups.
    """
    if not results:
        return {}
    graph = agent.opened.graph
    split = agent.opened.split
    # The evaluator may have played a sample, so goals follow the order of the played tasks.
    goals = tasks.goals[results[0].tasks]
    train_results = graph.sets[split.is_in("train"), -1]
    num_made = np.bincount(train_results, minlength=graph.num_entities)
    num_train_recipes = num_made[goals]
    layer = layers(graph)[goals]
    groups: dict[Slice, list[tuple[str, NDArray[np.bool_]]]] = {
        "train_recipes": list(binned(num_train_recipes, _TRAIN_RECIPES)),
        # Layer -1 marks goals that cannot be made from the base.
        "layer": [(NEVER, layer < 0), *binned(layer, _LAYERS)],
        "other_book": list(goal_groups(graph, goals, made_by_other_books).items()),
    }
    success = _successes(results)
    slices = {}
    for name, masks in groups.items():
        # Within a slice, too, whole groups are resampled: the split holds out the tasks of a group
        # together, so their outcomes are not independent.
        rows = [
            SliceSuccess(
                slice=label,
                tasks=int(mask.sum()),
                success=float(success[mask].mean()),
                ci=task_bootstrap(success[mask], results[0].groups[mask]),
            )
            for label, mask in masks
            if mask.any()
        ]
        if rows:
            slices[name] = tuple(rows)
    return slices


class SourceGain(Record):
    """What a source adds to a trained agent on the agent's tables.

    Attributes:
        without: success rate of the same agent with the source's scores set to 0.
        gain: the agent's success rate minus `without`.
        gain_ci: 95 % interval for `gain`, by resampling groups of tasks.
    """

    without: Share
    gain: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    gain_ci: tuple[float, float]

    @property
    def adds_nothing(self) -> bool:
        """Whether the agent is not better with the source, by the interval."""
        return self.gain_ci[0] <= 0

    @property
    def sentence(self) -> str:
        """The result in words, to be read after the source's name."""
        verdict = "adds nothing" if self.adds_nothing else "adds to success"
        low, high = self.gain_ci
        return (
            f"{verdict}: with its scores set to 0 the agent makes {self.without:.3f}, "
            f"a difference of {self.gain:+.3f} [{low:+.3f}, {high:+.3f}]"
        )


def source_gains(
    policies: Sequence[Policy], evaluator: Evaluator, results: Sequence[Evaluation]
) -> dict[str, SourceGain]:
    """Let agents play without each of their sources.

    Args:
        policies: the policies of an agent's runs, with the same sources.
        evaluator: the tables.
        results: the evaluation of each policy on these tables, with all sources.

    Returns:
        The gain by each source, by name, such as ``combines (u)``; empty without sources.
    """
    gains = {}
    for source in policies[0].sources:
        played = [evaluator(PolicyPlayer(policy, silent=[source])) for policy in policies]
        without = _successes(played)
        gain, low, high = paired_difference(_successes(results), without, results[0].groups)
        gains[with_letters([source])] = SourceGain(float(without.mean()), gain, (low, high))
    return gains


_CURVE_POINTS = 100
"""Approximate limit for points in a curve."""
TrainingMetric = Literal[
    "test_success", "return", "loss", "pg_loss", "baseline_loss", "entropy", "grad_norm"
]
METRICS: tuple[TrainingMetric, ...] = get_args(TrainingMetric)


class CurvePoint(Record, array_like=True):
    """Mean success over seeds at a point of the training.

    Attributes:
        step: environment steps so far.
        success: mean success rate.
        low, high: 95 % interval over seeds; None for a single seed.
    """

    step: int
    success: float
    low: float | None
    high: float | None


class LambdaCurve(Record):
    """Mean mixing weight λ of a source during training.

    Attributes:
        source: name of the score source.
        action: first or second action of an attempt.
        points: (environment step, λ).
    """

    source: str
    action: Literal["first", "second"]
    points: tuple[tuple[int, float], ...]


class SeedCurve(Record):
    """A logged training statistic of one run.

    Attributes:
        seed: training seed of the run.
        points: (environment step, value).
    """

    seed: int
    points: tuple[tuple[int, float], ...]


def success_curves(members: Sequence[AgentRun]) -> dict[str, tuple[CurvePoint, ...]]:
    """Return mean success curves by split part (test, train), with intervals over seeds."""
    curves = {}
    for part in ("test", "train"):
        points = tuple(mean_curve(_logged(members, f"{part}_success")))
        if points:
            curves[part] = points
    return curves


def shared_steps(curves: Iterable[Mapping[int, float]]) -> pd.DataFrame:
    """Return the values of curves at the steps that all of them have reached, a column for each."""
    columns = [pd.Series(curve, dtype=float) for curve in curves]
    # A mean over fewer curves would jump where one of them ends.
    return pd.concat(columns, axis=1, join="inner").sort_index()


def mean_curve(curves: Iterable[Mapping[int, float]]) -> Iterator[CurvePoint]:
    """Yield the mean of curves at the steps that all have, with intervals over the curves."""
    table = shared_steps(curves)
    for step, values in zip(table.index.tolist(), table.to_numpy(), strict=True):
        low, high = student_interval(values) or (None, None)
        yield CurvePoint(step, float(values.mean()), low, high)


def lambda_curves(members: Sequence[AgentRun]) -> Iterator[LambdaCurve]:
    """Yield mean mixing weights λ over seeds, by score source and action.

    A curve has about :data:`_CURVE_POINTS` points.
    """
    actions: tuple[Literal["first", "second"], ...] = ("first", "second")
    # A source that the agents do not have has no rows, and so no curve.
    for source in (ALPHA.name, *source_names()):
        for action in actions:
            table = shared_steps(_logged(members, f"lambda_{source}_{action}"))
            thinned = table[:: max(1, len(table) // _CURVE_POINTS)]
            rows = zip(thinned.index.tolist(), thinned.to_numpy(), strict=True)
            points = [(step, float(seeds.mean())) for step, seeds in rows]
            if points:
                yield LambdaCurve(source, action, tuple(points))


def training_metrics(members: Sequence[AgentRun]) -> dict[TrainingMetric, tuple[SeedCurve, ...]]:
    """Return each run's logged statistics as curves, in about :data:`_CURVE_POINTS` points.

    The trainer's statistics are means since the line before. Where a line shortly follows another,
    as at a point of the learning curve, they cover a few updates and are mostly noise, so these
    points are left out. The success on test tasks is measured at the line itself and stays.
    """
    by_metric: dict[TrainingMetric, tuple[SeedCurve, ...]] = {}
    for figure in METRICS:
        curves = []
        for agent in members:
            # Steps since the line before, which a line's means cover.
            lengths = np.diff([0, *(row.step for row in agent.metrics)])
            # A run that has just begun has no lines, and no median.
            is_long = lengths * 2 >= np.median(lengths) if len(lengths) else lengths
            is_mean = figure != "test_success"
            rows = list(compress(agent.metrics, is_long)) if is_mean else agent.metrics
            points = [(row.step, row.figures[figure]) for row in rows if figure in row.figures]
            # Every n-th point counted from the end, because the last point matters most.
            every = max(1, len(points) // _CURVE_POINTS)
            thinned = points[::-every][::-1]
            if thinned:
                curves.append(SeedCurve(agent.config.trainer.seed, tuple(thinned)))
        if curves:
            by_metric[figure] = tuple(curves)
    return by_metric


def _logged(members: Sequence[AgentRun], key: str) -> Iterator[dict[int, float]]:
    """Yield the logged values of each run, by step."""
    for agent in members:
        yield {row.step: row.figures[key] for row in agent.metrics if key in row.figures}
