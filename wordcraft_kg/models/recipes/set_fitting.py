"""Fit the network, the committee and the probabilities of a model of sets."""

import math
from collections.abc import Callable, Sequence
from itertools import chain, compress
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from wordcraft_kg.base import GraphError, Record
from wordcraft_kg.base.tensors import MAX_WEIGHT
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.sets.knowledge import SetKnowledge, Vector
from wordcraft_kg.models.scorers.sets.networks import Networks, fit
from wordcraft_kg.models.scorers.sets.scorer import LIMIT
from wordcraft_kg.runs.checkpoints import Checkpoints

TOP = (1, 3, 5, 10)
"""Numbers of suggestions, for shares of goals with a right one among them."""
_HIDDEN = 256
_EPOCHS = 25
_MEMBERS = 2
"""Networks of the last knowledge; folds have one each."""
_COMMITTEE = 5
"""Fewest networks of the committee; each fold has as many that have not seen it."""
_COMMITTEE_HIDDEN = 64
_COMMITTEE_EPOCHS = 14
_NEVER = -1e9


class FittedOrder(NamedTuple):
    """Networks and probabilities that put the candidates of a goal in order.

    Attributes:
        committee: scores of sets from their features; network m has not seen the goals of
            fold m modulo the number of folds.
        mean: of each feature, shape (F,).
        deviation: of each feature, shape (F,).
        calibrations: temperature, and score of none of the candidates, shape (2,) each: without the
            goals of each fold, and last of all goals.
        top: share of unseen train goals with a right set among the first 1, 3, 5 and 10.
    """

    committee: Networks
    mean: Tensor
    deviation: Tensor
    calibrations: tuple[Tensor, ...]
    top: tuple[float, ...]


class FittedSets(NamedTuple):
    """Fitted parts of a model of sets.

    Attributes:
        networks: scores of ingredients for a goal: without the recipes of each fold of the train
            goals, and last by all recipes.
        order: scores of sets from their features.
    """

    networks: tuple[Networks, ...]
    order: FittedOrder

    def tensors(self, fold: int | None = None) -> dict[str, Tensor]:
        """Return all weights by the names in a model folder.

        Args:
            fold: for cross-fitting, return the weights that have not seen this fold of the train
                goals; None for all.
        """
        order = self.order
        number = -1 if fold is None else fold
        committee = order.committee
        if fold is not None:
            num_folds = len(self.networks) - 1
            # The networks that have not seen the fold.
            committee = Networks(*(weights[fold::num_folds] for weights in committee))
        return {
            **self.networks[number].tensors("network."),
            **committee.tensors("committee."),
            "mean": order.mean,
            "deviation": order.deviation,
            "calibration": order.calibrations[number],
        }


class Candidates(NamedTuple):
    """Candidate sets of a goal.

    Attributes:
        sets: ids, shape (n, 8), padded.
        features: their features, shape (n, F).
        is_right: which of them the book has for the goal, shape (n,).
    """

    sets: Ids
    features: Vector
    is_right: NDArray[np.bool_]


def folds_of_recipes(recipes: Ids, folds: int, seed: int) -> Ids:
    """Return the fold of each recipe's goal, shape (R,), from 0.

    Args:
        recipes: shape (R, 9), as for :func:`fit_sets`.
        folds: number of folds.
        seed: root seed.
    """
    goals, goal_of_recipe = np.unique(recipes[:, -1], return_inverse=True)
    fold_of_goal = np.random.default_rng([seed, 1]).permutation(len(goals)) % folds
    return np.asarray(fold_of_goal[goal_of_recipe.ravel()])


