"""``wordcraft-kg compare-links``."""

from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output, aligned

if TYPE_CHECKING:
    from wordcraft_kg.models.links.comparison import LinkComparison

EXAMPLES = (
    "wordcraft-kg compare-links models/everyday models/everyday-rotate",
    "wordcraft-kg compare-links models/everyday models/everyday-rotate --resamples 10000 --json",
)


def compare_links(
    a: Path,
    b: Path,
    *,
    graph: str | None = None,
    resamples: int = 1_000,
    seed: int = 0,
    output: Output = Output(),
) -> None:
    """Compare two models on the same unseen triples, with a paired bootstrap over recipes.

    Args:
        a: model folder.
        b: model folder, trained on the same graph and split.
        graph: where the graph is now, if it has moved.
        resamples: number of bootstrap resamples.
        seed: seed of the bootstrap.
    """
    from wordcraft_kg.models.links.comparison import compare
    from wordcraft_kg.models.links.folder import open_model

    view = compare(open_model(a, graph), open_model(b, graph), resamples=resamples, seed=seed)
    output.result(view, _text(view))


def _text(view: "LinkComparison") -> list[str]:
    low, high = view.difference_ci
    verdict = "the interval excludes 0" if low > 0 or high < 0 else "the interval includes 0: no difference is shown"
    rows = [
        ("A", f"MRR {view.a.mrr:.3f}  hits@10 {view.a.hits_at_10:.3f}  {view.a.name}"),
        ("B", f"MRR {view.b.mrr:.3f}  hits@10 {view.b.hits_at_10:.3f}  {view.b.name}"),
        ("A - B", f"MRR {view.difference:+.3f} [{low:+.3f}, {high:+.3f}]; {verdict}"),
        ("P(A > B)", f"{view.probability_a_better:.3f} of the resamples"),
    ]
    for model in (view.a, view.b):
        if model.has_seen_the_test_recipes:
            rows.append(("note", f"{model.name} was trained on all recipes: it has seen these triples"))
    return [f"{view.queries:,} queries for unseen triples", *aligned(rows)]
