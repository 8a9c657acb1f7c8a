"""Make scorers from models trained with PyKEEN's pipeline.

The page docs/link-prediction.md has an example under *Custom scorers and PyKEEN models*.
"""

import torch
from pykeen.models import Model
from pykeen.triples import TriplesFactory

from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.pykeen_bridge import all_scores
from wordcraft_kg.models.scorers.config import check_table
from wordcraft_kg.models.scorers.factors import TableScorer


def from_pykeen(model: Model, factory: TriplesFactory, opened: OpenedGraph) -> TableScorer:
    """Return a scorer for a trained PyKEEN model, with a table of all triples' scores.

    Args:
        model: a trained PyKEEN model on any device, perhaps with inverse triples.
        factory: the model's training triples. Labels must match the graph; ids may differ.
        opened: the recipe graph.

    Raises:
        GraphMismatchError: if model and graph have different entities or relations.
        ConfigError: if the graph is too large for a score table.

    Example:
        >>> from pykeen.pipeline import pipeline
        >>> data, quietly = {"graph": "kitchen"}, {"use_tqdm": False}
        >>> result = pipeline(
        ...     dataset="wordcraft",
        ...     dataset_kwargs=data,
        ...     model="DistMult",
        ...     epochs=1,
        ...     training_kwargs=quietly,
        ... )
        >>> opened = open_graph("kitchen")
        >>> scorer = from_pykeen(result.model, result.training, opened)
        >>> save_scorer("models/distmult", scorer, opened, kg="partial").name
        'distmult'
    """
    graph = opened.graph
    for name, ids, expected in (
        ("entities", factory.entity_to_id, graph.entities),
        ("relations", factory.relation_to_id, RELATIONS),
    ):
        missing = [label for label in expected if label not in ids]
        unknown = sorted(set(ids) - set(expected))
        problems = []
        if missing:
            problems.append(f"{len(missing)} are missing ({', '.join(missing[:3])})")
        if unknown:
            problems.append(f"{len(unknown)} are unknown ({', '.join(unknown[:3])})")
        if problems:
            raise GraphMismatchError(
                f"the model's {name} do not match '{graph.name}': {', '.join(problems)}. Train "
                f"the model on dataset='wordcraft', dataset_kwargs={{'graph': {opened.source!r}}}."
            )
    # Before scoring, which would take long on a graph that is refused.
    check_table("a PyKEEN model", graph.num_entities)
    # A factory made from labelled triples sorts the labels, so its ids may differ from the graph's.
    entities = torch.tensor([factory.entity_to_id[label] for label in graph.entities])
    scores = all_scores(model, entities, [factory.relation_to_id[name] for name in RELATIONS])
    return TableScorer(scores, graph.entities, graph.hash, name=type(model).__name__)
