"""The training commands: train with one seed or several, and print the outcome."""

import logging
import shlex
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from cyclopts import Parameter

from wordcraft_kg.agents.agent_config import AgentConfig, ImpalaConfig, TaskConfig
from wordcraft_kg.base import ArtefactError, ConfigError, OutputExistsError, as_values, counted
from wordcraft_kg.cli.console import (
    Output,
    aligned,
    command_line,
    split_labels,
    whole_numbers,
)
from wordcraft_kg.cli.options import Force, Graph, Seeds, Trackers
from wordcraft_kg.graphs import TaskPart, describe_train_sample, open_graph
from wordcraft_kg.models.links.link_config import ComplExConfig, LinkModelConfig, LinksConfig
from wordcraft_kg.models.policies.policy_config import PolicyConfig
from wordcraft_kg.models.recipes.recipe_config import RecipesConfig, RecipeScorerConfig
from wordcraft_kg.models.scorers.features import ENCODE
from wordcraft_kg.runs.config_file import RunConfig
from wordcraft_kg.runs.record import RUN_FILE
from wordcraft_kg.runs.run_folder import Progress, check_run_output, interruption_message
from wordcraft_kg.runs.training import Training, begun_run

if TYPE_CHECKING:
    from wordcraft_kg.agents.agent_training import TrainedAgent
    from wordcraft_kg.models.links.link_records import LinkMetrics
    from wordcraft_kg.models.links.link_training import TrainedLinks
    from wordcraft_kg.models.recipes.recipe_records import RecipeMetrics, TrainedRecipes

EXAMPLES = {
    "train-recipes": (
        "wordcraft-kg train-recipes everyday --out models/everyday-recipes",
        "wordcraft-kg train-recipes everyday --folds 10 --out models/everyday-recipes-10",
        "wordcraft-kg train-recipes everyday --features one-hot --out models/everyday-no-words",
    ),
    "train-complex": (
        "wordcraft-kg train-complex everyday --out models/everyday",
        "wordcraft-kg train-complex everyday --kg full --seed 1 --out models/everyday-full",
        "wordcraft-kg train-complex everyday --seeds 0-4 --out models/everyday-seeds",
        "wordcraft-kg train-complex graphs/mine --with knowledge/wn --out models/mine-wn",
    ),
    "train-links": (
        "wordcraft-kg train-links everyday --model rotate --out models/everyday-rotate",
        "wordcraft-kg train-links everyday --model distmult --loop symmetric --out "
        "models/everyday-distmult",
        "wordcraft-kg train-links everyday --model rotate --seeds 0,1 --out models/rotate-seeds",
    ),
    "train-agent": (
        "wordcraft-kg train-agent everyday --out runs/no-kg",
        "wordcraft-kg train-agent graphs/everyday --scorer models/everyday --out runs/partial",
        "wordcraft-kg train-agent everyday --seeds 0-4 --out runs/no-kg-seeds",
    ),
}
FILE_ONLY = {
    # For comparisons: studies train on less or worse.
    "train-recipes": ["--label-noise", "--threads", "--train-fraction"],
    # Chosen once for all by studies.
    "train-complex": [
        "--batch-size",
        "--checkpoint-every",
        "--init-scale",
        "--label-noise",
        "--learning-rate",
        "--popularity",
        "--threads",
        "--train-fraction",
    ],
    # Chosen once for all by studies.
    "train-links": [
        "--batch-size",
        "--checkpoint-every",
        "--label-noise",
        "--threads",
        "--train-fraction",
    ],
    # Settings of the paper's released code, or chosen once for all by studies.
    "train-agent": [
        "--ambiguity",
        "--baseline-cost",
        "--batch-size",
        "--checkpoint-every",
        "--clip",
        "--compile",
        "--discount",
        "--distractor-policy",
        "--distractor-weighting",
        "--dropout",
        "--embedding-size",
        "--entropy-cost",
        "--hidden-size",
        "--key-size",
        "--log-every",
        "--memory-cost",
        "--momentum",
        "--pair-size",
        "--pays-held-out",
        "--plan-width",
        "--policy-lag",
        "--pooling",
        "--rms-decay",
        "--rms-epsilon",
        "--scale",
        "--scorer-cost",
        "--sees-attempts",
        "--self-edges",
        "--tables",
        "--task-weighting",
        "--threads",
        "--unroll",
        "--value-readout",
        "--value-size",
        "--vector-noise",
        "--weigh-plans",
    ],
}


