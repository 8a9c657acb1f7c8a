"""A source of one's own guides an agent: the letters that an entity shares with the goal.

Run it in an empty folder: it writes models/letters and runs/letters, in ten seconds.
A package makes its source known to `--use combines,component,letters` by an entry point:
[project.entry-points."wordcraft_kg.sources"], letters = "my_package.sources:SharedLetters".
"""

import torch
from torch import Tensor

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    TaskConfig,
    train_agent,
    train_links,
)
from wordcraft_kg.models.policies.config import PolicyConfig
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.registry import register_source
from wordcraft_kg.models.policies.sources.source import ScoreView, Source
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.protocol import TripleScorer


@register_source
class SharedLetters(Source):
    """Scores a slot by the number of letters that its entity shares with the goal."""

    shared: Tensor
    label = Label("letters", "x", "letters shared with the goal")

    def __init__(self, num_entities: int):
        """Prepare a table that is saved with the policy.

        Its last row and column are those of nothing.
        """
        super().__init__(num_entities)
        self.register_buffer("shared", torch.zeros(num_entities + 1, num_entities + 1))

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "SharedLetters":
        """Count the letters of the scorer's entities."""
        source, letters = cls(len(scorer.entities)), [set(entity) for entity in scorer.entities]
        source.shared[:-1, :-1] = torch.tensor(
            [[float(len(one & other)) for one in letters] for other in letters]
        )
        return source

    def forward(self, states: States) -> Tensor:
        """Look up the counts of the slots' entities, shape (B, A)."""
        return self.shared[states.goal[:, None], states.table]


def main() -> None:
    """Train an agent that weighs letters in addition to link scores."""
    train_links(LinksConfig("kitchen", ComplExConfig(epochs=10)), "models/letters")
    policy, trainer = PolicyConfig(use="combines,component,letters"), ImpalaConfig(steps=5_000)
    trained = train_agent(
        AgentConfig("kitchen", "models/letters", TaskConfig(), policy, trainer), "runs/letters"
    )
    assert trained.summary is not None
    print(f"success on test tasks: {trained.summary.success['test'].mean:.3f}")


if __name__ == "__main__":
    main()
