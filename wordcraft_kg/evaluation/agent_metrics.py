"""Metrics of evaluated agents: success rates with intervals, outcomes, and groups of tasks."""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import Evaluation
from wordcraft_kg.agents.records import TERMINATION_REASONS, TerminationReason
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.base.statistics import paired_difference, student_interval, task_bootstrap
from wordcraft_kg.evaluation.bins import OPEN_END, binned
from wordcraft_kg.evaluation.goal_groups import goal_groups
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.tasks import TaskSet

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
        actions: mean number of chosen slots in an episode.
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
    actions: Annotated[float, msgspec.Meta(ge=0)]
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
    of_scorer = _successes([alone] * len(results))
    # All episodes count for the gain: where decisions are equal the difference is 0, and leaving
    # these episodes out would choose tasks by the outcome.
    gain, low, high = paired_difference(success, of_scorer, alone.groups)
    # Without a single other decision, a success rate in these episodes has no meaning.
    any_differs = bool(differs.any())
    return AgainstScorer(
        scorer=scorer,
        differs=float(differs.mean()),
        success=float(success[differs].mean()) if any_differs else None,
        scorer_success=float(of_scorer[differs].mean()) if any_differs else None,
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
        actions=float(np.mean([result.actions.mean() for result in results])),
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
    of_runs = [result.shares() for result in results]
    shares: dict[TerminationReason, Share] = {}
    for termination in TERMINATION_REASONS:
        shares[termination] = float(np.mean([run[termination] for run in of_runs]))
    return shares


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
    train_results = graph.recipes[split.is_in("train"), 2]
    num_made = np.bincount(train_results, minlength=graph.num_entities)
    made = num_made[goals]
    layer = layers(graph)[goals]
    groups: dict[Slice, list[tuple[str, NDArray[np.bool_]]]] = {
        "train_recipes": list(binned(made, _TRAIN_RECIPES)),
        # Layer -1 marks goals that cannot be made from the base.
        "layer": [(NEVER, layer < 0), *binned(layer, _LAYERS)],
        "other_book": list(goal_groups(graph, goals, made_by_other_books).items()),
    }
    slices = {}
    for name, masks in groups.items():
        rows = slice_successes(dict(masks), results)
        if rows:
            slices[name] = rows
    return slices


def slice_successes(
    slices: Mapping[str, NDArray[np.bool_]], results: Sequence[Evaluation]
) -> tuple[SliceSuccess, ...]:
    """Return the success rate on each slice of the played tasks, over all results.

    Args:
        slices: mask over the played tasks, shape (tasks,), by name.
        results: an evaluation of each run, on the same tasks.

    Returns:
        success by slice, in the order of ``slices``; empty slices are left out.
    """
    success = _successes(results)
    rows = []
    for name, mask in slices.items():
        if mask.any():
            # Within a slice, too, whole groups are resampled: the split holds out the tasks of a
            # group together, so their outcomes are not independent.
            interval = task_bootstrap(success[mask], results[0].groups[mask])
            row = SliceSuccess(
                slice=name,
                tasks=int(mask.sum()),
                success=float(success[mask].mean()),
                ci=interval,
            )
            rows.append(row)
    return tuple(rows)
