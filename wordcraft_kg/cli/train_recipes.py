"""``wordcraft-kg train-recipes``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output
from wordcraft_kg.cli.options import Force, Graph
from wordcraft_kg.cli.training import RecipeTraining, train
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig

EXAMPLES = (
    "wordcraft-kg train-recipes everyday --out models/everyday-recipes",
    "wordcraft-kg train-recipes everyday --folds 10 --out models/everyday-recipes-10",
    "wordcraft-kg train-recipes everyday --features one-hot --out models/everyday-no-words",
)

# For comparisons: auto knows when an encoder gains something.
FILE_ONLY = ["--encoder"]


def train_recipes(
    graph: Graph,
    *,
    settings: Annotated[
        RecipeScorerConfig, Parameter(name="*", negative_iterable="")
    ] = RecipeScorerConfig(),
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> int:
    """Fit a recipe scorer: how plausible is a result for a pair, and which recipes support it?

    Agents can use the scorer as a third knowledge source (train-agent --use
    combines,component,recipe), and link commands accept it too. Only train recipes support a score.

    Args:
        out: model folder to write. Default: models/<graph name>-recipes.
    """
    return train(RecipeTraining(), RecipesConfig(graph, settings), out, force, output)
