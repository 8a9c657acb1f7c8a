"""JSON records in a link predictor's model folder.

The page docs/architecture.md, *On disk*, lists the files of a model folder.
"""

from wordcraft_kg.base import Count, Hash, Record, Share
from wordcraft_kg.graphs.graph_folder import KG
from wordcraft_kg.models.links.link_config import ComplExConfig, LinksConfig, LinkSettings
from wordcraft_kg.models.model import History, cross_fitted_words
from wordcraft_kg.runs.record import RunFiles


class TraceRow(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A line of ``trace.jsonl``: the metrics of an epoch.

    Attributes:
        epoch: number of the epoch, from 1.
        loss: mean loss over the epoch's batches.
        seconds: duration without checkpoints and trackers.
    """

    epoch: int
    loss: float
    seconds: float


class Candidate(Record, frozen=True, kw_only=True):
    """A candidate regularisation.

    Attributes:
        n3: N3 weight.
        popularity: weight of the training counts of entities in the scores.
        mrr: MRR on held-out train recipes.
    """

    n3: float
    popularity: float
    mrr: Share


class Choice(Candidate, frozen=True, kw_only=True):
    """Content of ``choice.json``: the regularisation chosen on held-out train recipes.

    Attributes:
        candidates: all candidates, also those not chosen.
        queries: number of held-out queries over all folds.
    """

    candidates: tuple[Candidate, ...]
    queries: Count

    def __str__(self) -> str:
        """Return the chosen weights and the metrics in a line."""
        return (
            f"n3 {self.n3:g}, popularity {self.popularity:g}: MRR {self.mrr:.3f} on "
            f"{self.queries:,} held-out train queries"
        )


class OutsideSummary(Record, frozen=True, kw_only=True):
    """Numbers of triples from outside the book.

    Attributes:
        triples: number of triples.
        nodes: number of nodes besides the graph's entities.
        relations: number of relations besides the game's two.
        coverage: share of the graph's entities in the triples.
    """

    triples: Count
    nodes: Count
    relations: Count
    coverage: Share

    def __str__(self) -> str:
        """Return the numbers in a line."""
        return (
            f"outside triples: {self.triples:,}, relations: {self.relations:,}, nodes besides "
            f"{self.coverage:.0%} of the entities: {self.nodes:,}"
        )


class LinkMetrics(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Content of ``metrics.json``: metrics from the training of a link predictor.

    Attributes:
        kg: training triples: partial (train recipes) or full (all recipes).
        train_fraction: fraction of the train recipes used in training.
        label_noise: fraction of these recipes with a wrong result.
        triples: number of the graph's training triples.
        epochs: number of finished epochs.
        seconds: duration of all epochs.
        parameters: number of the model's parameters, as PyKEEN stores them.
        loss: last epoch's loss.
        train_mrr: filtered MRR on the training triples, or a sample: memory, not prediction.
        outside: numbers of triples from outside the book; None without.
        choice: chosen regularisation; None if the weights were given or fixed.
        folds: number of cross-fitting folds, 0 without.
        fold_mrr: out-of-sample MRR on train triples, by the fold models; None without folds.
        fold_in_sample_mrr: in-sample MRR on the same triples, by the main model; None without
            folds.
    """

    kg: KG
    train_fraction: float = 1.0
    label_noise: float = 0.0
    triples: int
    epochs: int
    seconds: float
    parameters: int
    loss: float
    train_mrr: float
    outside: OutsideSummary | None = None
    choice: Choice | None = None
    folds: Count = 0
    fold_mrr: Share | None = None
    fold_in_sample_mrr: Share | None = None


class FoldDone(Record, frozen=True, kw_only=True):
    """Record saved with a finished fold model in an unfinished run.

    Attributes:
        trained_on: hash of the model's training triples.
    """

    trained_on: Hash


class LinkProgress(Record, frozen=True, kw_only=True):
    """Training progress in a checkpoint.

    Attributes:
        trace: metrics of each epoch, in order.
    """

    trace: tuple[TraceRow, ...]


def training_facts(settings: LinkSettings, metrics: LinkMetrics) -> dict[str, str]:
    """Return facts about a training by name, for reports and the model card."""
    facts = {
        "training": f"{metrics.epochs} epochs, {metrics.seconds:.1f} s, {metrics.triples:,} "
        f"triples, {metrics.parameters:,} parameters",
        "on training triples": f"MRR {metrics.train_mrr:.3f}",
    }
    # Only facts that the training has: a report shows no empty rows.
    if metrics.outside and isinstance(settings, ComplExConfig):
        facts["outside knowledge"] = f"{metrics.outside}, weight {settings.outside_weight:g}"
    if metrics.folds:
        facts["cross-fitted"] = cross_fitted_words(
            metrics.folds, metrics.fold_mrr, metrics.fold_in_sample_mrr
        )
    if metrics.choice:
        facts["regularisation chosen"] = str(metrics.choice)
    return facts


def links_history(files: RunFiles) -> History:
    """Return a link predictor's training history, from the files of a run.

    Raises:
        ArtefactError: if a file is missing, damaged or has changed.
    """
    config = LinksConfig.read(files.folder)
    metrics = files.record("metrics.json", LinkMetrics)
    settings = vars(config.settings).items()
    facts = {
        "trained by": " ".join(files.run.argv),
        **training_facts(config.settings, metrics),
        "settings": ", ".join(f"{name} {value}" for name, value in settings if value != ()),
    }
    # Each seed chooses for itself, so comparisons of seeds leave these settings out.
    chosen_settings = ("n3", "popularity") if metrics.choice else ()
    return History(config, facts, metrics, files.lines("trace.jsonl", TraceRow), chosen_settings)
