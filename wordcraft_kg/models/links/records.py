"""JSON records in a link predictor's model folder."""

from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.folder import KG
from wordcraft_kg.models.links.config import LinksConfig
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.runs.files import RunFiles


class TraceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A line of ``trace.jsonl`` after an epoch: mean loss, validation MRR if any, and seconds with validation."""

    epoch: int
    loss: float
    valid_mrr: float | None = None
    seconds: float


class Candidate(Record, frozen=True, kw_only=True):
    """A candidate regularisation: N3 weight and popularity weight, with the MRR on held-out train recipes."""

    n3: float
    popularity: float
    mrr: Share


class Choice(Record, frozen=True, kw_only=True):
    """Content of ``choice.json``: the regularisation chosen on held-out train recipes.

    Attributes:
        n3: chosen N3 weight.
        popularity: chosen weight of the training counts of entities in the scores.
        mrr: MRR on the held-out triples with these weights.
        frequency_mrr: MRR on the same triples with the frequency rule, which ranks entities by training counts.
        folds: number of random samples of held-out recipes.
        epochs: epochs per training.
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
        """Whether any candidate has a higher MRR than a ranking of entities by training counts."""
        return max(candidate.mrr for candidate in self.candidates) > self.frequency_mrr

    def __str__(self) -> str:
        """Return the chosen weights and the metrics in a line."""
        without = max(candidate.mrr for candidate in self.candidates if not candidate.popularity)
        return (
            f"n3 {self.n3:g}, popularity {self.popularity:g}: MRR {self.mrr:.3f} on {self.queries:,} held-out train "
            f"queries in {counted(self.folds, 'fold')} (frequency rule {self.frequency_mrr:.3f}, without popularity "
            f"{without:.3f})"
        )


class OutsideSummary(Record, frozen=True, kw_only=True):
    """Numbers of outside triples, further nodes and relations, and the share of entities in the triples."""

    triples: Count
    nodes: Count
    relations: Count
    coverage: Share

    def __str__(self) -> str:
        """Return the numbers in a line."""
        relations, nodes = counted(self.relations, "relation"), counted(self.nodes, "node")
        return f"{self.triples:,} outside triples, {relations}, {nodes} besides {self.coverage:.0%} of the entities"


class LinkMetrics(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Content of ``metrics.json``: metrics from the training of a link predictor; settings, counts and MRRs.

    Attributes:
        best_epoch: best epoch by validation MRR, ``valid_mrr``, if validated.
        seconds: duration of all epochs.
        loss: last epoch's loss.
        train_mrr: filtered MRR on the training triples, or a sample: memory, not prediction.
        train_mrr_triples: number of triples ranked for ``train_mrr``.
        outside: numbers of triples from outside the book, if any.
        choice: chosen regularisation, if any.
        folds: number of cross-fitting folds.
        fold_mrr: out-of-sample MRR on train triples, by the fold models, if any.
        fold_in_sample_mrr: in-sample MRR on the same triples, by the main model.
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
    outside: OutsideSummary | None = None
    choice: Choice | None = None
    folds: Count = 0
    fold_mrr: Share | None = None
    fold_in_sample_mrr: Share | None = None


class FoldDone(Record, frozen=True, kw_only=True):
    """Record saved with a finished fold model in an unfinished run: hash of the training triples, and epochs."""

    trained_on: Hash
    epochs: Count


class LinkProgress(Record, frozen=True, kw_only=True):
    """Training progress in a checkpoint: duration, best epoch, early stop, and trace (metrics per epoch)."""

    seconds: float
    best_mrr: float | None
    best_epoch: int | None
    has_stopped: bool
    trace: tuple[TraceRow, ...]


def links_history(files: RunFiles) -> History:
    """Return a link predictor's training history, from the files of a run: settings and metrics, also per epoch."""
    config, metrics = LinksConfig.read(files.folder), files.record("metrics.json", LinkMetrics)
    facts = {
        "trained by": " ".join(files.run.argv),
        "training": f"{metrics.epochs} epochs, {metrics.seconds:.1f} s, {metrics.parameters:,} parameters",
        "on training triples": f"MRR {metrics.train_mrr:.3f}",
        "settings": ", ".join(
            f"{name} {value}" for name, value in vars(config.settings).items() if value != ()
        ),
    }
    if metrics.outside:
        facts["outside knowledge"] = str(metrics.outside)
    if metrics.folds:
        facts["cross-fitted"] = cross_fitted_words(
            metrics.folds, metrics.fold_mrr, metrics.fold_in_sample_mrr
        )
    if metrics.choice:
        facts["regularisation chosen"] = str(metrics.choice)
    chosen = ("n3", "popularity") if metrics.choice else ()
    return History(config, facts, metrics, files.lines("trace.jsonl", TraceRow), chosen)
