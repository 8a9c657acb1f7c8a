"""Scorers: what a trained link predictor, a set of facts or plain counting says about a triple.

All follow :class:`wordcraft_kg.graphs.protocols.TripleScorer`. A scorer loads from a model folder in milliseconds and
without PyKEEN. A new scorer is a subclass of :class:`Scorer` with one method, ``_score``.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError

from wordcraft_kg.errors import ArtefactError, GraphMismatchError, UnknownEntityError, nearest
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMPONENT_OF, RELATIONS
from wordcraft_kg.runs import read_finished_run, verified_bytes

TABLE_LIMIT = 2**28
"""Bytes. Up to this size all scores are computed once and looked up; above it they come from the embeddings."""

EntityIds = int | str | Sequence[int] | Sequence[str] | np.ndarray | torch.Tensor
RelationIds = int | str | torch.Tensor


class Scorer(ABC):
    """Vocabulary and id handling shared by all scorers.

    Attributes:
        entities: labels in id order.
        graph_hash: content hash of the graph that the ids belong to.
        device: where scores are computed and returned.
        name: what reports call the scorer.
    """

    def __init__(self, entities: Sequence[str], graph_hash: str, device: str | torch.device = "cpu", name: str = ""):
        """Keep the vocabulary; subclasses keep what they score with."""
        self.entities = tuple(entities)
        self.graph_hash = graph_hash
        self.device = torch.device(device)
        self.name = name or type(self).__name__
        self._index = {label: i for i, label in enumerate(self.entities)}

    @abstractmethod
    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        """Score broadcastable int64 ids that are in range; return float32 of the broadcast shape."""

    def score(self, heads: EntityIds, relations: RelationIds, tails: EntityIds) -> torch.Tensor:
        """Score triples given by ids or labels.

        Args:
            heads: one entity, a sequence, or a tensor of ids of any shape.
            relations: one relation, or a tensor of ids.
            tails: like ``heads``; the three broadcast against each other.

        Returns:
            float32, of the broadcast shape.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        return self._score(self.entity_ids(heads), self.relation_ids(relations), self.entity_ids(tails))

    def table(self, relation: int | str) -> torch.Tensor:
        """Return the scores of all pairs, shape (E, E), row = head, column = tail."""
        everything = torch.arange(len(self.entities), device=self.device)
        return self._score(everything[:, None], self.relation_ids(relation), everything[None, :])

    def entity_ids(self, entities: EntityIds) -> torch.Tensor:
        """Return entities as a tensor of ids on the scorer's device.

        Raises:
            UnknownEntityError: with the nearest labels, or the range of ids.
        """
        if not isinstance(entities, torch.Tensor):
            values = np.asarray(entities)
            if values.dtype.kind == "U":
                unknown = [str(label) for label in values.flat if str(label) not in self._index]
                if unknown:
                    hint = nearest(unknown[0], self.entities)
                    raise UnknownEntityError(f"no entity '{unknown[0]}' in {self.name}.{hint}")
                values = np.array([self._index[str(label)] for label in values.flat]).reshape(values.shape)
            entities = torch.tensor(values if values.size else values.astype(np.int64))
        if entities.is_floating_point() or entities.is_complex():
            raise UnknownEntityError(f"entities are labels or integer ids; found numbers of type {entities.dtype}.")
        ids = entities.to(self.device, torch.int64)
        _check_range(ids, len(self.entities), "entity")
        return ids

    def relation_ids(self, relations: RelationIds) -> torch.Tensor:
        """Return relations as a tensor of ids on the scorer's device.

        Raises:
            UnknownEntityError: naming the relations there are.
        """
        if isinstance(relations, str):
            if relations not in RELATIONS:
                hint = nearest(relations, RELATIONS)
                raise UnknownEntityError(f"no relation '{relations}'; there are {', '.join(RELATIONS)}.{hint}")
            relations = RELATIONS.index(relations)
        ids = torch.as_tensor(relations, dtype=torch.int64, device=self.device)
        _check_range(ids, len(RELATIONS), "relation")
        return ids

    def top(
        self, head: EntityIds | None, relation: RelationIds, tail: EntityIds | None, limit: int | None = 10
    ) -> list[tuple[str, float]]:
        """Return the best entities for the one open slot (None), best first, with their scores; None returns all."""
        if (head is None) == (tail is None):
            raise ValueError("exactly one of head and tail must be None.")
        everything = torch.arange(len(self.entities), device=self.device)
        scores = self.score(everything if head is None else head, relation, everything if tail is None else tail)
        order = torch.sort(scores, descending=True, stable=True).indices[:limit]
        return [(self.entities[i], float(scores[i])) for i in order.tolist()]

    def check_graph(self, graph: RecipeGraph) -> None:
        """Make sure that the scorer's ids are this graph's.

        Raises:
            GraphMismatchError: if they belong to another graph.
        """
        if graph.hash != self.graph_hash:
            raise GraphMismatchError(
                f"{self.name} was trained on graph {self.graph_hash[:12]} ({len(self.entities)} entities) but "
                f"'{graph.name}' is {graph.hash[:12]} ({graph.num_entities}). Train it on this graph, or use the graph "
                "that it was trained on."
            )


