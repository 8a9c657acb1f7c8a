"""A link report from a scorer in one call."""

from wordcraft_kg.evaluation.links import view_links
from wordcraft_kg.evaluation.ranked_links import rank_links
from wordcraft_kg.models.scorers.config import MAX_QUERIES
from wordcraft_kg.reports.link_report import make_link_report


def link_report(scorer, opened, kg="partial", *, max_queries=MAX_QUERIES, seed=0, **more):
    """Evaluate a scorer and return its report, as ``evaluate-links`` does."""
    links = rank_links(scorer, opened, kg, max_queries=max_queries, seed=seed)
    return make_link_report(view_links(links, seed=seed, **more), links.labelled_ranks)