Values = dict[str, Any]
Rows = list[tuple[str, str]]


class TrainingCommand(ABC):
    """The parts in which training commands differ.

    Attributes:
        product: file or folder that :meth:`finish` writes; empty if none.
        compared_with: further words of the command `compare` that is suggested after training with
            several seeds.
    """

    product: ClassVar[str] = ""
    compared_with: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def trainer(self) -> type[Training[Any, Any, Any]]:
        """Import the class that trains; a method, because torch takes seconds to import."""

    @abstractmethod
    def rows(self, trained: Any) -> Rows:
        """Return the outcome of a training as text rows (name, value)."""

    def seed_rows(self, values: dict[str, Values]) -> Rows:
        """Return the outcomes of several seeds, as plain values, as text rows."""
        return []

    def values(self, trained: Any) -> Values:
        """Return an outcome as plain values for JSON."""
        return {"out": str(trained.folder), **as_values(trained.metrics)}

    def finish(self, trained: Any, config: Any) -> None:  # noqa: B027 - optional
        """Write further output after training, such as a report.

        Raises:
            ArtefactError: if it cannot be written.
        """

    def is_finished(self, folder: Path) -> bool:
        """Return whether the run folder has the ``product``, such as the report."""
        return (folder / self.product).exists()


def run_training(
    command: TrainingCommand,
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
        command: the kind of training.
        config: settings of the run.
        out: run folder, or parent folder of several seeds; None for the default.
        force: whether an existing output is replaced.
        output: the command's common options.
        seeds: seeds to train in turn, such as 0-4, each in a folder of its own; None trains with
            the seed in the settings.
        trackers: names of metric trackers.

    Returns:
        The exit code.

    Raises:
        KeyboardInterrupt: after Ctrl-C; the message says how to continue.
        OutputExistsError: if the folder exists, without ``force``.
    """
    if seeds is not None:
        return _train_seeds(command, config, seeds, out, force, trackers, output)
    if out is not None and (force or command.is_finished(out) or not (out / RUN_FILE).is_file()):
        # Before torch takes seconds to import. An unfinished run is no error: it is continued.
        check_run_output(out, force=force)
    kind = command.trainer().kind
    kg = getattr(getattr(config, "settings", None), "kg", None)
    progress = output.progress(f"{kg} graph" if kg else kind.name, unit=kind.unit)

    # A complete training without its report, as after a full disk, is not trained again.
    def lacks_product(folder: Path) -> bool:
        return not command.is_finished(folder)

    trained = _train(command, config, out, force, lacks_product, trackers, progress)
    # What a user does next: an agent has its report already.
    following = f"next: {command_line('evaluate-links', trained.folder)}"
    if command.product:
        following = f"open {trained.folder / command.product / 'index.html'}"
    end = f"wrote {trained.folder}/   {following}"
    output.result(command.values(trained), [*aligned(command.rows(trained)), end])
    return 0


def _train(
    command: TrainingCommand,
    config: RunConfig,
    folder: Path | None,
    force: bool,
    keep: bool | Callable[[Path], bool],
    trackers: Sequence[str],
    progress: Progress,
) -> Any:
    """Train with one seed, and write what the command adds, such as a report."""
    trainer = command.trainer()
    run = begun_run(
        trainer, config, folder, force=force, keep=keep, trackers=trackers, progress=progress
    )
    with run as fit:
        trained = fit()
    # Other trainings raise by themselves, and their outcomes have no such attribute.
    if getattr(trained, "interrupted", False):
        last = next(iter(trainer.kind.checkpoints(trained.folder).records()))
        raise KeyboardInterrupt(interruption_message(trained.folder, trainer.kind.unit, last))
    if not command.is_finished(trained.folder):
        command.finish(trained, config)
    return trained


def _train_seeds(
    command: TrainingCommand,
    config: Any,
    seeds: str,
    out: Path | None,
    force: bool,
    trackers: Sequence[str],
    output: Output,
) -> int:
    """Train with several seeds in turn, each in a folder of its own; see :func:`run_training`."""
    # Where the seed is: agents have several groups of settings, models one.
    part = "trainer" if hasattr(config, "trainer") else "settings"
    settings = getattr(config, part)
    if settings.seed:
        raise ConfigError(
            f"--seed {settings.seed} and --seeds {seeds} cannot be combined; use only one."
        )
    # All before the first training, so that a seed out of range is refused at once.
    configs = {
        seed: replace(config, **{part: replace(settings, seed=seed)})
        for seed in whole_numbers("seeds", [seeds])
    }
    parent = config.default_folder(open_graph(config.graph).graph.name) if out is None else out
    if (parent / RUN_FILE).exists():
        raise OutputExistsError(
            f"'{parent}' is a single run; several seeds need a folder for all runs. Choose another "
            "`out`."
        )
    values: dict[str, Values] = {}
    try:
        # One by one: each seed's report is there before the next training begins.
        for seed, seed_config in configs.items():
            name = f"seed-{seed}"
            progress = output.progress(name, unit=command.trainer().kind.unit)
            trained = _train(command, seed_config, parent / name, force, True, trackers, progress)
            values[str(seed)] = command.values(trained)
    except KeyboardInterrupt:
        advice = "repeat the command to train the rest"
        if force:
            advice = (
                "with --force the command trains all seeds again; "
                "leave out --force to keep finished seeds"
            )
        progress_so_far = f"{len(values)} of {len(configs)} seeds are done"
        raise KeyboardInterrupt(f"interrupted; {progress_so_far}, {advice}") from None
    following = command_line("compare", parent, *command.compared_with)
    end = f"wrote {parent}/   next: {following}"
    output.result({"out": str(parent), "seeds": values}, [*aligned(command.seed_rows(values)), end])
    return 0


class LinkTraining(TrainingCommand):
    """Trainings of link predictors: ``train-complex`` and ``train-links``."""

    compared_with = ("ANOTHER",)

    def trainer(self) -> type[Training[Any, Any, Any]]:  # noqa: D102
        from wordcraft_kg.models.links.link_training import LinksTraining

        return LinksTraining

    def rows(self, trained: "TrainedLinks") -> Rows:  # noqa: D102
        metrics = trained.metrics
        triples = f"{metrics.triples:,} triples ({metrics.kg} graph)"
        rows = [
            ("learned", f"{triples}, {metrics.epochs} epochs in {metrics.seconds:.1f} s"),
            *_learned_from(metrics),
        ]
        if metrics.outside:
            rows.append(("with", str(metrics.outside)))
        rows += _ranks(metrics, metrics.train_mrr)
        # A model that has converged remembers its training triples far better than this.
        if metrics.train_mrr < 0.1:
            advice = _how_to_fit(LinksConfig.read(trained.folder))
            logging.getLogger(__name__).warning(
                "the model hardly fits the training triples; try %s.", advice
            )
        return rows

    def seed_rows(self, values: dict[str, Values]) -> Rows:  # noqa: D102
        text = "links of learned recipes: MRR {train_mrr:.3f}, {epochs} epochs"
        return [(f"seed {seed}", text.format_map(metrics)) for seed, metrics in values.items()]


class RecipeTraining(TrainingCommand):
    """The training of recipe scorers, ``train-recipes``."""

    def trainer(self) -> type[Training[Any, Any, Any]]:  # noqa: D102
        from wordcraft_kg.models.recipes.recipe_training import RecipesTraining

        return RecipesTraining

    def rows(self, trained: "TrainedRecipes") -> Rows:  # noqa: D102
        from wordcraft_kg.models.knowledge.outside import describe_source
        from wordcraft_kg.models.recipes.recipe_records import SetMetrics

        metrics = trained.metrics
        if isinstance(metrics, SetMetrics):
            return list(metrics.facts().items())
        rows = [
            (
                "learned",
                f"{metrics.recipes:,} recipes ({metrics.kg} graph) in {metrics.seconds:.1f} s",
            ),
            *_learned_from(metrics),
            *(("with", describe_source(source)) for source in metrics.outside),
            *_ranks(metrics, metrics.fold_in_sample_mrr),
        ]
        config = RecipesConfig.read(trained.folder)
        # Only who has not chosen the words gets advice on them.
        if (config.settings.features, metrics.features) == ("auto", "glove"):
            command = ENCODE.replace("GRAPH", shlex.quote(str(config.graph)))
            effect = (
                "a sentence encoder raised success with new goals from .53 to .61 "
                "on the built-in book everyday"
            )
            rows.append(("words", f"glove; {effect}: {command}, then --features"))
        return rows


class AgentsTraining(TrainingCommand):
    """The training of agents, ``train-agent``."""

    product = "report"

    def trainer(self) -> type[Training[Any, Any, Any]]:  # noqa: D102
        from wordcraft_kg.agents.agent_training import AgentTraining

        return AgentTraining

    def rows(self, trained: "TrainedAgent") -> Rows:  # noqa: D102
        summary = trained.summary
        assert summary is not None
        preset = AgentConfig.read(trained.folder).trainer.preset
        rows = [("trained", f"{summary.steps:,} steps in {summary.seconds:.1f} s, preset {preset}")]
        distractors = counted(summary.distractors, "distractor")
        for name, rate in summary.success.items():
            success = f"{rate.mean:.3f} of the goals made [{rate.ci_low:.3f}, {rate.ci_high:.3f}]"
            tables = counted(rate.distractor_seeds, "table")
            rows.append(
                (f"{name} tasks", f"{success}: {rate.tasks:,} tasks, {tables} each, {distractors}")
            )
        return rows

    def seed_rows(self, values: dict[str, Values]) -> Rows:  # noqa: D102
        have_test = all("test" in summary["success"] for summary in values.values())
        part = "test" if have_test else "train"
        rates = {seed: summary["success"][part] for seed, summary in values.items()}
        mean = sum(rates.values()) / len(rates)
        spread = f"from {min(rates.values()):.3f} to {max(rates.values()):.3f}"
        rows = [
            (f"seed {seed}", f"success {rate:.3f} on {part} tasks") for seed, rate in rates.items()
        ]
        rows.append(("mean", f"success {mean:.3f}, {spread}"))
        return rows

    def values(self, trained: "TrainedAgent") -> Values:  # noqa: D102
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

    def finish(self, trained: "TrainedAgent", config: AgentConfig) -> None:  # noqa: D102
        from wordcraft_kg.agents.agent_folder import open_agent
        from wordcraft_kg.evaluation.agents import group_agents, view_agents
        from wordcraft_kg.reports.agent_report import make_agent_report
        from wordcraft_kg.reports.pages import write_report

        assert trained.summary is not None
        # A split may have no test tasks at this depth.
        part: TaskPart = "test" if "test" in trained.summary.success else "train"
        view = view_agents(group_agents([open_agent(trained.folder, config.graph)]), part=part)
        try:
            write_report(make_agent_report(view), trained.folder / self.product, force=True)
        except OSError as error:
            raise ArtefactError(
                f"the {self.product} of '{trained.folder}' cannot be written "
                f"({error.strerror or error}). The training is complete; make space and repeat "
                "the command."
            ) from None


def _learned_from(metrics: "LinkMetrics | RecipeMetrics") -> Rows:
    words = describe_train_sample(metrics.train_fraction, metrics.label_noise)
    return [("from", words)] if words else []


def _ranks(metrics: "LinkMetrics | RecipeMetrics", train_mrr: float | None) -> Rows:
    rows = []
    if train_mrr is not None:
        rows.append(("memory", f"links of learned recipes: MRR {train_mrr:.3f}"))
    if metrics.fold_mrr:
        # The reciprocal of the mean reciprocal rank is the harmonic mean of the ranks.
        mrr = f"MRR {metrics.fold_mrr:.3f} (about rank {1 / metrics.fold_mrr:.0f})"
        rows.append(("unseen", f"links of recipes left out in turn: {mrr}"))
    return rows


def _how_to_fit(config: LinksConfig) -> str:
    settings = config.settings
    if isinstance(settings, ComplExConfig):
        return "more --epochs, a larger --dim, or a smaller --n3"
    advice = "more --epochs, another --learning-rate"
    return f"{advice}, or --loop symmetric" if settings.loop == "slcwa" else advice


def train_recipes(
    graph: Graph,
    *,
    settings: Annotated[
        RecipeScorerConfig, Parameter(name="*", negative_iterable="")
    ] = RecipeScorerConfig(),
    out: Path | None = None,
    force: Force = False,
    output: Output = Output(),
) -> int:
    """Fit a recipe scorer: how plausible is a result for its ingredients, and why?

    For pairs, agents can use it as a third knowledge source (train-agent --use
    combines,component,recipe), and link commands accept it too. On a book of larger sets, or with
    --parts, it ranks whole sets for a goal (suggest). Only train recipes support a score.

    Args:
        out: model folder to write. Default: models/<graph name>-recipes.
    """
    return run_training(RecipeTraining(), RecipesConfig(graph, settings), out, force, output)


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
    return run_training(LinkTraining(), config, out, force, output, seeds=seeds, trackers=trackers)


def train_links(
    graph: Graph,
    *,
    settings: Annotated[LinkModelConfig, Parameter(name="*")] = LinkModelConfig(),
    seeds: Seeds = None,
    out: Path | None = None,
    force: Force = False,
    track: Trackers = None,
    output: Output = Output(),
) -> int:
    """Train any other PyKEEN model; the same reports and commands apply as for ComplEx.

    Args:
        out: model folder to write. Default: models/<graph name>-<model>-<kg>.
    """
    config = LinksConfig(graph, settings)
    trackers = split_labels(track or ())
    return run_training(LinkTraining(), config, out, force, output, seeds=seeds, trackers=trackers)


def train_agent(  # noqa: PLR0913 - parameters are the command's options
    graph: Graph,
    *,
    scorer: Path | None = None,
    tasks: Annotated[TaskConfig, Parameter(name="*", group="Tasks")] = TaskConfig(),
    policy: Annotated[PolicyConfig, Parameter(name="*", group="Policy")] = PolicyConfig(),
    trainer: Annotated[ImpalaConfig, Parameter(name="*", group="Training")] = ImpalaConfig(),
    seeds: Seeds = None,
    out: Path | None = None,
    force: Force = False,
    track: Trackers = None,
    output: Output = Output(),
) -> int:
    """Train an agent with IMPALA on the crafting tasks of a graph, alone or guided by a scorer.

    Args:
        scorer: model folder with scores to mix into the policy; the scorer is not trained.
        out: run folder to write. Default: runs/<graph name>-<scorer folder or no-kg>.
    """
    config = AgentConfig(graph, None if scorer is None else str(scorer), tasks, policy, trainer)
    config.check_preset()
    return run_training(
        AgentsTraining(),
        config,
        out,
        force,
        output,
        seeds=seeds,
        trackers=split_labels(track or ()),
    )
