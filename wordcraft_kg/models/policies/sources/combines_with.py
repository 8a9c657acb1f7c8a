"""u: how well a slot combines with the entity held."""

from torch import Tensor

from wordcraft_kg.graphs.triples import COMBINES_WITH
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.source import PairSource, ScoreView
from wordcraft_kg.models.scorers.protocol import TripleScorer


class CombinesWith(PairSource):
    """``u_i = L(e_i, combinesWith, e_s)``; 0 while nothing is held.

    Source: Jiang et al. 2020, section "Link Prediction Model".
    """

    label = Label("u", "u", "combinesWith {held}")

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "CombinesWith":  # noqa: D102 - inherited
        return cls.of_pairs(scorer, COMBINES_WITH, view, self_edges=view.self_edges)

    def key(self, goal: Tensor, selection: Tensor) -> Tensor:  # noqa: D102 - inherited
        return selection