def fit_sets(
    recipes: Ids,
    amounts: Vector,
    words: Vector,
    *,
    seed: int,
    folds: int = 5,
    saved: Checkpoints[Record] | None = None,
    after: Callable[[], None] = lambda: None,
) -> FittedSets:
    """Fit a model of sets.

    Args:
        recipes: shape (R, 9), entities (ingredients, padding -1, goal).
        amounts: parts of all entities, shape (E, P).
        words: unit vectors of all entities, shape (E, D).
        seed: root seed.
        folds: parts of the train goals, each scored by knowledge without its recipes.
        saved: where the networks of each fold, and of all recipes, are saved, and read if there.
        after: called after each network that is fitted.

    Raises:
        ArtefactError: if a saved network is damaged.
    """
    fold_of_recipe = folds_of_recipes(recipes, folds, seed)
    lessons: list[list[Candidates]] = []
    networks = []
    whole = SetKnowledge(recipes, amounts, words)

    def network_of(knowledge: SetKnowledge, number: int, members: int) -> Networks:
        part = 1 + number
        if saved is not None and part in saved.records():
            return Networks.of(saved.read(part).tensors, "")
        network = fit_network(knowledge, seed * 1_000 + number, members=members)
        if saved is not None:
            saved.save(part, network.tensors(""), Record())
        after()
        return network

    for fold in range(folds):
        others = recipes[fold_of_recipe != fold]
        knowledge = SetKnowledge(others, amounts, words, whole.style_parts)
        held_out = recipes[fold_of_recipe == fold]
        network = network_of(knowledge, fold, 1)
        networks.append(network)
        lessons.append(candidates_of(knowledge, network, held_out))
    networks.append(network_of(whole, folds, _MEMBERS))
    fold_of_lesson = np.repeat(np.arange(folds), list(map(len, lessons)))
    order = fit_order(list(chain(*lessons)), fold_of_lesson, seed)
    return FittedSets(tuple(networks), order)


def fit_network(knowledge: SetKnowledge, seed: int, *, members: int) -> Networks:
    """Fit networks that choose the ingredient for each key part of a goal.

    The loss of a recipe's key part is the cross-entropy of the ingredients that bring it, among all
    allowed ones with the part.

    Args:
        knowledge: the train recipes.
        seed: seed of weights, batches and dropout.
        members: number of networks.
    """
    lists = knowledge.lists
    generator = torch.Generator().manual_seed(seed)
    goal_amounts = knowledge.amounts[knowledge.goal_ids]
    inputs = knowledge.inputs(knowledge.goal_ids)
    num_ingredients = len(knowledge.ingredient_ids)
    options = [np.flatnonzero(column) for column in lists.has_part.T]
    # Padding is an ingredient behind the last, which is never allowed.
    table = _padded(options, num_ingredients).numpy()
    members_of_recipe = np.zeros((len(lists.recipe_goals), num_ingredients + 1), dtype=bool)
    # The padding of sets, -1, is the last column, too.
    np.put_along_axis(members_of_recipe, lists.sets[lists.recipe_sets], True, axis=1)
    is_allowed = np.zeros((len(goal_amounts), num_ingredients + 1), dtype=bool)
    is_allowed[:, :-1] = knowledge.allowed(goal_amounts)
    recipe, part = np.nonzero((goal_amounts[lists.recipe_goals] > 0) & knowledge.is_key)
    choices = table[part]
    can = is_allowed[lists.recipe_goals[recipe, None], choices]
    is_target = members_of_recipe[recipe[:, None], choices] & can
    is_lesson = is_target.any(1)
    recipe = recipe[is_lesson]
    lesson_choices = torch.from_numpy(choices[is_lesson])
    banned = torch.from_numpy(np.where(can[is_lesson], 0, _NEVER).astype(np.float32))
    target = torch.from_numpy(is_target[is_lesson].astype(np.float32))
    target /= target.sum(1, keepdim=True)
    goals = torch.from_numpy(lists.recipe_goals)
    counts = torch.from_numpy(np.bincount(recipe, minlength=len(goals)))
    # Lessons are in the order of recipes.
    lessons_of_recipe = torch.arange(len(recipe)).split(counts.tolist())

    def loss_of(networks: Networks, rows: Tensor, drop: Callable[[Tensor], Tensor]) -> Tensor:
        place = torch.repeat_interleave(torch.arange(len(rows)), counts[rows])
        lesson = torch.cat([lessons_of_recipe[row] for row in rows.tolist()])
        scores = torch.nn.functional.pad(networks(inputs[goals[rows]], drop), (0, 1))
        if not len(place):
            # The mean of no lesson is no number; such recipes teach nothing.
            return 0 * scores.sum()
        option_ids = lesson_choices[lesson].expand(len(scores), -1, -1)
        of_part = scores[:, place].gather(2, option_ids) + banned[lesson]
        return -(torch.log_softmax(of_part, 2) * target[lesson]).sum(2).mean()

    sizes = (inputs.shape[1], _HIDDEN, num_ingredients)
    start = Networks.drawn(members, sizes, generator)
    return fit(start, loss_of, len(goals), generator, epochs=_EPOCHS, rate=3e-3)


