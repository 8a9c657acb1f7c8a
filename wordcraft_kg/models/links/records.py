"""What a model folder keeps beside the weights."""

from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.records import Record


class TraceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A line of ``trace.jsonl``: what an epoch came to.

    Attributes:
        epoch: from 1.
        loss: mean over its batches.
        valid_mrr: of the validation triples, if they were ranked after it.
        seconds: that it took, with the ranking.
    """

    epoch: int
    loss: float
    valid_mrr: float | None = None
    seconds: float


class LinkMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: what a training came to.

    Attributes:
        kg: trained on: partial or full.
        triples: trained on.
        epochs: done.
        best_epoch: by validation MRR, None if nothing was validated.
        seconds: of all epochs.
        seconds_per_epoch: their mean.
        parameters: of the model.
        loss: of the last epoch.
        valid_mrr: of the best epoch.
        train_mrr: filtered by the training triples themselves: how well the model remembers, not how well it predicts.
        train_mrr_triples: that it was taken over.
    """

    kg: KG
    triples: int
    epochs: int
    best_epoch: int | None
    seconds: float
    seconds_per_epoch: float
    parameters: int
    loss: float
    valid_mrr: float | None
    train_mrr: float
    train_mrr_triples: int


class LinkProgress(Record, frozen=True, kw_only=True):
    """What a checkpoint of a link predictor's training notes beside its tensors."""

    seconds: float
    best_mrr: float | None
    best_epoch: int | None
    has_stopped: bool
    trace: tuple[TraceRow, ...]
