"""``wordcraft-kg people pairs``."""

from pathlib import Path

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Flag, Output, aligned, check_file, write_file
from wordcraft_kg.cli.options import Force, Graph

GROUP = "Tasks and play"
EXAMPLES = (
    "wordcraft-kg people pairs --fetch --recipes rated.csv",
    "wordcraft-kg train-recipes little-alchemy-2 --kg full --without rated.csv --out models/unjudged",
    "wordcraft-kg people pairs --model models/unjudged",
)


def people_pairs(
    graph: Graph = "little-alchemy-2",
    *,
    model: Path | None = None,
    recipes: Path | None = None,
    fetch: Flag = False,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Compare a recipe scorer with people's published judgements of single pairs of Little Alchemy 2.

    Args:
        model: model folder of train-recipes for this graph, trained without the recipes of rated pairs.
        recipes: CSV file to write with the recipes of rated pairs, for train-recipes --without.
        fetch: download the judgements into the cache; the SHA-256 is checked.
    """
    check_file(recipes, force=force)
    from wordcraft_kg.apps.people.pair_judgements import (
        judged_recipes,
        judgements_file,
        read_judgements,
        view_pairs,
    )
    from wordcraft_kg.graphs.book_files import recipe_table
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.models.scorers.folder import load_scorer
    from wordcraft_kg.models.scorers.recipes import RecipeScorer

    opened = open_graph(graph).graph
    judgements = read_judgements(judgements_file(fetch=fetch), opened)
    loaded = None
    if model is not None:
        scorer = load_scorer(model, graph=opened).whole
        if not isinstance(scorer, RecipeScorer):
            raise ConfigError(
                f"{model} is not a recipe scorer; expected a model from `wordcraft-kg train-recipes`."
            )
        loaded = model.name, scorer
    view = view_pairs(judgements, opened, loaded)
    if recipes is not None:
        write_file(recipes, recipe_table(judged_recipes(judgements, opened)), force=force)
    rows = [
        ("", "is it a recipe (AUC)", "which of four results"),
        (
            "one person",
            _cell(view.auc_people, view.auc_people_ci),
            _cell(view.right_people, view.right_people_ci),
        ),
        ("chance", "0.500", "0.250"),
    ]
    if view.model is not None:
        rows.insert(1, (view.model, _cell(view.auc, view.auc_ci), _cell(view.right, view.right_ci)))
    lines = [
        f"{view.graph}: {view.pairs} pairs, {view.recipes} of them recipes; {view.judgements:,} ratings by people, "
        f"{view.questions} answers with a right option",
        *aligned(rows),
        *(f"note: {caveat}" for caveat in view.caveats),
    ]
    output.result(view, lines + ([f"wrote {recipes}"] if recipes else []))


def _cell(value: float | None, bounds: tuple[float, float] | None) -> str:
    return f"{value:.3f} [{bounds[0]:.3f}, {bounds[1]:.3f}]" if bounds else ""