def _check_range(ids: torch.Tensor, size: int, what: str) -> None:
    if ids.numel() and not 0 <= int(ids.min()) <= int(ids.max()) < size:
        raise UnknownEntityError(f"{what} ids must be 0 .. {size - 1}; found {int(ids.min())} .. {int(ids.max())}.")


class TableScorer(Scorer):
    """Looks scores up in a table of all triples, shape (R, E, E): any link predictor, once it has scored them."""

    def __init__(self, scores: torch.Tensor, entities: Sequence[str], graph_hash: str, **kwargs: Any):
        """Keep ``scores``, shape (R, E, E), float, indexed by relation, head, tail."""
        super().__init__(entities, graph_hash, **kwargs)
        self.scores = scores.to(self.device, torch.float32)

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        size = len(self.entities)
        return self.scores.view(-1)[(relations * size + heads) * size + tails]

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        return self.scores[self.relation_ids(relation)]


class ComplExScorer(Scorer):
    """Computes ComplEx scores from the embeddings, for graphs whose score table would be too large.

    Source: Trouillon et al. 2016; Jiang et al. 2020, Eq. 1.
    """

    def __init__(self, embeddings: dict[str, torch.Tensor], entities: Sequence[str], graph_hash: str, **kwargs: Any):
        """Keep embeddings ``entity_real``, ``entity_imag`` (E, d), ``relation_real``, ``relation_imag`` (R, d)."""
        super().__init__(entities, graph_hash, **kwargs)
        tensors = {name: tensor.to(self.device, torch.float32) for name, tensor in embeddings.items()}
        self.entity = torch.complex(tensors["entity_real"], tensors["entity_imag"])
        self.relation = torch.complex(tensors["relation_real"], tensors["relation_imag"])

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        # All tails of some heads, or all heads of some tails, are one product of matrices.
        by_row = relations.ndim == 0 or (relations.ndim == 2 and relations.shape[1] == 1)
        if by_row and tails.ndim == 2 and tails.shape[0] == 1 and heads.ndim == 2 and heads.shape[1] == 1:
            return real_dot(self.entity[heads[:, 0]] * self.relation[relations.reshape(-1)], self.entity[tails[0]])
        if by_row and heads.ndim == 2 and heads.shape[0] == 1 and tails.ndim == 2 and tails.shape[1] == 1:
            known = self.relation[relations.reshape(-1)].conj() * self.entity[tails[:, 0]]
            return real_dot(known, self.entity[heads[0]])
        product = self.entity[heads] * self.relation[relations] * self.entity[tails].conj()
        return product.real.sum(dim=-1)

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        left = torch.view_as_real(self.entity * self.relation[self.relation_ids(relation)]).flatten(1)
        return left @ torch.view_as_real(self.entity).flatten(1).T

    def to_table(self) -> TableScorer:
        """Score everything once."""
        scores = torch.stack([self.table(relation) for relation in range(len(RELATIONS))])
        return TableScorer(scores, self.entities, self.graph_hash, device=self.device, name=self.name)


def real_dot(queries: torch.Tensor, candidates: torch.Tensor) -> torch.Tensor:
    """Return ``Re<query, conj(candidate)>`` of (B, d) and (N, d) complex rows, shape (B, N), by one real product."""
    return (
        torch.view_as_real(queries.resolve_conj()).flatten(1)
        @ torch.view_as_real(candidates.resolve_conj()).flatten(1).T
    )


