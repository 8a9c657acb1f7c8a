"""Writing any scorer as a model folder for all commands."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, get_args

from torch import Tensor

from wordcraft_kg.base.artefacts import staged_folder, with_a_name, write_atomically
from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.graphs.folder import OpenedGraph, TrainedOn
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.models.model import History
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, folds_of
from wordcraft_kg.models.scorers.folder import FOLD_OUTPUTS, VOCABULARY, WEIGHTS, stored, write_folds, write_scorer
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.runs.cards import scorer_card
from wordcraft_kg.runs.config_file import CONFIG_FILE, RunConfig
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import end_run, start_run


@dataclass(frozen=True)
class SavedConfig(RunConfig):
    """Description of a scorer that was not trained here.

    Attributes:
        kg: training data according to its author: partial (train recipes only), full, or none (no recipe).
        origin: description in a line for reports.
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
    """Write your own scorer as a model folder for all commands.

    With folds, see :func:`~wordcraft_kg.models.scorers.cross_fitting.cross_fit`, agents learn on out-of-sample scores.
    The folder holds the form that :func:`~wordcraft_kg.models.scorers.folder.stored` returns.

    Args:
        folder: folder to write.
        scorer: scorer of the graph's triples.
        opened: graph, and split for evaluation.
        kg: training data of the scorer: ``partial`` for train recipes only; ``full`` with other recipes of the graph,
            so that figures are marked as memory; ``none`` without recipes, such as from words alone.
        origin: description in a line for reports. Default: the scorer's name.
        force: replace the folder.

    Raises:
        OutputExistsError: if ``folder`` exists and ``force`` is False.
        GraphMismatchError: if the scorer belongs to another graph.
        ConfigError: if a score is not a finite number, or the graph is too large for a table of all scores.

    Example:
        >>> from wordcraft_kg.models.scorers.baselines import FrequencyScorer
        >>> opened = open_graph("kitchen")
        >>> mine = FrequencyScorer(opened.graph, opened.split.partial)
        >>> folder = save_scorer("models/frequency", mine, opened, kg="partial", origin="counts of the train recipes")
        >>> open_model(folder).kg
        'partial'
    """
    config = SavedConfig(opened.source, kg, origin or getattr(scorer, "name", type(scorer).__name__))
    check_scorer(scorer, opened.graph)
    if tuple(scorer.entities) != opened.graph.entities:
        raise GraphMismatchError(
            f"the scorer's `entities` are not those of '{opened.graph.name}', although it names its hash. Give it the "
            "labels of the graph, in the order of its ids."
        )
    whole, folded = stored(scorer), folds_of(scorer)
    out = with_a_name(Path(folder))
    with staged_folder(out, force=force) as staging:
        config.write(staging)
        write_scorer(staging, whole.kind, whole.tensors(), opened.graph)
        write_atomically(staging / "README.md", _model_card(config, opened))
        inputs = {"graph": opened.graph.hash, "split": opened.split.hash}
        outputs: tuple[str, ...] = (WEIGHTS, VOCABULARY, CONFIG_FILE)
        if folded is not None:
            inputs["folds"], outputs = folded.record.hash, (*outputs, *FOLD_OUTPUTS)
            _write_folds(staging, folded, whole.kind, opened)
            if folded.train_results is not None:
                inputs["train_sample"] = folded.train_sample(opened.graph).hash
        end_run(staging, start_run(staging, config.command, inputs=inputs), "done", outputs)
    return out


def _write_folds(folder: Path, scorer: CrossFitted, kind: str, opened: OpenedGraph) -> None:
    scorer.check_split(opened.split)

    def part(fold: int) -> tuple[str, dict[str, Tensor]]:
        scorer.trained_on(fold, opened.graph)  # or it is refused
        return scorer.record.folds[fold].trained_on, stored(scorer.left_out(fold)).tensors()

    train_sample = scorer.train_sample(opened.graph)
    folds = Folds(opened.split, scorer.count, scorer.record.seed, scorer.of_recipe, train_sample)
    write_folds(folder, folds, scorer.whole, kind, part)


def saved_history(files: RunFiles) -> History:
    """Return the history of a saved scorer."""
    config = SavedConfig.read(files.folder)
    facts = {"trained by": "someone else, and saved as a model folder", "what it is": config.origin}
    return History(config, facts, is_trained=False)


def _model_card(config: SavedConfig, opened: OpenedGraph) -> str:
    seen = {
        "full": "It is recorded as having seen more than the train recipes: its scores show what it remembers.",
        "partial": "It is recorded as having seen the train recipes only.",
        "none": "It is recorded as having seen no recipe of the graph.",
    }[config.kg]
    return scorer_card(
        opened,
        f"A scorer for {opened.graph.name}",
        f"{config.origin}\n\nIt was not trained by wordcraft-kg but saved with it, so nothing here can reproduce it. "
        + seen,
        (),
        "Its quality on unseen triples is what `wordcraft-kg evaluate-links` reports. Scores are not calibrated "
        "probabilities.",
        [f'scorer.top(None, "componentOf", {opened.graph.entities[0]!r})'],
    )
