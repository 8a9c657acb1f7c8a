"""The paper's training objective as PyKEEN training loops: a softmax over heads and over tails.

PyKEEN's ``SymmetricLCWATrainingLoop`` computes the same loss, but looks up all factors twice,
regularises the candidates as well as the batch, and builds dense one-hot targets. The first loop
reads the entity table once per batch and uses target indices. For many entities the second loop
samples S entities per batch in place of all entities; the gradients are sparse, which Adagrad
treats like dense gradients.

PyKEEN's minor version is pinned because private parts are used: two methods overridden and
``_plain_forward`` here, ``_epoch`` and ``_should_stop`` in ``fitting.py`` and ``link_training.py``.

Shapes: B triples in a batch, E entities, S sampled entities, d complex dimensions.

The page docs/evidence/links.md#complex measures the objective.
"""

from collections.abc import Iterator
from typing import Any

import torch
from pykeen.models import ERModel
from pykeen.training import SymmetricLCWATrainingLoop
from pykeen.triples import CoreTriplesFactory
from torch.nn.functional import cross_entropy
from torch.utils.data import BatchSampler, DataLoader, RandomSampler, TensorDataset

from wordcraft_kg.graphs.triples import RELATIONS


class IndexedSymmetricLCWATrainingLoop(SymmetricLCWATrainingLoop):
    """PyKEEN training loop: softmax cross entropy for heads and for tails, with target indices.

    The loop is for models with a single embedding per entity and per relation:

    ``loss = mean_b [ -log p(t | h, r) - log p(h | r, t) ] + regularisation(h) + (r) + (t)``, with
    the softmax over all entities and each looked-up factor regularised once.

    In joint training on a recipe graph and outside triples, ``num_own`` counts the graph's
    entities, which have the first ids. The softmax for a triple of the graph is over these entities
    alone, as without outside triples; for an outside triple it is over all nodes. The loss of an
    outside triple, with its regularisation, is multiplied by ``outside_weight``.

    Source: Jiang et al. 2020, Eq. 2; Lacroix et al. 2018.
    """

    def __init__(
        self,
        model: ERModel,
        *args: Any,
        num_own: int | None = None,
        outside_weight: float = 1.0,
        **kwargs: Any,
    ) -> None:
        """Set up the loop as PyKEEN does.

        Args:
            model: a model with one embedding per entity and per relation.
            args: as in PyKEEN's loop.
            num_own: number of the graph's entities in joint training; None without outside triples.
            outside_weight: factor of an outside triple's loss.
            kwargs: as in PyKEEN's loop.
        """
        super().__init__(model, *args, **kwargs)
        self.num_own = num_own
        self.outside_weight = outside_weight

    def _create_training_data_loader(
        self, triples_factory: CoreTriplesFactory, sampler: str | None, **kwargs: Any
    ) -> DataLoader[Any]:
        # A sampler of whole batches: one indexing operation per batch instead of one per triple.
        data = TensorDataset(triples_factory.mapped_triples)
        batches = BatchSampler(RandomSampler(data), kwargs["batch_size"], kwargs["drop_last"])
        return DataLoader(
            data, sampler=batches, batch_size=None, pin_memory=self.model.device.type == "cuda"
        )

    def _process_batch(
        self,
        batch: tuple[torch.Tensor],
        start: int,
        stop: int,
        **settings: Any,
    ) -> torch.Tensor:
        triples = batch[0][start:stop].to(self.model.device)
        if self.num_own is None:
            return self._loss(triples, None)
        # The graph's triples compete with its entities alone, outside triples with all nodes. Each
        # part's mean counts by its share of the batch, so a triple weighs the same in any batch.
        is_own = _is_own(triples)
        parts = (
            (triples[is_own], self.num_own, 1.0),
            (triples[~is_own], None, self.outside_weight),
        )
        losses = []
        for part, num_candidates, weight in parts:
            if len(part):
                loss = self._loss(part, num_candidates)
                losses.append(weight * len(part) / len(triples) * loss)
        return torch.stack(losses).sum()

    def _loss(self, triples: torch.Tensor, num_candidates: int | None) -> torch.Tensor:
        # In this order: the lookups within the entropies fill the regularisation term, and
        # collecting the term empties it.
        loss = self._entropies(triples, num_candidates)
        return loss + self.model.collect_regularization_term()

    def _vectors(self, triples: torch.Tensor) -> Iterator[torch.Tensor]:
        """Yield the embeddings of heads, relations and tails, shape (B, 1, d) each."""
        (entity,) = self.model.entity_representations
        (relation,) = self.model.relation_representations
        for representation, ids in zip((entity, relation, entity), triples.T, strict=True):
            yield representation(ids).unsqueeze(dim=1)

    def _entropies(self, triples: torch.Tensor, num_candidates: int | None) -> torch.Tensor:
        """Return the cross entropies of tails and of heads among the first ``num_candidates``."""
        (entity,) = self.model.entity_representations
        h, r, t = self._vectors(triples)
        # The public call would regularise the candidates, hence the private call. The candidates
        # have shape (1, E, d), for which the interaction costs one matrix product.
        everything = entity._plain_forward()[:num_candidates].unsqueeze(dim=0)
        heads, _, tails = triples.unbind(dim=1)
        tail_scores = self.model.interaction(h, r, everything)
        tail_entropy = cross_entropy(tail_scores, tails)
        head_scores = self.model.interaction(everything, r, t)
        head_entropy = cross_entropy(head_scores, heads)
        return tail_entropy + head_entropy