def candidates_of(knowledge: SetKnowledge, network: Networks, recipes: Ids) -> list[Candidates]:
    """Return candidates for the goals of recipes that the knowledge lacks.

    Args:
        knowledge: of other recipes.
        network: fitted to them.
        recipes: shape (n, 9).
    """
    goals = np.unique(recipes[:, -1])
    with torch.no_grad():
        scores = torch.log_softmax(network(knowledge.inputs(goals)), 2).mean(0).numpy()
    results = []
    for entity, log_network in zip(goals, scores, strict=True):
        sets, features = knowledge.candidates(knowledge.goal(entity, log_network))
        # An ingredient that other recipes lack is in no candidate.
        members = recipes[recipes[:, -1] == entity, :-1]
        is_known = ((members < 0) | (knowledge.number_of[members] >= 0)).all(1)
        right = knowledge.numbers(members[is_known])
        is_right = (sets[:, None] == right[None]).all(2).any(1)
        results.append(Candidates(sets, features, is_right))
    return results


def fit_order(lessons: Sequence[Candidates], fold_of_lesson: Ids, seed: int) -> FittedOrder:
    """Fit the committee and the probabilities; each network leaves out a fold of the goals.

    Args:
        lessons: candidates of train goals.
        fold_of_lesson: fold of each goal, shape (n,), from 0.
        seed: seed of weights and batches.

    Raises:
        GraphError: if no goal has candidates.
    """
    num_goals = len(lessons)
    num_folds = int(fold_of_lesson.max()) + 1
    has_sets = np.array([len(lesson.sets) > 0 for lesson in lessons])
    lessons = list(compress(lessons, has_sets))
    if not lessons:
        raise GraphError(
            "no train goal has a set of known ingredients to choose from, as if each recipe had "
            "ingredients of its own; expected recipes that share ingredients. Add recipes or parts."
        )
    every = np.concatenate([lesson.features for lesson in lessons])
    mean = torch.from_numpy(every.mean(0))
    deviation = torch.from_numpy(every.std(0) + 1e-6)
    features = _padded([lesson.features for lesson in lessons])
    is_right = _padded([lesson.is_right for lesson in lessons])
    is_set = _padded([np.ones(len(lesson.sets), dtype=bool) for lesson in lessons])
    longest, num_features = features.shape[1:]
    scaled = ((features - mean) / deviation).clamp(-LIMIT, LIMIT)
    # 0 for sets, and for right ones.
    never = torch.zeros(is_set.shape).masked_fill(~is_set, _NEVER)
    wrong = torch.zeros(is_set.shape).masked_fill(~is_right, _NEVER)
    generator = torch.Generator().manual_seed(seed * 1_000 + 999)
    has_right = is_right.any(1)
    left_out = torch.from_numpy(fold_of_lesson[has_sets])
    num_for_fold = math.ceil(_COMMITTEE / num_folds)
    members = num_folds * num_for_fold
    fold_of_member = torch.arange(members)[:, None] % num_folds
    useful = torch.nonzero(has_right)[:, 0]

    def scores_of(networks: Networks, rows: Tensor, **drop: Callable[[Tensor], Tensor]) -> Tensor:
        flat = scaled[rows].reshape(-1, num_features)
        return networks(flat, **drop).reshape(members, len(rows), longest) + never[rows]

    def loss_of(networks: Networks, rows: Tensor, drop: Callable[[Tensor], Tensor]) -> Tensor:
        goals = useful[rows]
        scores = scores_of(networks, goals, drop=drop)
        loss = torch.logsumexp(scores, 2) - torch.logsumexp(scores + wrong[goals], 2)
        return (
            (loss * (left_out[goals] != fold_of_member)).sum()
            / (members - num_for_fold)
            / len(rows)
        )

    start = Networks.drawn(members, (num_features, _COMMITTEE_HIDDEN, 1), generator)
    if not len(useful):
        # No set of a train goal is among its candidates, so there is nothing to learn from: equal
        # scores keep the order of the search, and a right set is as rare as the train goals say.
        level = Networks(*map(torch.zeros_like, start))
        none_score = math.log(longest * (num_goals + 1))
        level_calibrations = (torch.tensor([1.0, none_score]),) * (num_folds + 1)
        return FittedOrder(level, mean, deviation, level_calibrations, (0.0,) * len(TOP))
    committee = fit(start, loss_of, len(useful), generator, epochs=_COMMITTEE_EPOCHS, rate=5e-3)
    with torch.no_grad():
        everything = torch.arange(len(lessons))
        scores = scores_of(committee, everything)
        # Each goal by the networks that have not seen it.
        by_fold = scores.reshape(num_for_fold, num_folds, *scores.shape[1:]).mean(0)
        unseen = by_fold[left_out, everything]
    order = torch.argsort(unseen, dim=1, descending=True, stable=True)
    is_hit = is_right.gather(1, order)
    # Goals without candidates are misses.
    top = tuple(float(is_hit[:, :k].any(1).sum()) / num_goals for k in TOP)
    calibrations = []
    # No goal is of the fold behind the last.
    for fold in range(num_folds + 1):
        rows = left_out != fold
        calibrations.append(_calibrated(unseen[rows], wrong[rows], has_right[rows]))
    return FittedOrder(committee, mean, deviation, tuple(calibrations), top)


