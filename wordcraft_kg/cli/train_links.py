"""``wordcraft-kg train-links``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.cli.console import Flag, Output, aligned, split_labels
from wordcraft_kg.cli.options import Force, OptionalBook, Seeds, Trackers
from wordcraft_kg.cli.training import LinkTraining, train
from wordcraft_kg.models.links.config import ComplExConfig, LinkModelConfig, LinksConfig

EXAMPLES = (
    "wordcraft-kg train-links everyday --model rotate --out models/everyday-rotate",
    "wordcraft-kg train-links everyday --model distmult --loop symmetric --out "
    "models/everyday-distmult",
    "wordcraft-kg train-links everyday --model rotate --seeds 0,1 --out models/rotate-seeds",
    "wordcraft-kg train-links --list-models",
)

# Chosen once for all by studies.
FILE_ONLY = ["--batch-size", "--checkpoint-every", "--eval-every", "--threads"]


def train_links(
    graph: OptionalBook = None,
    *,
    list_models: Flag = False,
    settings: Annotated[LinkModelConfig, Parameter(name="*")] = LinkModelConfig(),
    seeds: Seeds = None,
    out: Path | None = None,
    force: Force = False,
    track: Trackers = None,
    output: Output = Output(),
) -> int:
    """Train any other PyKEEN model; the same reports and commands apply as for ComplEx.

    Args:
        graph: graph folder, recipe book or known book name.
        list_models: list all models: the paper's ComplEx, and installed PyKEEN models that need
            only triples.
        out: model folder to write. Default: models/<graph name>-<model>-<kg>.
    """
    # --list-models needs no graph, so the argument is optional; a training needs one.
    if list_models:
        return _list(output)
    if graph is None:
        raise ConfigError(
            "train-links needs a graph, such as everyday; `wordcraft-kg train-links --list-models`."
        )
    config = LinksConfig(graph, settings)
    trackers = split_labels(track or ())
    return train(LinkTraining(), config, out, force, output, seeds=seeds, trackers=trackers)


def _list(output: Output) -> int:
    from wordcraft_kg.models.links.builders import trainable_models

    # The paper's ComplEx has a command of its own, so the list names it first.
    commands = {"ComplEx": ComplExConfig.command}
    for kind in trainable_models():
        commands[kind.__name__] = f"{LinkModelConfig.command} --model {kind.__name__}"
    models = [{"name": name, "command": command} for name, command in commands.items()]
    rows = [(name, f"wordcraft-kg {command}") for name, command in commands.items()]
    output.result({"models": models}, aligned(rows))
    return 0
