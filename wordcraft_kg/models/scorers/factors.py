"""Scorers for storage: score tables, and ComplEx embeddings for graphs too large for a table.

A table serves any link predictor: all triples are scored once and then looked up. A table of sets
holds scores from elsewhere, such as a language model's opinions.

The page docs/link-prediction.md describes ComplEx to users; Eq. 1 of the paper is its formula.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import check_tensors
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.score_limits import has_table
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer


class TableScorer(StoredScorer):
    """A scorer with a score table, shape (R, E, E): by relation, head and tail, for E entities.

    Attributes:
        kind: ``table``, the scorer kind in ``vocabulary.json``.
        scores: shape (R, E, E), float32.
    """

    kind: ClassVar[str] = "table"

    def __init__(self, scores: Tensor, entities: Sequence[str], graph_hash: str, **kwargs: Any):
        """Keep a table of scores.

        Args:
            scores: shape (R, E, E): by relation, head and tail.
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            kwargs: ``device`` and ``name``, as in :class:`Scorer`.
        """
        super().__init__(entities, graph_hash, **kwargs)
        self.scores = scores.to(self.device, torch.float32).contiguous()

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return {"scores": self.scores}

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        check_tensors(
            tensors, {"scores": "relations E E float32"}, relations=len(RELATIONS), E=size
        )

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ) -> "TableScorer":
        return cls(tensors["scores"], entities, graph_hash, **settings)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        # One index into the flat table takes less time than three indices into three axes.
        size = len(self.entities)
        rows = relations * size + heads
        cells = rows * size + tails
        return self.scores.view(-1)[cells]

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        return self.scores[self.relation_ids(relation)]


class SetTableScorer(StoredScorer):
    """Scores of N sets, such as a language model's opinions; 0, the mean, where there is none.

    A triple has the highest score of the sets that it is part of.

    Attributes:
        kind: ``set-table``, the scorer kind in ``vocabulary.json``.
        sets: shape (N, 8), int64: the ingredients in ascending order, padded with E.
        results: shape (N,), int64.
        values: shape (N,), float32: standardised scores.
    """

    kind: ClassVar[str] = "set-table"

    def __init__(
        self,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ):
        """Take the three tensors by name; ``settings`` are ``device`` and ``name``."""
        super().__init__(entities, graph_hash, **settings)
        self.sets = tensors["sets"]
        self.results = tensors["results"]
        self.values = tensors["values"]

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return {"sets": self.sets, "results": self.results, "values": self.values}

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        layouts = {"sets": "N P int64", "results": "N int64", "values": "N float32"}
        check_tensors(tensors, layouts, P=8)
        sets, results = tensors["sets"], tensors["results"]
        is_in_range = ((sets >= 0) & (sets <= size)).all() and ((results >= 0) & (results < size))
        if not len(sets) or not bool(torch.as_tensor(is_in_range).all()):
            raise ValueError("the sets are none, or hold numbers of no entity")

    @cached_property
    def _tables(self) -> Tensor:
        """The scores of all triples, shape (R, E, E), -inf where no set has one."""
        size = len(self.entities)
        tables = torch.full((len(RELATIONS), size + 1, size + 1), -torch.inf)
        flat = tables.view(-1)
        for i, first in enumerate(self.sets.T):
            links = [(COMPONENT_OF, self.results)]
            links += [(COMBINES_WITH, ids) for j, ids in enumerate(self.sets.T) if i != j]
            for relation, second in links:
                cells = (relation * (size + 1) + first) * (size + 1) + second
                flat.scatter_reduce_(0, cells, self.values, "amax")
        return tables[:, :size, :size].masked_fill(tables[:, :size, :size] == -torch.inf, 0)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        return self._tables.to(self.device)[relations, heads, tails]


class ComplExScorer(StoredScorer):
    """ComplEx, ``Re<h, r, conj(t)>``, by embeddings with d complex dimensions.

    Attributes:
        kind: ``complex``, the scorer kind in ``vocabulary.json``.
        entity: complex embeddings of entities, shape (E, d).
        relation: complex embeddings of relations, shape (R, d).

    Source: Trouillon et al. 2016.
    """

    kind: ClassVar[str] = "complex"

    def __init__(
        self,
        embeddings: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **kwargs: Any,
    ):
        """Keep embeddings.

        Args:
            embeddings: ``entity_real`` and ``entity_imag``, shape (E, d), ``relation_real`` and
                ``relation_imag``, shape (R, d), float.
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            kwargs: ``device`` and ``name``, as in :class:`Scorer`.
        """
        super().__init__(entities, graph_hash, **kwargs)
        tensors = {
            name: tensor.to(self.device, torch.float32) for name, tensor in embeddings.items()
        }
        self.entity = torch.complex(tensors["entity_real"], tensors["entity_imag"])
        self.relation = torch.complex(tensors["relation_real"], tensors["relation_imag"])

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ) -> Scorer:
        scorer = cls(tensors, entities, graph_hash, **settings)
        if not has_table(len(entities)):
            return scorer
        # Where it has room, a table: scores are looked up many times in a training.
        scores = torch.stack([scorer.table(relation) for relation in range(len(RELATIONS))])
        return TableScorer(scores, entities, graph_hash, **settings)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        # Grids of queries and candidates are one matrix product; the plain formula would build a
        # (B, E, d) tensor.
        is_grid, is_turned = grids(heads, relations, tails)
        if is_grid:
            head_vectors = self.entity[heads[:, 0]]
            queries = head_vectors * self.relation[relations.reshape(-1)]
            return real_dot(queries, self.entity[tails[0]])
        if is_turned:
            # The conjugate has the same real part: Re(h r conj(t)) = Re(conj(r) t conj(h)).
            turned = self.relation[relations.reshape(-1)].conj()
            queries = turned * self.entity[tails[:, 0]]
            return real_dot(queries, self.entity[heads[0]])
        queries = self.entity[heads] * self.relation[relations]
        products = queries * self.entity[tails].conj()
        return products.real.sum(dim=-1)

    def factors(self, relation: int | str) -> tuple[Tensor, Tensor]:  # noqa: D102 - inherited
        # Re(x conj(y)) is the dot product of (real, imaginary) parts, here shape (E, 2 d).
        queries = self.entity * self.relation[self.relation_ids(relation)]
        head_factors = torch.view_as_real(queries)
        tail_factors = torch.view_as_real(self.entity)
        return head_factors.flatten(1), tail_factors.flatten(1)

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        head_factors, tail_factors = self.factors(relation)
        return head_factors @ tail_factors.T

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        layouts = {
            "entity_real": "E dim float32",
            "entity_imag": "E dim float32",
            "relation_real": "relations dim float32",
            "relation_imag": "relations dim float32",
        }
        check_tensors(tensors, layouts, relations=len(RELATIONS), E=size)

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return {
            "entity_real": self.entity.real,
            "entity_imag": self.entity.imag,
            "relation_real": self.relation.real,
            "relation_imag": self.relation.imag,
        }


def grids(heads: Tensor, relations: Tensor, tails: Tensor) -> tuple[bool, bool]:
    """Return which layout of all heads with all tails three tensors of ids have.

    Such a grid is one matrix product in place of B times N single products.

    Args:
        heads: entity ids, any shape.
        relations: relation ids: shape (B, 1), or a single id of shape ().
        tails: entity ids, any shape.

    Returns:
        whether (B, 1) heads meet (1, N) tails, and whether (1, N) heads meet (B, 1) tails.
    """
    is_column = relations.ndim == 2 and relations.shape[1] == 1
    are_tables = heads.ndim == tails.ndim == 2
    if not are_tables or not (is_column or relations.ndim == 0):
        return False, False
    is_grid = heads.shape[1] == tails.shape[0] == 1
    is_turned = heads.shape[0] == tails.shape[1] == 1
    return is_grid, is_turned


def real_dot(queries: Tensor, candidates: Tensor) -> Tensor:
    """Return ``Re<query, conj(candidate)>`` for all queries and candidates, by one real product.

    Args:
        queries: complex, shape (B, d).
        candidates: complex, shape (N, d).

    Returns:
        float, shape (B, N): a product of (B, 2 d) and (2 d, N), half the work of the complex
        product.
    """
    # torch conjugates lazily; the real view needs the conjugated numbers in memory.
    query_parts = torch.view_as_real(queries.resolve_conj()).flatten(1)
    candidate_parts = torch.view_as_real(candidates.resolve_conj()).flatten(1)
    return query_parts @ candidate_parts.T
