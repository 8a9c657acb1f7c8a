"""A scorer that learns nothing and compares neighbours instead."""

from typing import Any

import numpy as np
import torch

from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.limits import check_table
from wordcraft_kg.models.scorers.tables import TableScorer


class NeighbourScorer(TableScorer):
    """Scores a triple by how strongly entities like its head are linked to its tail, and its head to ones like it.

    Nothing is learned. With ``A_r`` the known links of relation r, ``score_r = S A_r + A_r S``, where ``S`` is the
    cosine of the rows of ``[A_combinesWith, A_componentOf, A_componentOf transposed]``: entities are similar to the
    extent that they share neighbours. A neighbour shared by n entities weighs 1 / n, and an entity's similarity to
    itself is 0. The weight was chosen among powers of n on validation parts: ``benchmarks/link_quality.py neighbours``.

    Everything is dense, (E, 3 E), so this suits graphs of up to a few thousand entities; larger ones are refused.

    Source: neighbourhood-based link prediction (Adamic and Adar 2003; Sarwar et al. 2001), here on two relations.
    """

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, *, power: float = 1.0, **kwargs: Any):
        """Score all triples from the known ones, shape (T, 3); a neighbour of n entities weighs ``n ** -power``.

        Raises:
            ConfigError: if the graph has too many entities.
        """
        size = graph.num_entities
        check_table("the neighbour rule", size)
        links = torch.zeros(len(RELATIONS), size, size)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64).T
        links[relations, heads, tails] = 1
        profiles = torch.cat([*links, links[COMPONENT_OF].T], dim=1)
        weighted = profiles * profiles.sum(0).clamp(min=1) ** (-power / 2)
        unit = torch.nn.functional.normalize(weighted, dim=1)
        alike = (unit @ unit.T).fill_diagonal_(0)
        super().__init__(alike @ links + links @ alike, graph.entities, graph.hash, **kwargs)
