"""Shared code of all training commands: train with one seed or several, and print the outcome."""

import logging
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned, command_line, read_seeds
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.graphs.train_samples import describe_train_sample
from wordcraft_kg.models.links.config import ComplExConfig, LinksConfig
from wordcraft_kg.models.recipes.config import RecipesConfig
from wordcraft_kg.models.scorers.features import ENCODE
from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.folder import Progress, check_run_output
from wordcraft_kg.runs.interruption import interruption_message
from wordcraft_kg.runs.record import RUN_FILE

if TYPE_CHECKING:
    from wordcraft_kg.agents.config import AgentConfig
    from wordcraft_kg.agents.training import TrainedAgent
    from wordcraft_kg.models.links.records import LinkMetrics
    from wordcraft_kg.models.links.training import TrainedLinks
    from wordcraft_kg.models.recipes.records import RecipeMetrics
    from wordcraft_kg.models.recipes.training import TrainedRecipes
    from wordcraft_kg.runs.training import Training

Values = dict[str, Any]
Rows = list[tuple[str, str]]


@dataclass(frozen=True)
class TrainingOutput:
    """The parts in which training commands differ; torch is imported only when they are used.

    Attributes:
        training_class: module and name of the class that trains.
        rows: converts the outcome of a training to text rows (name, value).
        seed_rows: converts the outcomes of several seeds, as plain values, to text rows.
        values: converts an outcome to plain values for JSON.
        finish: writes further output after training, such as a report.
        product: file or folder name that ``finish`` writes; empty if none.
        compared_with: further words of the command `compare` that is suggested after training with several seeds.
    """

    training_class: str
    rows: Callable[[Any], Rows]
    seed_rows: Callable[[dict[int, Values]], Rows]
    values: Callable[[Any], Values]
    finish: Callable[[Any, Any], None] = lambda trained, config: None
    product: str = ""
    compared_with: tuple[str, ...] = ()

    def trainer(self) -> "type[Training[Any, Any, Any]]":
        """Import the class that trains."""
        trainer: type[Training[Any, Any, Any]] = resolve_name(f"wordcraft_kg.{self.training_class}")
        return trainer

    def is_finished(self, folder: Path) -> bool:
        """Return whether the run folder has the ``product``, such as the report."""
        return (folder / self.product).exists()

    def finish_run(self, trained: Any, config: RunConfig) -> None:
        """Call ``finish``; raise an ArtefactError if the product cannot be written."""
        try:
            self.finish(trained, config)
        except OSError as error:
            reason = f"the {self.product} of '{trained.folder}' cannot be written ({error.strerror or error})"
            raise ArtefactError(
                f"{reason}. The training is complete; make space and repeat the command."
            ) from None


def train(
    training: TrainingOutput,
    config: RunConfig,
    out: Path | None,
    force: bool,
    output: Output,
    *,
    seeds: str | None = None,
    trackers: Sequence[str] = (),
) -> int:
    """Run a training command: train with one seed or several, print the outcome and return the exit code."""
    if seeds is not None:
        return _train_seeds(training, config, seeds, out, force, trackers, output)
    if out is not None and (force or training.is_finished(out) or not (out / RUN_FILE).is_file()):
        check_run_output(out, force=force)  # before torch takes seconds to import
    from wordcraft_kg.runs.training import train

    trainer = training.trainer()
    kg = getattr(getattr(config, "settings", None), "kg", None)
    progress = output.progress(f"{kg} graph" if kg else trainer.kind.name, unit=trainer.kind.unit)

    def lacks_product(folder: Path) -> bool:
        return not training.is_finished(folder)

    trained = train(
        trainer, config, out, force=force, keep=lacks_product, trackers=trackers, progress=progress
    )
    if getattr(trained, "interrupted", False):
        last = next(iter(trainer.kind.checkpoints(trained.folder).records()))
        raise KeyboardInterrupt(interruption_message(trained.folder, trainer.kind.unit, last))
    training.finish_run(trained, config)
    following = f"next: {command_line('evaluate-links', trained.folder)}"
    if training.product:
        following = f"open {trained.folder / training.product / 'index.html'}"
    output.result(
        training.values(trained),
        [*aligned(training.rows(trained)), f"wrote {trained.folder}/   {following}"],
    )
    return 0


