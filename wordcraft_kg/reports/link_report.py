"""The link-prediction report: evaluation results for a link predictor, with charts."""

from typing import TYPE_CHECKING

from wordcraft_kg.evaluation.links import FEW_TEST_RECIPES, LinkView
from wordcraft_kg.evaluation.ranked_links import LinkComparison, by_mrr
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM
from wordcraft_kg.models.scorers.ranking import RankingMetrics
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import GLOSSARY, Report, render_page

if TYPE_CHECKING:
    import pandas as pd


def make_link_report(view: LinkView, ranks: "pd.DataFrame | None" = None) -> Report[LinkView]:
    """Return the report on a link predictor, ready to write.

    Args:
        view: the evaluation results, by :func:`~wordcraft_kg.evaluation.links.view_links`.
        ranks: a row for each ranked query, by
            :attr:`~wordcraft_kg.evaluation.ranked_links.RankedLinks.labelled_ranks`, which becomes
            the report's ``ranks.csv``; None for a report without this file.

    Returns:
        The report, for :func:`~wordcraft_kg.reports.pages.write_report`.
    """
    rows = [_interval_row(view.model.name, view.metrics["all"])]
    # The order of the comparisons: the best baseline stands next to the model.
    for comparison in view.comparisons:
        name = GLOSSARY[comparison.baseline].name
        rows.append(_interval_row(name, view.baselines[comparison.baseline]["all"]))
    pictures = {
        "baselines": charts.intervals(
            rows,
            "filtered MRR, with 95 % intervals",
            "Filtered MRR of the model and of each baseline",
            reference=view.metrics["all"].mrr,
        )
    }
    series = {}
    for row in view.probabilities:
        # With a reason, all triples have one probability, which is a point and no curve.
        if row.reason:
            continue
        kind = ", itself" if row.pairs == "itself" else ""
        series[f"{row.relation}{kind}"] = [
            (at.probability, at.observed, at.low, at.high, at.triples) for at in row.bins
        ]
    if view.probabilities:
        pictures["probabilities"] = charts.log_reliability(
            series, "Share of true triples against their probability"
        )
    files = {}
    if ranks is not None:
        files["ranks.csv"] = ranks.to_csv(index=False, lineterminator="\n", float_format="%.6g")
    return Report(
        view,
        "link_report.html.j2",
        pictures,
        shown={
            "relations": RELATIONS,
            "few": FEW_TEST_RECIPES,
            "near_synonym": NEAR_SYNONYM,
        },
        files=files,
    )


def _interval_row(name: str, metrics: RankingMetrics) -> tuple[str, charts.Estimate]:
    low, high = metrics.mrr_ci or (None, None)
    return name, (metrics.mrr or 0.0, low, high)


def comparison_page(view: LinkComparison) -> str:
    """Render a comparison of link predictors as an HTML page: MRR, and differences to the first."""
    ranked = by_mrr(view)
    mrr = charts.intervals(
        [_interval_row(model.name, model) for model in ranked],
        f"filtered MRR, 95 % over {view.unit}",
        "MRR of each model with its interval",
    )
    return render_page("link_comparison.html.j2", report=view, ranked=ranked, mrr=mrr)
