"""Records that a model folder holds beside the weights."""

from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.records import Record


class TraceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A line of ``trace.jsonl``: the figures of an epoch.

    Attributes:
        epoch: from 1.
        loss: mean loss over its batches.
        valid_mrr: MRR of the validation triples, if they were ranked after it.
        seconds: time that it took, including the ranking.
    """

    epoch: int
    loss: float
    valid_mrr: float | None = None
    seconds: float


class LinkMetrics(Record, frozen=True, kw_only=True):
    """``metrics.json``: the figures of a training.

    Attributes:
        kg: knowledge graph that it was trained on: partial or full.
        triples: number of training triples.
        epochs: number of epochs done.
        best_epoch: best epoch by validation MRR, None if nothing was validated.
        seconds: time of all epochs.
        seconds_per_epoch: their mean.
        parameters: number of parameters of the model.
        loss: loss of the last epoch.
        valid_mrr: validation MRR of the best epoch.
        train_mrr: MRR of the training triples, filtered by themselves: how well the model remembers, not how well it
            predicts.
        train_mrr_triples: number of triples that ``train_mrr`` is taken over.
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
    """Progress of a link predictor's training, as a checkpoint records it beside its tensors."""

    seconds: float
    best_mrr: float | None
    best_epoch: int | None
    has_stopped: bool
    trace: tuple[TraceRow, ...]
