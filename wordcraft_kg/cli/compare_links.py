"""``wordcraft-kg compare-links``."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.base.errors import OutputExistsError
from wordcraft_kg.cli.completion import Model
from wordcraft_kg.cli.console import Flag, Output, aligned

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.link_comparison import ComparedModel, LinkComparison

EXAMPLES = (
    "wordcraft-kg compare-links models/everyday models/everyday-rotate",
    "wordcraft-kg compare-links models/everyday models/distmult models/rotate-seeds --out comparison.html",
)


def compare_links(
    a: Model,
    b: Model,
    *others: Model,
    graph: str | None = None,
    resamples: int = 2_000,
    seed: int = 0,
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> None:
    """Compare models on the same unseen triples, with a paired bootstrap over recipes.

    Args:
        a: model folder, or folder of seeds (train-complex --seeds); the others are compared with it.
        b: another one, trained on the same graph and split.
        others: further ones.
        graph: where the graph is now, if it has moved.
        resamples: number of bootstrap resamples.
        seed: seed of the bootstrap, and of the sample of very many queries.
        out: HTML page to write.
        force: replace the page if it exists.
    """
    if out is not None and out.exists() and not force:
        raise OutputExistsError(f"'{out}' exists. Choose another --out, or replace it with --force.")
    from wordcraft_kg.evaluation.link_comparison import Contender, compare, written_to
    from wordcraft_kg.models.links.folder import open_model
    from wordcraft_kg.runs.seeds import run_folders, run_name

    folders = [a, b, *others]
    names = [run_name(folder) for folder in folders]
    contenders = [
        Contender(
            name if names.count(name) == 1 else str(folder), [open_model(run, graph) for run in run_folders(folder)]
        )
        for name, folder in zip(names, folders, strict=True)
    ]
    view = compare(contenders, resamples=resamples, seed=seed)
    if out is not None:
        from wordcraft_kg.base.artefacts import staged_file, write_atomically
        from wordcraft_kg.reports.link_report import comparison_page

        with staged_file(out, force=force) as file:
            write_atomically(file, comparison_page(view))
        view = written_to(view, out)
    output.result(view, _text(view))


def _text(view: "LinkComparison") -> Iterator[str]:
    sample = "" if view.sampled_from is None else f"a uniform sample of {view.triples:,} of {view.sampled_from:,} "
    yield f"{view.queries:,} queries for {sample}unseen triples"
    yield from aligned((model.name, _figures(model)) for model in view.models)
    for model in view.models:
        if model.has_seen_the_test_recipes:
            yield f"note: {model.name} was trained on all recipes: it has seen these triples"
    if view.best is not None:
        level = f"; not told apart from it: {', '.join(view.not_told_apart)}" if view.not_told_apart else ""
        yield f"best: {view.best}{level}"
    widened = f"; those of differences are widened for {view.pairs} pairs of models (Bonferroni)"
    yield "95 % intervals over recipes" + (widened if view.pairs > 1 else "")
    if view.out:
        yield f"wrote {view.out}"


def _figures(model: "ComparedModel") -> str:
    low, high = model.mrr_ci or (0.0, 0.0)
    text = f"MRR {model.mrr:.3f} [{low:.3f}, {high:.3f}]  hits@10 {model.hits_at_10:.3f}"
    if len(model.seeds) > 1:
        text += f"  {len(model.seeds)} seeds {min(model.mrr_of_seeds):.3f} to {max(model.mrr_of_seeds):.3f}"
    if model.difference is None or model.difference_ci is None:
        return text
    down, up = model.difference_ci
    verdict = "excludes 0" if down > 0 or up < 0 else "includes 0: no difference is shown"
    return f"{text}  difference {model.difference:+.3f} [{down:+.3f}, {up:+.3f}] {verdict}"
