"""A scorer of one's own guides an agent: here one that knows nothing but which words are alike.

Run it in an empty folder: it writes models/alike and runs/alike, in about ten seconds.
"""

import torch

from wordcraft_kg import AgentConfig, ImpalaConfig, TaskConfig, open_graph, save_scorer, train_agent
from wordcraft_kg.evaluation.links import view_links
from wordcraft_kg.evaluation.ranked_links import rank_links
from wordcraft_kg.graphs.graph_folder import OpenedGraph
from wordcraft_kg.models.scorers.features import glove_features
from wordcraft_kg.models.scorers.scorer import Scorer


class AlikeScorer(Scorer):
    """Holds that things combine, and are made of each other, if their names are used alike.

    Cosine of GloVe vectors.
    """

    def __init__(self, opened: OpenedGraph):
        """Look up the vectors of the graph's entities."""
        super().__init__(opened.graph.entities, opened.graph.hash, name="alike")
        vectors = torch.tensor(glove_features(opened.graph.entities).vectors)
        self.unit = torch.nn.functional.normalize(vectors, dim=1)

    def _score(
        self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor
    ) -> torch.Tensor:
        return (self.unit[heads] * self.unit[tails]).sum(dim=-1) + 0 * relations


def main() -> None:
    """Evaluate the scorer as a link predictor, then train an agent with its scores."""
    opened = open_graph("kitchen")
    scorer = AlikeScorer(opened)
    print(f"water is most like {scorer.top('water', 'combinesWith', None, limit=4)[1:]}")

    # The scorer has seen no recipe at all, so its scores for train tasks are not in-sample.
    save_scorer("models/alike", scorer, opened, kg="none", origin="cosine of GloVe vectors")
    metrics = view_links(rank_links(scorer, opened)).metrics["all"]
    print(f"MRR on unseen triples: {metrics.mrr:.3f}")

    tasks, trainer = TaskConfig(distractors=4), ImpalaConfig(steps=50_000)
    trained = train_agent(
        AgentConfig("kitchen", "models/alike", tasks, trainer=trainer), "runs/alike"
    )
    assert trained.summary is not None
    print(f"success on test tasks: {trained.summary.success['test'].mean:.3f}")


if __name__ == "__main__":
    main()
