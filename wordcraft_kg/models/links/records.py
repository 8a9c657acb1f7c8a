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
        epoch: from 1.
        loss: mean loss over its batches.
        valid_mrr: MRR of the validation triples, if they were ranked after it.
        seconds: time that it took, including the ranking.
    """

    epoch: int
    loss: float
    valid_mrr: float | None = None
    seconds: float


class Candidate(Record, frozen=True, kw_only=True):
    """A regularisation, and the MRR of held-out train recipes with it."""

    n3: float
    popularity: float
    mrr: Share


class Choice(Record, frozen=True, kw_only=True):
    """``choice.json``: how the regularisation of a small or large book was chosen, on train recipes held out.

    Attributes:
        n3: the chosen weight of the N3 regulariser.
        popularity: the chosen weight of the counts.
        mrr: MRR of the held-out triples with them.
        frequency_mrr: MRR of the same triples by counting alone.
        candidates: everything that was tried.
        folds: number of times that a part of the train recipes was held out.
        epochs: epochs of each training.
        queries: number of held-out queries, over all folds.
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
        """Whether any candidate is better than counting alone."""
        return max(candidate.mrr for candidate in self.candidates) > self.frequency_mrr

    def __str__(self) -> str:
        """Say what was chosen and why, in a line."""
        without = max(candidate.mrr for candidate in self.candidates if not candidate.popularity)
        return (
            f"n3 {self.n3:g}, popularity {self.popularity:g}: MRR {self.mrr:.3f} on {self.queries:,} queries of train "
            f"recipes held out {counted(self.folds, 'time')} (counting alone {self.frequency_mrr:.3f}, without "
            f"popularity {without:.3f})"
        )


class LinkMetrics(Record, frozen=True, kw_only=True, omit_defaults=True):
    """``metrics.json``: the figures of a training.

    Attributes:
        kg: knowledge graph that it was trained on: partial or full.
        share: share of the train recipes that it was trained on.
        noise: share of these that had a wrong result.
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
        choice: how the regularisation was chosen, None if it was given or fixed.
        folds: number of folds of cross-fitting.
        fold_mrr: MRR of triples of the train recipes by models that have not seen them, None without folds.
        fold_in_sample_mrr: MRR of the same triples by the model of all train recipes.
    """

    kg: KG
    share: float = 1.0
    noise: float = 0.0
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
    """What is recorded beside the tensors of a fold's model until the run is done: hash of its triples, and epochs."""

    trained_on: Hash
    epochs: Count


class LinkProgress(Record, frozen=True, kw_only=True):
    """Progress of a link predictor's training, as a checkpoint records it beside its tensors."""

    seconds: float
    best_mrr: float | None
    best_epoch: int | None
    has_stopped: bool
    trace: tuple[TraceRow, ...]


def links_history(files: RunFiles) -> History:
    """Read how a link predictor was trained."""
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
