"""The source plan (p): the probability of the best plan whose next pair contains a slot's entity."""

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.policies.sources.source import Evidence, ScoreView, check_constants
from wordcraft_kg.models.policies.states import Attempts, States
from wordcraft_kg.models.recipes.method import uses_lists
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import NeighbourKnowledge
from wordcraft_kg.models.scorers.pair_features import knowledge_of
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipe_curve import KINDS, RecipeCurve
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.planning.intermediates import KNOWN_LINK
from wordcraft_kg.planning.search import NO_PLAN, PlanSearch

P = Label(
    "p",
    "p",
    "begins the best plan",
    "plan score",
    "Log-probability of the most probable plan whose next pair contains a slot's entity, and the selection if any.",
)


class BestPlan(BestRecipe):
    """The source plan (p), ``p_i = max_j log Q_n(e_i, e_j)``; with selection s, ``p_i = log Q_n(e_i, e_s)``.

    Q is the value of a pair with n attempts left, see :mod:`wordcraft_kg.planning.search`. With one attempt left, p
    ranks pairs by the probability that they make the goal. The buffer ``curve`` holds the settings of the search:
    intercepts, slope, shift and width.
    """

    label: ClassVar[Label] = P
    reads_attempts: ClassVar[bool] = True
    curve: Tensor

    def __init__(
        self, num_entities: int, knowledge: PairKnowledge, fold_of_recipe: Tensor | None = None
    ):
        super().__init__(num_entities, knowledge, fold_of_recipe)
        self._search: PlanSearch | None = None
        self.register_load_state_dict_post_hook(_forget)

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> Self:  # noqa: D102 - inherited
        whole, folded = whole_of(scorer), folds_of(scorer)
        curve = (
            folded.probabilities.recipes if folded is not None and folded.probabilities else None
        )
        if not isinstance(whole, RecipeScorer) or curve is None:
            raise ConfigError(
                "`use` plan (p) needs probabilities of recipes, and "
                f"{getattr(scorer, 'name', 'this scorer')} has none. Train a recipe scorer with "
                "folds: `wordcraft-kg train-recipes` on a graph with a test part. Leave out "
                "`in_sample`, which drops the folds."
            )
        source = super().of_scorer(scorer, view)
        assert isinstance(source, cls)
        values = [*curve.intercepts, curve.slope, curve.shift, float(view.width)]
        source.register_buffer("curve", torch.tensor(values, dtype=torch.float64))
        return source

    @staticmethod
    def serves(scorer: TripleScorer) -> bool:
        """Return whether a scorer has the probabilities of recipes that this source needs."""
        folded = folds_of(scorer)
        return (
            folded is not None
            and folded.probabilities is not None
            and folded.probabilities.recipes is not None
        )

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Self:  # noqa: D102 - inherited
        check_constants(constants, {"curve": "values float64"}, values=KINDS + 3)
        source = super().restored(num_entities, constants)
        assert isinstance(source, cls)
        source.register_buffer("curve", torch.zeros_like(constants["curve"]))
        return source

    @property
    def search(self) -> PlanSearch:
        """The search for plans."""
        if self._search is None or self._search.device != self.knowledge.bias.device:
            a, b, c, d, slope, shift, width = self.curve.tolist()
            curve = RecipeCurve(intercepts=(a, b, c, d), slope=slope, shift=shift)
            self._search = PlanSearch(self.knowledge, curve, width=int(width))
        return self._search

    def pair_scores(self, states: States, model: Tensor) -> Tensor:
        """Return log Q for all slot pairs, shape (B, A, A); ValueError without ``attempts``."""
        attempts = states.attempts
        if attempts is None:
            raise ValueError(
                "the source plan (p) needs `attempts`: the number of attempts left in each state."
            )
        tried = self._tried(states.table, attempts)
        return self.search.values(states.goal, states.table, model, attempts.left, tried)

    def _tried(self, table: Tensor, attempts: Attempts) -> Tensor | None:
        """Return a mask of the tried slot pairs, shape (B, A, A); None if unknown."""
        pairs = attempts.tried
        if pairs is None:
            return None
        one, other = (table[:, :, None, None] == pairs[:, None, None, :, part] for part in (0, 1))
        both = (one & other.transpose(1, 2)).any(3) & (table != self.num_entities)[:, :, None]
        return both | both.transpose(1, 2)

    @classmethod
    def of_recipes(cls, size: int, recipes: Ids) -> Self:
        """Return a source that plans with the given recipes alone, ids (n, 3), for a graph with ``size`` entities."""
        source = cls(size, _without_words(size, recipes))
        impossible = [10 * NO_PLAN] * KINDS
        source.register_buffer(
            "curve", torch.tensor([*impossible, 0.0, 0.0, 0.0], dtype=torch.float64)
        )
        return source

    def evidence(self, states: States) -> tuple[Evidence | None, ...]:  # noqa: D102 - inherited
        goal, selection, table, task, attempts = states
        evidence = super().evidence(states)
        if attempts is None:
            return evidence
        models, left, entities = self.model_of(task), int(attempts.left), table[0].tolist()
        model = 0 if models is None else int(models)
        # Without empty slots, with a selection that is not on the table
        at_hand = [
            one for one in dict.fromkeys((*entities, int(selection))) if one != self.num_entities
        ]
        tried = self._tried(torch.tensor([at_hand], device=table.device), attempts)

        def planned(entity: int, one: Evidence) -> Evidence:
            pair = at_hand.index(entity), at_hand.index(one.partner)
            plan = self.search.plan(
                int(goal), at_hand, pair, model=model, attempts_left=left, tried=tried
            )
            if not plan:
                return one
            supporting = self.knowledge.supporting_recipes(
                entity, one.partner, plan[0][2], model=model, limit=3
            )
            return Evidence(one.partner, tuple(supporting), tuple(plan))

        return tuple(
            one and planned(entity, one) for entity, one in zip(entities, evidence, strict=True)
        )


def _without_words(size: int, recipes: Ids) -> PairKnowledge:
    """Return the knowledge of recipes, ids (n, 3), and nothing else, for a graph with ``size`` entities."""
    if uses_lists(size):
        no_words = np.zeros((size, 0))
        return NeighbourKnowledge.of_recipes(
            recipes, no_words.astype(np.float16), no_words.astype(np.int32)
        )
    nothing = torch.zeros(size, size)
    links = torch.zeros(size, size)
    for part in (0, 1):
        links[recipes[:, part].copy(), recipes[:, 2].copy()] = KNOWN_LINK
    return knowledge_of(recipes, torch.eye(size), nothing, (nothing, links), (nothing, links))


def _forget(source: nn.Module, _: object) -> None:
    assert isinstance(source, BestPlan)
    source._search = None
