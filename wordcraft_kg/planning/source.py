"""The source plan (p): the probability of the best plan whose next attempt has a slot's entity.

:class:`BestPlan` plans with pairs, by the search of :mod:`wordcraft_kg.planning.search`.
:class:`BestSetPlan` plans with recipes of any number of ingredients, by a scorer of whole sets: a
plan is a tree of attempts, in which a set of entities on the table and of intermediates makes the
goal, and such sets make the intermediates. Its value is the sum of the sets' scores, each the log
probability that a recipe of the entity has exactly these ingredients; a recipe that the model knows
is certain. The search takes all plans of at most :data:`~.search.MAX_ATTEMPTS` attempts from a
limited number of intermediates and of sets for each.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from itertools import product
from typing import ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base import MAX_DIM, ConfigError
from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.graphs import COMPONENT_OF, Ids
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.recipe import (
    LEAST,
    BestRecipe,
    BestSet,
    ScoredSets,
    likely_sets,
    rows_of,
)
from wordcraft_kg.models.policies.sources.source import Evidence, FoldedSource, ScoreView
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.probabilities import KINDS, RecipeCurve
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.sets.scorer import SetScorer
from wordcraft_kg.planning.search import (
    AT_ONCE,
    FEATURES,
    FURTHER,
    MAX_ATTEMPTS,
    NO_PLAN,
    REUSED,
    PlanSearch,
)

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
        attempts = _attempts_of(states)
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


class BestPlan(BestRecipe):
    """The source plan (p).

    ``p_i = max_j log Q_n(e_i, e_j)``; with selection s, ``p_i = log Q_n(e_i, e_s)``. Q is the value
    of a pair with n attempts left, see :mod:`wordcraft_kg.planning.search`. With one attempt left,
    p ranks pairs by the probability that they make the goal.

    Attributes:
        label: name and description of the source.
        reads_attempts: True: states need the number of attempts left.
        curve: buffer with the settings of the search, float64: the intercepts, then slope, shift,
            width, and the log-odds of two forms of plans.
        weights: buffer, shape (:data:`~.search.MAX_ATTEMPTS`, F), float32: the weight of each
            feature in :data:`~.search.FEATURES` by the attempts left, from one on. Not there
            without :meth:`weigh`.
    """

    label: ClassVar[Label] = P
    reads_attempts: ClassVar[bool] = True
    curve: Tensor
    weights: Tensor

    @classmethod
    def of_scorer(  # noqa: D102 - inherited
        cls, scorer: TripleScorer, view: ScoreView
    ) -> FoldedSource:
        main_model = whole_of(scorer)
        if isinstance(main_model, SetScorer):
            return BestSetPlan.of_scorer(scorer, view)
        folded = folds_of(scorer)
        # The curve is fitted to out-of-sample scores, so it comes from the folds alone.
        curve = None
        if folded is not None and folded.probabilities:
            curve = folded.probabilities.recipes
        if not isinstance(main_model, RecipeScorer) or curve is None:
            raise ConfigError(
                "`use` plan (p) needs probabilities of recipes, and "
                f"{getattr(scorer, 'name', 'this scorer')} has none. Train a recipe scorer with "
                "folds: `wordcraft-kg train-recipes` on a graph with a test part. Leave out "
                "`in_sample`, which drops the folds."
            )
        source = super().of_scorer(scorer, view)
        assert isinstance(source, cls)
        values = [*curve.intercepts, curve.slope, curve.shift, float(view.width), REUSED, AT_ONCE]
        # float64: the numbers that a file restores equal those of the scorer's record, to the bit.
        source.register_buffer("curve", torch.tensor(values, dtype=torch.float64))
        return source

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls,
        num_entities: int,
        constants: Mapping[str, Tensor],
    ) -> FoldedSource:
        if BestSetPlan.is_stored(constants):
            return BestSetPlan.restored(num_entities, constants)
        # Besides an intercept for each kind of pair: slope, shift, width and two forms.
        check_tensors(constants, {"curve": "values float64"}, values=KINDS + 5)
        width = constants["curve"].tolist()[KINDS + 2]
        if width not in range(MAX_DIM + 1):
            raise ValueError(
                f"curve has the width {width}; expected a whole number up to {MAX_DIM}"
            )
        source = super().restored(num_entities, constants)
        assert isinstance(source, cls)
        source.register_buffer("curve", constants["curve"])
        if "weights" in constants:
            sizes = {"attempts": MAX_ATTEMPTS, "features": len(FEATURES)}
            check_tensors(constants, {"weights": "attempts features float32"}, **sizes)
            source.weigh(constants["weights"])
        return source

    def weigh(self, weights: Tensor) -> None:
        """Score pairs by weighted features of their plans instead of log Q.

        Args:
            weights: as in :attr:`weights`.
        """
        self.register_buffer("weights", weights)
        self.kept.forget()

    @property
    def search(self) -> PlanSearch:
        """The search for plans, with the settings in :attr:`curve`."""
        new, result_weight, slope, shift, width, reused, at_once = self.curve.tolist()
        curve = RecipeCurve(intercepts=(new, result_weight), slope=slope, shift=shift)
        return PlanSearch(self.knowledge, curve, width=int(width), reused=reused, at_once=at_once)

    def pair_scores(self, states: States, model: Tensor) -> Tensor:
        """Return log Q for all slot pairs.

        With :attr:`weights`, the weighted features of each pair, as log-probabilities over all
        pairs of the table.

        Args:
            states: B states on tables with A slots, with ``attempts``.
            model: shape (B,), int64: number of the model for each state.

        Returns:
            shape (B, A, A), nats.

        Raises:
            ValueError: if the states have no ``attempts``.
            ConfigError: if the search would not fit into memory.
        """
        state = self._searched(states, model)
        if "weights" not in self._buffers:
            return self.search.values(*state)
        *_, attempts_left, _ = state
        is_empty = states.table == self.num_entities
        return log_shares(self.search.features(*state), self.weights, attempts_left, is_empty)

    def features(self, states: States) -> Tensor:
        """Return the features of all slot pairs, before :attr:`weights`.

        Args:
            states: B states of bound tasks with A slots, with ``attempts``.

        Returns:
            shape (B, A, A, F), in the order of :data:`~.search.FEATURES`.

        Raises:
            ValueError: if the states have no ``attempts``.
            LeakError: if a model trained on a task's recipes could score it.
            IndexError: for a number without a task.
            ConfigError: if the search would not fit into memory.
        """
        return self.search.features(*self._searched(states, self.model_of(states)))

    def _searched(
        self, states: States, model: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return the arguments of the search: goal, table, model, attempts left and tried pairs.

        Args:
            states: as in :meth:`pair_scores`.
            model: as in :meth:`pair_scores`.

        Raises:
            ValueError: if the states have no ``attempts``.
        """
        attempts = _attempts_of(states)
        tried = self._tried(states.table, attempts)
        return states.goal, states.table, model, attempts.left, tried

    def _tried(self, table: Tensor, attempts: Attempts) -> Tensor:
        """Return a mask of the tried slot pairs, shape (B, A, A); of none if they are unknown."""
        pairs = attempts.tried
        if pairs is None:
            return table.new_zeros(*table.shape, table.shape[1], dtype=torch.bool)
        # (B, A, 1, n): whether a slot holds the first, and the second, entity of each tried pair.
        slots = table[:, :, None, None]
        holds_first = slots == pairs[:, None, None, :, 0]
        holds_second = slots == pairs[:, None, None, :, 1]
        was_tried = (holds_first & holds_second.transpose(1, 2)).any(3)
        # The padding of pairs is E, as an empty slot.
        was_tried = was_tried & (table != self.num_entities)[:, :, None]
        return was_tried | was_tried.transpose(1, 2)

    @classmethod
    def of_recipes(cls, size: int, recipes: Ids) -> Self:
        """Return a source that plans with the given recipes alone.

        Args:
            size: number of entities in the graph.
            recipes: ids, shape (n, 3).
        """
        no_vectors = np.zeros((size, 0), dtype=np.float16)
        no_neighbours = np.zeros((size, 0), dtype=np.int32)
        source = cls(size, RecipeKnowledge.of_recipes(recipes, no_vectors, no_neighbours))
        # A known recipe is certain; a log-odds far below `NO_PLAN` makes any other impossible.
        impossible = [10 * NO_PLAN] * KINDS
        # Slope, shift and width (0: the default). Of certain plans, none is better.
        values = [*impossible, 0.0, 0.0, 0.0, 0.0, 0.0]
        source.register_buffer("curve", torch.tensor(values, dtype=torch.float64))
        return source

    def evidence(self, states: States) -> tuple[Evidence | None, ...]:  # noqa: D102 - inherited
        evidence = super().evidence(states)
        attempts = _attempts_of(states)
        model = int(self.model_of(states))
        entities = states.table[0].tolist()
        # Each entity once, without empty slots, with a selection that is not on the table.
        distinct = dict.fromkeys((*entities, int(states.selection)))
        at_hand = [entity for entity in distinct if entity != self.num_entities]
        tried = self._tried(torch.tensor([at_hand], device=states.table.device), attempts)

        def planned(entity: int, best: Evidence) -> Evidence:
            plan = self.search.plan(
                int(states.goal),
                at_hand,
                (at_hand.index(entity), at_hand.index(best.partner)),
                model=model,
                attempts_left=int(attempts.left),
                tried=tried,
            )
            if not plan:
                return best
            _, _, expected, _ = plan[0]
            supporting = self.knowledge.supporting_recipes(
                entity,
                best.partner,
                expected,
                model=model,
                limit=3,
            )
            return Evidence(best.partner, tuple(supporting), tuple(plan))

        by_slot = zip(entities, evidence, strict=True)
        return tuple(best and planned(entity, best) for entity, best in by_slot)


