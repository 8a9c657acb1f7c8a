"""Weights of plans, learned from play on train tasks: which plans of the search succeed?

The planner follows the most probable plan. Its probabilities come from pairs on random tables, and
it knows no tasks. Here a player tries all pairs on the tables of train tasks, with scores by a
model that has not seen a fold of the task's plan, and notes which pairs lead to the goal in the
attempts left. A log-linear model then learns which features of plans tell such pairs: an expert's
choices, as in expert iteration, with a search of the known recipes as the expert.

``P(pair) = softmax over pairs of w_n · features(pair)``, n attempts left; the loss is
``-log Σ P(pairs that lead to the goal)``.

Source: Anthony, Tian and Barber 2017 (expert iteration); McFadden 1974 (conditional logit).
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations_with_replacement, product

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.agents.states import states_of
from wordcraft_kg.base import LeakError, steps
from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.planning.search import FEATURES, MAX_ATTEMPTS
from wordcraft_kg.planning.source import BestPlan, log_shares

TASKS = 4_000
"""Train tasks that are played, at most."""
_RIDGE = 1e-3
"""Weight of squared distances to the planner's weights, for each table."""
_ROUNDS = 60
"""Most steps of the optimiser; it is done after 20 to 40."""
_Results = Mapping[tuple[int, ...], Sequence[int]]


def planner_weights() -> Tensor:
    """Return the weights with which pairs are ranked as by the planner: that of log Q is 1."""
    weights = torch.zeros(MAX_ATTEMPTS, len(FEATURES))
    weights[:, FEATURES.index("value")] = 1
    return weights


def fit_plan_weights(
    source: BestPlan,
    world: World,
    *,
    seed: int = 0,
    tasks: int = TASKS,
    features: Collection[str] = FEATURES,
) -> Tensor:
    """Learn weights of plans on train tasks.

    Args:
        source: source plan (p) of a cross-fitted scorer.
        world: train tasks; their depth and distractors decide the tables.
        seed: seed of the sampled tasks and tables.
        tasks: number of train tasks that are played, at most.
        features: names of the features whose weights are learned; others keep the planner's.

    Returns:
        shape (:data:`~wordcraft_kg.planning.search.MAX_ATTEMPTS`, F), float32; the planner's where
        tasks of this depth have no such attempt.

    Raises:
        LeakError: if the tasks are not train tasks, or the scorer has no models of folds.
        GraphMismatchError: if the tasks belong to another graph or split than the scorer.
    """
    if world.config.part != "train" or not source.reads_task:
        raise LeakError(
            f"weights of plans are learned on train tasks with cross-fitted scores; found part "
            f"'{world.config.part}'. Use the world of the part 'train', and a scorer with folds."
        )
    source.bind(world.tasks)
    rng = np.random.default_rng([seed, 1])
    task_sample = np.sort(rng.permutation(len(world.tasks))[:tasks])
    # Tasks whose plans are seen by every model have no scores.
    models = source.model_of_task[torch.from_numpy(task_sample)]
    task_sample = task_sample[(models < source.knowledge.num_models).numpy()]
    weights = planner_weights()
    is_learned = torch.tensor([name in features for name in FEATURES])
    if not len(task_sample):
        return weights
    engine = BatchEngine(world, len(task_sample))
    state = engine.pose(task_sample, 0, seed=seed)
    # Numbers of the environments whose goal is still to be made.
    rows = torch.arange(len(task_sample))
    with torch_threads(1):
        for number in steps("weighing plans", range(world.config.depth, 0, -1)):
            # As many attempts as a plan needs.
            states = states_of(state).of(rows)
            assert states.attempts is not None
            left = torch.full_like(states.goal, number)
            states = states._replace(attempts=states.attempts._replace(left=left))
            leads = _pairs_to_goal(states, world.outcomes, number, world.nothing)
            is_possible = leads.flatten(1).any(1)
            rows = rows[is_possible]
            leads = leads[is_possible]
            if not len(rows):
                break
            # The search looks no further ahead than its most attempts.
            row = min(number, MAX_ATTEMPTS) - 1
            weights[row] = _fitted(source, states.of(is_possible), leads, weights[row], is_learned)
            if number > 1:
                # A right pair each, drawn evenly; environments that are done choose their first
                # slot twice.
                slots = np.zeros((2, len(task_sample)), dtype=np.int64)
                for place, lead in zip(rows.tolist(), leads, strict=True):
                    right = lead.nonzero()
                    slots[:, place] = right[rng.integers(len(right))]
                for choices in slots:
                    state, step = engine.step_once(state, choices)
                rows = rows[step.outcome[rows] != GOAL]
    return weights


