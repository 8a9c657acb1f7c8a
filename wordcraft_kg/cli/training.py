"""Shared code of all training commands: train with one seed or several, and print the outcome.

``train`` is what the commands call, with one of the outputs at the end of this file.
"""

import logging
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from wordcraft_kg.agents.config import AgentConfig
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
        compared_with: further words of the command `compare` that is suggested after training with
            several seeds.
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
            product = f"the {self.product} of '{trained.folder}'"
            raise ArtefactError(
                f"{product} cannot be written ({error.strerror or error}). The training is "
                "complete; make space and repeat the command."
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
    """Run a training command: train with one seed or several, and print the outcome.

    Args:
        training: the parts in which training commands differ.
        config: settings of the run.
        out: run folder, or parent folder of several seeds; None for the default.
        force: whether an existing output is replaced.
        output: the command's common options.
        seeds: seeds to train in turn, such as 0-4; None trains with the seed in the settings.
        trackers: names of metric trackers.

    Returns:
        The exit code.

    Raises:
        KeyboardInterrupt: after Ctrl-C; the message says how to continue.
        OutputExistsError: if the folder exists, without ``force``.
    """
    if seeds is not None:
        return _train_seeds(training, config, seeds, out, force, trackers, output)
    if out is not None and (force or training.is_finished(out) or not (out / RUN_FILE).is_file()):
        # Before torch takes seconds to import. An unfinished run is no error: it is continued.
        check_run_output(out, force=force)
    from wordcraft_kg.runs.training import train

    trainer = training.trainer()
    kg = getattr(getattr(config, "settings", None), "kg", None)
    progress = output.progress(f"{kg} graph" if kg else trainer.kind.name, unit=trainer.kind.unit)

    # A complete training without its report, as after a full disk, is not trained again.
    def lacks_product(folder: Path) -> bool:
        return not training.is_finished(folder)

    trained = train(
        trainer, config, out, force=force, keep=lacks_product, trackers=trackers, progress=progress
    )
    # The training of a recipe scorer raises by itself, and its outcome has no such attribute.
    if getattr(trained, "interrupted", False):
        last = next(iter(trainer.kind.checkpoints(trained.folder).records()))
        raise KeyboardInterrupt(interruption_message(trained.folder, trainer.kind.unit, last))
    training.finish_run(trained, config)
    # What a user does next: an agent has its report already.
    following = f"next: {command_line('evaluate-links', trained.folder)}"
    if training.product:
        following = f"open {trained.folder / training.product / 'index.html'}"
    end = f"wrote {trained.folder}/   {following}"
    output.result(training.values(trained), [*aligned(training.rows(trained)), end])
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
    """Train with several seeds in turn, each in a folder of its own; see :func:`train`."""
    # Where the seed is: agents have several groups of settings, models one.
    part = "trainer" if hasattr(config, "trainer") else "settings"
    settings = getattr(config, part)
    if settings.seed:
        raise ConfigError(
            f"--seed {settings.seed} and --seeds {seeds} cannot be combined; use only one."
        )
    configs = {}
    for seed in read_seeds(seeds):
        configs[seed] = replace(config, **{part: replace(settings, seed=seed)})
    from wordcraft_kg.graphs.folder import open_graph
    from wordcraft_kg.runs.training import train_seeds

    trainer = training.trainer()
    parent = config.default_folder(open_graph(config.graph).graph.name) if out is None else out

    def outcomes() -> Iterator[tuple[int, Any]]:
        def progress(seed: int) -> Progress:
            return output.progress(f"seed-{seed}", unit=trainer.kind.unit)

        # One by one: each seed's report is there before the next training begins.
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
    """Return the outcomes by seed.

    Args:
        outcomes: pairs of a seed and its outcome; taking the next one trains.
        number: number of all seeds, for the message.
        force: whether the command replaces existing output, for the message.

    Raises:
        KeyboardInterrupt: after Ctrl-C; the message says how to continue.
    """
    trained: dict[int, Any] = {}
    try:
        for seed, outcome in outcomes:
            if outcome.interrupted:
                raise KeyboardInterrupt
            trained[seed] = outcome
    except KeyboardInterrupt:
        again = "repeat the command to train the rest"
        if force:
            again = (
                "with --force the command trains all seeds again; "
                "leave out --force to keep finished seeds"
            )
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
    ]
    if metrics.outside:
        rows.append(("with", str(metrics.outside)))
    rows += [
        ("time", f"{metrics.seconds:.1f} s, {metrics.seconds_per_epoch:.3f} s per epoch"),
        ("parameters", f"{metrics.parameters:,}"),
        # Memory, not ability: these are the triples that the model was trained on.
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
            "on held-out train recipes no candidate is better than the frequency rule; expect the "
            "same for unseen triples."
        )
    # A model that has converged remembers its training triples far better than this.
    if metrics.train_mrr < 0.1:
        advice = _how_to_fit(LinksConfig.read(trained.folder))
        logging.getLogger(__name__).warning(
            "the model hardly fits the training triples; try %s.", advice
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
    # Only who has not chosen the words gets advice on them.
    if (config.settings.features, metrics.features) == ("auto", "glove"):
        command = ENCODE.replace("GRAPH", shlex.quote(config.graph))
        effect = (
            "a sentence encoder raised success with new goals from .53 to .61 "
            "on the built-in book everyday"
        )
        rows.append(("words", f"glove; {effect}: {command}, then --features"))
    return rows


def _write_agent_report(trained: "TrainedAgent", config: AgentConfig) -> None:
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.agents import group_agents, view_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report

    assert trained.summary is not None
    # A split may have no test tasks at this depth.
    part: TaskPart = "test" if "test" in trained.summary.success else "train"
    view = view_agents(group_agents([open_agent(trained.folder, config.graph)]), part=part)
    write_report(make_agent_report(view), trained.folder / "report", force=True)


def _agent_values(trained: "TrainedAgent") -> Values:
    assert trained.summary is not None
    success = trained.summary.success
    return {
        "out": str(trained.folder),
        "report": str(trained.folder / "report" / "index.html"),
        "preset": AgentConfig.read(trained.folder).trainer.preset,
        **as_values(trained.summary),
        # Flat, for scripts: the record has an object for each part.
        "success": {name: rate.mean for name, rate in success.items()},
        "success_ci": {name: [rate.ci_low, rate.ci_high] for name, rate in success.items()},
    }


def _agent_rows(trained: "TrainedAgent") -> Rows:
    summary = trained.summary
    assert summary is not None
    evaluation = f"{summary.curves_share:.1%} of the time spent on the curves"
    config = AgentConfig.read(trained.folder)
    rows = [
        ("preset", config.describe_preset()),
        ("trained", f"{summary.steps:,} steps in {summary.seconds:.1f} s"),
        ("speed", f"{summary.steps_per_second:,} steps/s; {evaluation}"),
    ]
    distractors = counted(summary.distractors, "distractor")
    for name, rate in summary.success.items():
        success = f"success {rate.mean:.3f} [{rate.ci_low:.3f}, {rate.ci_high:.3f}] greedy"
        seeds = counted(rate.distractor_seeds, "distractor seed")
        rows.append((f"{name} tasks", f"{success}, {rate.tasks:,} tasks, {seeds}, {distractors}"))
    return rows


def _agent_seed_rows(values: dict[int, Values]) -> Rows:
    have_test = all("test" in summary["success"] for summary in values.values())
    part = "test" if have_test else "train"
    rates = []
    rows = []
    for seed, summary in values.items():
        success = summary["success"][part]
        rates.append(success)
        rows.append((f"seed {seed}", f"success {success:.3f} on {part} tasks"))
    mean = sum(rates) / len(rates)
    spread = f"from {min(rates):.3f} to {max(rates):.3f}"
    rows.append(("mean", f"success {mean:.3f}, {spread}"))
    return rows


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
    advice = "more --epochs, another --learning-rate"
    return f"{advice}, or --loop symmetric" if settings.loop == "slcwa" else advice


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
