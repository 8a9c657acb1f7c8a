"""``wordcraft-kg train-complex``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.options import Book, Words
from wordcraft_kg.cli.training import ToldLinks, train
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig

EXAMPLES = (
    "wordcraft-kg train-complex everyday --out models/everyday",
    "wordcraft-kg train-complex everyday --kg full --seed 1 --out models/everyday-full",
    "wordcraft-kg train-complex everyday --seeds 0-4 --out models/everyday-seeds",
)


def train_complex(
    graph: Book,
    *,
    settings: Annotated[ComplExConfig, Parameter(name="*")] = ComplExConfig(),
    seeds: str | None = None,
    out: Path | None = None,
    force: Flag = False,
    track: Words = None,
    output: Output = Output(),
) -> int:
    """Train ComplEx with the paper's objective on the partial or the full knowledge graph.

    Args:
        graph: graph folder, recipe book or known book's name.
        settings: settings of the model and its training.
        seeds: seeds to train one after the other, such as 0-4 or 0,3,7, each in a folder seed-N of its own. Seeds that
            are done are kept, so the same command goes on after Ctrl-C.
        out: model folder to write. Default: models/<graph's name>-<kg>.
        force: replace the folder if it exists.
        track: where the figures of each epoch go too, comma-separated: tensorboard, wandb (offline), mlflow (a local
            file); each needs the extra of its name.
    """
    config, trackers = LinksConfig(graph, settings), split_labels(track or ())
    return train(ToldLinks(), config, out, force, output, seeds=seeds, trackers=trackers)
