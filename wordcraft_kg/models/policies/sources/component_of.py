"""v: how well a slot serves as an ingredient of the goal."""

from torch import Tensor

from wordcraft_kg.graphs.triples import COMPONENT_OF
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.source import PairSource, ScoreView
from wordcraft_kg.models.scorers.protocol import TripleScorer


class ComponentOf(PairSource):
    """``v_i = L(e_i, componentOf, e_g)``.

    Source: Jiang et al. 2020, section "Link Prediction Model".
    """

    label = Label("v", "v", "componentOf goal")

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "ComponentOf":  # noqa: D102 - inherited
        return cls.of_pairs(scorer, COMPONENT_OF, view)

    def key(self, goal: Tensor, selection: Tensor) -> Tensor:  # noqa: D102 - inherited
        return goal