def _attempts_of(states: States) -> Attempts:
    """Return the attempts of states; ValueError if they are unknown."""
    if states.attempts is None:
        raise ValueError(
            "the source plan (p) needs `attempts`: the number of attempts left in each state."
        )
    return states.attempts


def log_shares(
    features: Tensor, weights: Tensor, attempts_left: Tensor, is_empty: Tensor
) -> Tensor:
    """Return the log-probability of each pair by weighted features, a softmax over pairs.

    Args:
        features: shape (B, A, A, F).
        weights: shape (:data:`MAX_ATTEMPTS`, F).
        attempts_left: shape (B,), int64: attempts left.
        is_empty: shape (B, A), bool: True for empty slots.

    Returns:
        shape (B, A, A), symmetric, from :data:`NO_PLAN`; -inf for empty slots.
    """
    # Row 0 is for a single attempt left.
    state_weights = weights[attempts_left.clamp(1, MAX_ATTEMPTS) - 1]
    scores = (features * state_weights[:, None, None]).sum(-1)
    has_empty = is_empty[:, :, None] | is_empty[:, None]
    scores = scores.masked_fill(has_empty, -torch.inf)
    # A pair counts once, and is written twice.
    is_lower = torch.ones_like(scores[0], dtype=torch.bool).tril(-1)
    counted_once = scores.masked_fill(is_lower, -torch.inf)
    total = torch.logsumexp(counted_once.flatten(1), dim=1)
    # A table without entities has no pair.
    shares = (scores - total[:, None, None]).clamp(min=NO_PLAN)
    return shares.masked_fill(has_empty, -torch.inf)
