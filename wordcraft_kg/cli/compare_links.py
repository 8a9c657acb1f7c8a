"""``wordcraft-kg compare-links``."""

from pathlib import Path

from wordcraft_kg.cli.console import Output, aligned

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
        graph: where their graph is now, if it has moved.
        resamples: of the bootstrap.
        seed: of the bootstrap.
    """
    from wordcraft_kg.models.links.comparison import compare
    from wordcraft_kg.models.links.folder import open_model

    values = compare(open_model(a, graph), open_model(b, graph), resamples=resamples, seed=seed)
    low, high = values["difference_ci"]
    verdict = "the interval leaves out 0" if low > 0 or high < 0 else "the interval holds 0: no difference is shown"
    rows = [
        ("A", f"MRR {values['a']['mrr']:.3f}  hits@10 {values['a']['hits@10']:.3f}  {values['a']['name']}"),
        ("B", f"MRR {values['b']['mrr']:.3f}  hits@10 {values['b']['hits@10']:.3f}  {values['b']['name']}"),
        ("A - B", f"MRR {values['difference']:+.3f} [{low:+.3f}, {high:+.3f}]; {verdict}"),
        ("P(A > B)", f"{values['probability_a_better']:.3f} of the resamples"),
    ]
    for side in ("a", "b"):
        if values[side]["has_seen_the_test_recipes"]:
            rows.append(("note", f"{values[side]['name']} was trained on all recipes: it has seen these triples"))
    output.result(values, [f"{values['queries']:,} queries for unseen triples", *aligned(rows)])