def _padded(rows: Sequence[NDArray[Any]], padding: int = 0) -> Tensor:
    """Return arrays of different lengths as one tensor, with padding behind the shorter ones."""
    tensors = [torch.from_numpy(row) for row in rows]
    return pad_sequence(tensors, batch_first=True, padding_value=padding)


def _calibrated(scores: Tensor, wrong: Tensor, has_right: Tensor) -> Tensor:
    """Return the temperature, and the score of none, that make unseen goals likeliest.

    Args:
        scores: of candidates by a network that has not seen the goal, shape (n, K).
        wrong: 0 for right candidates, else a large negative number.
        has_right: whether a candidate is right, shape (n,).
    """
    values = torch.zeros(2, requires_grad=True)
    optimiser = torch.optim.LBFGS([values], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        scaled = scores * torch.exp(-values[0])
        every = torch.cat([scaled, values[1].expand(len(scores), 1)], 1)
        right = torch.where(
            has_right, torch.logsumexp(scaled + wrong, 1), values[1].expand(len(scores))
        )
        total = (torch.logsumexp(every, 1) - right).mean()
        optimiser.zero_grad()
        total.backward()
        return total

    optimiser.step(loss)
    temperature, none_score = values.detach()
    # Scores that say nothing are likeliest at any large temperature; a folder holds none above.
    return torch.stack([torch.exp(temperature).clamp(max=MAX_WEIGHT), none_score])
