"""Make scorers from models trained with PyKEEN's pipeline."""

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
    """Return a table scorer (a scorer with a table of all triple scores) for a trained PyKEEN model.

    The model may have inverse triples. ``factory`` holds the model's training triples; labels must match the graph in
    ``opened``, ids may differ. GraphMismatchError if model and graph have different entities or relations, ConfigError
    if the graph is too large for a score table.

    Example:
        >>> from pykeen.pipeline import pipeline
        >>> data, quietly = {"graph": "kitchen"}, {"use_tqdm": False}
        >>> result = pipeline(
        ...     dataset="wordcraft", dataset_kwargs=data, model="DistMult", epochs=1, training_kwargs=quietly
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
        missing, unknown = (
            [label for label in expected if label not in ids],
            sorted(set(ids) - set(expected)),
        )
        if missing or unknown:
            problems = [
                f"{len(labels)} {problem} ({', '.join(labels[:3])})"
                for labels, problem in ((missing, "are missing"), (unknown, "are unknown"))
                if labels
            ]
            raise GraphMismatchError(
                f"the model's {name} do not match '{graph.name}': {', '.join(problems)}. Train the model on "
                f"dataset='wordcraft', dataset_kwargs={{'graph': {opened.source!r}}}."
            )
    check_table("a PyKEEN model", graph.num_entities)
    entities = torch.tensor([factory.entity_to_id[label] for label in graph.entities])
    scores = all_scores(model, entities, [factory.relation_to_id[name] for name in RELATIONS])
    return TableScorer(scores, graph.entities, graph.hash, name=type(model).__name__)
