"""Write the files in the model folder of a trained link predictor."""

from pathlib import Path

from msgspec.structs import replace
from pykeen.models import Model

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.records import as_lines, as_values
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.train_samples import TrainSample, describe_train_sample
from wordcraft_kg.models.links.builders import scorer_tensors
from wordcraft_kg.models.links.config import ComplExConfig, LinkSettings
from wordcraft_kg.models.links.records import Choice, LinkMetrics, LinkProgress, OutsideSummary
from wordcraft_kg.models.scorers.cross_fitting import FoldsRecord
from wordcraft_kg.models.scorers.folder import make_scorer, write_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.cards import scorer_card

OUTPUTS = ("model.safetensors", "vocabulary.json", "config.toml", "metrics.json", "trace.jsonl")


def write_results(
    folder: Path,
    model: Model,
    train_sample: TrainSample,
    settings: LinkSettings,
    progress: LinkProgress,
    choice: Choice | None = None,
    outside: OutsideSummary | None = None,
) -> tuple[Scorer, LinkMetrics]:
    """Write a trained model's scorer, metrics (also per epoch) and chosen weights; return scorer and metrics."""
    model.eval()
    graph, triples = train_sample.graph, train_sample.triples
    kind, tensors = scorer_tensors(settings, model, triples, graph.num_entities)
    sample = sampled_for(graph, triples)  # on large graphs a fixed sample is enough
    scorer = make_scorer(kind, tensors, graph.entities, graph.hash)
    ranks = rank_triples(scorer, sample, triples)
    metrics = LinkMetrics(
        kg=settings.kg,
        train_fraction=settings.train_fraction,
        label_noise=settings.label_noise,
        triples=len(triples),
        epochs=len(progress.trace),
        best_epoch=progress.best_epoch,
        seconds=round(progress.seconds, 3),
        seconds_per_epoch=round(progress.seconds / len(progress.trace), 4),
        parameters=sum(parameter.numel() for parameter in model.parameters()),
        loss=progress.trace[-1].loss,
        valid_mrr=progress.best_mrr,
        train_mrr=mean_reciprocal_rank(ranks),
        train_mrr_triples=len(sample),
        outside=outside,
        choice=choice,
    )
    write_scorer(folder, kind, tensors, graph)
    write_atomically(folder / "metrics.json", dump_json(as_values(metrics)))
    write_atomically(folder / "trace.jsonl", as_lines(progress.trace))
    return scorer, metrics


def with_folds(folder: Path, metrics: LinkMetrics, record: FoldsRecord) -> LinkMetrics:
    """Return the metrics with the cross-fitting metrics added, and write ``metrics.json`` again."""
    metrics = replace(metrics, folds=record.count, fold_mrr=record.mrr, fold_in_sample_mrr=record.in_sample_mrr)
    write_atomically(folder / "metrics.json", dump_json(as_values(metrics)))
    return metrics


def model_card(opened: OpenedGraph, settings: LinkSettings, metrics: LinkMetrics) -> str:
    """Return the model card (``README.md``) for a link predictor."""
    name = "ComplEx" if isinstance(settings, ComplExConfig) else settings.model
    sample = describe_train_sample(settings.train_fraction, settings.label_noise) or "the train recipes"
    seen = f"the triples of {sample} only."
    if settings.kg == "full":
        seen = "all triples, test recipes included: the scores show memory, not prediction."
    fitted = f"{metrics.epochs} epochs, {metrics.parameters:,} parameters, MRR on training triples "
    points = [f"{metrics.triples:,} training triples", fitted + f"{metrics.train_mrr:.3f}"]
    if metrics.outside and isinstance(settings, ComplExConfig):
        points.append(f"joint training with {metrics.outside}, weight {settings.outside_weight:g}")
    if metrics.choice:
        points.append(f"regularisation chosen: {metrics.choice}")
    if isinstance(settings, ComplExConfig) and settings.negatives:
        sample = f"softmax over {settings.negatives:,} entities sampled for each batch"
        points.append(f"objective: {sample}, in place of all entities")
    if metrics.folds:
        folds = f"cross-fitted: {metrics.folds} more models, each trained without one fold of the train recipes"
        if metrics.fold_mrr is not None:
            folds += f": MRR {metrics.fold_mrr:.3f} out-of-sample, {metrics.fold_in_sample_mrr:.3f} in-sample"
        points.append(folds)
    more = "; `scorer.probability` returns probabilities for triples outside training" if metrics.folds else ""
    return scorer_card(
        opened,
        f"{name} on the {settings.kg} knowledge graph of {opened.graph.name}",
        f"Scores triples (head, relation, tail) with the relations `combinesWith` and `componentOf`. Trained on {seen}",
        points,
        "`config.toml` reproduces the training; `run.json` records all versions. For the quality on unseen triples, "
        f"run\n`wordcraft-kg evaluate-links`; the MRR above shows memory. Scores are not probabilities{more}.",
        [f'scorer.top(None, "componentOf", {opened.graph.entities[0]!r})'],
    )
