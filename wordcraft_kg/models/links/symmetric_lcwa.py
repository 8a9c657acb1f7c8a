"""The paper's training objective as a PyKEEN training loop: softmax over all heads plus softmax over all tails.

PyKEEN's ``SymmetricLCWATrainingLoop`` computes the same loss, but looks everything up twice, regularises the candidates
as well as the batch, and builds dense one-hot targets. This one reads the entity table once per batch and uses the
target indices themselves.

PyKEEN's minor version is pinned because we use some of its private parts: two methods overridden and
``_plain_forward`` here, ``_epoch`` and ``_should_stop`` in ``epochs.py`` and ``training.py``, and the pipeline's seed
in ``pykeen_bridge.py``.
"""

from typing import Any

import torch
from pykeen.losses import CrossEntropyLoss
from pykeen.models import ERModel
from pykeen.training import SymmetricLCWATrainingLoop, training_loop_resolver
from pykeen.triples import CoreTriplesFactory
from torch.nn.functional import cross_entropy
from torch.utils.data import BatchSampler, DataLoader, RandomSampler, TensorDataset

from wordcraft_kg.base.errors import ConfigError


class IndexedSymmetricLCWATrainingLoop(SymmetricLCWATrainingLoop):
    """Both-side softmax cross entropy with index targets, for models with one embedding per entity and relation.

    ``loss = mean_b [ -log p(t | h, r) - log p(h | r, t) ] + regularisation(h) + (r) + (t)``, with the softmax over all
    entities and each looked-up factor regularised once.

    Source: Jiang et al. 2020, Eq. 2; Lacroix et al. 2018.
    """

    def __init__(self, model: ERModel, *args: Any, **kwargs: Any) -> None:
        """Check that the model suits this loop, then set it up as PyKEEN does.

        Raises:
            ConfigError: for a loss other than cross entropy, or a model that is not built from single embeddings.
        """
        if not isinstance(model.loss, CrossEntropyLoss):
            raise ConfigError(
                f"this loop computes a cross entropy; the model has {type(model.loss).__name__}. "
                'PyKEEN\'s pipeline gives every model its own default loss; pass loss="crossentropy".'
            )
        if not isinstance(model, ERModel) or any(
            len(parts) != 1 for parts in (model.entity_representations, model.relation_representations)
        ):
            raise ConfigError(
                f"{type(model).__name__} has no single embedding per entity; train it with 'SymmetricLCWA'."
            )
        super().__init__(model, *args, **kwargs)

    def _create_training_data_loader(
        self, triples_factory: CoreTriplesFactory, sampler: str | None, **kwargs: Any
    ) -> DataLoader:
        # A sampler of whole batches: one indexing operation per batch instead of one per triple.
        data = TensorDataset(triples_factory.mapped_triples)
        batches = BatchSampler(RandomSampler(data), kwargs["batch_size"], kwargs["drop_last"])
        return DataLoader(data, sampler=batches, batch_size=None, pin_memory=self.model.device.type == "cuda")

    def _process_batch(
        self,
        batch: tuple[torch.Tensor],
        start: int,
        stop: int,
        label_smoothing: float = 0.0,
        slice_size: int | None = None,
    ) -> torch.Tensor:
        triples = batch[0][start:stop].to(self.model.device)
        heads, relations, tails = triples.unbind(dim=1)
        (entity,) = self.model.entity_representations
        (relation,) = self.model.relation_representations
        h, r, t = (x.unsqueeze(dim=1) for x in (entity(heads), relation(relations), entity(tails)))
        loss = self._cross_entropies(h, r, t, triples, label_smoothing)
        return loss + self.model.collect_regularization_term()

    def _cross_entropies(
        self, h: torch.Tensor, r: torch.Tensor, t: torch.Tensor, triples: torch.Tensor, label_smoothing: float
    ) -> torch.Tensor:
        """Return the sum of both sides' cross entropies, of factors of shape (B, 1, d) and the triples (B, 3)."""
        (entity,) = self.model.entity_representations
        # The public call regularises what it looks up; the candidates must not be regularised, hence the private call.
        everything = entity._plain_forward().unsqueeze(dim=0)
        heads, _, tails = triples.unbind(dim=1)
        return cross_entropy(
            self.model.interaction(h, r, everything), tails, label_smoothing=label_smoothing
        ) + cross_entropy(self.model.interaction(everything, r, t), heads, label_smoothing=label_smoothing)


training_loop_resolver.register(IndexedSymmetricLCWATrainingLoop, raise_on_conflict=False)
