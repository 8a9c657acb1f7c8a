"""Opening a model folder for evaluation: its scorer, the graph and split that it was trained on, and its history."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from wordcraft_kg.apps.elicitation.config import OpinionsConfig
from wordcraft_kg.apps.elicitation.records import OpinionMetrics
from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.base.records import parse_lines, parse_record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.doses import Dose, dose_words, is_dosed, make_dose
from wordcraft_kg.graphs.folder import OpenedGraph, Taught
from wordcraft_kg.models.links.config import LinksConfig, LinkSettings, SavedConfig
from wordcraft_kg.models.links.records import LinkMetrics, TraceRow
from wordcraft_kg.models.recipes.config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.recipes.records import RecipeMetrics
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.opinions import OpinionScorer
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.inputs import open_run_graph
from wordcraft_kg.runs.record import RunRecord, read_finished_run, verified_bytes

MODEL = "a model of train-complex, train-links, train-recipes or ask-opinions"
WEIGHTS = "model.safetensors"


@dataclass(frozen=True)
class OpenedModel:
    """A link predictor with everything that its evaluation needs.

    Attributes:
        scorer: the scorer of the folder, cross-fitted if it has folds.
        opened: the graph and split that it was trained on, checked by hash.
        settings: the settings that it was trained with, or what is known of a scorer that was not trained here.
        run: its ``run.json``.
        metrics: figures of its training; None if it was not trained here.
        trace: one row per epoch; empty if it was not trained here.
    """

    scorer: Scorer
    opened: OpenedGraph
    settings: LinkSettings | SavedConfig | RecipesConfig | OpinionsConfig
    run: RunRecord
    metrics: LinkMetrics | RecipeMetrics | OpinionMetrics | None
    trace: list[TraceRow]

    @property
    def kg(self) -> Taught:
        """What it was trained on: ``partial``, ``full``, or ``none`` of the recipes."""
        return self.settings.kg

    @cached_property
    def dose(self) -> Dose:
        """The recipes that it was trained on, as they were taught.

        Raises:
            GraphMismatchError: if they cannot be told: they are drawn again here, and are not those of the training.
        """
        settings, split = self.settings, self.opened.split
        if isinstance(self.scorer, CrossFitted):
            found = self.scorer.dose(split.graph)
        elif isinstance(settings, SavedConfig | OpinionsConfig) or not is_dosed(settings.share, settings.noise):
            found = self.opened.dose(self.kg)
        else:
            found = make_dose(split, settings.share, settings.noise, settings.seed)
        if self.run.inputs.get("dose", found.hash) != found.hash:
            raise GraphMismatchError(
                f"the model was trained on the recipes {self.run.inputs['dose'][:12]}, but `share` and `noise` give "
                f"{found.hash[:12]}. Train it again with this version of NumPy."
            )
        return found

    @property
    def triples(self) -> Ids:
        """The triples that it was trained on, shape (T, 3), sorted."""
        return self.dose.triples

    @property
    def observed(self) -> Ids:
        """The triples that it holds to be true, shape (T, 3): those of its training, or of its opinions."""
        return self.scorer.triples if isinstance(self.scorer, OpinionScorer) else self.triples

    @property
    def provenance(self) -> dict[str, str]:
        """Facts for a report."""
        metrics = self.metrics
        if isinstance(self.settings, SavedConfig):
            facts = {"trained by": "someone else, and saved as a model folder", "what it is": self.settings.origin}
        elif isinstance(self.settings, OpinionsConfig) and isinstance(metrics, OpinionMetrics):
            facts = {
                "asked by": " ".join(self.run.argv),
                "what it is": f"{metrics.opinions:,} opinions of {self.settings.model} at {self.settings.endpoint}",
                "answered as": ", ".join(metrics.models) or "not said",
                "prompts": f"{metrics.prompts:,}, wording {metrics.template[:12]}",
            }
        elif isinstance(metrics, RecipeMetrics):
            facts = {
                "trained by": " ".join(self.run.argv),
                "what it is": f"rankers on what {metrics.recipes:,} recipes say about recipes held out of them",
                "training": f"{metrics.seconds:.1f} s",
                "settings": ", ".join(f"{name} {value}" for name, value in vars(self.settings).items()),
                **({"cross-fitted": _cross_fitted(metrics)} if metrics.folds else {}),
            }
        elif isinstance(metrics, LinkMetrics):
            facts = {
                "trained by": " ".join(self.run.argv),
                "training": f"{metrics.epochs} epochs, {metrics.seconds:.1f} s, {metrics.parameters:,} parameters",
                "on its own training triples": f"MRR {metrics.train_mrr:.3f}",
                "settings": ", ".join(f"{name} {value}" for name, value in vars(self.settings).items()),
                **({"cross-fitted": _cross_fitted(metrics)} if metrics.folds else {}),
                **({"regularisation chosen": str(metrics.choice)} if metrics.choice else {}),
            }
        if not isinstance(self.settings, SavedConfig | OpinionsConfig) and (
            words := dose_words(self.settings.share, self.settings.noise)
        ):
            facts["learned from"] = words
        return {
            **facts,
            "finished": self.run.ended or "",
            "versions": ", ".join(f"{name} {number}" for name, number in self.run.versions.items()),
            "weights": self.run.outputs[WEIGHTS],
        }


def _cross_fitted(metrics: LinkMetrics | RecipeMetrics) -> str:
    if metrics.fold_mrr is None or metrics.fold_in_sample_mrr is None:
        return f"{metrics.folds} folds"
    return (
        f"{metrics.folds} folds, MRR {metrics.fold_mrr:.3f} on train triples left out of training "
        f"({metrics.fold_in_sample_mrr:.3f} where they were in it)"
    )


def read_dose(folder: str | Path, opened: OpenedGraph, weights: str) -> Dose | None:
    """Return the recipes that the model of a folder was trained on, see :attr:`OpenedModel.dose`.

    The weights are read only if the model was not taught all train recipes as they are.

    Args:
        folder: folder of the model.
        opened: its graph.
        weights: hash of the weights that are meant.

    Returns:
        None if the folder holds other weights.

    Raises:
        ArtefactError: as :func:`open_model` does.
        GraphMismatchError: as :func:`open_model` and :attr:`OpenedModel.dose` do.
    """
    folder = Path(folder)
    run = read_finished_run(folder, MODEL, WEIGHTS)
    if run.outputs[WEIGHTS] != weights:
        return None
    if run.kind == OpinionsConfig.command:
        return opened.dose("none")
    if run.kind != SavedConfig.command:
        verified_bytes(folder, run, "config.toml")
        is_of_recipes = run.kind == RecipesConfig.command
        settings = (RecipeScorerConfig if is_of_recipes else LinksConfig).read(folder).settings
        if not is_dosed(settings.share, settings.noise):
            return opened.dose(settings.kg)
    return open_model(folder, opened.source).dose


def open_model(folder: str | Path, graph: str | None = None) -> OpenedModel:
    """Open a model folder.

    Args:
        folder: folder written by ``train-complex``, ``train-links``, ``ask-opinions`` or ``save_scorer``.
        graph: where its graph is now, if it has moved.

    Raises:
        ArtefactError: if the folder is unfinished or damaged, or its graph is not found.
        GraphMismatchError: if the graph or its split is not the one that the model was trained on.

    Example:
        >>> model = open_model("models/kitchen")
        >>> model.kg, model.opened.graph.name
        ('partial', 'kitchen')
    """
    folder = Path(folder)
    run = read_finished_run(folder, MODEL, WEIGHTS)
    scorer = load_scorer(folder)
    verified_bytes(folder, run, "config.toml")
    if run.kind == SavedConfig.command:
        saved = SavedConfig.read(folder)
        return OpenedModel(scorer, open_run_graph(folder, run, graph or saved.graph), saved, run, None, [])
    if run.kind == OpinionsConfig.command:
        asked = OpinionsConfig.read(folder)
        of_opinions = parse_record(verified_bytes(folder, run, "metrics.json"), OpinionMetrics, folder / "metrics.json")
        return OpenedModel(scorer, open_run_graph(folder, run, graph or asked.graph), asked, run, of_opinions, [])
    if run.kind == RecipesConfig.command:
        of_recipes = RecipeScorerConfig.read(folder)
        opened = open_run_graph(folder, run, graph or of_recipes.graph)
        if isinstance(scorer, CrossFitted):
            scorer.check_split(opened.split)
        figures = parse_record(verified_bytes(folder, run, "metrics.json"), RecipeMetrics, folder / "metrics.json")
        return OpenedModel(scorer, opened, of_recipes.settings, run, figures, [])
    config = LinksConfig.read(folder)
    opened = open_run_graph(folder, run, graph or config.graph)
    if isinstance(scorer, CrossFitted):
        scorer.check_split(opened.split)
    metrics = parse_record(verified_bytes(folder, run, "metrics.json"), LinkMetrics, folder / "metrics.json")
    trace = parse_lines(verified_bytes(folder, run, "trace.jsonl"), TraceRow, folder / "trace.jsonl")
    return OpenedModel(scorer, opened, config.settings, run, metrics, trace)
