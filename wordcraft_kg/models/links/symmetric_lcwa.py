"""The paper's training objective as PyKEEN training loops: softmax over all heads plus softmax over all tails.

PyKEEN's ``SymmetricLCWATrainingLoop`` computes the same loss, but looks up all factors twice, regularises the
candidates as well as the batch, and builds dense one-hot targets. The first loop reads the entity table once per batch
and uses target indices. For many entities the second loop samples S entities per batch in place of all entities; the
gradients are sparse, which Adagrad treats like dense gradients.

PyKEEN's minor version is pinned because private parts are used: two methods overridden and ``_plain_forward`` here,
``_epoch`` and ``_should_stop`` in ``fitting.py`` and ``training.py``.
"""

from collections.abc import Iterator
from typing import Any

import torch
from pykeen.losses import CrossEntropyLoss
from pykeen.models import ERModel
from pykeen.nn import Embedding
from pykeen.training import SymmetricLCWATrainingLoop, training_loop_resolver
from pykeen.triples import CoreTriplesFactory
from torch.nn.functional import cross_entropy
from torch.utils.data import BatchSampler, DataLoader, RandomSampler, TensorDataset

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.triples import RELATIONS


class IndexedSymmetricLCWATrainingLoop(SymmetricLCWATrainingLoop):
    """PyKEEN training loop: softmax cross entropy for heads and for tails, with target indices.

    The loop is for models with a single embedding per entity and per relation:

    ``loss = mean_b [ -log p(t | h, r) - log p(h | r, t) ] + regularisation(h) + (r) + (t)``, with the softmax over all
    entities and each looked-up factor regularised once.

    In joint training on a recipe graph and outside triples, ``num_own`` counts the graph's entities, which have the
    first ids. The softmax for a triple of the graph is over these entities alone, as without outside triples; for an
    outside triple it is over all nodes. The loss of an outside triple, with its regularisation, is multiplied by
    ``outside_weight``.

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
        if not isinstance(model.loss, CrossEntropyLoss):
            raise ConfigError(
                f"this loop computes a cross entropy; the model has {type(model.loss).__name__}. "
                'PyKEEN\'s pipeline gives every model its own default loss; pass loss="crossentropy".'
            )
        if not isinstance(model, ERModel) or any(
            len(parts) != 1
            for parts in (model.entity_representations, model.relation_representations)
        ):
            raise ConfigError(
                f"{type(model).__name__} has no single embedding per entity; train with 'SymmetricLCWA'."
            )
        super().__init__(model, *args, **kwargs)
        self.num_own, self.outside_weight = num_own, outside_weight

    def _create_training_data_loader(
        self, triples_factory: CoreTriplesFactory, sampler: str | None, **kwargs: Any
    ) -> DataLoader:
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
        label_smoothing: float = 0.0,
        slice_size: int | None = None,
    ) -> torch.Tensor:
        triples = batch[0][start:stop].to(self.model.device)
        if self.num_own is None:
            return self._loss(triples, label_smoothing, None)
        is_own = _is_own(triples)
        parts = (triples[is_own], 1.0, self.num_own), (triples[~is_own], self.outside_weight, None)
        losses = [
            weight * len(rows) / len(triples) * self._loss(rows, label_smoothing, candidates)
            for rows, weight, candidates in parts
            if len(rows)
        ]
        return torch.stack(losses).sum()

    def _loss(
        self, triples: torch.Tensor, label_smoothing: float, num_candidates: int | None
    ) -> torch.Tensor:
        loss = self._entropies(triples, label_smoothing, num_candidates)
        return loss + self.model.collect_regularization_term()

    def _vectors(self, triples: torch.Tensor) -> Iterator[torch.Tensor]:
        (entity,), (relation,) = (
            self.model.entity_representations,
            self.model.relation_representations,
        )
        return (
            of(ids).unsqueeze(dim=1)
            for of, ids in zip((entity, relation, entity), triples.T, strict=True)
        )

    def _entropies(
        self, triples: torch.Tensor, label_smoothing: float, num_candidates: int | None
    ) -> torch.Tensor:
        (entity,) = self.model.entity_representations
        h, r, t = self._vectors(triples)
        # The public call would regularise the candidates, hence the private call.
        everything = entity._plain_forward()[:num_candidates].unsqueeze(dim=0)
        heads, _, tails = triples.unbind(dim=1)
        return cross_entropy(
            self.model.interaction(h, r, everything), tails, label_smoothing=label_smoothing
        ) + cross_entropy(
            self.model.interaction(everything, r, t), heads, label_smoothing=label_smoothing
        )


def _is_own(triples: torch.Tensor) -> torch.Tensor:
    return triples[:, 1] < len(RELATIONS)


training_loop_resolver.register(IndexedSymmetricLCWATrainingLoop, raise_on_conflict=False)


def sampled_cross_entropy(
    true: torch.Tensor, sampled: torch.Tensor, log_expected: torch.Tensor, is_true: torch.Tensor
) -> torch.Tensor:
    """Return the mean cross entropy over B queries, with a softmax over the true entity and S sampled entities.

    ``mean_b [ log( exp s_b + Σ_j exp(s_bj - log m_j) ) - s_b ]``, summed over all sampled j except the true entity. If
    every entity is sampled once and expected once (``m_j = 1``), the result is the cross entropy over all entities.

    ``true`` and ``sampled`` are the entities' scores, shapes (B,) and (B, S); ``log_expected``, shape (S,), is the log
    of each sampled entity's expected count in the sample; ``is_true``, shape (B, S), marks the true entity in the
    sample.

    Source: Bengio and Senecal 2008, importance sampling; Jean et al. 2015, one sample for many queries.
    """
    others = (sampled - log_expected).masked_fill(is_true, -torch.inf)
    return (torch.logsumexp(torch.cat([true[:, None], others], dim=1), dim=1) - true).mean()


class SampledSymmetricLCWATrainingLoop(IndexedSymmetricLCWATrainingLoop):
    """PyKEEN training loop: softmax cross entropy for heads and for tails over entities sampled for each batch.

    Entity j is drawn with probability ``q_j = (1 / E + c_j / 2 T) / 2``, where c_j counts j among the 2 T heads and
    tails: the uniform half gives every entity negative examples, and the other half follows the frequencies, which a
    recipe model has to learn first.
    """

    def __init__(
        self,
        model: ERModel,
        triples_factory: CoreTriplesFactory,
        *args: Any,
        num_sampled: int,
        **kwargs: Any,
    ) -> None:
        super().__init__(model, triples_factory, *args, **kwargs)
        self.num_sampled = num_sampled
        (entity,) = model.entity_representations
        if isinstance(entity, Embedding):
            entity._embeddings.sparse = True
        triples, size = triples_factory.mapped_triples, self.num_own or entity.max_id
        self.probabilities = self._probabilities(
            triples[_is_own(triples)] if self.num_own else triples, size
        )
        if self.num_own:
            self.outside_probabilities = self._probabilities(
                triples[~_is_own(triples)], entity.max_id
            )

    def _probabilities(self, triples: torch.Tensor, size: int) -> torch.Tensor:
        counts = torch.bincount(triples[:, [0, 2]].flatten(), minlength=size)
        return ((1 / size + counts / counts.sum()) / 2).to(self.model.device)

    def _entropies(
        self, triples: torch.Tensor, label_smoothing: float, num_candidates: int | None
    ) -> torch.Tensor:
        if label_smoothing:
            raise ConfigError("a sampled softmax has no label smoothing; train with `negatives` 0.")
        (entity,) = self.model.entity_representations
        h, r, t = self._vectors(triples)
        is_own = num_candidates == self.num_own
        probabilities = self.probabilities if is_own else self.outside_probabilities
        drawn = torch.multinomial(probabilities, self.num_sampled, replacement=True)
        log_expected = torch.log(self.num_sampled * probabilities[drawn])
        sample = entity._plain_forward(drawn)[None]
        true = self.model.interaction(h, r, t)[:, 0]
        heads, _, tails = triples.unbind(dim=1)
        return sampled_cross_entropy(
            true, self.model.interaction(h, r, sample), log_expected, drawn == tails[:, None]
        ) + sampled_cross_entropy(
            true, self.model.interaction(sample, r, t), log_expected, drawn == heads[:, None]
        )
