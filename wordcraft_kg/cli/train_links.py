"""``wordcraft-kg train-links``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.completion import Book
from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.training import train
from wordcraft_kg.models.links.config import LinkModelConfig, LinksConfig

EXAMPLES = (
    "wordcraft-kg train-links everyday --model rotate --out models/everyday-rotate",
    "wordcraft-kg train-links everyday --model distmult --loop symmetric --out models/everyday-distmult",
    "wordcraft-kg train-links everyday --model rotate --seeds 0,1 --out models/rotate-seeds",
)


def train_links(
    graph: Book,
    *,
    settings: Annotated[LinkModelConfig, Parameter(name="*")] = LinkModelConfig(),
    seeds: str | None = None,
    out: Path | None = None,
    force: Flag = False,
    track: list[str] | None = None,
    output: Output = Output(),
) -> int:
    """Train another PyKEEN model; scorer, report and commands are the same as for ComplEx.

    Args:
        graph: graph folder, recipe book or known book's name.
        settings: settings of the model and its training.
        seeds: seeds to train one after the other, such as 0-4 or 0,3,7, each in a folder seed-N of its own. Seeds that
            are done are kept, so the same command goes on after Ctrl-C.
        out: model folder to write. Default: models/<graph's name>-<model>-<kg>.
        force: replace the folder if it exists.
        track: where the figures of each epoch go too, comma-separated: tensorboard, wandb (offline), mlflow (a local
            file); each needs the extra of its name.
    """
    return train(LinksConfig(graph, settings), seeds, out, force, split_labels(track or ()), output)
