"""The training commands: train with one seed or several, and print the outcome."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any

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
from wordcraft_kg.runs.record import RUN_FILE
from wordcraft_kg.runs.training import Training, train

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
        "--baseline-cost",
        "--batch-size",
        "--checkpoint-every",
        "--clip",
        "--discount",
        "--distractor-weighting",
        "--dropout",
        "--embedding-size",
        "--entropy-cost",
        "--hidden-size",
        "--key-size",
        "--log-every",
        "--memory-cost",
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
        "--threads",
        "--unroll",
        "--value-readout",
        "--value-size",
        "--vector-noise",
        "--weigh-plans",
    ],
}


Rows = list[tuple[str, str]]
LINKS_TRAINING = "wordcraft_kg.models.links.link_training:LinksTraining"
RECIPES_TRAINING = "wordcraft_kg.models.recipes.recipe_training:RecipesTraining"
AGENT_TRAINING = "wordcraft_kg.agents.agent_training:AgentTraining"
REPORT = "report"
"""Folder of an agent's report in its run folder."""


def run_training(
    trainer_name: str,
    rows_of: Callable[[Any], Rows],
    config: Any,
    out: Path | None,
    force: bool,
    output: Output,
    *,
    seeds: str | None = None,
    track: Sequence[str] | None = None,
) -> int:
    """Run a training command: train with one seed or several, and print the outcome.

    Args:
        trainer_name: module and class of the training; a name, because torch takes seconds to
            import.
        rows_of: returns the outcome of a training as rows of text, each a name and a value.
        config: settings of the run.
        out: run folder, or parent folder of several seeds; None for the default.
        force: whether an existing output is replaced.
        output: the command's common options.
        seeds: seeds to train in turn, such as 0-4, each in a folder of its own; None trains with
            the seed in the settings.
        track: names of metric trackers.

    Returns:
        The exit code.

    Raises:
        KeyboardInterrupt: after Ctrl-C; the message says how to continue.
        OutputExistsError: if the folder exists, without ``force``.
    """
    configs = {"": config} if seeds is None else _configs_of_seeds(config, seeds)
    if seeds is not None:
        out = out or config.default_folder(open_graph(config.graph).graph.name)
        if (out / RUN_FILE).exists():
            raise OutputExistsError(
                f"'{out}' is a single run; several seeds need a folder for all runs. Choose "
                "another `out`."
            )
    trainer: type[Training[Any, Any, Any]] = resolve_name(trainer_name)

    # Seeds that are done are kept. A complete training without its report, as after a full disk, is
    # not trained again.
    def is_kept(folder: Path) -> bool:
        lacks_report = isinstance(config, AgentConfig) and not (folder / REPORT).exists()
        return seeds is not None or lacks_report

    trackers = list(dict.fromkeys(split_labels(track or ())))
    values: dict[str, dict[str, Any]] = {}
    text: list[str] = []
    # One by one: each seed's report is there before the next training begins.
    for name, seed_config in configs.items():
        try:
            trained = train(
                trainer,
                seed_config,
                out and out / name,
                force=force,
                keep=is_kept,
                trackers=trackers,
                progress=output.progress(name or trainer.kind.name, unit=trainer.kind.unit),
            )
            values[name.removeprefix("seed-")] = _values(trained, seed_config)
        except KeyboardInterrupt as stop:
            done = f"{len(values)} of {len(configs)} trainings are done"
            # Without a message, this training has no checkpoint.
            message = str(stop) or f"interrupted; {done}. Repeat the command for the rest."
            if force and (values or str(stop)):
                message += " Leave out --force, which trains all anew."
            raise KeyboardInterrupt(message) from None
        text += [*([name] if name else []), *aligned(rows_of(trained))]
    if seeds is not None:
        # A comparison of agents may begin with one, a comparison of models needs two.
        further = [] if isinstance(config, AgentConfig) else ["ANOTHER"]
        text.append(f"wrote {out}/   next: {command_line('compare', str(out), *further)}")
        output.result({"out": str(out), "seeds": values}, text)
    else:
        following = f"next: {command_line('evaluate-links', trained.folder)}"
        if isinstance(config, AgentConfig):
            following = f"open {trained.folder / REPORT / 'index.html'}"
        text.append(f"wrote {trained.folder}/   {following}")
        output.result(values[""], text)
    return 0