def _pairs_to_goal(states: States, results: _Results, number: int, nothing: int) -> Tensor:
    """Return which pairs of slots lead to the goal in so many attempts, shape (B, A, A), bool."""
    num_states, num_slots = states.table.shape
    leads = torch.zeros(num_states, num_slots, num_slots, dtype=torch.bool)
    goals = states.goal.tolist()
    for row, table in enumerate(states.table.tolist()):
        entities = [entity for entity in table if entity != nothing]
        right = _right_pairs(goals[row], entities, results, number)
        is_right = [tuple(sorted(pair)) in right for pair in product(table, repeat=2)]
        leads[row] = torch.tensor(is_right).view(num_slots, num_slots)
    return leads


def _right_pairs(
    goal: int,
    table: Sequence[int],
    results: _Results,
    number: int,
) -> set[tuple[int, int]]:
    """Return the pairs, smaller id first, after which the goal can be made in time."""
    distinct = sorted(set(table))
    right = set()
    # Each pair once, also of an entity with itself; of sorted ids, the smaller one comes first.
    for pair in combinations_with_replacement(distinct, 2):
        results_of_pair = results.get(pair, ())
        if goal in results_of_pair:
            right.add(pair)
            continue
        new = [entity for entity in results_of_pair if entity not in distinct]
        if number > 1 and new:
            # The new entities are on the table of the attempts that are left.
            later = _right_pairs(goal, [*distinct, *new], results, number - 1)
            if later:
                right.add(pair)
    return right


def _fitted(
    source: BestPlan,
    states: States,
    leads: Tensor,
    first: Tensor,
    is_learned: Tensor,
) -> Tensor:
    """Return the weights for these states.

    Args:
        source: source plan (p), bound to the states' tasks.
        states: B states on tables with A slots.
        leads: shape (B, A, A), bool: the pair leads to the goal; one or more in each state.
        first: shape (F,): weights to begin with, and to stay near.
        is_learned: shape (F,), bool: weights that change.

    Returns:
        shape (F,).
    """
    slots = states.num_used_slots(source.num_entities)
    narrow = states._replace(table=states.table[:, :slots])
    features = source.features(narrow)
    right = leads[:, :slots, :slots]
    is_empty = narrow.table == source.num_entities
    ones_per_row = torch.ones(len(features), dtype=torch.int64)
    # A pair counts once: `log_shares` gives it twice.
    is_lower = torch.ones(slots, slots, dtype=torch.bool).tril(-1)
    wrong = ~right | is_lower
    change = torch.zeros_like(first).requires_grad_()
    optimizer = torch.optim.LBFGS([change], max_iter=_ROUNDS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        weights = first + change * is_learned
        shares = log_shares(features, weights[None], ones_per_row, is_empty)
        # (B, A, A) to (B, A · A): the probability of any right pair.
        right_shares = shares.masked_fill(wrong, -torch.inf).flatten(1)
        penalty = _RIDGE * change.square().sum()
        value = penalty - torch.logsumexp(right_shares, dim=1).mean()
        value.backward()
        return value

    optimizer.step(loss)
    return (first + change * is_learned).detach()
