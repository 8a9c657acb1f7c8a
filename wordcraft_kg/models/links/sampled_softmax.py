"""The paper's training objective with a softmax over a sample of the entities, for graphs of many.

A softmax over all E entities costs E scores a query. Here each batch draws S entities that all its queries share, and
each drawn one stands for the ``1 / expected draws`` that it represents, so that the sum over the sample is, in
expectation, the sum over all other entities.

Only rows that a batch looks up get a gradient. It is sparse, and Adagrad, which leaves a row without gradient as it
is, does the same as with a dense one.
"""

from typing import Any

import torch
from pykeen.models import ERModel
from pykeen.nn import Embedding
from pykeen.triples import CoreTriplesFactory

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.models.links.symmetric_lcwa import IndexedSymmetricLCWATrainingLoop


def sampled_cross_entropy(
    true: torch.Tensor, sampled: torch.Tensor, log_expected: torch.Tensor, is_true: torch.Tensor
) -> torch.Tensor:
    """Return the mean cross entropy of the true entities against a sample of the others.

    ``mean_b [ log( exp s_b + Σ_j exp(s_bj - log m_j) ) - s_b ]``, the sum over the sampled j that are not the true one.
    If every entity is sampled once and expected once (``m_j = 1``), it is the cross entropy over all entities.

    Args:
        true: scores of the true entities, shape (B,).
        sampled: scores of the sampled entities, shape (B, S).
        log_expected: logarithm of how often each of them is expected in the sample, shape (S,).
        is_true: whether a sampled entity is the true one of the query, shape (B, S), bool.

    Source: Bengio and Senecal 2008, importance sampling; Jean et al. 2015, one sample for many queries.
    """
    others = (sampled - log_expected).masked_fill(is_true, -torch.inf)
    return (torch.logsumexp(torch.cat([true[:, None], others], dim=1), dim=1) - true).mean()


class SampledSymmetricLCWATrainingLoop(IndexedSymmetricLCWATrainingLoop):
    """Both-side softmax cross entropy over a sample of the entities, drawn anew for each batch.

    An entity is drawn with probability ``q_j = (1 / E + c_j / 2 T) / 2``, where c_j counts it among the 2 T heads and
    tails of the triples: half of the sample is uniform, so that every entity is pushed away from where it does not
    belong, and half follows the frequencies, which a model of recipes has to know first.
    """

    def __init__(
        self, model: ERModel, triples_factory: CoreTriplesFactory, *args: Any, num_sampled: int, **kwargs: Any
    ) -> None:
        """Take a model as :class:`IndexedSymmetricLCWATrainingLoop` does, and S, the size of the sample."""
        super().__init__(model, triples_factory, *args, **kwargs)
        self.num_sampled = num_sampled
        (entity,) = model.entity_representations
        if isinstance(entity, Embedding):
            entity._embeddings.sparse = True
        counts = torch.bincount(triples_factory.mapped_triples[:, [0, 2]].flatten(), minlength=entity.max_id)
        self.probabilities = ((1 / entity.max_id + counts / counts.sum()) / 2).to(model.device)

    def _cross_entropies(
        self, h: torch.Tensor, r: torch.Tensor, t: torch.Tensor, triples: torch.Tensor, label_smoothing: float
    ) -> torch.Tensor:
        if label_smoothing:
            raise ConfigError("a sampled softmax has no label smoothing; train with `negatives` 0.")
        (entity,) = self.model.entity_representations
        drawn = torch.multinomial(self.probabilities, self.num_sampled, replacement=True)
        log_expected = torch.log(self.num_sampled * self.probabilities[drawn])
        sample = entity._plain_forward(drawn)[None]
        true = self.model.interaction(h, r, t)[:, 0]
        heads, _, tails = triples.unbind(dim=1)
        return sampled_cross_entropy(
            true, self.model.interaction(h, r, sample), log_expected, drawn == tails[:, None]
        ) + sampled_cross_entropy(true, self.model.interaction(sample, r, t), log_expected, drawn == heads[:, None])
