"""Link predictors compared, as one self-contained HTML page."""

from wordcraft_kg.evaluation.link_comparison import LinkComparison
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import render_page


def comparison_page(view: LinkComparison) -> str:
    """Return the page: a table of all models, their MRR, and their differences to the first."""
    mrr = charts.intervals(
        [(model.name, (model.mrr or 0.0, *(model.mrr_ci or (None, None)))) for model in view.models],
        "filtered MRR, 95 % over recipes",
        "MRR of each model with its interval",
    )
    differences = charts.intervals(
        [(model.name, (model.difference or 0.0, *(model.difference_ci or (None, None)))) for model in view.models],
        f"difference of MRR to {view.models[0].name}, paired",
        f"Difference of each model's MRR to that of {view.models[0].name} with its interval",
        reference=0.0,
    )
    return render_page("link_comparison.html.j2", report=view, mrr=mrr, differences=differences)