def _train_seeds(
    training: TrainingOutput,
    config: Any,
    seeds: str,
    out: Path | None,
    force: bool,
    trackers: Sequence[str],
    output: Output,
) -> int:
    part = "trainer" if hasattr(config, "trainer") else "settings"
    settings = getattr(config, part)
    if settings.seed:
        raise ConfigError(
            f"--seed {settings.seed} and --seeds {seeds} cannot be combined; use only one."
        )
    configs = {
        seed: replace(config, **{part: replace(settings, seed=seed)}) for seed in read_seeds(seeds)
    }
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.runs.training import train_seeds

    trainer = training.trainer()
    parent = config.default_folder(open_graph(config.graph).graph.name) if out is None else out

    def outcomes() -> Iterator[tuple[int, Any]]:
        def progress(seed: int) -> Progress:
            return output.progress(f"seed-{seed}", unit=trainer.kind.unit)

        for seed, trained in train_seeds(
            trainer, configs, parent, force=force, trackers=trackers, progress=progress
        ):
            if not trained.interrupted and not training.is_finished(trained.folder):
                training.finish_run(trained, config)
            yield seed, trained

    outcome_of = _until_interrupted(outcomes(), len(configs), force)
    values = {seed: training.values(outcome) for seed, outcome in outcome_of.items()}
    following = command_line("compare", parent, *training.compared_with)
    end = f"wrote {parent}/   next: {following}"
    by_seed = {str(seed): outcome for seed, outcome in values.items()}
    output.result(
        {"out": str(parent), "seeds": by_seed}, [*aligned(training.seed_rows(values)), end]
    )
    return 0


def _until_interrupted(
    outcomes: Iterator[tuple[int, Any]], number: int, force: bool
) -> dict[int, Any]:
    trained: dict[int, Any] = {}
    try:
        for seed, outcome in outcomes:
            if outcome.interrupted:
                raise KeyboardInterrupt
            trained[seed] = outcome
    except KeyboardInterrupt:
        again = "repeat the command to train the rest"
        if force:
            again = "with --force the command trains all seeds again; leave out --force to keep finished seeds"
        message = f"interrupted; {len(trained)} of {number} seeds are done, {again}"
        raise KeyboardInterrupt(message) from None
    return trained


def _metrics(trained: "TrainedLinks | TrainedRecipes") -> Values:
    return {"out": str(trained.folder), **as_values(trained.metrics)}


def _link_rows(trained: "TrainedLinks") -> Rows:
    metrics = trained.metrics
    assert metrics is not None
    rows = [
        ("trained", f"{metrics.epochs} epochs on {metrics.triples:,} triples ({metrics.kg} graph)"),
        *_learned_from(metrics),
        *([("with", str(metrics.outside))] if metrics.outside else []),
        ("time", f"{metrics.seconds:.1f} s, {metrics.seconds_per_epoch:.3f} s per epoch"),
        ("parameters", f"{metrics.parameters:,}"),
        ("train MRR", f"{metrics.train_mrr:.3f} on training triples (memory)"),
    ]
    if metrics.choice:
        rows.append(("chosen", str(metrics.choice)))
    rows += _folds(metrics)
    if metrics.valid_mrr is not None:
        rows.append(
            ("valid MRR", f"{metrics.valid_mrr:.3f} at best, in epoch {metrics.best_epoch}")
        )
    if metrics.choice and not metrics.choice.beats_counting:
        logging.getLogger(__name__).warning(
            "on held-out train recipes no candidate is better than the frequency rule; expect the same for unseen "
            "triples."
        )
    if metrics.train_mrr < 0.1:
        logging.getLogger(__name__).warning(
            "the model hardly fits the training triples; try %s.",
            _how_to_fit(LinksConfig.read(trained.folder)),
        )
    return rows


def _link_seed_rows(values: dict[int, Values]) -> Rows:
    text = "train MRR {train_mrr:.3f} (memory), {epochs} epochs"
    return [(f"seed {seed}", text.format_map(metrics)) for seed, metrics in values.items()]


