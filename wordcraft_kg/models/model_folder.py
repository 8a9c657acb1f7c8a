"""Open a model folder (scorer, training graph, split and history), or save any scorer as one.

The page docs/architecture.md, *On disk*, lists the files of a model folder, and
docs/link-prediction.md has an example of a saved scorer under *Custom scorers and PyKEEN models*.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, get_args

from torch import Tensor

from wordcraft_kg.base import (
    NotRegisteredError,
    one_of,
    staged_folder,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.graphs import Folds, GraphLike, OpenedGraph, TrainedOn
from wordcraft_kg.models.links.link_config import LinksConfig
from wordcraft_kg.models.links.link_records import links_history
from wordcraft_kg.models.model import History, Model
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig
from wordcraft_kg.models.recipes.recipe_records import recipes_history
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, folds_of
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.scorer_folder import (
    FOLD_OUTPUTS,
    MODEL,
    VOCABULARY,
    WEIGHTS,
    load_scorer,
    stored,
    write_folds,
    write_scorer,
)
from wordcraft_kg.runs.config_file import CONFIG_FILE, RunConfig
from wordcraft_kg.runs.record import RunFiles, end_run, read_finished_run, scorer_card, start_run


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
            "to MODELS of wordcraft_kg.models.model_folder in this program first."
        )
    return MODELS[files.run.kind](files)


# --- save any scorer -----------------------------------------------------------------------------


@dataclass(frozen=True)
class SavedConfig(RunConfig):
    """Settings of a scorer trained elsewhere, as ``config.toml`` holds them.

    Attributes:
        commands: the kind of run of a saved scorer.
        kg: training data, as stated by the user: partial (train recipes only), full, or none (no
            recipe).
        origin: one-line description for reports.

    Raises:
        ConfigError: for another ``kg``.
    """

    commands: ClassVar[tuple[str, ...]] = ("save-scorer",)

    kg: TrainedOn
    origin: str

    def __post_init__(self) -> None:
        one_of("kg", self.kg, get_args(TrainedOn))


def save_scorer(
    folder: str | Path,
    scorer: TripleScorer,
    opened: OpenedGraph,
    *,
    kg: TrainedOn,
    origin: str = "",
    force: bool = False,
) -> Path:
    """Save your own scorer as a model folder that all commands accept; return the folder.

    The folder says that the scorer was not trained here. From a cross-fitted scorer (see
    :func:`~wordcraft_kg.models.scorers.cross_fitting.cross_fit`) agents learn with out-of-sample
    scores. The folder holds the scorer as returned by
    :func:`~wordcraft_kg.models.scorers.scorer_folder.stored`.

    Args:
        folder: new folder.
        scorer: scorer for the graph's triples.
        opened: graph, and split for evaluation.
        kg: training data: ``partial`` for train recipes only; ``full`` with other recipes, so
            metrics are marked as memory; ``none`` without recipes, such as a scorer that rests on
            words. Nobody else can know this, so it cannot be checked.
        origin: one-line description for reports. Default: the scorer's name.
        force: replace the folder.

    Raises:
        OutputExistsError: if ``folder`` exists and ``force`` is False.
        GraphMismatchError: if the scorer belongs to another graph, or its folds to another split.
        ConfigError: for another ``kg``, if a score is not a finite number, or if the graph is too
            large for a score table.
        LeakError: if a fold's scorer was trained on other recipes than its folds say.

    Example:
        >>> from wordcraft_kg.models.scorers.baselines import FrequencyScorer
        >>> opened = open_graph("kitchen")
        >>> mine = FrequencyScorer(opened.graph, opened.split.partial)
        >>> folder = save_scorer(
        ...     "models/frequency", mine, opened, kg="partial", origin="counts of the train recipes"
        ... )
        >>> open_model(folder).kg
        'partial'
    """
    origin = origin or getattr(scorer, "name", type(scorer).__name__)
    config = SavedConfig(opened.source, kg, origin)
    check_scorer(scorer, opened.graph)
    main = stored(scorer)
    folded = folds_of(scorer)
    # An error within the block leaves no folder behind.
    out = with_a_name(Path(folder))
    with staged_folder(out, force=force) as staging:
        config.write(staging)
        write_scorer(staging, main.kind, main.tensors(), opened.graph)
        write_atomically(staging / "README.md", _model_card(config, opened))
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash}
        outputs: tuple[str, ...] = (WEIGHTS, VOCABULARY, CONFIG_FILE)
        if folded is not None:
            inputs["folds"] = folded.record.hash
            outputs += FOLD_OUTPUTS
            _write_folds(staging, folded, main.kind, opened)
            if folded.train_results is not None:
                inputs["train_sample"] = folded.train_sample(opened.graph).hash
        end_run(staging, start_run(staging, config.command, inputs=inputs), "done", outputs)
    return out


def _write_folds(folder: Path, scorer: CrossFitted, kind: str, opened: OpenedGraph) -> None:
    scorer.check_split(opened.split)

    def part(fold: int) -> dict[str, Tensor]:
        # Raises LeakError if the fold's scorer was trained on anything else.
        scorer.trained_on(fold, opened.graph)
        return stored(scorer.left_out(fold)).tensors()

    # Folds with the recipes that the scorers were trained on, perhaps with wrong results.
    train_sample = scorer.train_sample(opened.graph)
    folds = Folds(opened.split, scorer.count, scorer.record.seed, scorer.of_recipe, train_sample)
    write_folds(folder, folds, scorer.whole, kind, part)


def saved_history(files: RunFiles) -> History:
    """Return settings and facts for a scorer saved by :func:`save_scorer`.

    Raises:
        ArtefactError: if the settings are missing or damaged.
    """
    config = SavedConfig.read(files.folder)
    facts = {"trained by": "someone else, and saved as a model folder", "what it is": config.origin}
    return History(config, facts, is_trained=False)


def _model_card(config: SavedConfig, opened: OpenedGraph) -> str:
    # The statement of whoever saved the scorer; nobody else can know.
    training_data = {
        "full": "Recorded training data: more than the train recipes. The scores show memory, not "
        "prediction.",
        "partial": "Recorded training data: the train recipes only.",
        "none": "Recorded training data: no recipe from the graph.",
    }[config.kg]
    return scorer_card(
        opened,
        f"A scorer for {opened.graph.name}",
        f"{config.origin}\n\n"
        "The scorer was not trained by wordcraft-kg but only saved, so the folder cannot reproduce "
        "the training. " + training_data,
        {},
        "`wordcraft-kg evaluate-links` measures the quality on unseen triples. Scores are not "
        "calibrated probabilities.",
        [f'scorer.top(None, "componentOf", {opened.graph.entities[0]!r})'],
    )


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