def _is_own(triples: torch.Tensor) -> torch.Tensor:
    """Return which triples (B, 3) are of the recipe graph: its relations have the first ids."""
    return triples[:, 1] < len(RELATIONS)


def sampled_cross_entropy(
    true: torch.Tensor, sampled: torch.Tensor, log_expected: torch.Tensor, is_true: torch.Tensor
) -> torch.Tensor:
    """Return the mean cross entropy over B queries, with a softmax over a sample of entities.

    ``mean_b [ log( exp s_b + Σ_j exp(s_bj - log m_j) ) - s_b ]``, summed over all sampled j except
    the true entity. If every entity is sampled once and expected once (``m_j = 1``), the result is
    the cross entropy over all entities.

    Args:
        true: scores of the true entities, shape (B,).
        sampled: scores of the S sampled entities, shape (B, S).
        log_expected: log of each sampled entity's expected count in the sample, shape (S,).
        is_true: shape (B, S), bool: whether a sampled entity is the query's true entity.

    Returns:
        shape (), in nats.

    Source: Bengio and Senecal 2008, importance sampling; Jean et al. 2015, one sample for many
    queries.
    """
    # The true entity is in the softmax already, so its copies in the sample do not count.
    negatives = (sampled - log_expected).masked_fill(is_true, -torch.inf)
    together = torch.cat([true[:, None], negatives], dim=1)
    return (torch.logsumexp(together, dim=1) - true).mean()


class SampledSymmetricLCWATrainingLoop(IndexedSymmetricLCWATrainingLoop):
    """PyKEEN training loop: cross entropies over entities sampled for each batch.

    Entity j is drawn with probability ``q_j = (1 / E + c_j / 2 T) / 2``, where c_j counts j among
    the 2 T heads and tails: the uniform half gives every entity negative examples, and the other
    half follows the frequencies, which a recipe model has to learn first.
    """

    def __init__(
        self,
        model: ERModel,
        triples_factory: CoreTriplesFactory,
        *args: Any,
        num_sampled: int,
        **kwargs: Any,
    ) -> None:
        """Set up the loop, and the probabilities of entities in the sample.

        Args:
            model: a model with one embedding per entity and per relation.
            triples_factory: training triples.
            args: as in PyKEEN's loop.
            num_sampled: number S of entities sampled for each batch, with replacement.
            kwargs: as in :class:`IndexedSymmetricLCWATrainingLoop`.
        """
        super().__init__(model, triples_factory, *args, **kwargs)
        self.num_sampled = num_sampled
        (entity,) = model.entity_representations
        # A batch changes few of the entities, so dense gradients would be mostly zeros.
        entity._embeddings.sparse = True
        triples = triples_factory.mapped_triples
        if self.num_own is None:
            self.probabilities = self._probabilities(triples, entity.max_id)
        else:
            is_own = _is_own(triples)
            self.probabilities = self._probabilities(triples[is_own], self.num_own)
            self.outside_probabilities = self._probabilities(triples[~is_own], entity.max_id)

    def _probabilities(self, triples: torch.Tensor, size: int) -> torch.Tensor:
        """Return the probability of each entity in a draw, shape (size,)."""
        counts = torch.bincount(triples[:, [0, 2]].flatten(), minlength=size)
        return ((1 / size + counts / counts.sum()) / 2).to(self.model.device)

    def _entropies(self, triples: torch.Tensor, num_candidates: int | None) -> torch.Tensor:
        (entity,) = self.model.entity_representations
        h, r, t = self._vectors(triples)
        is_own = num_candidates == self.num_own
        probabilities = self.probabilities if is_own else self.outside_probabilities
        # One sample for all queries of the batch, so their scores are one matrix product.
        sampled_ids = torch.multinomial(probabilities, self.num_sampled, replacement=True)
        log_expected = torch.log(self.num_sampled * probabilities[sampled_ids])
        sample = entity._plain_forward(sampled_ids)[None]
        true = self.model.interaction(h, r, t)[:, 0]
        heads, _, tails = triples.unbind(dim=1)
        tail_scores = self.model.interaction(h, r, sample)
        is_tail = sampled_ids == tails[:, None]
        tail_entropy = sampled_cross_entropy(true, tail_scores, log_expected, is_tail)
        head_scores = self.model.interaction(sample, r, t)
        is_head = sampled_ids == heads[:, None]
        head_entropy = sampled_cross_entropy(true, head_scores, log_expected, is_head)
        return tail_entropy + head_entropy
