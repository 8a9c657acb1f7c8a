"""v: how well a slot serves as an ingredient of the goal."""

from torch import Tensor

from wordcraft_kg.graphs.triples import COMPONENT_OF
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.source import ScoreView, TableSource
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.scales import scaled_table


class ComponentOf(TableSource):
    """``v_i = L(e_i, componentOf, e_g)``.

    Source: Jiang et al. 2020, section "Link Prediction Model".
    """

    label = Label("v", "v", "componentOf goal")

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "ComponentOf":  # noqa: D102 - inherited
        return cls(len(scorer.entities), scaled_table(scorer, COMPONENT_OF, view.scale))

    def key(self, goal: Tensor, selection: Tensor) -> Tensor:  # noqa: D102 - inherited
        return goal
