"""The source plan (p) for recipes of any number of ingredients, by a scorer of whole sets.

A plan is a tree of attempts: a set of entities on the table and of intermediates makes the goal,
and such sets make the intermediates. Its value is the sum of the sets' scores, each the log
probability that a recipe of the entity has exactly these ingredients; a recipe that the model knows
is certain. The search takes all plans of at most :data:`~.search.MAX_ATTEMPTS` attempts from a
limited number of intermediates and of sets for each.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.graphs import COMPONENT_OF, Ids
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.sets import (
    LEAST,
    BestSet,
    ScoredSets,
    likely_sets,
    rows_of,
)
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.sets.scorer import SetScorer
from wordcraft_kg.planning.search import AT_ONCE, FURTHER, MAX_ATTEMPTS

P = Label(
    "p",
    "p",
    "begins the best plan",
    "plan score",
    "Log-probability of the most probable plan whose next pair contains a slot's entity, and the "
    "selection if any. With plans weighed in play, log-probability that such a pair leads to the "
    "goal.",
)
_WIDTH = 8
"""Most intermediates of a table."""
_MOST_SETS = 48
"""Most sets that make an entity."""
_Set = tuple[int, ...]
_Recipes = Mapping[int, set[_Set]]
_Values = Mapping[_Set, float]
"""Log-probabilities by a set: of a recipe, or of a plan that begins with the set."""


class BestSetPlan(BestSet):
    """The source plan (p) of a scorer of sets.

    ``p_i = max_R log Q_n(R)`` over sets R of entities on the table that contain the selection and
    slot i, with Q the probability of the best plan of at most n attempts that begins with R. Sets
    that were tried before begin no plan.

    Attributes:
        recipes: the known recipes of each model, as sets by result.
    """

    label = P
    reads_attempts = True

    def __init__(
        self,
        num_entities: int,
        models: Sequence[SetScorer],
        fold_of_recipe: Tensor | None = None,
    ):
        super().__init__(num_entities, models, fold_of_recipe)
        self.recipes = tuple(map(known_recipes, models))

    def attempts(self, states: States) -> list[Tensor]:  # noqa: D102 - inherited
        attempts = states.attempts
        if attempts is None:
            raise ValueError(
                "the source plan (p) needs `attempts`: the number of attempts left in each state."
            )
        tried = [] if attempts.tried is None else [attempts.tried.flatten(1)]
        return [attempts.left[:, None], *tried]

    def sets_of_table(  # noqa: D102 - inherited
        self,
        model: int,
        goal: int,
        entities: _Set,
        sizes: range,
        attempts: _Set,
    ) -> ScoredSets:
        number, *tried_ids = attempts
        # Each set that was tried has as many places as the largest recipe.
        rows = np.array(tried_ids, dtype=np.int64).reshape(-1, sizes.stop - 1).tolist()
        tried = {_set_of(row, self.num_entities) for row in rows} - {()}
        number = min(max(number, 1), MAX_ATTEMPTS)
        plans = best_plans(
            self.models[model], self.recipes[model], goal, entities, sizes, number, tried
        )
        values = np.array(list(plans.values()), dtype=np.float32)
        return ScoredSets(rows_of(list(plans)), values).best()

    def other_scores(self, model: int, goal: int, sets: Ids) -> NDArray[np.float32]:  # noqa: D102
        # No plan begins with these sets, or they were tried.
        return np.full(len(sets), LEAST, dtype=np.float32)


def known_recipes(scorer: SetScorer) -> _Recipes:
    """Return the recipes of a model, as sets by result."""
    recipes: dict[int, set[_Set]] = defaultdict(set)
    for *ingredients, result in scorer.knowledge.recipes.tolist():
        recipes[result].add(_set_of(ingredients, -1))
    return recipes


def best_plans(
    scorer: SetScorer,
    recipes: _Recipes,
    goal: int,
    entities: _Set,
    sizes: range,
    number: int,
    tried: Collection[_Set] = (),
) -> _Values:
    """Return the value of the best plan that begins with each likely set of a table, nats.

    Args:
        scorer: scores sets.
        recipes: its known recipes.
        goal: id.
        entities: ids on the table.
        sizes: numbers of ingredients.
        number: attempts left.
        tried: sets that make nothing new.
    """
    middle: _Set = ()
    if number > 1:
        middle = _intermediates(scorer, recipes, goal, entities, number)
    # A task has as many attempts as it needs: only a distractor opens so short a plan.
    at_once = AT_ONCE if number > 1 and not tried else 0.0

    @cache
    def sets_of(target: int) -> _Values:
        at_hand = {*entities, *middle} - {target}
        scored = likely_sets(scorer, target, sorted(at_hand), sizes)
        sets = [_set_of(row, -1) for row in scored.sets.tolist()]
        values = dict(zip(sets, scored.scores.tolist(), strict=True))
        values |= {ids: 0.0 for ids in recipes.get(target, ()) if at_hand.issuperset(ids)}
        # By ids where values are equal, whatever the order of a set of Python.
        best = sorted(values, key=lambda ids: (-values[ids], ids))
        return {ids: values[ids] for ids in best[:_MOST_SETS]}

    @cache
    def plans_of(target: int, attempts: int) -> _Values:
        plans: dict[_Set, float] = defaultdict(lambda: -np.inf)
        is_whole = (target, attempts) == (goal, number)
        for ingredients, score in sets_of(target).items():
            parts = [entity for entity in dict.fromkeys(ingredients) if entity in middle]
            spare = attempts - 1 - len(parts)
            if not parts and ingredients not in tried:
                plans[ingredients] = max(score + at_once * is_whole, plans[ingredients])
            if not parts or spare < 0:
                continue
            # One part takes the spare attempts, and one part is made first.
            for longest, first in product(parts, parts):
                plans_with = {part: plans_of(part, 1 + spare * (part == longest)) for part in parts}
                best = {part: max(plans_with[part].values(), default=-np.inf) for part in parts}
                others_value = score + sum(best.values()) - best[first] - FURTHER
                for start, value in plans_with[first].items():
                    # False for parts that nothing makes, whose values are no numbers here.
                    if others_value + value > plans[start]:
                        plans[start] = others_value + value
        return plans

    return plans_of(goal, number)


def _set_of(ids: Iterable[int], nothing: int) -> _Set:
    """Return ids in ascending order, without the padding ``nothing``."""
    return tuple(sorted(entity for entity in ids if entity != nothing))


def _intermediates(
    scorer: SetScorer, recipes: _Recipes, goal: int, entities: _Set, number: int
) -> _Set:
    """Return entities that a plan of ``number`` attempts may make on its way to the goal.

    Likely ingredients of the goal that are not on the table: first those that known recipes make
    from the table, then any.
    """
    every = torch.arange(len(scorer.entities))
    shares = scorer.score(every, COMPONENT_OF, goal).numpy()
    at_hand = {*entities}
    for _ in range(number - 1):
        at_hand |= {
            result for result, sets in recipes.items() if any(map(at_hand.issuperset, sets))
        }
    makes = sorted(at_hand.difference(entities), key=lambda entity: -shares[entity])
    ingredients = np.argsort(-shares, kind="stable")[: 2 * _WIDTH].tolist()
    options = dict.fromkeys([*makes[: _WIDTH // 2], *ingredients])
    return tuple(entity for entity in options if entity not in {*entities, goal})[:_WIDTH]
