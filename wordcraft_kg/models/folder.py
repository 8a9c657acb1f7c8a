"""Open a model folder: scorer, training graph, split and training history.

The page docs/architecture.md, *On disk*, lists the files of a model folder.
"""

from collections.abc import Callable
from pathlib import Path

from wordcraft_kg.base.errors import NotRegisteredError
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.graphs.folder import GraphLike, OpenedGraph
from wordcraft_kg.graphs.train_samples import TrainSample, is_subsample
from wordcraft_kg.models.links.config import LinksConfig
from wordcraft_kg.models.links.records import links_history
from wordcraft_kg.models.model import History, Model
from wordcraft_kg.models.recipes.config import RecipesConfig
from wordcraft_kg.models.recipes.records import recipes_history
from wordcraft_kg.models.saving import SavedConfig, saved_history
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.folder import MODEL, WEIGHTS, load_scorer
from wordcraft_kg.models.scorers.protocol import check_scorer
from wordcraft_kg.runs.config_file import CONFIG_FILE
from wordcraft_kg.runs.record import RunFiles, read_finished_run

MODELS: Registry[Callable[[RunFiles], History]] = Registry(
    "wordcraft_kg.models",
    {
        **dict.fromkeys(LinksConfig.commands, links_history),
        **dict.fromkeys(RecipesConfig.commands, recipes_history),
        **dict.fromkeys(SavedConfig.commands, saved_history),
    },
)
"""Functions that read a model's training history, by training command.

A new kind of model adds a function, here or by an entry point of the same name.
"""


def open_model(folder: str | Path, graph: GraphLike | None = None) -> Model:
    """Open a model folder: scorer, training graph and history.

    Args:
        folder: folder from a training command or ``save_scorer``.
        graph: the training graph, or its new path if it was moved; None for the recorded path.

    Raises:
        ArtefactError: if the folder is unfinished or damaged, or the graph is missing.
        GraphMismatchError: if the model was trained on another graph or split.

    Example:
        >>> model = open_model("models/kitchen")
        >>> model.kg, model.opened.graph.name
        ('partial', 'kitchen')
    """
    folder = Path(folder)
    files = RunFiles(folder, read_finished_run(folder, MODEL, WEIGHTS))
    scorer = load_scorer(folder)
    history = _history(files)
    graph_and_split = files.graph(graph or history.config.graph)
    check_scorer(scorer, graph_and_split.graph)
    # A scorer that was saved, not trained here, was checked when it was saved.
    folds = folds_of(scorer)
    if folds is not None and history.is_trained:
        folds.check_split(graph_and_split.split)
    return Model(scorer, graph_and_split, files.run, history)


def read_train_sample(folder: str | Path, opened: OpenedGraph, weights: str) -> TrainSample | None:
    """Return a model's training recipes, :attr:`Model.train_sample`, from few of its files.

    The weights are read only if the model has a training fraction or label noise, or was saved by
    ``save_scorer``.

    Args:
        folder: the model folder.
        opened: the training graph.
        weights: expected hash of the weights, such as the hash that an agent's run recorded.

    Returns:
        the training recipes; None if the folder has other weights than expected.

    Raises:
        ArtefactError: if the folder is unfinished or damaged, or the graph is missing.
        GraphMismatchError: if the model was trained on another graph or split, or the recipes have
            another hash than recorded.
    """
    history = read_history(folder, weights)
    if history is None:
        return None
    settings = history.config.values()
    train_fraction = settings.get("train_fraction", 1.0)
    label_noise = settings.get("label_noise", 0.0)
    # Then the recipes depend on the folds in the folder, not on the split alone.
    if not history.is_trained or is_subsample(train_fraction, label_noise):
        return open_model(folder, opened.source).train_sample
    return opened.train_sample(settings.get("kg", "none"))


def read_history(folder: str | Path, weights: str) -> History | None:
    """Return a model's training history without its scorer, from few of its files.

    Args:
        folder: the model folder.
        weights: expected hash of the weights, such as the hash that an agent's run recorded.

    Returns:
        The history; None if the folder has other weights than expected.

    Raises:
        ArtefactError: if the folder is unfinished or damaged, or the package that provides its
            training command is missing.
    """
    folder = Path(folder)
    files = RunFiles(folder, read_finished_run(folder, MODEL, WEIGHTS))
    # A model trained anew in the same folder has another history than the one that was recorded.
    if files.run.outputs[WEIGHTS] != weights:
        return None
    return _history(files)


def _history(files: RunFiles) -> History:
    """Return the history in a model folder, by the function for its training command.

    Raises:
        ArtefactError: if the settings have changed, or no function is registered for the command.
    """
    # Read for its check by hash: a changed file is an error, not a wrong setting.
    files.bytes(CONFIG_FILE)
    if files.run.kind not in MODELS:
        raise NotRegisteredError(
            f"'{files.folder}' is a model from {files.run.kind}, which is not registered; expected "
            f"{', '.join(MODELS)}. Install the package that provides {files.run.kind}, or add it "
            "to MODELS of wordcraft_kg.models.folder in this program first."
        )
    return MODELS[files.run.kind](files)
