"""From a recipe book to a guided agent, in Python.

`make lint` checks that a type checker sees real types here.

Run it in an empty folder: it writes models/kitchen and runs/kitchen, in about ten seconds.
"""

from typing import assert_type

from wordcraft_kg import (
    AgentConfig,
    ComplExConfig,
    ImpalaConfig,
    LinksConfig,
    TaskConfig,
    evaluate,
    load_policy,
    load_scorer,
    open_graph,
    train_agent,
    train_links,
)
from wordcraft_kg.agents.evaluation import Evaluation
from wordcraft_kg.graphs.graph_folder import OpenedGraph
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.scorers.scorer import Scorer


def main() -> None:
    """Train a scorer, and an agent with its knowledge; evaluate the agent on the test tasks."""
    opened = open_graph("kitchen")
    assert_type(opened, OpenedGraph)
    print(
        f"{opened.graph}: {len(opened.split.unseen)} triples that the partial knowledge graph lacks"
    )

    train_links(LinksConfig("kitchen", ComplExConfig(dim=32, epochs=20)), "models/kitchen")
    scorer = load_scorer("models/kitchen", graph=opened.graph)
    assert_type(scorer, Scorer)
    for entity, score in scorer.top(None, "componentOf", "bread", limit=3):
        print(f"{score:8.2f}  {entity} componentOf bread")

    tasks, trainer = TaskConfig(distractors=4), ImpalaConfig(steps=100_000)
    train_agent(AgentConfig("kitchen", "models/kitchen", tasks, trainer=trainer), "runs/kitchen")
    policy = load_policy("runs/kitchen")
    assert_type(policy, Policy)
    result = evaluate(policy, opened, num_distractors=4)
    assert_type(result, Evaluation)
    print(f"success on test tasks: {result.metrics().mean:.3f}")


if __name__ == "__main__":
    main()
