"""``wordcraft-kg train-links``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output
from wordcraft_kg.cli.training import train
from wordcraft_kg.models.links.config import LinkModelConfig, LinksConfig

EXAMPLES = (
    "wordcraft-kg train-links everyday --model rotate --out models/everyday-rotate",
    "wordcraft-kg train-links everyday --model distmult --loop symmetric --out models/everyday-distmult",
)


def train_links(
    graph: str,
    *,
    settings: Annotated[LinkModelConfig, Parameter(name="*")] = LinkModelConfig(),
    out: Path | None = None,
    force: Flag = False,
    output: Output = Output(),
) -> int:
    """Train another PyKEEN model; scorer, report and commands are the same as for ComplEx.

    Args:
        graph: graph folder, recipe book or known book's name.
        settings: settings of the model and its training.
        out: model folder to write. Default: models/<graph's name>-<model>-<kg>.
        force: replace the folder if it exists.
    """
    return train(LinksConfig(graph, settings), out, force, output)
