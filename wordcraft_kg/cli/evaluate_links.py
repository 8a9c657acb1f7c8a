"""``wordcraft-kg evaluate-links``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.options import Force, MovedGraph
from wordcraft_kg.models.scorers.config import MAX_QUERIES

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.links import LinkView
    from wordcraft_kg.models.scorers.ranking import RankingMetrics

EXAMPLES = (
    "wordcraft-kg evaluate-links models/everyday",
    "wordcraft-kg evaluate-links models/everyday --json --force",
)


def evaluate_links(
    model: Path,
    *,
    graph: MovedGraph = None,
    max_queries: int = MAX_QUERIES,
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> int:
    """Evaluate a model on unseen triples and write the report; leaked triples are left out.

    Args:
        model: model folder.
        max_queries: most queries to rank, two for each triple; above this, a uniform sample is
            ranked. 0 ranks all.
        out: folder to write. Default: report/ in the model folder.
    """
    from wordcraft_kg.base.artefacts import check_output
    from wordcraft_kg.evaluation.links import summarise_links, view_links
    from wordcraft_kg.evaluation.ranked_links import rank_links
    from wordcraft_kg.models.folder import open_model
    from wordcraft_kg.reports.link_report import make_link_report
    from wordcraft_kg.reports.pages import write_report

    folder = out or model / "report"
    trained = open_model(model, graph)
    check_output(folder, force=force)
    links = rank_links(
        trained.scorer,
        trained.opened,
        trained.kg,
        train_sample=trained.train_sample,
        made_by_other_books=trained.made_by_other_books,
        max_queries=max_queries,
    )
    view = view_links(links, name=model.name, provenance=trained.provenance, trace=trained.trace)
    write_report(make_link_report(view, links.labelled_ranks), folder, force=force)
    output.result(summarise_links(view, str(folder / "index.html")), _text(view, folder))
    # Coverage depends on the split (by-goal splits lack coverage); if another check fails, no
    # metric is valid.
    failed = [check for check in view.checks if not check.passed and check.id != "coverage"]
    for check in failed:
        print(f"CHECK FAILED: {check.name} ({check.detail})", file=sys.stderr)
    return 1 if failed else 0


def _text(view: "LinkView", folder: Path) -> list[str]:
    from wordcraft_kg.evaluation.links import has_few_test_recipes

    rows = [(name, _metrics(view.metrics[name])) for name in ("all", "combinesWith", "componentOf")]
    rows += [(name, _metrics(table["all"])) for name, table in view.baselines.items()]
    ranked = f"{view.triples:,}"
    if view.sampled_from is not None:
        ranked = f"a uniform sample of {view.triples:,} of {view.sampled_from:,}"
    wrote = f"wrote {folder}/   open {folder / 'index.html'}"
    if view.model.has_seen_the_test_recipes:
        memory = f"{ranked} triples of the graph, all seen in training: memory, not prediction"
        return [memory, *aligned(rows), wrote]
    best = view.comparisons[0]
    low, high = best.ci
    lead = f"{best.difference:+.3f} [{low:+.3f}, {high:+.3f}]"
    rows.append(("verdict", f"{best.compared} the best baseline, {best.baseline}: {lead}"))
    if has_few_test_recipes(view):
        count = f"{view.split.test_recipes:,} test recipes"
        rows.append(
            ("few recipes", f"only {count}: another seed of the split may change the verdict")
        )
    for row in view.drill_down.near_synonyms:
        if row.slice == "no such train recipe":
            rows.append(
                (
                    "no near-synonym",
                    f"{_metrics(row)}  (recipes that do not nearly repeat a train recipe)",
                )
            )
    rows += [(row.slice, _metrics(row)) for row in view.drill_down.other_book]
    if view.in_sample:
        left_out = f"MRR {view.in_sample.left_out_mrr:.3f} on train triples left out of training"
        rows.append(("cross-fitted", f"{left_out} ({view.in_sample.in_sample_mrr:.3f} in-sample)"))
    if view.leaked_left_out and view.model.kg != "none":
        leaked, headline = (
            metrics.mrr or 0.0 for metrics in (view.with_leaked, view.metrics["all"])
        )
        # A model that does not remember the leaked triples lowers the metric.
        inflated = (
            "inflated: training contains them"
            if leaked > headline
            else "no better, though training contains them"
        )
        rows.append(("with leaked", f"MRR {leaked:.3f}, {inflated}"))
    return [
        f"{ranked} unseen triples; {view.leaked_left_out:,} leaked ones left out",
        *aligned(rows),
        wrote,
    ]


def _metrics(metrics: "RankingMetrics") -> str:
    if not metrics.queries:
        return "no queries"
    interval = f" [{metrics.mrr_ci[0]:.3f}, {metrics.mrr_ci[1]:.3f}]" if metrics.mrr_ci else ""
    return (
        f"MRR {metrics.mrr:.3f}{interval}  hits@1 {metrics.hits_at_1:.3f}  hits@10 "
        f"{metrics.hits_at_10:.3f}"
    )
