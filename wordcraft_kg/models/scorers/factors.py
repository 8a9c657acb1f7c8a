"""Scorers for storage: score tables, and ComplEx embeddings for graphs too large for a table."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer, check_shapes


class TableScorer(StoredScorer):
    """A scorer with a score table, shape (R, E, E): by relation, head and tail, for E entities."""

    kind: ClassVar[str] = "table"

    def __init__(self, scores: Tensor, entities: Sequence[str], graph_hash: str, **kwargs: Any):
        super().__init__(entities, graph_hash, **kwargs)
        self.scores = scores.to(self.device, torch.float32).contiguous()

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return {"scores": self.scores}

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        check_shapes(tensors, {"scores": (len(RELATIONS), size, size)})

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **settings: Any,
    ) -> "TableScorer":
        return cls(tensors["scores"], entities, graph_hash, **settings)

    @classmethod
    def of(cls, scorer: Scorer) -> "TableScorer":
        """Tabulate all scores by another scorer."""
        scores = torch.stack([scorer.table(relation) for relation in range(len(RELATIONS))])
        return TableScorer(
            scores, scorer.entities, scorer.graph_hash, device=scorer.device, name=scorer.name
        )

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        size = len(self.entities)
        return self.scores.view(-1)[(relations * size + heads) * size + tails]

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        return self.scores[self.relation_ids(relation)]


class ComplExScorer(StoredScorer):
    """ComplEx (Trouillon et al. 2016) by embeddings ``{entity,relation}_{real,imag}``, (E, d) and (R, d)."""

    kind: ClassVar[str] = "complex"

    def __init__(
        self,
        embeddings: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **kwargs: Any,
    ):
        super().__init__(entities, graph_hash, **kwargs)
        tensors = {
            name: tensor.to(self.device, torch.float32) for name, tensor in embeddings.items()
        }
        self.entity = torch.complex(tensors["entity_real"], tensors["entity_imag"])
        self.relation = torch.complex(tensors["relation_real"], tensors["relation_imag"])

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        is_grid, is_turned = _grids(heads, relations, tails)
        if is_grid:
            return real_dot(
                self.entity[heads[:, 0]] * self.relation[relations.reshape(-1)],
                self.entity[tails[0]],
            )
        if is_turned:
            known = self.relation[relations.reshape(-1)].conj() * self.entity[tails[:, 0]]
            return real_dot(known, self.entity[heads[0]])
        product = self.entity[heads] * self.relation[relations] * self.entity[tails].conj()
        return product.real.sum(dim=-1)

    def factors(self, relation: int | str) -> tuple[Tensor, Tensor]:  # noqa: D102 - inherited
        left = torch.view_as_real(self.entity * self.relation[self.relation_ids(relation)]).flatten(
            1
        )
        return left, torch.view_as_real(self.entity).flatten(1)

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        left, right = self.factors(relation)
        return left @ right.T

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        dim, rows = tensors["entity_real"].shape[-1], {"entity": size, "relation": len(RELATIONS)}
        check_shapes(
            tensors,
            {f"{what}_{part}": (rows[what], dim) for what in rows for part in ("real", "imag")},
        )

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        parts = {"entity": self.entity, "relation": self.relation}
        return {
            f"{name}_{part}": getattr(parts[name], part)
            for name in parts
            for part in ("real", "imag")
        }


def _grids(heads: Tensor, relations: Tensor, tails: Tensor) -> tuple[bool, bool]:
    by_row = relations.ndim == 0 or (relations.ndim == 2 and relations.shape[1] == 1)
    if not by_row or not heads.ndim == tails.ndim == 2:
        return False, False
    return {heads.shape[1], tails.shape[0]} == {1}, {heads.shape[0], tails.shape[1]} == {1}


def real_dot(queries: Tensor, candidates: Tensor) -> Tensor:
    """Return ``Re<query, conj(candidate)>``, shape (B, N), for complex rows (B, d) and (N, d), by a real product."""
    return (
        torch.view_as_real(queries.resolve_conj()).flatten(1)
        @ torch.view_as_real(candidates.resolve_conj()).flatten(1).T
    )