class SymbolicScorer(Scorer):
    """Scores 1 for the triples of a set and 0 for all others: a knowledge graph that knows its facts and no more."""

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        """Keep the triples, shape (T, 3), ids of ``graph``."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        self._keys = torch.unique(self._key(*torch.tensor(triples, dtype=torch.int64, device=self.device).T))

    def _key(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        return (relations * len(self.entities) + heads) * len(self.entities) + tails

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        return torch.isin(self._key(heads, relations, tails), self._keys).float()


class FrequencyScorer(Scorer):
    """Scores a triple by how often its head and its tail stand there in known triples of the relation.

    With one slot open, this ranks the candidates by their training frequency in that slot: the baseline that a link
    predictor has to beat.
    """

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, **kwargs: Any):
        """Count heads and tails of the triples, shape (T, 3), ids of ``graph``."""
        super().__init__(graph.entities, graph.hash, **kwargs)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64, device=self.device).T
        size = len(RELATIONS) * len(self.entities)
        shape = (len(RELATIONS), len(self.entities))
        self._as_head = torch.bincount(relations * shape[1] + heads, minlength=size).view(shape).float()
        self._as_tail = torch.bincount(relations * shape[1] + tails, minlength=size).view(shape).float()

    def _score(self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor) -> torch.Tensor:
        return self._as_head[relations, heads] + self._as_tail[relations, tails]


class NeighbourScorer(TableScorer):
    """Scores a triple by how strongly entities like its head are linked to its tail, its head to those like that.

    Nothing is learned. With ``A_r`` the known links of relation r, ``score_r = S A_r + A_r S``, where ``S`` is the
    cosine of the rows of ``[A_combinesWith, A_componentOf, A_componentOf transposed]``: entities are alike as far as
    they share neighbours. A neighbour that n entities have weighs 1 / n, and no entity is like itself. The weight was
    chosen among powers of n on validation parts: ``benchmarks/link_quality.py neighbours``.

    Everything is dense, (E, 3 E), so this is for graphs of some thousand entities.

    Source: neighbourhood-based link prediction (Adamic and Adar 2003; Sarwar et al. 2001), here on two relations.
    """

    def __init__(self, graph: RecipeGraph, triples: np.ndarray, *, power: float = 1.0, **kwargs: Any):
        """Score all triples from the known ones, shape (T, 3); a neighbour of n entities weighs ``n ** -power``."""
        size = graph.num_entities
        links = torch.zeros(len(RELATIONS), size, size)
        heads, relations, tails = torch.tensor(triples, dtype=torch.int64).T
        links[relations, heads, tails] = 1
        profiles = torch.cat([*links, links[COMPONENT_OF].T], dim=1)
        weighted = profiles * profiles.sum(0).clamp(min=1) ** (-power / 2)
        unit = torch.nn.functional.normalize(weighted, dim=1)
        alike = (unit @ unit.T).fill_diagonal_(0)
        super().__init__(alike @ links + links @ alike, graph.entities, graph.hash, **kwargs)


def load_scorer(folder: str | Path, *, graph: RecipeGraph | None = None, device: str = "cpu") -> Scorer:
    """Load the scorer of a model folder.

    Args:
        folder: written by ``train-complex`` or ``train-links``.
        graph: if given, the scorer must belong to it.
        device: where to score.

    Raises:
        ArtefactError: if the folder is unfinished or incomplete, or a file in it was damaged.
        GraphMismatchError: if it belongs to another graph.
    """
    folder = Path(folder)
    run = read_finished_run(folder, "wordcraft-kg train-complex")
    tensors = read_tensors(folder / "model.safetensors", verified_bytes(folder, run, "model.safetensors"))
    try:
        vocabulary = json.loads(verified_bytes(folder, run, "vocabulary.json"))
        kind, entities, graph_hash = vocabulary["scorer"], vocabulary["entities"], vocabulary["graph"]
        scorer = make_scorer(kind, tensors, entities, graph_hash, device=device, name=folder.name)
    except ArtefactError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{folder} does not hold a scorer ({error!r}). Train it again.") from None
    if graph is not None:
        scorer.check_graph(graph)
    return scorer


def make_scorer(
    kind: str, tensors: dict[str, torch.Tensor], entities: Sequence[str], graph_hash: str, **settings: Any
) -> Scorer:
    """Make a scorer from the tensors of a trained model: a table where it fits :data:`TABLE_LIMIT`.

    Args:
        kind: ``complex`` (embeddings) or ``table`` (scores), as in ``vocabulary.json``.
        tensors: what that kind needs.
        entities: labels in id order.
        graph_hash: of the graph that the ids belong to.
        settings: ``device`` and ``name``.

    Raises:
        ValueError: for another kind.
    """
    if kind not in ("complex", "table"):
        raise ValueError(f"no kind of scorer '{kind}'")
    if kind == "table":
        return TableScorer(tensors["scores"], entities, graph_hash, **settings)
    scorer = ComplExScorer(tensors, entities, graph_hash, **settings)
    return scorer.to_table() if len(RELATIONS) * len(entities) ** 2 * 4 <= TABLE_LIMIT else scorer


def read_tensors(path: Path, data: bytes) -> dict[str, torch.Tensor]:
    """Parse safetensors bytes.

    Raises:
        ArtefactError: if they are not whole.
    """
    try:
        return safetensors.torch.load(data)
    except (SafetensorError, ValueError) as error:
        raise ArtefactError(f"{path} is damaged ({error}). Train the model again, or restore a copy.") from None
