"""Records that a model folder holds beside the weights."""

from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.models.links.config import LinksConfig
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.runs.files import RunFiles


class TraceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A line of ``trace.jsonl``: the figures of an epoch.

    Attributes:
        epoch: number from 1.
        loss: mean loss over the batches.
        valid_mrr: MRR of the validation triples, if ranked.
        seconds: duration, including the ranking.
    """

    epoch: int
    loss: float
    valid_mrr: float | None = None
    seconds: float


class Candidate(Record, frozen=True, kw_only=True):
    """A regularisation, and its MRR on held-out train recipes."""

    n3: float
    popularity: float
    mrr: Share


class Choice(Record, frozen=True, kw_only=True):
    """``choice.json``: the choice of regularisation on held-out train recipes.

    Attributes:
        n3: chosen weight of the N3 regulariser.
        popularity: chosen weight of the counts.
        mrr: MRR of the held-out triples with these weights.
        frequency_mrr: MRR of the same triples by counting alone.
        candidates: all candidates.
        folds: number of draws of held-out recipes.
        epochs: epochs of each training.
        queries: number of held-out queries over all folds.
    """

    n3: float
    popularity: float
    mrr: Share
    frequency_mrr: Share
    candidates: tuple[Candidate, ...]
    folds: Count
    epochs: Count
    queries: Count

    @property
    def beats_counting(self) -> bool:
        """Whether any candidate beats counting."""
        return max(candidate.mrr for candidate in self.candidates) > self.frequency_mrr

    def __str__(self) -> str:
        """Return the choice and its figures in a line."""
        without = max(candidate.mrr for candidate in self.candidates if not candidate.popularity)
        return (
            f"n3 {self.n3:g}, popularity {self.popularity:g}: MRR {self.mrr:.3f} on {self.queries:,} queries of train "
            f"recipes held out {counted(self.folds, 'time')} (counting alone {self.frequency_mrr:.3f}, without "
            f"popularity {without:.3f})"
        )


class LinkMetrics(Record, frozen=True, kw_only=True, omit_defaults=True):
    """``metrics.json``: the figures of a training.

    Attributes:
        kg: knowledge graph of the training: partial or full.
        train_fraction: training fraction: share of the train recipes.
        label_noise: label noise: share of these with a wrong result.
        triples: number of training triples.
        epochs: number of epochs.
        best_epoch: best epoch by validation MRR, if validated.
        seconds: duration of all epochs.
        seconds_per_epoch: mean duration of an epoch.
        parameters: number of model parameters.
        loss: loss of the last epoch.
        valid_mrr: validation MRR of the best epoch.
        train_mrr: MRR of the training triples, filtered by themselves: memory, not prediction.
        train_mrr_triples: number of triples behind ``train_mrr``.
        choice: choice of the regularisation, if any.
        folds: number of cross-fitting folds.
        fold_mrr: out-of-sample MRR of train triples by the folds' models, if any.
        fold_in_sample_mrr: in-sample MRR of the same triples by the main model.
    """

    kg: KG
    train_fraction: float = 1.0
    label_noise: float = 0.0
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
    choice: Choice | None = None
    folds: Count = 0
    fold_mrr: Share | None = None
    fold_in_sample_mrr: Share | None = None


class FoldDone(Record, frozen=True, kw_only=True):
    """Record of a fold's model in an unfinished run: hash of its triples, and epochs."""

    trained_on: Hash
    epochs: Count


class LinkProgress(Record, frozen=True, kw_only=True):
    """Progress of a training in a checkpoint."""

    seconds: float
    best_mrr: float | None
    best_epoch: int | None
    has_stopped: bool
    trace: tuple[TraceRow, ...]


def links_history(files: RunFiles) -> History:
    """Return the history of a link predictor."""
    config, metrics = LinksConfig.read(files.folder), files.record("metrics.json", LinkMetrics)
    facts = {
        "trained by": " ".join(files.run.argv),
        "training": f"{metrics.epochs} epochs, {metrics.seconds:.1f} s, {metrics.parameters:,} parameters",
        "on its own training triples": f"MRR {metrics.train_mrr:.3f}",
        "settings": ", ".join(f"{name} {value}" for name, value in vars(config.settings).items()),
    }
    if metrics.folds:
        facts["cross-fitted"] = cross_fitted_words(metrics.folds, metrics.fold_mrr, metrics.fold_in_sample_mrr)
    if metrics.choice:
        facts["regularisation chosen"] = str(metrics.choice)
    chosen = ("n3", "popularity") if metrics.choice else ()
    return History(config, facts, metrics, files.lines("trace.jsonl", TraceRow), chosen)
