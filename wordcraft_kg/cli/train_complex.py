"""``wordcraft-kg train-complex``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.cli.console import Output, split_labels
from wordcraft_kg.cli.options import Force, Graph, Seeds, Trackers
from wordcraft_kg.cli.training import LinkTraining, train
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig

EXAMPLES = (
    "wordcraft-kg train-complex everyday --out models/everyday",
    "wordcraft-kg train-complex everyday --kg full --seed 1 --out models/everyday-full",
    "wordcraft-kg train-complex everyday --seeds 0-4 --out models/everyday-seeds",
    "wordcraft-kg train-complex graphs/mine --with knowledge/wn --out models/mine-wn",
)

# Chosen once for all by studies.
FILE_ONLY = ["--batch-size", "--checkpoint-every", "--init-scale", "--threads"]


def train_complex(
    graph: Graph,
    *,
    settings: Annotated[ComplExConfig, Parameter(name="*", negative_iterable="")] = ComplExConfig(),
    seeds: Seeds = None,
    out: Path | None = None,
    force: Force = False,
    track: Trackers = None,
    output: Output = Output(),
) -> int:
    """Train ComplEx with the objective of Jiang et al. (2020).

    The model learns the train recipes, or all recipes (--kg full).

    Args:
        out: model folder to write. Default: models/<graph name>-<kg>.
    """
    config = LinksConfig(graph, settings)
    trackers = split_labels(track or ())
    return train(LinkTraining(), config, out, force, output, seeds=seeds, trackers=trackers)