def _recipe_rows(trained: "TrainedRecipes") -> Rows:
    from wordcraft_kg.models.recipes.outside import describe_source

    metrics = trained.metrics
    rows = [
        ("fitted", f"{metrics.recipes:,} recipes ({metrics.kg} graph)"),
        *_learned_from(metrics),
        *(("with", describe_source(source)) for source in metrics.outside),
        ("time", f"{metrics.seconds:.1f} s"),
        *_folds(metrics),
    ]
    config = RecipesConfig.read(trained.folder)
    if (config.settings.features, metrics.features) == ("auto", "glove"):
        command = ENCODE.replace("GRAPH", shlex.quote(config.graph))
        effect = "a sentence encoder raised success with new goals from .53 to .61 on the built-in book everyday"
        rows.append(("words", f"glove; {effect}: {command}, then --features"))
    return rows


def _write_agent_report(trained: "TrainedAgent", config: "AgentConfig") -> None:
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.agents import group_agents, view_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report

    assert trained.summary is not None
    part: TaskPart = "test" if "test" in trained.summary.success else "train"
    view = view_agents(group_agents([open_agent(trained.folder, config.graph)]), part=part)
    write_report(make_agent_report(view), trained.folder / "report", force=True)


def _agent_values(trained: "TrainedAgent") -> Values:
    assert trained.summary is not None
    success = trained.summary.success
    return {
        "out": str(trained.folder),
        "report": str(trained.folder / "report" / "index.html"),
        **as_values(trained.summary),
        "success": {name: rate.mean for name, rate in success.items()},
        "success_ci": {name: [rate.ci_low, rate.ci_high] for name, rate in success.items()},
    }


def _agent_rows(trained: "TrainedAgent") -> Rows:
    summary = trained.summary
    assert summary is not None
    evaluation = f"{summary.curves_share:.1%} of the time spent on the curves"
    return [
        ("trained", f"{summary.steps:,} steps in {summary.seconds:.1f} s"),
        ("speed", f"{summary.steps_per_second:,} steps/s; {evaluation}"),
        *(
            (
                f"{name} tasks",
                f"success {rate.mean:.3f} [{rate.ci_low:.3f}, {rate.ci_high:.3f}] greedy, {rate.tasks:,} tasks, "
                f"{counted(rate.distractor_seeds, 'distractor seed')}, {counted(summary.distractors, 'distractor')}",
            )
            for name, rate in summary.success.items()
        ),
    ]


def _agent_seed_rows(values: dict[int, Values]) -> Rows:
    part = "test" if all("test" in summary["success"] for summary in values.values()) else "train"
    rates = {seed: summary["success"][part] for seed, summary in values.items()}
    spread = f"from {min(rates.values()):.3f} to {max(rates.values()):.3f}"
    return [
        *(
            (f"seed {seed}", f"success {success:.3f} on {part} tasks")
            for seed, success in rates.items()
        ),
        ("mean", f"success {sum(rates.values()) / len(rates):.3f}, {spread}"),
    ]


def _learned_from(metrics: "LinkMetrics | RecipeMetrics") -> Rows:
    words = describe_train_sample(metrics.train_fraction, metrics.label_noise)
    return [("from", words)] if words else []


def _folds(metrics: "LinkMetrics | RecipeMetrics") -> Rows:
    if metrics.fold_mrr is None:
        return []
    figures = f"{metrics.fold_mrr:.3f} out-of-sample, {metrics.fold_in_sample_mrr:.3f} in-sample"
    return [("folds", f"{metrics.folds}; MRR on train triples {figures}")]


def _how_to_fit(config: LinksConfig) -> str:
    settings = config.settings
    if isinstance(settings, ComplExConfig):
        return "more --epochs, a larger --dim, or a smaller --n3"
    return "more --epochs, another --learning-rate" + (
        ", or --loop symmetric" if settings.loop == "slcwa" else ""
    )


LINKS = TrainingOutput(
    "models.links.training:LinksTraining",
    _link_rows,
    _link_seed_rows,
    _metrics,
    compared_with=("ANOTHER",),
)
RECIPES = TrainingOutput(
    "models.recipes.training:RecipesTraining", _recipe_rows, lambda values: [], _metrics
)
AGENTS = TrainingOutput(
    "agents.training:AgentTraining",
    _agent_rows,
    _agent_seed_rows,
    _agent_values,
    _write_agent_report,
    product="report",
)
