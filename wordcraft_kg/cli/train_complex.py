"""``wordcraft-kg train-complex``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.training import train
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig

EXAMPLES = (
    "wordcraft-kg train-complex everyday --out models/everyday",
    "wordcraft-kg train-complex everyday --kg full --seed 1 --out models/everyday-full",
)


def train_complex(
    graph: str,
    *,
    settings: Annotated[ComplExConfig, Parameter(name="*")] = ComplExConfig(),
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> int:
    """Train ComplEx with the paper's objective on the partial or the full knowledge graph.

    Args:
        graph: graph folder, recipe book or known book's name.
        settings: settings of the model and its training.
        out: model folder to write. Default: models/<graph's name>-<kg>.
        force: replace the folder if it exists.
    """
    return train(LinksConfig(graph, settings), out, force, output)