def _configs_of_seeds(config: Any, seeds: str) -> dict[str, Any]:
    """Return the settings for each seed, by the name of its folder."""
    # Where the seed is: agents have several groups of settings, models one.
    part = "trainer" if hasattr(config, "trainer") else "settings"
    settings = getattr(config, part)
    if settings.seed:
        raise ConfigError(
            f"--seed {settings.seed} and --seeds {seeds} cannot be combined; use only one."
        )
    # All before the first training, so that a seed out of range is refused at once.
    return {
        f"seed-{seed}": replace(config, **{part: replace(settings, seed=seed)})
        for seed in whole_numbers("seeds", [seeds])
    }


def _values(trained: Any, config: Any) -> dict[str, Any]:
    """Return an outcome as plain values for JSON; of an agent, also write the report."""
    out = {"out": str(trained.folder)}
    if not isinstance(config, AgentConfig):
        return {**out, **as_values(trained.metrics)}
    if not (trained.folder / REPORT).exists():
        _write_report(trained, config)
    success = trained.summary.success
    return {
        **out,
        "report": str(trained.folder / REPORT / "index.html"),
        "preset": AgentConfig.read(trained.folder).trainer.preset,
        **as_values(trained.summary),
        # Flat, for scripts: the record has an object for each part.
        "success": {name: rate.mean for name, rate in success.items()},
        "success_ci": {name: [rate.ci_low, rate.ci_high] for name, rate in success.items()},
    }


def _write_report(trained: "TrainedAgent", config: AgentConfig) -> None:
    """Write an agent's report.

    Raises:
        ArtefactError: if it cannot be written.
    """
    from wordcraft_kg.agents.agent_folder import open_agent
    from wordcraft_kg.evaluation.agents import group_agents, view_agents
    from wordcraft_kg.reports.agent_report import make_agent_report
    from wordcraft_kg.reports.pages import write_report

    # A split may have no test tasks at this depth.
    part: TaskPart = "test" if "test" in trained.summary.success else "train"
    view = view_agents(group_agents([open_agent(trained.folder, config.graph)]), part=part)
    try:
        write_report(make_agent_report(view), trained.folder / REPORT, force=True)
    except OSError as error:
        raise ArtefactError(
            f"the report of '{trained.folder}' cannot be written ({error.strerror or error}). The "
            "training is complete; make space and repeat the command."
        ) from None


def _link_rows(trained: "TrainedLinks") -> Rows:
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
        logging.getLogger(__name__).warning(
            "the model hardly fits the training triples; try more --epochs."
        )
    return rows


def _recipe_rows(trained: "TrainedRecipes") -> Rows:
    from wordcraft_kg.models.knowledge.outside import describe_source
    from wordcraft_kg.models.recipes.recipe_records import SetMetrics

    metrics = trained.metrics
    if isinstance(metrics, SetMetrics):
        return list(metrics.facts().items())
    return [
        ("learned", f"{metrics.recipes:,} recipes ({metrics.kg} graph) in {metrics.seconds:.1f} s"),
        *_learned_from(metrics),
        *(("with", describe_source(source)) for source in metrics.outside),
        *_ranks(metrics, metrics.fold_in_sample_mrr),
    ]


def _agent_rows(trained: "TrainedAgent") -> Rows:
    summary = trained.summary
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
    config = RecipesConfig(graph, settings)
    return run_training(RECIPES_TRAINING, _recipe_rows, config, out, force, output)


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
    return run_training(
        LINKS_TRAINING, _link_rows, config, out, force, output, seeds=seeds, track=track
    )


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
    return run_training(
        LINKS_TRAINING, _link_rows, config, out, force, output, seeds=seeds, track=track
    )


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
        AGENT_TRAINING, _agent_rows, config, out, force, output, seeds=seeds, track=track
    )
